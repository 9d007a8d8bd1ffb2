"""Targets of a robot program: where their numbers stand in the text, units, tool and base."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casadical.core.basics import M_PER_MM, Array

# Radians per degree.
RAD_PER_DEG = np.pi / 180


@dataclass(frozen=True)
class Number:
    """A number in a program's text.

    start, stop : index of its first character in the text, and one past its last (in a CSV table:
        its row and column, from 0)
    text : its characters
    unit : factor of the number to SI
    decimals : number of decimals with which it is written; None: as many as it has, and enough for
        its unit
    """

    start: int
    stop: int
    text: str
    unit: float
    decimals: int | None = None

    @property
    def si(self) -> float:
        """Return the value [SI]."""
        return float(self.text) * self.unit

    def written(self, value: float) -> str:
        """Return the text that replaces this number by another value [SI], in the number's unit."""
        _, _, fraction = self.text.lower().partition("e")[0].partition(".")
        # decimals whose rounding error is below a tenth of a micrometre at the tool
        finest = {RAD_PER_DEG: 6, M_PER_MM: 4, 1.0: 9}[self.unit]
        decimals = max(len(fraction), finest) if self.decimals is None else self.decimals
        text = f"{value / self.unit:.{decimals}f}"
        return text[1:] if float(text) == 0 and text.startswith("-") else text

    def differs(self, text: str) -> bool:
        """Return whether a text stands for another number; always True of quoted ones ('B101')."""
        return self.text.startswith("'") or text.startswith("'") or float(self.text) != float(text)


# Arm configuration, one of the eight solutions of a six-axis robot's inverse kinematics: whether the
# wrist is behind axis 1, whether it is behind the line from axis 2 through axis 3, and whether the
# reading of joint 5 is negative.
Posture = tuple[bool, bool, bool]


@dataclass(frozen=True, eq=False)
class Target:
    """A motion target of a program.

    line, name : line of the program, and name of the target
    joints : whether its numbers are joint readings; else they are a pose in the language's form
    numbers : its numbers in the text
    posture : arm configuration that the program states; None: none
    turns : turns of joints that the program states, as the language counts them; None: none
    turn_text : numbers or words of the text that hold the turns
    near : joints to which the pose's solution must be near, shape (n,) [rad]; None: the program
        states none
    tool, base : pose of the tool in the flange's frame and of the base in the controller's root
        frame, shape (4, 4) [m] each; None: unknown
    about : names of tool and base, as text
    skip_reason : why the target remains unchanged; empty if it is to be corrected
    external : whether an external axis is off its zero
    accurate : whether it was taught with the controller's absolute accuracy on
    """

    line: int
    name: str
    joints: bool
    numbers: tuple[Number, ...]
    posture: Posture | None = None
    turns: tuple[int, ...] | None = None
    turn_text: tuple[Number, ...] = ()
    near: Array | None = None
    tool: Array | None = None
    base: Array | None = field(default_factory=lambda: np.eye(4))
    about: str = ""
    skip_reason: str = ""
    external: bool = False
    accurate: bool = False

    @property
    def si(self) -> Array:
        """Return the values of the target's numbers, shape (k,) [SI]."""
        return np.array([number.si for number in self.numbers])

    def leave(self, reason: str) -> Target:
        """Return the target, marked to remain unchanged; the first reason counts."""
        return self if self.skip_reason else replace(self, skip_reason=reason)


@dataclass(frozen=True, eq=False)
class Given:
    """Tools, bases and units that come from outside the program.

    tools, bases : transforms (4, 4) [m] by the name or number that the program uses; "" for the
        only one
    texts : other files of the program in which tools and bases are looked up, by file name
    units : rad or m of each joint's reading in the robot file; empty: all rad
    """

    tools: dict[str, Array] = field(default_factory=dict)
    bases: dict[str, Array] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    units: tuple[str, ...] = ()

    def joint_units(self, joints: int) -> tuple[float, ...]:
        """Return the factor of each joint's number in a program (degree or millimetre) to SI."""
        return tuple(M_PER_MM if unit == "m" else RAD_PER_DEG for unit in self.units or ("rad",) * joints)


def numbers(tokens: Iterable[Any], units: Iterable[float], decimals: int | None = None) -> tuple[Number, ...]:
    """Return number tokens with their places in the text, factors to SI, and decimals."""
    return tuple(Number(t.start_pos, t.end_pos, str(t), unit, decimals) for t, unit in zip(tokens, units, strict=True))
