"""Targets of a program: where their numbers stand, what they mean, their tool and base."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from casadical.core.basics import Array

DEG, MM = np.pi / 180, 1e-3


@dataclass(frozen=True)
class Number:
    """A number of the text: its place [characters], its text, and the factor that makes it SI.

    decimals : that it is written with; None: as many as it has, and enough for its unit
    """

    start: int
    stop: int
    text: str
    unit: float
    decimals: int | None = None

    @property
    def si(self) -> float:
        return float(self.text) * self.unit

    def written(self, value: float) -> str:
        """Another value [SI] as text."""
        _, _, fraction = self.text.lower().partition("e")[0].partition(".")
        finest = {DEG: 6, MM: 4, 1.0: 9}[self.unit]  # below a tenth of a micrometre at the tool
        decimals = max(len(fraction), finest) if self.decimals is None else self.decimals
        text = f"{value / self.unit:.{decimals}f}"
        return text[1:] if float(text) == 0 and text.startswith("-") else text

    def differs(self, text: str) -> bool:
        """Whether a text means another number."""
        return self.text.startswith("'") or text.startswith("'") or float(self.text) != float(text)


class Posture(NamedTuple):
    """Which of the eight arms of a six-axis robot reaches a pose.

    behind : the wrist is behind axis 1; bent_back : it is behind the line from axis 2 through axis
        3
    wrist_negative : the reading of joint 5 is negative
    """

    behind: bool
    bent_back: bool
    wrist_negative: bool


@dataclass(frozen=True, eq=False)
class Target:
    """One target.

    joints : whether its numbers are joint readings, else a pose in the language's own form
    posture, turns, turn_text : the arm's configuration and the joints' turns where the program says
        them, and the number or word that says the turns
    near : joints [rad] that the pose's solution is to be near to, shape (n,), where the program
        says them
    tool, base : tool in the flange's frame and base in the controller's root frame, each (4, 4)
        [m]; None: not known
    about : names of tool and base; left : why the target stays as it is, empty if it is to be
        corrected
    external : whether an external axis is off its zero; accurate : whether it was taught with
        absolute accuracy on
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
    left: str = ""
    external: bool = False
    accurate: bool = False

    @property
    def si(self) -> Array:
        return np.array([number.si for number in self.numbers])

    def leave(self, reason: str) -> Target:
        """The same target, to be left as it is; the first reason counts."""
        return self if self.left else replace(self, left=reason)


@dataclass(frozen=True, eq=False)
class Given:
    """What a program does not say itself.

    tools, bases : transforms (4, 4) [m] by the name or number that the program uses; "" for the
        only one
    texts : other files of the program in which tools and bases are looked up, by file name
    units : rad or m of each joint's reading in the robot file; none: all rad
    """

    tools: dict[str, Array] = field(default_factory=dict)
    bases: dict[str, Array] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    units: tuple[str, ...] = ()

    def joint_units(self, joints: int) -> tuple[float, ...]:
        """Degrees, millimetres of a linear axis, each as a factor to SI."""
        return tuple(MM if unit == "m" else DEG for unit in self.units or ("rad",) * joints)


def numbers(tokens: Iterable[Any], units: Iterable[float], decimals: int | None = None) -> tuple[Number, ...]:
    """Tokens as numbers of these units, each a factor to SI."""
    return tuple(Number(t.start_pos, t.end_pos, str(t), unit, decimals) for t, unit in zip(tokens, units, strict=True))
