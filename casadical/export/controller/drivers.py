"""The calibrated geometry in drivers' formats: YAML of the UR driver, DH tables, xacro.

Each holds the geometry of a rigid arm in the robot's own base frame; the position error of what a
format cannot hold is reported in millimetres.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.files import csv_text
from casadical.core.transforms import frame, inverse, to_rpy
from casadical.export.controller.commands import Sources, own_robots, robot_of
from casadical.export.omission import rigid_omissions
from casadical.robot.axes import frames_at_zero, row_matrix
from casadical.robot.robot import Robot, modified_dh


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
    # Largest sine of the angle between two axes at which they count as parallel, and largest
    # distance [m] at which parallel ones count as coincident, so that their common normal is not
    # unique.
    parallel_tolerance = 1e-9
    if np.linalg.norm(normal) < parallel_tolerance:
        normal = np.array([p[0], p[1], 0.0]) if np.hypot(p[0], p[1]) > parallel_tolerance else np.array([1.0, 0, 0])
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
    """Return the kinematics YAML of the UR driver: link origins [m, rad] at zero joint variables.

    Raises InputError: the nominal robot's twists are more than 3 deg from those of a UR.
    """
    twists = np.array([j.alpha for j in nominal.joints])
    # Names that the UR driver gives to a robot's links, in the order of the joints.
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
