"""Small neural network that corrects the errors that remain after calibration."""

from casadical.compensator.compensator import Compensator, train
from casadical.compensator.iwo import InvasiveWeeds, IwoSettings, iwo_minimise
from casadical.compensator.layout import JointBox, Layout
from casadical.compensator.network import Network, make_task
from casadical.compensator.saving import load_compensator, save_compensator
from casadical.compensator.trainers import *  # noqa: F403 - every trainer, by its line there
from casadical.compensator.trainers.base import Trainer

__all__ = [
    "Compensator",
    "InvasiveWeeds",
    "IwoSettings",
    "JointBox",
    "Layout",
    "Network",
    "Trainer",
    "iwo_minimise",
    "load_compensator",
    "make_task",
    "save_compensator",
    "train",
]
