"""Trainers by name and by method: those of the registry and of installed plug-ins.

A plug-in is a class in another package, under an entry point of its `name`:

    [project.entry-points."casadical.trainers"]
    my-trainer = "my_package:MyTrainer"
"""

from collections.abc import Mapping
from functools import cache

from casadical.compensator.trainers import registry
from casadical.compensator.trainers.base import Trainer
from casadical.core.basics import InputError
from casadical.core.plugins import members

GROUP = "casadical.trainers"


@cache
def known_trainers() -> Mapping[str, type[Trainer]]:
    """Every trainer by its name, those of plug-ins last. Raises InputError: a faulty plug-in."""
    own = (kind for kind in vars(registry).values() if isinstance(kind, type))
    trainers = members(GROUP, Trainer, own)  # type: ignore[type-abstract]
    methods = [kind.method for kind in trainers.values() if kind.method]
    if taken := {method for method in methods if methods.count(method) > 1}:
        raise InputError(f"two trainers have the method {min(taken)!r}; rename it in the plug-in, or uninstall one")
    return trainers


def network_methods() -> Mapping[str, type[Trainer]]:
    """Trainers by the method of problem.toml that each stands for. Raises InputError: a faulty plug-in."""
    return {kind.method: kind for kind in known_trainers().values() if kind.method}


def trainer_named(trainer: Trainer | str) -> Trainer:
    """A trainer as it is, or the one of this name with its default settings. Raises InputError."""
    if isinstance(trainer, Trainer):
        return trainer
    if trainer not in known_trainers():
        raise InputError(f"there is no trainer {trainer!r}; there are {', '.join(known_trainers())}")
    return known_trainers()[trainer]()
