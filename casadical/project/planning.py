"""What `casadical plan` does: calibrate what was measured, choose the next poses, order them, look ahead, stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from casadical.core.errors import InputError
from casadical.effects import Effect
from casadical.identification.identification import identify
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.pose_selection.candidates import Circumstances
from casadical.pose_selection.criteria import Criterion
from casadical.pose_selection.information import Noise
from casadical.pose_selection.pose_search import select_poses
from casadical.pose_selection.selection import Selection
from casadical.pose_selection.stopping_rule import Forecast, forecast
from casadical.pose_selection.workspace import Workspace
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot


def robot_of(path: Path) -> Robot:
    """The robot of a problem folder, of a robot file, or of what `calibrate --out` wrote. Raises InputError."""
    if path.is_file():
        return read_robot(path)
    written = sorted(path.glob("*.robot.toml"))
    if not (path / "problem.toml").exists() and written:
        if len(written) > 1:
            names = ", ".join(str(p) for p in written)
            raise InputError(f"{path}: {len(written)} calibrated robots; give the one to plan with: {names}")
        return read_robot(written[0])
    return read_campaign_robot(path)


def planned_with(path: Path, measured: Path | None) -> str:
    """Which model the poses are chosen for, in a sentence."""
    if measured is not None:
        return f"Planned with the robot of {path}, calibrated with {measured}."
    if not (path / "problem.toml").exists():
        return f"Planned with the robot of {path}, as it stands there."
    return (
        f"Planned with the robot that {path} declares, its base and tool as declared too. Once something is measured, "
        "give it with --measured, or plan with the robot file that calibrate --out wrote."
    )


def continued(robot: Robot, m: Measurements, noise: Noise | None) -> tuple[Robot, Measurements, Noise]:
    """The robot calibrated by what was measured, that, and the noise it shows if none is given. Raises InputError."""
    m, missing = derive(m, robot.conditions)
    lost = [name for name in missing if name != "payload_kg"]
    if lost:
        raise InputError(f"{m.source}: column {lost[0]!r} is missing, which the effects to plan for need")
    result = identify(robot, m, ("kinematic", "compliance", *(e.label for e in robot.effects)))
    return result.robot, m, noise or Noise(result.sigmas[0][0])


@dataclass(frozen=True, eq=False)
class _Start:
    """Where planning begins: the robot with its effects, calibrated by what was measured, and the noise."""

    robot: Robot
    measured: Measurements | None
    noise: Noise | None


def _start(robot: Robot, effects: Sequence[Effect], measured: Measurements | None, noise: Noise | None) -> _Start:
    known = {e.label for e in robot.effects}
    robot = robot.with_effect(*(e for e in effects if e.label not in known)) if effects else robot
    return _Start(robot, None, noise) if measured is None else _Start(*continued(robot, measured, noise))


def _mounted(given: Circumstances | None, effects: Sequence[Effect], measured: Measurements | None) -> Circumstances:
    """If effects are to be identified, payloads that were mounted before can be mounted again."""
    known = given or Circumstances()
    states = np.unique(measured.conditions["payload_kg"]) if measured and "payload_kg" in measured.conditions else ()
    return known if known.payloads or not effects or len(states) < 2 else replace(known, payloads=tuple(states))


def look_ahead(
    robot: Robot,
    effects: Sequence[Effect] = (),
    *,
    most: int = 100,
    workspace: Workspace | None = None,
    circumstances: Circumstances | None = None,
    measured: Measurements | None = None,
    noise: Noise | None = None,
    seed: int = 0,
) -> Forecast:
    """The stopping rule: the accuracy to expect against the number of poses, with what was measured so far.

    effects : in the model as well; measured : poses measured already; most : as of `forecast`, on top of these
    Raises InputError.
    """
    start = _start(robot, effects, measured, noise)
    circumstances = _mounted(circumstances, effects, start.measured)
    before = 0 if start.measured is None else len(start.measured)
    return forecast(
        start.robot, before + most, workspace=workspace, circumstances=circumstances, measured=start.measured,
        noise=start.noise, seed=seed,
    )  # fmt: skip


def plan(
    robot: Robot,
    n: int,
    effects: Sequence[Effect] = (),
    *,
    criterion: Criterion = "V",
    workspace: Workspace | None = None,
    circumstances: Circumstances | None = None,
    measured: Measurements | None = None,
    noise: Noise | None = None,
    min_distance: float = 0.0,
    order: bool = True,
    seed: int = 0,
) -> tuple[Selection, Forecast]:
    """Poses in order and the forecast beyond them.

    effects : to identify, besides the accuracy over the task; measured : poses measured already; order : for
    little travel; other arguments as of `select_poses`. Raises InputError.
    """
    start = _start(robot, effects, measured, noise)
    before, noise = start.measured, start.noise
    circumstances = _mounted(circumstances, effects, before)
    found = select_poses(
        start.robot, workspace, n, criterion, circumstances=circumstances, measured=before,
        interest=tuple(e.label for e in effects), noise=noise, min_distance=min_distance, seed=seed,
    )  # fmt: skip
    total = len(found) + (0 if before is None else len(before))
    ahead = forecast(
        start.robot, total + max(20, total // 2), workspace=workspace, circumstances=circumstances, measured=before,
        noise=noise, seed=seed,
    )  # fmt: skip
    return (found.ordered() if order else found), ahead
