"""Poses that could be measured, and under which circumstances: payloads, approaches, repeats, time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements, unmeasured
from casadical.pose_selection.workspace import Workspace
from casadical.robot.robot import Robot

_TIMED = re.compile(r"progress|time_s|temperature_degC|warmth_\d+s")
_APPROACH = re.compile(r"approach\d+")
# The timeline's resolution.
_STEPS = 200


@dataclass(frozen=True)
class Circumstances:
    """How poses are measured.

    payloads : masses [kg] that can be mounted; empty: the declared one, and also none if an effect needs two
    every_payload : whether each reading is measured with all of them instead of one
    both_approaches : whether each reading is approached twice, with all joints moving in opposite directions
    repeats : how often each reading is measured, in passes over all poses
    seconds : time per pose; warmup_K, warmup_minutes : assumed rise of temperature [K] and its time constant [min]
    """

    payloads: tuple[float, ...] = ()
    every_payload: bool = False
    both_approaches: bool = False
    repeats: int = 1
    seconds: float = 30.0
    warmup_K: float = 5.0
    warmup_minutes: float = 35.0

    def states(self, robot: Robot) -> tuple[float, ...]:
        """Payloads [kg] of the campaign."""
        declared = robot.payload.mass if robot.payload else 0.0
        if self.payloads:
            return self.payloads
        return (0.0, declared) if any("payload_kg" in e.needs for e in robot.effects) else (declared,)

    def size(self, robot: Robot) -> int:
        """How many measurements are made at one reading."""
        return self.repeats * (1 + self.both_approaches) * (len(self.states(robot)) if self.every_payload else 1)


@dataclass(frozen=True, eq=False)
class Candidates:
    """N readings, each to be measured g times under its own circumstances.

    q : shape (N, joints) [rad or m]; conditions : by name, shape (N, g); turn : in which pass, shape (g,)
    """

    q: Array
    conditions: Mapping[str, Array] = field(default_factory=dict)
    turn: Array = field(default_factory=lambda: np.zeros(1, dtype=int))

    def __len__(self) -> int:
        return len(self.q)

    @property
    def size(self) -> int:
        """Measurements a reading, g."""
        return len(self.turn)

    def __getitem__(self, which: Array) -> Candidates:
        return replace(self, q=self.q[which], conditions={n: v[which] for n, v in self.conditions.items()})

    def joined(self, other: Candidates) -> Candidates:
        """These, then the others; both made under the same circumstances."""
        conditions = {n: np.concatenate([v, other.conditions[n]]) for n, v in self.conditions.items()}
        return replace(self, q=np.concatenate([self.q, other.q]), conditions=conditions)

    def measurements(self, robot: Robot, source: str = "candidates") -> Measurements:
        """One row per measurement, the g of a reading in sequence, at the positions that the model gives."""
        conditions = {n: v.ravel() for n, v in self.conditions.items()}
        return expected(robot, np.repeat(self.q, self.size, axis=0), conditions, source)


def expected(robot: Robot, q: Array, conditions: Mapping[str, Array], source: str) -> Measurements:
    """Measurements at readings q, shape (n, joints) [rad or m], as the model predicts them."""
    m = unmeasured(q, conditions, source)
    return replace(m, position=predicted(robot, m)[0])


def draw(robot: Robot, count: int, workspace: Workspace, rng: np.random.Generator) -> Array:
    """Readings that the workspace allows, shape (count, joints): every other one drawn towards the joints' ends.

    Good poses often lie there. Raises InputError where hardly any reading is allowed.
    """
    lower, upper = workspace.ranges(robot)
    kept = np.empty((0, robot.n))
    for _ in range(50):
        share = rng.uniform(size=(count, robot.n))
        share[::2] = 0.5 - 0.5 * np.cos(np.pi * share[::2])
        q = lower + (upper - lower) * share
        kept = np.concatenate([kept, q[workspace.allows(robot, q)]])[:count]
        if len(kept) == count:
            return kept
    refused = {reason: int(mask.sum()) for reason, mask in workspace.refusals(robot, q).items()}
    raise InputError(
        f"only {len(kept)} of {50 * count} readings drawn are allowed; of the last {count} were refused: "
        f"{', '.join(f'{reason} {number}' for reason, number in refused.items())}; widen the tightest of these"
    )


def draw_uniform(robot: Robot, count: int, workspace: Workspace, rng: np.random.Generator) -> Array:
    """Readings that the workspace allows, shape (count, joints), drawn evenly. Raises InputError."""
    lower, upper = workspace.ranges(robot)
    kept = np.empty((0, robot.n))
    for _ in range(100):
        q = rng.uniform(lower, upper, (count, robot.n))
        kept = np.concatenate([kept, q[workspace.allows(robot, q)]])[:count]
        if len(kept) == count:
            return kept
    raise InputError(f"only {len(kept)} of {100 * count} readings drawn are allowed by the workspace; widen it")


def candidates_at(robot: Robot, q: Array, circumstances: Circumstances, n: int, rng: np.random.Generator) -> Candidates:
    """Candidates at readings q with every column that the robot's model needs, some drawn at random.

    n : number of readings of the campaign, which determines how long it takes
    Raises InputError for a column that cannot be planned.
    """
    g, N = circumstances.size(robot), len(q)
    states = circumstances.states(robot)
    counts = (
        circumstances.repeats,
        len(states) if circumstances.every_payload else 1,
        1 + circumstances.both_approaches,
    )
    turn, payload, side = np.unravel_index(np.arange(g), counts)
    moment = rng.uniform(size=(N, 1)) * np.ones(g)
    columns: dict[str, Array] = {}
    for name in robot.conditions:
        if name == "payload_kg":
            start = 0 if circumstances.every_payload else rng.integers(len(states), size=(N, 1))
            columns[name] = np.array(states)[(start + payload) % len(states)] * np.ones((N, g))
        elif _APPROACH.fullmatch(name):
            columns[name] = rng.choice([-1.0, 1.0], (N, 1)) * np.where(side, -1.0, 1.0)
        elif not _TIMED.fullmatch(name):
            raise InputError(f"column {name!r} is needed by an effect and cannot be planned; leave that effect out")
    timed = [name for name in robot.conditions if _TIMED.fullmatch(name)]
    if timed:
        columns |= timeline(timed, moment, n * g, circumstances)
        columns["progress"] = moment
    return Candidates(q, columns, np.asarray(turn))


def timeline(names: list[str], progress: Array, n: int, circumstances: Circumstances) -> dict[str, Array]:
    """Columns that follow from the time alone, for shares of a campaign of n measurements, any shape."""
    rows = max(n, 2)
    course = np.linspace(0, 1, _STEPS)
    time = circumstances.seconds * rows * course
    warmth = circumstances.warmup_K * -np.expm1(-time / (60 * circumstances.warmup_minutes))
    clock = unmeasured(np.zeros((_STEPS, 1)), {"time_s": time, "temperature_degC": 20 + warmth})
    clock, missing = derive(clock, names)
    assert not missing
    return {name: np.interp(progress, course, clock.conditions[name]) for name in names}
