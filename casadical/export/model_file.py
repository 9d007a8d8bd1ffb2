"""Convert a calibrated robot to another program's format: MuJoCo, URDF, driver kinematics."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from casadical.core.basics import InputError, Show, silent
from casadical.core.files import json_text
from casadical.core.reading import missing
from casadical.core.reporting.blocks import Words
from casadical.core.reporting.result import Result
from casadical.effects.base import Omission
from casadical.export.controller.commands import Sources, robot_of
from casadical.export.controller.drivers import DRIVER_FORMS as DRIVERS
from casadical.export.controller.drivers import driver_file
from casadical.export.mjcf.into_mjcf import into_mjcf
from casadical.export.mjcf.mjcf import MjcfExport, mjcf
from casadical.export.mjcf.moving import (
    actuators_of,
    has_motion_parameters,
    moving_mjcf,
    omitted_drive_parameters,
    replay_in_words,
)
from casadical.export.omission import geometry_alone, left_out, rigid_omissions
from casadical.measurements.logs.reading import is_log, read_log
from casadical.project.calibration import Calibration, calibrate
from casadical.project.diagnosis import Options, diagnose_campaign, effects_named, read_campaigns
from casadical.project.problem import read_campaign_robot, read_problem, read_problem_robot
from casadical.robot.robot import Robot
from casadical.robot.urdf import new_urdf, no_urdf_place

# Names of the formats to which a robot can be converted, as of `export model --to`.
MODEL_FORMS = ("mjcf", "urdf", "actuators", *DRIVERS)


@dataclass(frozen=True, eq=False)
class RobotModel(Result):
    """A robot in the file format of another program.

    text : content of the file
    lines : sentences on what the file holds besides the geometry, what it omits, the position error
        without it, and of a model that moves its replay
    figures : the same, without the replay, or for "actuators" the file's content, as plain data
    about : robot in words, such as its name and number of joints
    """

    line: ClassVar[str] = " of {{ it.about or 'a robot' }}, {{ it.text.splitlines() | length }} lines"

    file_stem: ClassVar[str] = "model"

    text: str
    lines: tuple[str, ...]
    figures: dict[str, Any]
    about: str = ""

    def blocks(self) -> list[Words]:
        """Return the sentences of `lines`, one per block, or one that nothing is left out."""
        return [Words(line) for line in self.lines or ("nothing is left out",)]

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data."""
        return self.figures


def form_of(word: str | None, out: Path) -> str:
    """Return the name of the requested format, or of that which a file's suffix implies.

    word : requested format; None: none; out : path of the file
    Raises InputError: the format is unknown, or the suffix implies none.
    """
    endings = {".xml": "mjcf", ".urdf": "urdf", ".json": "actuators", ".xacro": "xacro"}
    endings |= {".yaml": "ur", ".yml": "ur"}
    form = word or endings.get(out.suffix.lower())
    if form is None:
        raise InputError(f"{out}: its ending does not say which form is wanted; give --to {'|'.join(MODEL_FORMS)}")
    if form not in MODEL_FORMS:
        raise InputError(f"--to {form}: unknown; allowed: {', '.join(MODEL_FORMS)}")
    return form


