"""Convert a calibrated robot to another program's format: MuJoCo, URDF, driver kinematics.

Formats of drivers (YAML of the UR driver, DH tables, xacro) hold the geometry of a rigid arm in the
robot's own base frame; the position error of what a format cannot hold is told in millimetres.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from casadical.core.basics import Array, InputError, Show, silent
from casadical.core.files import csv_text, json_text
from casadical.core.reading import missing
from casadical.core.reporting.blocks import Words
from casadical.core.reporting.result import Result
from casadical.core.transforms import frame, inverse, to_rpy
from casadical.effects.base import Omission
from casadical.export.controller.commands import Sources, own_robots, robot_of
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
from casadical.project.diagnosis import diagnose_campaign, effects_named, read_campaigns
from casadical.project.problem import read_campaign_robot, read_problem, read_problem_robot
from casadical.robot.axes import frames_at_zero, row_matrix
from casadical.robot.robot import Robot, modified_dh
from casadical.robot.urdf import new_urdf, no_urdf_place


def driver_file(sources: Sources, form: str, checksum: str = "") -> tuple[str, tuple[str, ...]]:
    """Return the text of a robot's kinematics in a driver's format, and sentences on what it omits.

    sources : calibrated and nominal robot
    form : `ur` (kinematics YAML of the UR ROS 2 description), `standard_dh`, `modified_dh` (CSV),
        or `xacro`
    checksum : checksum of the controller's own calibration, for `ur`: the driver compares it
    Raises InputError: another form, a robot with closed loops or without the structure of the form,
    or as of `own_robots`. Effects are omitted without being refused.
    """
    if form not in DRIVER_FORMS:
        raise InputError(f"--to {form}: unknown; allowed: {', '.join(DRIVER_FORMS)}")
    full = robot_of(sources.robot)
    if full.loops:
        raise InputError(f"{full.name}: a four-bar has no place in a driver's kinematics; export c has one")
    real, nominal, _ = own_robots(replace(sources, leave_out=True))
    frames = "base and tool of the measurement: the kinematics are those of the flange in the robot's own base frame"
    return DRIVER_FORMS[form](real, nominal, checksum), (frames, *rigid_omissions(replace(full, payload=real.payload)))


def standard_dh(robot: Robot, like: Array) -> tuple[Array, Array, Array]:
    """Return a robot's geometry as standard DH table: base (4, 4), rows (n, 4), tool (4, 4).

    Each row is theta, d, a, alpha of Rz(theta) Tz(d) Tx(a) Rx(alpha) [rad, m]; base and tool are
    transforms [m] before the first and after the last row.

    like : angles theta near which those of the rows are chosen, shape (n,) [rad]: they decide the
        directions of the common normals

    The common normals are exact, as in manufacturers' calibrations: nearly parallel axes have a
    large d, and its opposite in a later row. Base and last row take what four numbers per joint
    cannot hold. (Denavit and Hartenberg 1955; Hayati 1983 on parallel axes.)
    """
    frames = frames_at_zero(robot.joints)
    z, p = frames[0][:3, 2], frames[0][:3, 3]
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z  # the base's x axis, projected perpendicular to z
    x /= np.linalg.norm(x)
    base = frame(np.column_stack([x, np.cross(z, x), z]), p - (z @ p) * z)
    at, rows = base, []
    for i in range(robot.n - 1):
        theta, d, a, alpha = standard_row(at, frames[i + 1], like[i])
        rows.append((theta, d, a, alpha))
        at = at @ standard_row_matrix(theta, d, a, alpha)
    last = np.linalg.inv(at) @ frames[-1]
    theta, d = float(np.arctan2(last[1, 0], last[0, 0])), float(last[2, 3])
    rows.append((theta, d, 0.0, 0.0))
    tool = np.array(inverse(at @ standard_row_matrix(theta, d, 0.0, 0.0))) @ frames[-1] @ robot.tool.T
    return base, np.array(rows), tool


def standard_row(at: Array, following: Array, like: float) -> tuple[float, float, float, float]:
    """Return the standard DH row theta, d, a, alpha [rad, m] from one joint axis to the next.

    at : frame whose z axis is the first axis, shape (4, 4) [m]
    following : frame whose z axis is the next one, in the same base, shape (4, 4) [m]
    like : angle theta [rad]; of the two possible ones the nearer to it is taken
    """
    local = np.array(inverse(at)) @ following
    z, p = local[:3, 2], local[:3, 3]
    normal = np.array([-z[1], z[0], 0.0])  # across both axes
    if np.linalg.norm(normal) < 1e-9:  # parallel, or coincident: many common normals
        normal = np.array([p[0], p[1], 0.0]) if np.hypot(p[0], p[1]) > 1e-9 else np.array([1.0, 0, 0])
        on = p - p[2] / z[2] * z
    else:
        # The point of the next axis nearest to this one; its offset from it is along the normal.
        on = p - (p[:2] @ z[:2]) / (z[:2] @ z[:2]) * z
    normal /= np.linalg.norm(normal)
    normal *= 1.0 if normal[0] * np.cos(like) + normal[1] * np.sin(like) >= 0 else -1.0
    theta = float(np.arctan2(normal[1], normal[0]))
    alpha = float(np.arctan2(np.cross([0, 0, 1], z) @ normal, z[2]))
    return theta, float(on[2]), float(on @ normal), alpha


def standard_row_matrix(theta: float, d: float, a: float, alpha: float) -> Array:
    """Return the transform of one standard DH row, shape (4, 4) [m]; theta, alpha [rad], d, a [m].

    It is Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha).
    """
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    R = np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0, sa, ca]])
    return frame(R, np.array([a * c, a * s, d]))


def _ur(real: Robot, nominal: Robot, checksum: str) -> str:
    """Return the kinematics YAML of the UR driver: link origins [m, rad] at zero variables."""
    twists = np.array([j.alpha for j in nominal.joints])
    ur_links = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    # Twists alpha [rad] of the rows of a UR robot's DH table, in casadical's convention.
    ur_twists_rad = np.deg2rad([0, 90, 0, 0, 90, -90])
    if (
        len(twists) != len(ur_links)
        or np.abs(twists - ur_twists_rad).max() > np.deg2rad(3)
        or nominal.joints[0].b is not None
    ):
        raise InputError(
            f"{nominal.name}: its twists are {np.rad2deg(twists).round(3).tolist()} deg, those of "
            f"a UR {np.rad2deg(ur_twists_rad).tolist()}: give a robot file with the maker's DH "
            "table (convention standard)"
        )
    lines = ["kinematics:"]
    for name, joint in zip(ur_links, real.joints, strict=True):
        T = row_matrix(joint)
        values = (*T[:3, 3], *to_rpy(T[:3, :3]))
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        lines += [f"  {name}:", *(f"    {key}: {float(v)!r}" for key, v in zip(keys, values, strict=True))]
    return "\n".join([*lines, *([f"  hash: {checksum}"] if checksum else [])]) + "\n"


def _standard_table(real: Robot, nominal: Robot, _: str) -> str:
    """Return the CSV text of the standard DH table [deg, mm] with differences from the nominal one.

    Rows for base and tool, x y z [mm] and roll pitch yaw [deg], follow those of the joints.
    """
    like = standard_dh(nominal, np.zeros(nominal.n))[1][:, 0]
    base, rows, tool = standard_dh(real, like)
    before = standard_dh(nominal, like)[1]
    table = [["joint", "theta_deg", "d_mm", "a_mm", "alpha_deg", *(f"delta_{k}" for k in ("theta", "d", "a", "alpha"))]]
    units = np.array([180 / np.pi, 1e3, 1e3, 180 / np.pi])
    for i, (row, nom) in enumerate(zip(rows * units, before * units, strict=True), 1):
        table.append([str(i), *(f"{v:.12f}" for v in (*row, *(row - nom)))])
    for name, T in (("base", base), ("tool", tool)):
        angles = np.rad2deg(to_rpy(T[:3, :3]))
        table.append([f"{name} x y z roll pitch yaw", *(f"{v:.12f}" for v in (*(1e3 * T[:3, 3]), *angles)), "", ""])
    return csv_text(table)


def _modified_table(real: Robot, _nominal: Robot, _: str) -> str:
    """Return the CSV text of the real robot's modified DH table, see `modified_dh`."""
    rows = modified_dh(real)
    texts = [["" if v is None else f"{v:.12f}" if isinstance(v, float) else str(v) for v in r.values()] for r in rows]
    return csv_text([list(rows[0]), *texts])


