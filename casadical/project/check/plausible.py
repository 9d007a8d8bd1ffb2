"""Plausibility of the data for the nominal model, and the coverage of the poses.

With base and tool fitted, the nominal robot must explain the data within centimetres. Single slips
are tried one by one (see `slips`), and one that explains the data far better is named. Coverage is
that of joint ranges and repeated readings, with the margin of four-bars.
"""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.reading import load_toml
from casadical.core.statistics import first_of_best
from casadical.identification.accuracy import errors, predicted
from casadical.identification.placement import median_error, place_frames, rigid
from casadical.identification.plausibility import least_margins
from casadical.measurements.measurements import Measurements, same_readings
from casadical.project.check.slip_fit import Fit, Hypothesis
from casadical.project.check.slip_list import single_slips, undone
from casadical.project.check.slips import MIN_ERROR_REDUCTION, outside, slip_fit
from casadical.robot.robot import Robot
from casadical.robot.robot_file import robot_from


def plausible(robot: Robot, m: Measurements, others: Sequence[Robot] = ()) -> tuple[Fit, Fit] | None:
    """Return the fit of the data as they are, and the best fit with at most one slip undone.

    None for kinds without positions, except distances that `slip_fit` takes. At most 150 poses,
    evenly spread, are fitted.

    robot : nominal robot
    others : robots that the file may have meant (see `other_conventions`)
    """
    some, none = m[:: -(-len(m) // 150)], Hypothesis.none(robot.n)
    if m.position is None:  # lengths, which show neither a wrong unit nor a mirrored frame
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
        if measured > 0.1 * moved:  # positions that are shrunk to a point would fit any model
            tried.append(replace(fit, error=median_error(free, meant)))
    return _simplest(robot, some, tried)


def _simplest(robot: Robot, some: Measurements, tried: list[Fit]) -> tuple[Fit, Fit]:
    """Return the first and the best of the fits; of tied fits the one with fewest shifted zeros.

    A fit with readings out of the joint ranges must be better by MIN_ERROR_REDUCTION.
    """
    before = tried[0]
    tried.sort(key=lambda fit: sum(z != 0 for z in fit.hypothesis.zero))
    costs = [fit.error * (MIN_ERROR_REDUCTION if outside(fit.hypothesis, robot, some.q) else 1) for fit in tried]
    return before, tried[first_of_best(-np.log(np.maximum(costs, 1e-12)), logs=True)]


def far_off(robot: Robot, m: Measurements) -> tuple[Array, Array]:
    """Return the mask of rows far off the placed nominal model, and all errors [m], both (n,).

    A row is far off if its error exceeds five times the median. None is where more than half were;
    with fewer than 12 poses, or without positions, none is and all errors are zero.
    """
    inliers = np.ones(len(m), dtype=bool)
    e = np.zeros(len(m))
    if m.position is None or len(m) < 12:
        return ~inliers, e
    free = rigid(robot)
    for _ in range(4):  # far rows bias base and tool
        e = errors(place_frames(free, m[inliers]), m)
        near = e <= 5.0 * np.median(e)
        if (near == inliers).all():
            break
        inliers = near
    return (~inliers if inliers.mean() >= 0.5 else np.zeros(len(m), dtype=bool)), e


def other_conventions(path: Path) -> list[Robot]:
    """Return a robot file's robot with rows in the other DH convention; [] if URDF or faulty."""
    # Faults of the file are reported where the problem is read.
    with suppress(InputError):
        if path.suffix == ".toml":
            other = {"modified": "standard", "standard": "modified"}[convention_of(path)]
            return [robot_from({**load_toml(path), "convention": other}, path.name, folder=path.parent)]
    return []


def convention_of(path: Path) -> str:
    """Return a robot file's DH convention, modified for a URDF. Raises InputError."""
    return str(load_toml(path).get("convention", "modified")) if path.suffix == ".toml" else "modified"


def other_readings(robot: Robot, m: Measurements) -> list[tuple[tuple[str, ...], float, Measurements]]:
    """Return each second set of joint readings in a table: columns, unit [SI], and the poses by it.

    They are logged columns that are numbered like the joints and close to the readings, as angles
    that were commanded together with those that the controller read back.
    """
    groups: dict[str, dict[int, str]] = {}
    for name in m.conditions:
        numbers = re.findall(r"\d+", name)
        if len(numbers) == 1:
            groups.setdefault(re.sub(r"\d+", "#", name), {})[int(numbers[0])] = name
    found = []
    for columns in groups.values():
        if sorted(columns) != [*robot.numbers]:
            continue
        given = np.column_stack([m.conditions[columns[j]] for j in robot.numbers])
        for factor in (np.pi / 180, 1.0, 1e-3):
            off = np.abs(factor * given - m.q)
            # Two sets of readings of one pose differ by less than a degree or a centimetre.
            if off.max() > 0 and np.quantile(off, 0.9) < 0.01:
                found.append((tuple(columns[j] for j in robot.numbers), factor, replace(m, q=factor * given)))
                break
    return found


@dataclass(frozen=True)
class JointCoverage:
    """The range of one joint's variable (of the robot's row) over the poses.

    joint : number of the joint, from 1
    unit : deg or mm
    low, high : lowest and highest value [deg or mm]
    lower, upper : joint limits [deg or mm]
    share : covered share of the range between the limits, 0 to 1
    """

    joint: int
    unit: str
    low: float
    high: float
    lower: float
    upper: float
    share: float


def coverage(robot: Robot, m: Measurements) -> tuple[JointCoverage, ...]:
    """Return for each joint the range of its variable and the share of its limits that it covers.

    A joint that turns more than once is fully covered by one turn.
    """
    joints = []
    for i, (joint, (key, factor)) in enumerate(zip(robot.joints, robot.reading_units.items(), strict=True)):
        low, high = float(m.q[:, i].min()), float(m.q[:, i].max())
        whole = min(joint.upper - joint.lower, 2 * np.pi if joint.kind == "revolute" else np.inf)
        ends = (low / factor, high / factor, joint.lower / factor, joint.upper / factor)
        joints.append(JointCoverage(i + 1, key.split("_")[1], *ends, min(1.0, (high - low) / whole)))
    return tuple(joints)


def repeats(m: Measurements) -> tuple[int, float | None]:
    """Return the number of distinct poses, and the noise of a coordinate by repeated ones [m].

    The noise is a standard deviation, None without positions or with fewer than three repeats.
    """
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
    """Return the smallest margin of the four-bars over the poses; None without four-bars."""
    return float(least_margins(robot, m).min()) if robot.loops else None