def robot_model(
    source: str | Path,
    form: str,
    *,
    nominal: Path | None = None,
    campaign: Path | None = None,
    effects: str | None = None,
    into: Path | None = None,
    joints: str | None = None,
    springs: bool = False,
    checksum: str = "",
    leave_out: bool = False,
    show: Show = silent,
) -> RobotModel:
    """Return a calibrated robot in the file format of another program, with what the format omits.

    source : robot file, whose values are taken, or problem folder, which is calibrated
    form : "mjcf", "urdf", "actuators" (drive parameters by joint name) or a table of geometry for
        other software: "ur", "standard_dh", "modified_dh", "xacro"
    nominal : robot file from before the calibration: for a driver's kinematics, and for `into` with
        a robot file as source and no campaign
    campaign : for "mjcf", table of measured poses from which the robot is calibrated and diagnosed,
        or a joint log that the model replays in MuJoCo
    effects : for "mjcf", the effects to be diagnosed, as the option of `casadical diagnose`
    into : for "mjcf", a user's MuJoCo model into which the calibrated geometry is written
    joints : for `into`, names of the arm's joints in that model, separated by commas
    springs : for `into`, whether compliant joints get springs in addition
    checksum : for "ur", checksum of the controller's own calibration
    leave_out : for "mjcf" and "urdf", whether effects that the format cannot represent are omitted;
        else they are refused. Tables of geometry always omit them
    show : function that is called with each line of progress
    Returns the text of the file (`text`), and sentences on what it omits and the position error
        that this causes (`lines`)
    Raises InputError: an argument does not belong to this format, or the format cannot represent
        an effect; ConvergenceError: Ipopt finds no optimum.

    Examples
    --------
    >>> model = casadical.robot_model("problems/planar/robot.toml", "mjcf")
    >>> "<mujoco" in model.text, model.about
    (True, 'Planar arm of two links, 2 joints')
    """
    source = Path(source)
    if not source.exists():
        raise missing(source, "problem folder or robot file")
    if form != "mjcf" and any((campaign, effects, into, joints, springs)):
        raise InputError("--campaign, --effects, --into, --joints and --springs are of MuJoCo models: give --to mjcf")
    if form != "ur" and checksum:
        raise InputError(f"--hash is of the UR driver's kinematics, not of {form}: give --to ur")
    if form == "mjcf":
        if (into is None) != (joints is None) or (into is None and (springs or nominal)):
            raise InputError("--into and --joints belong together; --springs and --nominal belong to them")
        if effects and campaign is None:
            raise InputError("--effects says with which effects --campaign is diagnosed; give --campaign CSV, too")
        show("calibrating")
        logged = campaign if campaign and is_log(campaign) else None
        robot = robot_to_write(source, None if logged else campaign, effects, show)
        moves = has_motion_parameters(robot) and into is None
        if logged and not moves:
            raise InputError(
                f"{logged.name}: a joint log, and no drives to replay it: casadical diagnose ARM LOG --out DIR"
            )
        if into is not None:
            made = _into_users(source, nominal, campaign, into, str(joints), springs, robot)
        else:
            made = moving_mjcf(robot) if moves else mjcf(robot)
        counted = (f"the controller's readings J: {robot.readings_in_words}",) if robot.counts_otherwise else ()
        omitted = (*left_out(robot, made.omitted, "a MuJoCo model", leave_out), *made.notes, *counted)
        sentences = (*(f"effect {text}" for text in made.written), *(f"LEFT OUT {text}" for text in omitted))
        if moves:
            show("replaying in MuJoCo")
            sentences += (replay_in_words(robot, made.text, read_log(logged, robot) if logged else None),)
        data = {"robot": robot.name, "written": list(made.written), "left_out": list(omitted)}
        return RobotModel(made.text, sentences, data, f"{robot.name}, {robot.n} joints")
    if form == "actuators":
        robot = robot_to_write(source)
        drives = actuators_of(robot)
        return RobotModel(json_text(drives), ("the drives alone",), drives, f"drives of {robot.name}, by joint names")
    if form == "urdf":
        return _urdf(source, nominal, leave_out, show)
    if nominal is None:
        raise InputError(f"--to {form}: needs the robot file from before the calibration, too: give --nominal")
    show("calibrating")
    given = calibrated(source).written_robot if source.is_dir() else source
    text, omitted = driver_file(Sources(given, nominal), form, checksum)
    figures = {"form": form, "left_out": list(omitted)}
    return RobotModel(text, tuple(f"LEFT OUT {line}" for line in omitted), figures)


def calibrated(folder: Path) -> Calibration:
    """Return the calibration of a problem folder by its last method. Raises CasadicalError."""
    problem = read_problem(folder)
    return calibrate(problem, method=problem.methods[-1])


