"""Trainers of the compensator network, in the order in which their methods run."""
# ruff: noqa: I001

from casadical.compensator.trainers.levenberg_marquardt import Backprop as Backprop
from casadical.compensator.iwo import Iwo as Iwo
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt as LevenbergMarquardt
from casadical.compensator.iwo import IwoThenLm as IwoThenLm
from casadical.compensator.trainers.distilled import Taught as Taught
