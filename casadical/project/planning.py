"""Measurement plans: calibration with the poses so far, the next poses and the forecast."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import Words, next_step
from casadical.identification.pose_selection.camera_stations import (
    CameraStations,
    camera_stations,
    read_view,
    simulated_stations,
)
from casadical.identification.pose_selection.candidates import Circumstances, one_turn
from casadical.identification.pose_selection.planning import MeasurementPlan, Places, plan
from casadical.identification.pose_selection.pose_search import forecast, select_poses
from casadical.identification.pose_selection.workspace import Workspace, read_workspace
from casadical.identification.result import Identification
from casadical.measurements.columns import POSSIBLE_RANGES, Columns
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements, Noise
from casadical.measurements.raw_table import read_table
from casadical.project.acceptance.iso9283 import planned_test, words_of_plan
from casadical.project.problem import Carried, read_campaign, read_campaign_robot
from casadical.project.problem_file import tables_of
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

# Standard deviation of a coordinate by a laser tracker [mm]; plans use it where none is declared.
TRACKER_SIGMA_MM = 0.02


def robot_of(path: Path) -> Robot:
    """Return the robot to plan with: of a problem folder, a robot file or a folder of results.

    Of results it is the only calibrated robot. Raises InputError where there are several.
    """
    if path.is_file():
        return read_campaign_robot(path)
    written = sorted(path.glob("*.robot.toml"))
    if not (path / "problem.toml").exists() and written:
        if len(written) > 1:
            names = ", ".join(str(p) for p in written)
            raise InputError(f"{path}: {len(written)} calibrated robots; give the one to plan with: {names}")
        return read_robot(written[0])
    return read_campaign_robot(path)


def circumstances_of(payloads: str | None, every_payload: bool, both_approaches: bool, repeats: int) -> Circumstances:
    """Return the payloads, approaches and repeats of a plan, from the command's options.

    payloads : masses [kg], separated by commas; None: none
    every_payload : whether each pose is measured with every payload
    both_approaches : whether each pose is approached from both directions
    repeats : number of measurements of each pose
    Raises InputError for payloads that are no numbers or not possible.
    """
    try:
        numbers = tuple(float(word) for word in payloads.split(",")) if payloads else ()
    except ValueError:
        raise InputError(f"--payloads {payloads}: allowed: numbers by commas, such as 0,120") from None
    least, most = POSSIBLE_RANGES["payload_kg"]
    for number in numbers:
        if not least <= number <= most:
            raise InputError(f"--payloads {payloads}: {number:g} kg is not possible; allowed: {least:g} to {most:g}")
    return Circumstances(numbers, every_payload, both_approaches, repeats)


def places_of(wires: int | None, sockets: int | None, candidates: Path | None, surveyed: bool) -> Places | None:
    """Return the wires or sockets to plan for in place of positions; None without these options.

    candidates : table of places in the measuring frame, in columns x_mm, y_mm, z_mm (or _m)
    surveyed : whether the places will be measured
    Raises InputError for options that do not go together.
    """
    if wires and sockets:
        raise InputError("--wires and --sockets: give one of them; each is a plan of its own")
    if not (wires or sockets):
        if candidates is not None or surveyed:
            raise InputError("--places and --known-places are of --wires N or --sockets N; give one of these, too")
        return None
    where = Columns.of_file(read_table(candidates)).vector("") if candidates else None
    return Places("wires", wires, where, surveyed) if wires else Places("sockets", sockets or 1, where, surveyed)


def declared_kinds_and_noise(path: Path, robot: Robot) -> tuple[tuple[str, ...], float | None]:
    """Return the kinds of a problem folder's tables, and the largest declared sigma [mm].

    A kind that is not declared is read from the table, if that is possible; the noise is None where
    none is declared. A robot file has neither: ((), None).
    """
    tables = tables_of(path) if path.is_dir() else ()
    kinds = {data.kind for data in tables if data.kind}
    for data in tables:
        if data.kind is None and (path / data.file).is_file():
            with suppress(InputError):  # a plan needs no table
                kinds.add(read_campaign(path, path / data.file, robot).kind)
    return tuple(sorted(kinds)), max((data.sigma_mm for data in tables if data.sigma_mm), default=None)


def more_poses(path: Path, m: Measurements) -> Words:
    """Return the command that plans more poses of the kind of m; at most four wires.

    path : problem folder or robot file
    """
    ends = m.label if m.target is None else m.target
    kind = {"distance": "--wires", "contact": "--sockets"}.get(m.kind)
    count = 1 if ends is None else len(np.unique(ends, axis=0))
    more = (kind, str(min(count, 4) if kind == "--wires" else count)) if kind else ()
    return next_step("to plan poses that are enough", "plan", path, *more)


def noise_declared(path: Path, robot: Robot, places: Places | None) -> float:
    """Return the standard deviation of a coordinate to plan with where none is given [mm].

    It is the one that the folder's tables declare, else that of a laser tracker. Raises InputError
    where the tables are of no positions and it is not said what to plan for.
    """
    kinds, noise = declared_kinds_and_noise(path, robot)
    if places is None and kinds and not any("position" in find_kind(kind).arrays for kind in kinds):
        raise InputError(
            f"{path}: its tables are of kind {', '.join(kinds)}, and a plan is for positions "
            "unless more is given; give --wires N for N draw wires, --sockets N for touched "
            "points, or --noise-mm for positions all the same"
        )
    return TRACKER_SIGMA_MM if noise is None else noise


def planned_with(path: Path, measured: Path | None, prior: Path | None = None) -> str:
    """Return a sentence on the model with which poses are planned.

    path : problem folder or robot file; measured : table of poses so far; prior : robot file of
        another campaign
    """
    if prior is not None:
        more = f" and {measured}" if measured else ""
        return f"Planned with the robot of {path} and what {prior}{more} tells of it: calibrate with the same --prior."
    if measured is not None:
        return f"Planned with the robot of {path}, calibrated with {measured}."
    if not (path / "problem.toml").exists():
        return f"Planned with the robot of {path}, as it stands there."
    return (
        f"Planned with the robot that {path} declares, its base and tool as declared too. Once "
        "something is measured, give it with --measured, or plan with the robot file that "
        "calibrate --out wrote."
    )


def plan_problem(
    path: Path,
    n: int | None,
    measured: Path | None,
    carried: Carried,
    *,
    effects: Sequence[str],
    room: Path | None,
    noise_mm: float | None,
    joint_noise_urad: float,
    target_mm: float | None,
    places: Places | None,
    **asked: Any,
) -> MeasurementPlan:
    """Return the plan of a problem folder or robot file, asked for in the units of the command.

    path : problem folder, robot file or folder of results
    n : number of poses, as of `plan`
    measured : table of the poses measured so far
    carried : function that puts a prior into the robot
    effects : names or labels of effects to plan for
    room : file of a workspace
    noise_mm : one sigma of a coordinate; None: as declared, or estimated
    joint_noise_urad : one sigma of the joints' repeatability
    target_mm : wanted accuracy
    places : wires or sockets, in place of positions
    asked : further arguments of `plan`
    Raises InputError.
    """
    from casadical.diagnosis.candidates import named

    robot, prior = carried(robot_of(path))
    before = read_campaign(path, measured, robot) if measured else None
    candidates = [c for c in named(robot, effects) if c.listed] if effects else []
    # An effect with a grid of settings is represented by the middle one, and once where it is of a
    # joint and of all joints together.
    middle = {e.label: e for c in candidates for e in c.variants[len(c.variants) // 2]}
    if noise_mm is None and measured is None:
        noise_mm = noise_declared(path, robot, places)
    noise = None if noise_mm is None else Noise(1e-3 * noise_mm, 1e-6 * joint_noise_urad)
    return plan(
        robot,
        n,
        [*middle.values()],
        workspace=read_workspace(room, robot) if room else None,
        measured=before,
        noise=noise,
        target=None if target_mm is None else 1e-3 * target_mm,
        places=places,
        prior=prior,
        **asked,
    )


def poses_ahead(robot: Robot, folder: Path, workspace: Workspace | None, target: float | None) -> tuple[Array, str]:
    """Return ordered joint variables to measure, (n, joints) [rad or m], and a sentence on them.

    Their number is what the stopping rule, or the wanted accuracy, needs, if 100 are enough.

    folder : problem folder, whose tables may declare the noise
    workspace : None: above the plane z = 0 of the robot's base or, if none is there, anywhere
    target : wanted accuracy [m], None without one
    Raises InputError where no pose is allowed.
    """
    own = replace(robot.without_sessions, targets=(), tool_name="")
    own = one_turn(own if workspace else replace(own, base=replace(own.base, T=np.eye(4))))
    # The second floor is for robots with axes in the plane that they stand on.
    above = [Workspace(floor=0.0, clearance=0.05), Workspace(floor=0.0, clearance=-1e-6)]
    noise = Noise(1e-3 * (declared_kinds_and_noise(folder, robot)[1] or TRACKER_SIGMA_MM))
    rooms = [workspace] if workspace else [*above, Workspace()]
    for k, room in enumerate(rooms, 1):
        how: dict[str, Any] = {"workspace": room, "noise": noise, "free": ("kinematic", "compliance"), "pool": 300}
        try:
            course = forecast(own, 100, **how)
            enough = course.enough(target) if target else course.stop()
            n = enough or int(course.poses[-1])
            chosen = select_poses(own, None, n, restarts=1, **how).ordered()
        except InputError:
            if k == len(rooms):
                raise
            continue
        said = f"{n} are planned, of which {1e3 * chosen.accuracy:.3f} mm are to expect"
        if target and not enough:
            said += f"; they are not enough for {1e3 * target:.3g} mm"
        return chosen.q, said + ("; floor and obstacles were not checked: --room FILE.toml" if k == 3 else "")
    raise AssertionError


def stations_ahead(
    arm: Identification | Path, n: int, view: str, sigma: float, room: Path | None, seed: int
) -> CameraStations:
    """Return n stations of an arm with a camera, chosen by the stations so far.

    arm : calibration of the stations so far; robot file: stations are simulated, camera at the tool
    view, sigma : of the simulation: NEAR,FAR,OFF,OBLIQUE [m, deg], noise [m]
    room : file of a workspace
    Raises InputError.
    """
    seen = None
    if isinstance(arm, Path):
        seen = read_view(view)
        arm = simulated_stations(read_campaign_robot(arm), seen, sigma, seed)
    return camera_stations(arm, n, read_workspace(room, arm.robot) if room else None, seed, seen)


def iso9283_plan(path: Path, cube_mm: float | None, room: Path | None, seed: int) -> tuple[list[Words], pd.DataFrame]:
    """Return instructions for a test by ISO 9283, and the table of its poses to be filled in.

    path : problem folder, robot file or folder of results
    cube_mm : side of the test cube; None: the largest that fits
    room : file of a workspace
    Raises InputError.
    """
    robot = robot_of(path)
    side, workspace = 1e-3 * cube_mm if cube_mm else None, read_workspace(room, robot) if room else None
    table, centre, size = planned_test(robot, side, workspace, seed)
    return words_of_plan(robot, table, centre, size), table
