"""A small network that learns what calibration leaves. Stands alone: it loads no kinematics."""

from casadical.compensator.compensator import Compensator
from casadical.compensator.iwo import InvasiveWeeds, IwoHistory, IwoResult, IwoSettings, iwo_minimise
from casadical.compensator.layout import JointBox, Layout
from casadical.compensator.network import Network
from casadical.compensator.report import BeforeAfter, Errors
from casadical.compensator.saving import compensator_text, load_compensator, save_compensator
from casadical.compensator.task import Loss, Task, make_task
from casadical.compensator.trainers import TRAINERS, Backprop, Iwo, IwoThenLm, LevenbergMarquardt, Taught, Trainer
from casadical.compensator.training import Progress, Training, train, train_all

__all__ = [
    "TRAINERS",
    "Backprop",
    "BeforeAfter",
    "Compensator",
    "Errors",
    "InvasiveWeeds",
    "Iwo",
    "IwoHistory",
    "IwoResult",
    "IwoSettings",
    "IwoThenLm",
    "JointBox",
    "Layout",
    "LevenbergMarquardt",
    "Loss",
    "Network",
    "Progress",
    "Task",
    "Taught",
    "Trainer",
    "Training",
    "compensator_text",
    "iwo_minimise",
    "load_compensator",
    "make_task",
    "save_compensator",
    "train",
    "train_all",
]
