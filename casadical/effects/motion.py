"""Causes that act in a joint log: formulas of what was logged, at torques and at the servos' position errors.

A torque is in shares of the joint's great torque in the log, a response in rad (or m): command less reading. At the
seams `torques` and `responses` a formula is taken for every joint, else for the cause's own.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from casadical.core.basics import Array
from casadical.effects.definition import DefinedEffect, read_definitions
from casadical.effects.formula import NUMERIC
from casadical.effects.plugins import known_effects

# A cause that may be asked for, with all settings of its own.
Cause = type[DefinedEffect]
LISTED = Path(__file__).with_name("motion.effect.toml")


@cache
def motion_effects() -> Mapping[str, type[DefinedEffect]]:
    """The list's causes of joint logs, and those of installed plug-ins whose `on_list` is motion, by name."""
    installed = {k: kind for k, kind in known_effects().items() if kind.on_list == "motion"}
    own = {k: kind for k, kind in installed.items() if issubclass(kind, DefinedEffect)}
    return {**read_definitions(LISTED, __name__), **own}


def motion_columns(effect: DefinedEffect, seam: str, names: Mapping[str, Array]) -> list[Array]:
    """What one of each parameter does at a seam, in its size; names : what the formula's variables stand for."""
    formula, sizes = effect.formulas[seam], effect.sizes()
    settings = {key: getattr(effect, key) for key in effect.definition.settings}
    known = {**{name: names[name] for name in effect.drivers if name in formula.names}, **settings}
    shape = next(iter(names.values())).shape
    return [
        np.broadcast_to(formula.values({**known, **dict.fromkeys(sizes, 0.0), name: size}, NUMERIC)[0], shape)
        for name, (size, _) in sizes.items()
    ]
