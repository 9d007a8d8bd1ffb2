"""Coverage of the poses: ranges of the joints, repeated readings and their scatter, four-bar margin."""

from dataclasses import dataclass

import numpy as np

from casadical.identification.plausibility import least_margins
from casadical.measurements.angle_unit import RADIANS
from casadical.measurements.measurements import Measurements, same_readings
from casadical.project.check.findings import Finding
from casadical.robot.kinematics import LEAST_MARGIN
from casadical.robot.robot import Robot

LITTLE = 0.25
STILL = np.deg2rad(1.0)
NARROW_MARGIN = 5 * LEAST_MARGIN
FEWEST_REPEATS = 3
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
    found = []
    for i, (joint, (key, factor)) in enumerate(zip(robot.joints, robot.reading_units.items(), strict=True)):
        low, high = float(m.q[:, i].min()), float(m.q[:, i].max())
        whole = min(joint.upper - joint.lower, 2 * np.pi if joint.kind == "revolute" else np.inf)
        ends = (low / factor, high / factor, joint.lower / factor, joint.upper / factor)
        found.append(JointCoverage(i + 1, key.split("_")[1], *ends, min(1.0, (high - low) / whole)))
    return tuple(found)


def coverage_findings(robot: Robot, m: Measurements) -> list[Finding]:
    found = []
    for c, moved in zip(coverage(robot, m), np.ptp(m.q, axis=0), strict=True):
        if moved < STILL:
            text = f"joint {c.joint} does not move: its parameters cannot be distinguished from those of its neighbours"
            found.append(Finding("warning", "coverage", f"{m.source}: {text}"))
        elif c.share < LITTLE:
            text = f"joint {c.joint} covers {c.low:.0f} .. {c.high:.0f} {c.unit}, {100 * c.share:.0f} % of its range"
            doubt = "; are these radians?" if c.unit == "deg" and max(-c.low, c.high) <= RADIANS else ""
            found.append(
                Finding("warning", "coverage", f"{m.source}: {text}; expect little beyond these readings{doubt}")
            )
    return found


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
    if m.position is None or freedom < FEWEST_REPEATS:
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
    if smallest is None or not LEAST_MARGIN <= smallest < NARROW_MARGIN:
        return []
    text = f"the four-bar is nearly folded in some pose (margin {smallest:.3f}; 1 is square, {LEAST_MARGIN} refused)"
    return [Finding("warning", "four-bar", f"{m.source}: {text}; small errors of the bars count much there")]
