"""Whether the data are plausible for the nominal model: with base and tool fitted, no centimetres may be left.

Single slips are tried one by one (see `slips`), and one that explains far more is named.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.reading import load_toml
from casadical.core.statistics import first_of_best
from casadical.identification.accuracy import errors, predicted
from casadical.identification.placement import place_frames
from casadical.measurements.measurements import Measurements
from casadical.project.check.findings import Finding
from casadical.project.check.slip_fit import Fit, Hypothesis
from casadical.project.check.slips import WORTH, outside, single_slips, slip_fit
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from

# Share of the reach that a placed nominal robot may miss by, and the share of that which an undone mistake may leave.
GROSS = 0.02
# And that by which a single row may miss.
IMPOSSIBLE = 0.5
LEAST_SPREAD = 0.1
# A row with more than so many times the median error is doubtful; of so few poses nothing is said.
FAR, FEWEST = 5.0, 12
POSES = 150


def plausible(robot: Robot, m: Measurements, others: Sequence[Robot] = ()) -> tuple[Fit, Fit] | None:
    """What is left after placing, and with the single slip undone of which least is left; None of kinds without
    positions and lengths.

    others : robots that the file may have meant (see `other_conventions`)
    """
    some, none = m[:: -(-len(m) // POSES)], Hypothesis.none(robot.n)
    if m.position is None:  # lengths, which tell no unit and no hand of a frame
        lengths = slip_fit(robot, some, others)
        if lengths is None:
            return None
        before = lengths.placed(none, as_given=True)
        hypotheses = [fit.hypothesis for fit in single_slips(robot, len(lengths.rows) - 1)]
        return _simplest(robot, some, [before, *(lengths.placed(h) for h in hypotheses if h != none)])
    before = Fit(none, median_error(rigid(robot), some))
    tried = [before]
    for fit in single_slips(robot, len(others)):
        h = fit.hypothesis
        turns = np.array([*fit.scale]) * [1, -1 if fit.mirrored else 1, 1]
        meant = replace(some, q=h.readings(some.q), position=some.position * turns)
        free = rigid([robot, *others][h.rows])
        if _large_enough(free, meant):
            tried.append(replace(fit, error=median_error(free, meant)))
    return _simplest(robot, some, tried)


def _simplest(robot: Robot, some: Measurements, tried: list[Fit]) -> tuple[Fit, Fit]:
    """The first, and of all that which leaves least: of slips that fit alike a turned sign comes before a shifted zero,
    and one that leaves the joints' ranges is none.
    """
    before = tried[0]
    tried.sort(key=lambda fit: sum(z != 0 for z in fit.hypothesis.zero))
    costs = [fit.error * (WORTH if outside(fit.hypothesis, robot, some.q) else 1) for fit in tried]
    return before, tried[first_of_best(-np.log(np.maximum(costs, 1e-12)), logs=True)]


def far_off(robot: Robot, m: Measurements) -> tuple[Array, Array]:
    """At which rows the placed nominal model is far off, and its errors [m], shapes (n,); none where poses are few."""
    kept = np.ones(len(m), dtype=bool)
    e = np.zeros(len(m))
    if m.position is None or len(m) < FEWEST:
        return ~kept, e
    free = rigid(robot)
    for _ in range(4):  # far rows draw base and tool towards themselves
        e = errors(place_frames(free, m[kept]), m)
        near = e <= FAR * np.median(e)
        if (near == kept).all():
            break
        kept = near
    return (~kept if kept.mean() >= 0.5 else np.zeros(len(m), dtype=bool)), e


def far_rows(robot: Robot, m: Measurements) -> list[Finding]:
    """Rows that are far off: doubtful measurements; those that no robot of this size measures are an error."""
    far, e = far_off(robot, m)
    if not far.any():
        return []
    gross = m.row[far & (e > IMPOSSIBLE * robot.reach)]
    order = [k for k in np.argsort(-e) if far[k]]
    rows = ", ".join(f"{m.row[k]} ({1e3 * e[k]:.3g} mm)" for k in order[:8]) + (" ..." if len(order) > 8 else "")
    text = (
        f"{m.source}: rows {rows} are far off, where the median is {1e3 * float(np.median(e)):.3g} mm; calibrate "
        "leaves out those that its fit does not explain, and names them and those that are held out; the accuracy to "
        "expect is without them"
    )
    if len(gross):
        text += f". Rows {', '.join(map(str, gross))} lie further off than half the reach: correct them, or leave them "
        text += f"out (leave_out = {gross.tolist()} in problem.toml, under [[measurements]])"
    return [Finding("error" if len(gross) else "warning", "rows", text)]


def other_conventions(path: Path) -> list[Robot]:
    """The robot of a robot file with its DH rows read by the other convention; none for a URDF."""
    # The reader of the problem reports faults of its files.
    with suppress(InputError):
        if path.suffix == ".toml":
            other = {"modified": "standard", "standard": "modified"}[convention_of(path)]
            return [robot_from({**load_toml(path), "convention": other}, path.name)]
    return []


def convention_of(path: Path) -> str:
    """Of the DH rows in a robot file; modified for a URDF. Raises InputError."""
    return str(load_toml(path).get("convention", "modified")) if path.suffix == ".toml" else "modified"


def rigid(robot: Robot) -> Robot:
    """With rigid joints, for deflections are millimetres, and mistakes decimetres; base and tool unknown."""
    rigid = tuple(replace(j, compliance=None) for j in robot.joints)
    base, tool = replace(robot.base, unknown="pose"), replace(robot.tool, unknown="position")
    return replace(robot, joints=rigid, base=base, tool=tool, knowledge=None)


def median_error(robot: Robot, m: Measurements) -> float:
    """Error after base and tool are placed [m]; infinite where the model cannot be evaluated."""
    with np.errstate(all="ignore"):
        try:
            e = errors(place_frames(robot, m), m)
            near = np.flatnonzero(e <= FAR * np.median(e))
            if FEWEST <= len(near) < len(e):  # gross errors draw base and tool towards themselves
                e = errors(place_frames(robot, m[near]), m)
        except np.linalg.LinAlgError:
            return np.inf
    # The median: a few gross errors are outliers, not such a mistake.
    return float(np.median(e)) if np.isfinite(e).all() else np.inf


def _large_enough(robot: Robot, m: Measurements) -> bool:
    """Whether the positions spread as far as a robot's do; shrunk ones would fit anything."""
    assert m.position is not None
    moved, _ = predicted(robot, m)
    return bool(np.linalg.norm(np.ptp(m.position, axis=0)) > LEAST_SPREAD * np.linalg.norm(np.ptp(moved, axis=0)))