def _xacro(real: Robot, _nominal: Robot, _: str) -> str:
    """Return the xacro text with properties of each joint's origin and of the measured point.

    They are xyz [m] and rpy [rad] in the frame of the link before.
    """
    lines = ['<?xml version="1.0"?>', '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">']
    places = [(f"joint{i}", row_matrix(joint)) for i, joint in enumerate(real.joints, 1)]
    for name, T in [*places, ("measured", real.tool.T)]:
        for what, values in (("xyz", T[:3, 3]), ("rpy", to_rpy(T[:3, :3]))):
            text = " ".join(repr(float(v)) for v in values)
            lines.append(f'  <xacro:property name="{name}_{what}" value="{text}"/>')
    return "\n".join([*lines, "</robot>"]) + "\n"


# Function (real robot, nominal robot, checksum) -> text of each driver's format, by its name.
DRIVER_FORMS: dict[str, Callable[[Robot, Robot, str], str]] = {
    "ur": _ur,
    "standard_dh": _standard_table,
    "modified_dh": _modified_table,
    "xacro": _xacro,
}


# Names of the formats to which a robot can be converted, as of `export model --to`.
MODEL_FORMS = ("mjcf", "urdf", "actuators", *DRIVER_FORMS)


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
    Raises InputError, ConvergenceError.
    """
    if campaign is None:
        return read_campaign_robot(source) if source.is_file() else calibrated(source).written_robot
    (given,) = read_campaigns(source, [campaign])
    return diagnose_campaign(given, effects_named(effects), show=show).diagnosis.apply()


def _into_users(
    source: Path, nominal: Path | None, campaign: Path | None, into: Path, joints: str, springs: bool, robot: Robot
) -> MjcfExport:
    """Return a user's MJCF model with the robot's geometry and joint springs, without effects.

    nominal : robot file from before the calibration; None: source is it, so that a robot file needs
        a campaign
    springs : whether springs are added to the compliant joints
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
