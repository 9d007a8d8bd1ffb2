"""Whether the data are plausible for the nominal model: with base and tool fitted, no centimetres may be left.

Single slips are tried one by one (see `slips`), and one that explains far more is named.

Coverage of the poses: ranges of the joints, repeated readings and their scatter, four-bar margin.
"""

import difflib
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.parts import GRAVITY
from casadical.core.reading import load_toml
from casadical.core.statistics import first_of_best
from casadical.identification.accuracy import errors, predicted
from casadical.identification.placement import median_error, place_frames, rigid
from casadical.identification.plausibility import least_margins
from casadical.measurements.columns import RADIANS
from casadical.measurements.measurements import Measurements, same_readings
from casadical.project.check.slip_fit import Fit, Hypothesis
from casadical.project.check.slip_list import single_slips, undone
from casadical.project.check.slips import WORTH, outside, slip_fit
from casadical.project.robot_columns import some_rows
from casadical.robot.kinematics import LEAST_MARGIN
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from

# Fewer poses fit any model, or none, with base and tool alone.
TELLING = 4
# Share of the reach that a placed nominal robot may miss by, and the share of that which an undone mistake may leave.
GROSS = 0.02
# Columns that the model or an effect may ask for, besides readings and observations.
KNOWN = ("payload_kg", "temperature_degC", "time_s", "warmth_K", "weight", "set", "point", "pose", "other_pose")
Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """level : error (no use to go on), warning (look at it), note (good to know); topic : one word or two"""

    level: Level
    topic: str
    text: str


