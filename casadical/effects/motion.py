"""Causes that act in a joint log: formulas of logged signals for torques and servo position errors.

A torque is divided by the joint's peak torque in the log, a response is command minus reading [rad
or m]. At the insertion points `torques` and `responses` a formula applies to every joint, else to
the cause's own.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from casadical.core.basics import Array
from casadical.effects.definition import DefinedEffect, read_definitions
from casadical.effects.formula import NUMERIC_FUNCTIONS
from casadical.effects.plugins import effects_by_name

# Class of a defined effect that is a cause in joint logs, with any joint and settings.
Cause = type[DefinedEffect]


@cache
def motion_effects() -> Mapping[str, type[DefinedEffect]]:
    """Return the effect classes that are causes in joint logs, by name.

    They are the package's and, of plug-ins, the defined effects whose `on_list` is "motion".
    """
    installed = {k: kind for k, kind in effects_by_name().items() if kind.on_list == "motion"}
    own = {k: kind for k, kind in installed.items() if issubclass(kind, DefinedEffect)}
    return {**read_definitions(Path(__file__).with_name("motion.effect.toml"), __name__), **own}


def motion_columns(effect: DefinedEffect, seam: str, names: Mapping[str, Array]) -> list[Array]:
    """Return the value of an effect's formula for each parameter alone at its typical size.

    The other parameters are zero. Values are torques divided by the peak torque, or responses [rad
    or m].
    seam : insertion point, "torque", "torques", "response" or "responses"
    names : samples of the variables of the formula, all of one shape, which is that of each column
    """
    formula, sizes = effect.formulas[seam], effect.sizes()
    settings = {key: getattr(effect, key) for key in effect.definition.settings}
    values = {**{name: names[name] for name in effect.drivers if name in formula.names}, **settings}
    shape = next(iter(names.values())).shape
    return [
        np.broadcast_to(
            formula.values({**values, **dict.fromkeys(sizes, 0.0), name: size}, NUMERIC_FUNCTIONS)[0], shape
        )
        for name, (size, _) in sizes.items()
    ]
