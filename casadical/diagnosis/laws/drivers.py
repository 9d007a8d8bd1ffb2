"""Drivers of laws: what an error may follow, as text over the names of formulas, and its values at the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.arm import Arm
from casadical.core.basics import Array
from casadical.diagnosis.linearisation import Linearisation
from casadical.effects.formula import NUMERIC, names_in, parse
from casadical.effects.formula_effect import COLUMN, columns_of
from casadical.effects.law import Law
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements

LETTERS = "abcdefghijklmnopqs"
LAGS = (300, 600, 1200, 2400)
# How far back motions are remembered [mrad or mm].
WAYS = (100, 300, 1000, 3000)
# Half of a play [mrad or mm].
PLAYS = (100, 300, 1000)
# A driver that varies less is none [rad, m, K, kg, or a share].
LEAST_SPREAD = 0.02
# One that is larger is the rounding error of a load over none.
LARGEST = 1e6


@dataclass(frozen=True)
class Driver:
    """text : over the names of formulas; kind : which forms it may have; family : which drivers it is one of."""

    text: str
    kind: str
    family: str

    @property
    def columns_only(self) -> bool:
        """Whether it follows from logged columns alone, not from the pose."""
        return all(COLUMN.fullmatch(name) for name in parse(self.text).names)


def drivers_of(arm: Arm) -> list[Driver]:
    """Every driver of a robot, whether its columns were logged or not."""
    found = [Driver(f"q{i}", "angle", "angle") for i in arm.numbers]
    for i in arm.numbers[:-1]:
        found += [Driver(f"q{i} {sign} q{i + 1}", "angle", "angles") for sign in "+-"]
        unequal = (f"{a}q{i} {sign} {b}q{i + 1}" for a, b in (("2*", ""), ("", "2*")) for sign in "+-")
        found += [Driver(text, "weighted", "angles") for text in unequal]
    found += [Driver(f"tau{i}", "signed", "load") for i in arm.numbers]
    found += [Driver(f"m{i}{c}", "signed", "moment") for i in arm.numbers for c in "xy"]
    found += [Driver(f"sqrt(m{i}x**2 + m{i}y**2 + m{i}z**2)", "positive", "moment") for i in arm.numbers]
    found += [Driver(f"g{c}", "signed", "gravity") for c in "xyz"]
    found += [Driver("sqrt(px**2 + py**2)", "positive", "place"), Driver("pz", "positive", "place")]
    found += [Driver("t", "time", "time"), Driver("warmth", "positive", "warmth")]
    found += [Driver(f"warmth_{lag}s", "positive", "warmth") for lag in LAGS]
    found.append(Driver("payload", "linear", "payload"))
    for i in arm.numbers:
        found += [Driver(f"approach{i}", "linear", "approach"), Driver(f"move{i}", "signed", "move")]
        found += [Driver(f"play{i}_{play}mrad", "play", "play") for play in PLAYS]
        memories = [f"memory{i}_{way}mrad" for way in WAYS]
        found += [Driver(f"{own}{m}", "linear", "memory") for m in memories for own in ("", f"tau{i}*")]
        found += [Driver(f"approach{i}*{other}", "linear", "approach") for other in (f"tau{i}", f"abs(tau{i})", "t")]
        parts = (f"q{i}", f"tau{i}", f"sin(q{i})", f"cos(q{i})")
        found += [Driver(f"{own}*{other}", "linear", "product") for own in parts for other in ("t", WARM)]
        found.append(Driver(f"tau{i}*payload", "linear", "product"))
    pairs = [(i, j) for i in arm.numbers for j in arm.numbers if i < j]
    found += [Driver(f"tau{i}*tau{j}", "linear", "product") for i, j in pairs]
    found += [Driver(f"approach{i}*approach{j}", "linear", "approach") for i, j in pairs]
    return found


WARM = "warmth_600s"


def with_columns(m: Measurements, drivers: Sequence[Driver]) -> tuple[Measurements, list[Driver]]:
    """The measurements with the drivers' columns, and those drivers whose columns were logged or follow."""
    needed = {d: columns_of(parse(d.text).names) for d in drivers}
    m, missing = derive(m, [c for columns in needed.values() for c in columns])
    return m, [d for d in drivers if not set(needed[d]) & set(missing)]


def values_of(linear: Linearisation, drivers: Sequence[Driver]) -> tuple[list[Driver], Array]:
    """Drivers that vary over the poses, and their values, shape (n, drivers); the columns must be there."""
    names = names_in([parse(d.text) for d in drivers])
    at = variables(linear, names)
    values = [np.asarray(parse(d.text).values(at, NUMERIC)[0]) for d in drivers]
    kept = [k for k, v in enumerate(values) if np.ptp(v) > LEAST_SPREAD and np.abs(v).max() < LARGEST]
    found = [replace(drivers[k], kind="linear") if len(np.unique(values[k])) < 3 else drivers[k] for k in kept]
    return found, np.stack([values[k] for k in kept], axis=1)


def own_drivers() -> list[Driver]:
    """Drivers of every joint at once, each by its own: names without the joint's number."""
    found = [Driver("q", "angle", "angle"), Driver("tau", "signed", "load"), Driver("move", "signed", "move")]
    found += [Driver(text, "linear", "approach") for text in ("approach", "approach*tau", "approach*t")]
    return [*found, *(Driver(f"{own}*{other}", "linear", "product") for own in ("q", "tau") for other in ("t", WARM))]


def own_values(linear: Linearisation, known: Mapping[str, Array], driver: Driver) -> Array:
    """Values of a driver of every joint, shape (n, joints); known : by name, as of `variables`."""
    formula = parse(driver.text)
    joints = [{n: known[n] if n in known else known[f"{n}{j}"] for n in formula.names} for j in linear.robot.numbers]
    return np.stack([np.asarray(formula.values(at, NUMERIC)[0]) for at in joints], axis=1)


def variables(linear: Linearisation, names: Sequence[str]) -> dict[str, Array]:
    """Values of names of formulas at the poses, shape (n,) each, from what they do as a shift of the foot."""
    unit = linear.columns([Law(None, "base shift", "[a, 0, 0]")])[:, :, 0]
    found: dict[str, Array] = {}
    for first in range(0, len(names), len(LETTERS)):
        some = dict(zip(LETTERS, names[first:], strict=False))
        terms = " + ".join(f"{letter}*{name}" for letter, name in some.items())
        law = Law(None, "base shift", f"[{terms}, 0, 0]", tuple((letter, 1e-5) for letter in some))
        columns = linear.columns([law])
        share = (columns * unit[:, :, None]).sum(axis=1) / (unit**2).sum(axis=1)[:, None]
        found.update(zip(some.values(), share.T, strict=True))
    return found