def plausible(robot: Robot, m: Measurements, others: Sequence[Robot] = ()) -> tuple[Fit, Fit] | None:
    """What is left after placing, and with the single slip undone of which least is left; None of kinds without
    positions and lengths.

    others : robots that the file may have meant (see `other_conventions`)
    """
    some, none = m[:: -(-len(m) // 150)], Hypothesis.none(robot.n)
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
        meant, free = undone(fit, some), rigid([robot, *others][fit.hypothesis.rows])
        assert meant.position is not None
        measured, moved = (np.linalg.norm(np.ptp(p, axis=0)) for p in (meant.position, predicted(free, meant)[0]))
        if measured > 0.1 * moved:  # shrunk positions would fit anything
            tried.append(replace(fit, error=median_error(free, meant)))
    return _simplest(robot, some, tried)


def _simplest(robot: Robot, some: Measurements, tried: list[Fit]) -> tuple[Fit, Fit]:
    """The first and the best: of alike fits that with fewest shifted zeros; one out of the joints' ranges is none."""
    before = tried[0]
    tried.sort(key=lambda fit: sum(z != 0 for z in fit.hypothesis.zero))
    costs = [fit.error * (WORTH if outside(fit.hypothesis, robot, some.q) else 1) for fit in tried]
    return before, tried[first_of_best(-np.log(np.maximum(costs, 1e-12)), logs=True)]


def far_off(robot: Robot, m: Measurements) -> tuple[Array, Array]:
    """At which rows the placed nominal model is far off, and its errors [m], shapes (n,); none where poses are few."""
    kept = np.ones(len(m), dtype=bool)
    e = np.zeros(len(m))
    if m.position is None or len(m) < 12:
        return ~kept, e
    free = rigid(robot)
    for _ in range(4):  # far rows draw base and tool towards themselves
        e = errors(place_frames(free, m[kept]), m)
        near = e <= 5.0 * np.median(e)
        if (near == kept).all():
            break
        kept = near
    return (~kept if kept.mean() >= 0.5 else np.zeros(len(m), dtype=bool)), e


def far_rows(robot: Robot, m: Measurements) -> list[Finding]:
    """Rows that are far off: doubtful measurements; those that no robot of this size measures are an error."""
    far, e = far_off(robot, m)
    if not far.any():
        return []
    gross = m.row[far & (e > 0.5 * robot.reach)]
    order = [k for k in np.argsort(-e) if far[k]]
    rows = some_rows([f"{m.row[k]} ({1e3 * e[k]:.3g} mm)" for k in order])
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


ASSUMED = {"revolute": (-2 * np.pi, 2 * np.pi), "prismatic": (-10.0, 10.0)}


@dataclass(frozen=True)
class JointCoverage:
    """Of one joint: least and greatest reading, and its limits [deg or mm]; share of the range that is covered."""

    joint: int
    unit: str
    low: float
    high: float
    lower: float
    upper: float
    share: float


def coverage(robot: Robot, m: Measurements) -> tuple[JointCoverage, ...]:
    """Ranges covered by the readings; of a joint that turns more than once, a full turn is all there is to cover."""
    joints = []
    for i, (joint, (key, factor)) in enumerate(zip(robot.joints, robot.reading_units.items(), strict=True)):
        low, high = float(m.q[:, i].min()), float(m.q[:, i].max())
        whole = min(joint.upper - joint.lower, 2 * np.pi if joint.kind == "revolute" else np.inf)
        ends = (low / factor, high / factor, joint.lower / factor, joint.upper / factor)
        joints.append(JointCoverage(i + 1, key.split("_")[1], *ends, min(1.0, (high - low) / whole)))
    return tuple(joints)


def coverage_findings(robot: Robot, m: Measurements) -> list[Finding]:
    findings = []
    for c, moved in zip(coverage(robot, m), np.ptp(m.q, axis=0), strict=True):
        if moved < np.deg2rad(1.0):
            text = f"joint {c.joint} does not move: its parameters cannot be distinguished from those of its neighbours"
            findings.append(Finding("warning", "coverage", f"{m.source}: {text}"))
        elif c.share < 0.25:
            text = f"joint {c.joint} covers {c.low:.0f} .. {c.high:.0f} {c.unit}, {100 * c.share:.0f} % of its range"
            doubt = "; are these radians?" if c.unit == "deg" and max(-c.low, c.high) <= RADIANS else ""
            findings.append(
                Finding("warning", "coverage", f"{m.source}: {text}; expect little beyond these readings{doubt}")
            )
    return findings


def limits_findings(robot: Robot) -> list[Finding]:
    """Joints whose limits are those that are taken where none are given."""
    wide = [str(i) for i, j in enumerate(robot.joints, 1) if (j.lower, j.upper) == ASSUMED[j.kind]]
    if not wide:
        return []
    text = f"joint{'s' if len(wide) > 1 else ''} {', '.join(wide)}: -360 .. 360 deg (-10 .. 10 m of a prismatic one)"
    more = "is what is taken where the robot file gives no limits; shares and forecasts below, and plan, go by it"
    return [Finding("note", "limits", f"{text} {more}")]


def repeats(m: Measurements) -> tuple[int, float | None]:
    """How many distinct readings there are, and one sigma of a coordinate [m] that repeated ones show (or None)."""
    tools = [values for name, values in m.conditions.items() if name.startswith("tool_")]
    reading = same_readings(np.column_stack([m.q, *tools]))
    distinct = int(reading.max()) + 1
    freedom = len(m) - distinct
    if m.position is None or freedom < 3:
        return distinct, None
    sums = np.zeros((distinct, 3))
    np.add.at(sums, reading, m.position)
    off = m.position - (sums / np.bincount(reading)[:, None])[reading]
    return distinct, float(np.sqrt((off**2).sum() / (3 * freedom)))


def margin(robot: Robot, m: Measurements) -> float | None:
    """The smallest margin of the robot's four-bars over the poses; None without four-bars."""
    return float(least_margins(robot, m).min()) if robot.loops else None


def margin_findings(robot: Robot, m: Measurements) -> list[Finding]:
    """A four-bar that is nearly folded somewhere; one that is open is refused elsewhere."""
    smallest = margin(robot, m)
    if smallest is None or not LEAST_MARGIN <= smallest < 5 * LEAST_MARGIN:
        return []
    text = f"the four-bar is nearly folded in some pose (margin {smallest:.3f}; 1 is square, {LEAST_MARGIN} refused)"
    return [Finding("warning", "four-bar", f"{m.source}: {text}; small errors of the bars count much there")]


def unknown_columns(robot: Robot, conditions: Sequence[str], source: str) -> list[Finding]:
    """Columns that are almost a name that something asks for, and those that this robot has no use for."""
    findings = []
    if robot.gravity_frame != "logged" and {*GRAVITY} <= {*conditions}:
        text = f"{source}: its columns say how the base tilts, and the robot file takes it as still"
        findings.append(
            Finding("warning", "columns", f'{text}: write frame = "logged" in [gravity], or leave them out')
        )
    beyond = [c for c in conditions if (match := re.fullmatch(r"approach(\d+)", c)) and int(match[1]) > robot.n]
    if beyond:
        text = f"{source}: column {beyond[0]!r} has no effect: this robot has {robot.n} joints"
        findings.append(Finding("warning", "columns", text))
    for name in conditions:
        near = [known for known in KNOWN if known.startswith(f"{name}_")]
        # A height is no weight (0.83); a temperature_C may be meant as temperature_degC.
        near = near or difflib.get_close_matches(name.casefold(), KNOWN, 1, 0.84)
        if name not in KNOWN and near and not name.startswith(("warmth_", "approach")):
            text = f"{source}: column {name!r} is no name that anything asks for; is {near[0]!r} meant?"
            findings.append(Finding("warning", "columns", text))
    return findings
