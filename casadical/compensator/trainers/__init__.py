"""The ways to train a network, one small file each."""

from casadical.compensator.trainers.backprop import Backprop
from casadical.compensator.trainers.base import Run, Trainer
from casadical.compensator.trainers.distilled import Taught
from casadical.compensator.trainers.iwo import Iwo
from casadical.compensator.trainers.iwo_lm import IwoThenLm
from casadical.compensator.trainers.lm import LevenbergMarquardt
from casadical.core.errors import InputError

__all__ = [
    "TRAINERS",
    "Backprop",
    "Iwo",
    "IwoThenLm",
    "LevenbergMarquardt",
    "Run",
    "Taught",
    "Trainer",
    "trainer_named",
]

TRAINERS: dict[str, type[Trainer]] = {
    "iwo": Iwo,
    "backprop": Backprop,
    "lm": LevenbergMarquardt,
    "iwo-lm": IwoThenLm,
    "taught": Taught,
}


def trainer_named(trainer: Trainer | str) -> Trainer:
    """Return a trainer as it is, or the one of this name with default settings. Raises InputError for other names."""
    if isinstance(trainer, Trainer):
        return trainer
    if trainer not in TRAINERS:
        raise InputError(f"there is no trainer {trainer!r}; there are {', '.join(TRAINERS)}")
    return TRAINERS[trainer]()
