"""A small network that learns the error left after calibration. It can be used alone: it loads no kinematics."""

from casadical.compensator.compensator import Compensator
from casadical.compensator.iwo import InvasiveWeeds, IwoHistory, IwoResult, iwo_minimise
from casadical.compensator.iwo_settings import IwoSettings
from casadical.compensator.layout import JointBox, Layout
from casadical.compensator.network import Network
from casadical.compensator.report import BeforeAfter, Errors
from casadical.compensator.saving import compensator_text, load_compensator, save_compensator
from casadical.compensator.task import Loss, Task, make_task
from casadical.compensator.trainers.base import Trainer
from casadical.compensator.trainers.known import known_trainers, network_methods
from casadical.compensator.trainers.registry import *  # noqa: F403 - every trainer, by its line there
from casadical.compensator.training import Progress, Training, train, train_all

__all__ = [
    "BeforeAfter",
    "Compensator",
    "Errors",
    "InvasiveWeeds",
    "IwoHistory",
    "IwoResult",
    "IwoSettings",
    "JointBox",
    "Layout",
    "Loss",
    "Network",
    "Progress",
    "Task",
    "Trainer",
    "Training",
    "compensator_text",
    "iwo_minimise",
    "known_trainers",
    "load_compensator",
    "make_task",
    "network_methods",
    "save_compensator",
    "train",
    "train_all",
]
