"""Effects that an export format cannot represent: refused with their error [mm], or omitted."""

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.effects import Effect
from casadical.effects.base import Omission
from casadical.identification.accuracy import errors
from casadical.robot.kinematics import MIN_LOOP_MARGIN
from casadical.robot.robot import Robot

if TYPE_CHECKING:
    from casadical.project.calibration import Calibration

# Number of random poses at which the mean and largest position error of an omission are computed.
SAMPLED_POSES = 1000


def left_out(robot: Robot, omissions: Iterable[Omission], target: str, leave_out: bool) -> tuple[str, ...]:
    """Return a sentence on each omitted effect, with the position error that the omission causes.

    The error is said to be unknown where a condition has no range, and is not stated for effects of
    the measurement.

    omissions : effects that the format cannot represent, with reasons
    target : name of the format, for the error message
    leave_out : whether effects of the robot may be omitted; those of the measurement always may
    Raises InputError: other effects are omitted and `leave_out` is false.
    """
    lines, refused = [], []
    for omission in omissions:
        line, effects = str(omission), [e for e in robot.effects if e.label == omission.label]
        if not all(e.of_measurement for e in effects):
            if why := _unknown_loss(robot, effects):
                line += f"; {why}"
            else:
                parts = [n for e in effects for n in e.sizes() if n in omission.parts or not omission.parts]
                mean, largest = displacement_without(robot, [f"{omission.label}.{part}" for part in parts])
                has_readings = robot.knowledge and len(robot.knowledge.readings)
                line += f"; lost without it: {1e3 * mean:.4f} mm on average, {1e3 * largest:.4f} mm at most"
                line += f" over the {'learnt range' if has_readings else 'range of the joints'}"
            refused.append(line)
        lines.append(line)
    if refused and not leave_out:
        raise InputError(
            f"{robot.name}: {target} cannot hold {len(refused)} of its effects:\n"
            + "\n".join(f"  {line}" for line in refused)
            + "\ngive --leave-out to write it without them"
        )
    return tuple(lines)


def rigid_omissions(robot: Robot) -> tuple[str, ...]:
    """Return sentences on what a file that holds only the rigid geometry omits.

    The first names compliances and effects, and the position error [mm] without all of them; one
    follows for each effect whose position error is unknown. Effects of the measurement are named,
    but cause no error of the robot. There are none for a rigid robot without effects.
    """
    soft = ", ".join(str(i) for i, j in enumerate(robot.joints, 1) if j.compliance)
    names = [*([f"compliance of joints {soft}"] if soft else []), *(e.label for e in robot.effects)]
    if not names:
        return ()
    unknown = {e.label: why for e in robot.effects if not e.of_measurement and (why := _unknown_loss(robot, [e]))}
    mean, largest = distance_from_rigid(robot.with_only(e for e in robot.effects if e.label not in unknown))
    off = (
        f"without them the point is off by {1e3 * mean:.4f} mm on average, {1e3 * largest:.4f} mm at most, by the model"
    )
    lines = [f"{', '.join(n for n in names if n not in unknown)}: {off}"] if len(names) > len(unknown) else []
    return (*lines, *(f"{label}: {why}" for label, why in unknown.items()))


def distance_from_rigid(robot: Robot) -> tuple[float, float]:
    """Return mean and maximum distance [m] of the robot's point from that of its rigid geometry.

    They are taken over random poses as in `displacement_without`. Effects of the measurement do not
    count.
    """
    robot = robot.with_only(e for e in robot.effects if not e.of_measurement)
    q, w = _poses(robot)
    bare = robot.with_only(()).rigid
    (p,) = bare.model.evaluate(("p",), q, np.tile(bare.declared, (SAMPLED_POSES, 1)), bare.parameters.values)
    return _apart(robot, q, w, p)


