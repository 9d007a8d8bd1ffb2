"""Whether the data are plausible for the nominal model: with base and tool fitted, no centimetres may be left.

The usual mistakes are tried one by one (another unit, of one joint too, a joint counted the other way, a zero a quarter
turn off, a left-handed measuring frame, DH rows of the other convention), and one that explains far more is named.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.reading import load_toml
from casadical.identification.accuracy import errors, predicted
from casadical.identification.placement import place_frames
from casadical.measurements.measurements import Measurements
from casadical.project.check.findings import Finding
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from

# Share of the reach that a placed nominal robot may miss by, and the share of that which an undone mistake may leave.
GROSS = 0.02
EXPLAINS = 0.25
LEAST_SPREAD = 0.1
# A row with more than so many times the median error is doubtful; of so few poses nothing is said.
FAR, FEWEST = 5.0, 12
POSES = 150
UNEXPLAINED = "no single mistake of unit, sign or zero explains it: check the robot file"


def plausible(robot: Robot, m: Measurements, others: Mapping[str, Robot] | None = None) -> list[Finding]:
    """What is left after placing [mm], and which mistake explains it where far less is left once it is undone.

    others : robots that the file may have meant, by words that say how (see `other_conventions`)
    """
    if m.position is None:
        return []
    free = rigid(robot)
    some = m[:: -(-len(m) // POSES)]
    left = _median_error(free, some)
    tried = {
        words: _median_error(free, undone) for words, undone in _mistakes(robot, some) if _large_enough(free, undone)
    }
    tried |= {words: _median_error(rigid(other), some) for words, other in (others or {}).items()}
    best = min(tried, key=lambda words: tried[words])
    explained = tried[best] < EXPLAINS * left
    if left <= GROSS * robot.reach and not explained:
        text = f"{m.source}: the nominal model, base and tool fitted, is {1e3 * left:.3g} mm (median) from the data"
        return [Finding("note", "units", f"{text}: units, signs and zeros fit")]
    text = (
        f"{m.source}: with base and tool fitted the nominal model still is {1e3 * left:.4g} mm (median) from the data, "
        f"{100 * left / robot.reach:.2g} % of its reach"
    )
    if explained:
        return [Finding("error", "units", f"{text}; {1e3 * tried[best]:.3g} mm would be left if {best}")]
    return [Finding("error", "units", f"{text}; {UNEXPLAINED}")]


def far_off(robot: Robot, m: Measurements) -> tuple[Array, Array]:
    """At which rows the placed nominal model is off by many times its usual error, and its errors [m].

    Both of shape (n,); none is far off where there are too few poses, or where many are.
    """
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
    """Rows that are far off: doubtful measurements."""
    far, e = far_off(robot, m)
    if not far.any():
        return []
    order = [k for k in np.argsort(-e) if far[k]]
    rows = ", ".join(f"{m.row[k]} ({1e3 * e[k]:.3g} mm)" for k in order[:8]) + (" ..." if len(order) > 8 else "")
    text = (
        f"{m.source}: rows {rows} are far off, where the median is {1e3 * float(np.median(e)):.3g} mm; calibrate "
        "leaves out those that its fit does not explain, and names them and those that are held out; the accuracy to "
        "expect is without them"
    )
    return [Finding("warning", "rows", text)]


def other_conventions(path: Path) -> dict[str, Robot]:
    """The robot of a robot file with its DH rows read by the other convention; none for a URDF."""
    found: dict[str, Robot] = {}
    # The reader of the problem reports faults of its files.
    with suppress(InputError):
        if path.suffix == ".toml":
            data = dict(load_toml(path))
            said = convention_of(path)
            other = {"modified": "standard", "standard": "modified"}[said]
            words = f"the DH rows are of the {other} convention, not {said} (convention in {path.name})"
            found[words] = robot_from({**data, "convention": other}, path.name)
    return found


def convention_of(path: Path) -> str:
    """Of the DH rows in a robot file; modified for a URDF. Raises InputError."""
    return str(load_toml(path).get("convention", "modified")) if path.suffix == ".toml" else "modified"


def rigid(robot: Robot) -> Robot:
    """With rigid joints, for deflections are millimetres, and mistakes decimetres; base and tool unknown."""
    rigid = tuple(replace(j, compliance=None) for j in robot.joints)
    base, tool = replace(robot.base, unknown="pose"), replace(robot.tool, unknown="position")
    return replace(robot, joints=rigid, base=base, tool=tool, knowledge=None)


def _median_error(robot: Robot, m: Measurements) -> float:
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


def _mistakes(robot: Robot, m: Measurements) -> Iterator[tuple[str, Measurements]]:
    """What may have gone wrong, in words, and the data as they would be without it."""
    assert m.position is not None
    turning = np.array([j.kind == "revolute" for j in robot.joints])
    factor = 180 / np.pi
    yield "the joint readings are radians under names of degrees", replace(m, q=np.where(turning, m.q * factor, m.q))
    yield "the joint readings are degrees under names of radians", replace(m, q=np.where(turning, m.q / factor, m.q))
    yield "the positions are metres under names of millimetres", replace(m, position=1e3 * m.position)
    yield "the positions are millimetres under names of metres", replace(m, position=1e-3 * m.position)
    yield "the positions are inches under names of millimetres", replace(m, position=25.4 * m.position)
    yield "the measuring frame is left-handed (turn the sign of y)", replace(m, position=m.position * [1, -1, 1])
    for i in range(robot.n):
        if turning[i]:
            yield f"q{i + 1} alone holds radians under a name of degrees", _with_reading(m, i, factor, 0.0)
        yield f"joint {i + 1} counts the other way (turn the sign of q{i + 1})", _with_reading(m, i, -1.0, 0.0)
        if turning[i]:
            for degrees in (90, -90, 180):
                words = f"the zero of joint {i + 1} is {abs(degrees)} deg off (add {degrees} to q{i + 1}_deg)"
                yield words, _with_reading(m, i, 1.0, np.deg2rad(degrees))
    for i in range(1, robot.n):
        coupled = m.q.copy()
        coupled[:, i] += m.q[:, i - 1]
        yield f"q{i + 1} counts from the horizontal, not from link {i} (subtract q{i})", replace(m, q=2 * m.q - coupled)
        yield f"q{i + 1} is counted the other way against link {i} (add q{i})", replace(m, q=coupled)


def _with_reading(m: Measurements, i: int, sign: float, offset: float) -> Measurements:
    q = m.q.copy()
    q[:, i] = sign * q[:, i] + offset
    return replace(m, q=q)