def robot_to_write(
    source: Path, campaign: Path | None = None, effects: str | None = None, show: Show = silent
) -> Robot:
    """Return the robot to be exported, from a robot file, a problem folder or a diagnosed campaign.

    Without a campaign a robot file is read and a problem folder is calibrated; with a campaign the
    robot is calibrated and diagnosed from it, and has the causes found as effects.

    source : robot file or problem folder; campaign : CSV of measured poses
    effects : as of `casadical diagnose`
    Raises InputError, ConvergenceError.
    """
    if campaign is None:
        return read_campaign_robot(source) if source.is_file() else calibrated(source).written_robot
    (given,) = read_campaigns(source, [campaign])
    asked = Options(effects_named(effects))
    return diagnose_campaign(given, asked, show).diagnosis.apply()


def _into_users(
    source: Path, nominal: Path | None, campaign: Path | None, into: Path, joints: str, springs: bool, robot: Robot
) -> MjcfExport:
    """Return a user's MJCF model with the robot's geometry and joint springs, without effects.

    nominal : robot file from before the calibration; None: source is it, so that a robot file needs
        a campaign
    into : the user's MJCF file; joints : names of its joints, separated by commas
    springs : whether springs are added to the compliant joints; robot : calibrated robot
    Raises InputError: no robot from before the calibration, or as of `into_mjcf`.
    """
    if source.is_file() and nominal is None and campaign is None:
        raise InputError("--into needs the robot before its calibration too: give --nominal, or the problem folder")
    if nominal is not None:
        before = robot_of(nominal)
    else:
        before = read_campaign_robot(source) if campaign else read_problem_robot(source)
    names = [name.strip() for name in joints.split(",")]
    text = into_mjcf(before, robot, into, names, springs)
    why = f"effects go into a model of casadical's own, not into {into.name}"
    omitted = tuple(Omission(label, why) for label in dict.fromkeys(e.label for e in robot.effects))
    lacking = not springs and any(j.compliance for j in robot.joints)
    notes = ("springs of the joints; --springs adds them",) if lacking else ()
    return MjcfExport(text, (), omitted, notes)


def _urdf(source: Path, nominal: Path | None, leave_out: bool, show: Show) -> RobotModel:
    """Return the robot as a URDF (geometry and masses), with the position errors of what it omits.

    The user's own URDF is updated where the problem names one; otherwise a new one is written.
    Raises InputError: `nominal` is given, or effects are omitted and `leave_out` is false.
    """
    if nominal is not None:
        raise InputError("--nominal has no part in a URDF; remove it")
    show("calibrating")
    calibration = calibrated(source) if source.is_dir() else None
    robot = calibration.written_robot if calibration else robot_to_write(source)
    into = calibration.problem.urdf if calibration else None
    figures = geometry_alone(calibration) if calibration else None
    omissions = [Omission(e.label, "a URDF holds geometry and masses only") for e in robot.effects]
    soft = (*left_out(robot, omissions, "a URDF", leave_out), *rigid_omissions(robot))
    own = () if calibration and into else no_urdf_place(robot)
    omitted = (*soft, *omitted_drive_parameters(robot), *own)
    text = calibration.problem.calibrated_urdf(robot) if calibration and into else new_urdf(robot)
    nothing = "nothing is left out: the robot is rigid and has no effects"
    lines = [f"LEFT OUT {line}" for line in omitted] or [nothing]
    if figures:
        poses = "held-out poses" if figures["set"] == "report" else "poses that were identified from"
        lines.append(
            f"mean error at {figures['poses']} {poses}: nominal, base and tool fitted, "
            f"{figures['nominal_mm']:.3f} mm; this URDF alone {figures['geometry_mm']:.3f} mm; the "
            f"whole model {figures['model_mm']:.3f} mm"
        )
    if soft:
        lines.append(
            "a robot that is calibrated as rigid (method KM) loses less as a URDF; `export model "
            "--to mjcf` keeps the springs"
        )
    name = into[0].name if into else None
    data = {"robot": robot.name, "into": name, "left_out": list(omitted), "mean_errors": figures}
    about = f"{robot.name}, {robot.n} joints" + (f", after {name}" if name else "")
    return RobotModel(text, tuple(lines), data, about)
