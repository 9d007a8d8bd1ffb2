"""Which robot is written: a robot file's, a problem's calibrated one, or a campaign's with its diagnosed effects."""

from collections.abc import Callable
from pathlib import Path

from casadical.core.errors import InputError
from casadical.diagnosis.result import Diagnosis
from casadical.effects.counterparts import Omission
from casadical.export.mjcf.into_mjcf import into_mjcf
from casadical.export.mjcf.mjcf import MjcfExport
from casadical.project.calibration import Calibration, calibrate
from casadical.project.diagnosis import Options, diagnose_campaign, read_campaigns
from casadical.project.problem import read_campaign_robot, read_problem, read_problem_robot
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

Show = Callable[[str], None]


def calibrated(folder: Path) -> Calibration:
    """A problem calibrated by the last of its methods. Raises InputError, ConvergenceError."""
    problem = read_problem(folder)
    return calibrate(problem, method=problem.methods[-1])


def robot_to_write(
    source: Path, campaign: Path | None = None, effects: str | None = None, show: Show = lambda _text: None
) -> tuple[Robot, Diagnosis | None]:
    """The robot, and the diagnosis where a campaign is given.

    source : a robot file, taken as it is, or a problem folder, which is calibrated; campaign : measured poses from
    which the robot of either is calibrated and diagnosed; effects : as of `casadical diagnose`
    Raises InputError, ConvergenceError.
    """
    if not source.exists():
        raise InputError(f"{source}: no such problem folder or robot file")
    if campaign is None:
        return read_campaign_robot(source) if source.is_file() else calibrated(source).robot, None
    (given,) = read_campaigns(source, [campaign])
    options = Options(effects.split(",") if effects else "standard")
    found = diagnose_campaign(given, options, show).diagnosis
    return found.apply(), found


def into_users(
    source: Path, campaign: Path | None, nominal: Path | None, robot: Robot, into: Path, joints: str, springs: bool
) -> MjcfExport:
    """A user's own model with the geometry (and springs) of a robot from `robot_to_write`; effects stay out of it.

    nominal : robot file from before the calibration, needed where source is a robot file; joints : names by commas
    Raises InputError.
    """
    if source.is_file() and nominal is None and campaign is None:
        raise InputError("--into needs the robot before its calibration too: give --nominal, or the problem folder")
    if nominal is not None:
        before = read_robot(nominal)
    else:
        before = read_campaign_robot(source) if campaign else read_problem_robot(source)
    text = into_mjcf(before, robot, into, [name.strip() for name in joints.split(",")], springs)
    why = f"effects go into a model of casadical's own, not into {into.name}"
    omitted = tuple(Omission(label, why) for label in dict.fromkeys(e.label for e in robot.effects))
    lacking = not springs and any(j.compliance for j in robot.joints)
    return MjcfExport(text, (), omitted, ("springs of the joints; --springs adds them",) if lacking else ())