def geometry_alone(calibration: "Calibration") -> dict[str, float | int | str]:
    """Return mean position errors [mm] at measured poses: nominal, rigid calibrated, whole model.

    The keys are nominal_mm, geometry_mm and model_mm, `set` and `poses`. The poses are those of the
    set "report", which the fit has not seen, or else those of "identify"; `set` is its name and
    `poses` their number. Base and tool of the nominal robot are fitted.
    """
    identified, sets = calibration.identification, calibration.problem.sets
    name = "report" if "report" in sets else "identify"
    robots = {"nominal": identified.placed, "geometry": identified.robot.with_only(()).rigid, "model": identified.robot}
    mean = {key: np.concatenate([errors(robot, m) for m in sets[name]]) for key, robot in robots.items()}
    figures = {f"{key}_mm": 1e3 * float(e.mean()) for key, e in mean.items()}
    return {"set": name, "poses": len(mean["model"]), **figures}


def _unknown_loss(robot: Robot, effects: Iterable[Effect]) -> str:
    """Return a sentence on the effects' first condition without a range in the robot file, or "".

    Approach directions, progress and payload need no range; see `_drawn`.
    """
    ranges = robot.knowledge.conditions if robot.knowledge else {}
    names = (name for e in effects for name in e.conditions if name not in ranges)
    missing = [name for name in names if not name.startswith(("approach", "progress", "payload_kg"))]
    return f"what would be lost is unknown, for the robot file gives no range of {missing[0]}" if missing else ""


def displacement_without(robot: Robot, parameters: Collection[str]) -> tuple[float, float]:
    """Return mean and maximum displacement [m] of the measured point if these parameters are zero.

    Joint variables and conditions are drawn uniformly from the range on which the robot was learnt,
    approach directions from its ends. Where it is unknown, they are drawn from the joint limits,
    both directions, the whole progress, and the declared value of every other condition.
    """
    q, w = _poses(robot)
    without = robot.parameters.values.copy()
    without[[robot.parameters.index_of(name) for name in parameters]] = 0.0
    (p,) = robot.model.evaluate(("p",), q, w, without)
    return _apart(robot, q, w, p)


def _apart(robot: Robot, q: Array, w: Array, other: Array) -> tuple[float, float]:
    """Return mean and maximum distance [m] between the robot's measured point and other points.

    Poses at which a closed loop (four-bar) cannot close are excluded.

    q : joint variables, shape (poses, n) [rad or m]; w : conditions, shape (poses, m)
    other : the other points in the measuring frame, shape (3, poses) [m]
    """
    p, margin = robot.model.evaluate(("p", "margin"), q, w, robot.parameters.values)
    closed = (margin.reshape(-1, SAMPLED_POSES) > MIN_LOOP_MARGIN).all(axis=0)
    moved = np.linalg.norm(p - other, axis=0)[closed]
    return float(moved.mean()), float(moved.max())


def _poses(robot: Robot) -> tuple[Array, Array]:
    """Return random joint variables, (k, n) [rad or m], and conditions, (k, m), with a fixed seed.

    They are in the ranges of `displacement_without`; k is `SAMPLED_POSES`.
    """
    rng = np.random.default_rng(0)
    ranges = robot.knowledge.readings if robot.knowledge else np.zeros((0, 2))
    lower, upper = ranges.T if len(ranges) else robot.limits
    q = rng.uniform(lower, upper, (SAMPLED_POSES, robot.n))
    columns = [_drawn(robot, k, rng) for k in range(len(robot.conditions))]
    w = np.column_stack(columns or [np.zeros((SAMPLED_POSES, 0))])
    return q, w


def _drawn(robot: Robot, column: int, rng: np.random.Generator) -> Array:
    """Return random values of one condition, shape (poses,), in its own unit.

    The range is the robot file's; otherwise -1 to 1 for an approach direction, 0 to 1 for progress,
    and the declared value for the rest. An approach direction is either end of its range.
    """
    name, declared = robot.conditions[column], robot.declared[column]
    usual = (-1.0, 1.0) if name.startswith("approach") else (0.0, 1.0) if name == "progress" else (declared, declared)
    low, high = (robot.knowledge.conditions if robot.knowledge else {}).get(name, usual)
    if name.startswith("approach"):
        return np.asarray(rng.choice((low, high), SAMPLED_POSES))
    return np.asarray(rng.uniform(low, high, SAMPLED_POSES))
