"""Registry of the trainers by name, and by the method of problem.toml."""

from collections.abc import Mapping

from casadical.compensator.trainers import Backprop, Iwo, IwoThenLm, LevenbergMarquardt, Taught
from casadical.compensator.trainers.base import Trainer
from casadical.core.basics import InputError

# Classes of all trainers, in the order in which their methods run.
_TRAINERS = (Backprop, Iwo, LevenbergMarquardt, IwoThenLm, Taught)


def trainers_by_name() -> Mapping[str, type[Trainer]]:
    """Return the class of every trainer by its short name, such as "lm"."""
    return {kind.name: kind for kind in _TRAINERS}


def network_methods() -> Mapping[str, type[Trainer]]:
    """Return the class of every trainer by its method in problem.toml, such as "LM-NN-SKCM"."""
    return {kind.method: kind for kind in _TRAINERS}


def trainer_named(trainer: Trainer | str) -> Trainer:
    """Return a trainer unchanged, or the one of this name with its default settings.

    Raises InputError: there is none of this name.
    """
    if isinstance(trainer, Trainer):
        return trainer
    if trainer not in trainers_by_name():
        raise InputError(f"there is no trainer {trainer!r}; there are {', '.join(trainers_by_name())}")
    return trainers_by_name()[trainer]()
