"""Transfer the calibrated geometry into a user's own MuJoCo model: bodies move, the rest stays.

The user's link frames may differ from casadical's: each body keeps its pose relative to casadical's
frame of the same link. Only the joints' axes must be those of the nominal robot, which is checked.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.dom import minidom

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.transforms import frame, nearest_rotation, quaternion
from casadical.export.mjcf.equilibrium import load_mujoco
from casadical.export.mjcf.mjcf import armature_and_damping, numbers, place
from casadical.robot.axes import frames_at_zero
from casadical.robot.robot import Robot
from casadical.robot.urdf.tree import parse_xml


def into_mjcf(nominal: Robot, calibrated: Robot, path: Path, joints: Sequence[str], springs: bool = False) -> str:
    """Return the XML text of a user's model with the calibrated geometry.

    The base stays where it is; the site `casadical_measured` is added at the measured point.
    Relative paths of meshes are unchanged.

    nominal, calibrated : robot before and after the calibration; path : file of the user's model
    joints : names of the arm's joints in the model, from the base on
    springs : whether each compliant joint also gets a spring `NAME_spring` on the same axis, in the
        same body
    Raises InputError: a closed loop, a file that cannot be read or changed, another number of
        joints, no such joint, or a joint whose axis is not the nominal robot's.
    """
    if nominal.loops:
        raise InputError(f"{nominal.name!r} has a closed loop; write a new model (without --into)")
    if len(joints) != nominal.n:
        raise InputError(f"--joints: {len(joints)} names for the {nominal.n} joints of {nominal.name}")
    spec = _read(path)
    X, axes, points, bodies = _zero(spec, joints, str(path))
    N, after = frames_at_zero(nominal.joints), frames_at_zero(calibrated.joints)
    B = _base_pose(N, axes, points, joints, str(path))
    C = [np.linalg.inv(B @ n) @ x for n, x in zip(N, X, strict=True)]
    new = [B @ n @ c for n, c in zip(after, C, strict=True)]
    document = parse_xml(path, "mujoco")
    _, data = _at_zero(spec, joints)
    before, moved = np.eye(4), np.eye(4)
    for name, x, target in zip(bodies, X, new, strict=True):
        body = spec.body(name)
        local = np.linalg.inv(moved @ np.linalg.inv(before) @ _pose(data.body(body.parent.name))) @ target
        body.pos, body.quat = local[:3, 3], quaternion(local[:3, :3])
        _write_pose(_element(document, "body", name, str(path)), local)
        before, moved = x, target
    refuse_unmoved(spec, joints, new, str(path))
    site = document.createElement("site")
    site.setAttribute("name", "casadical_measured")
    _write_pose(site, np.linalg.inv(C[-1]) @ calibrated.tool.T)
    _element(document, "body", bodies[-1], str(path)).appendChild(site)
    for name, row in zip(joints, calibrated.joints, strict=True) if springs else ():
        _add_spring(document, name, row.compliance or 0.0, str(path))
    return "\n".join(node.toxml() for node in document.childNodes) + "\n"


def _element(document: minidom.Document, tag: str, name: str, source: str) -> minidom.Element:
    """Return the only element with a tag and name.

    source : name of the file, for the message
    Raises InputError: there is none, or more than one.
    """
    elements = [e for e in document.getElementsByTagName(tag) if e.getAttribute("name") == name]
    if len(elements) != 1:
        raise InputError(f"{source}: {tag} {name!r} is not in this file itself; is it in an <include>?")
    return elements[0]


def _write_pose(element: minidom.Element, T: Array) -> None:
    """Set position and orientation of an element to a pose T in its parent, shape (4, 4) [m]."""
    for other in ("axisangle", "euler", "xyaxes", "zaxis"):
        if element.hasAttribute(other):
            element.removeAttribute(other)
    for attribute, value in place(T).items():
        element.setAttribute(attribute, value)


def _add_spring(document: minidom.Document, name: str, compliance: float, source: str) -> None:
    """Add a spring hinge (or slide) NAME_spring behind a joint in its body, on the same axis.

    name : name of the joint; source : name of the file, for messages
    compliance : compliance of the joint [rad/(N m) or m/N]; 0: nothing is added
    """
    if not compliance:
        return
    joint = _element(document, "joint", name, source)
    spring = document.createElement("joint")
    copied = {key: joint.getAttribute(key) for key in ("type", "axis", "pos", "class") if joint.hasAttribute(key)}
    rest = {"limited": "false", "stiffness": numbers(1 / compliance), **armature_and_damping(1 / compliance)}
    for key, value in ({"name": f"{name}_spring"} | copied | rest).items():
        spring.setAttribute(key, value)
    assert isinstance(joint.parentNode, minidom.Element)
    joint.parentNode.insertBefore(spring, joint)
    joint.parentNode.insertBefore(joint, spring)


def _read(path: Path) -> Any:
    """Return MuJoCo's specification of a model file. Raises InputError if it cannot be read."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        return load_mujoco().MjSpec.from_file(str(path))
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot read it: {str(error).strip()}") from None


def _at_zero(spec: Any, joints: Sequence[str]) -> tuple[Any, Any]:
    """Return MuJoCo's compiled model and its data, with the arm's joints (only these) at zero.

    spec : MuJoCo's specification of the model; joints : names of the arm's joints
    """
    mujoco = load_mujoco()
    model = spec.compile()
    data = mujoco.MjData(model)
    for name in joints:
        data.qpos[model.joint(name).qposadr[0]] = 0.0
    mujoco.mj_kinematics(model, data)
    return model, data


def _pose(body: Any) -> Array:
    """Return the pose of one of MuJoCo's bodies in the model's world, shape (4, 4) [m]."""
    return frame(np.array(body.xmat).reshape(3, 3), np.array(body.xpos))


def _zero(spec: Any, joints: Sequence[str], source: str) -> tuple[list[Array], Array, Array, list[str]]:
    """Return poses of the joints' bodies, joint axes, points on these, and the bodies' names.

    They are a list of poses, (4, 4) [m], axes and points, (n, 3) [m], in the model's world, with
    all joints at zero.

    spec : MuJoCo's specification of the model; joints : names of the arm's n joints
    source : name of the file, for messages
    Raises InputError: no such joint, or one that is not alone in a body with a name.
    """
    present = [joint.name for joint in spec.joints]
    missing = [name for name in joints if name not in present]
    if missing:
        raise InputError(f"{source}: no joint {missing[0]!r}; there are {', '.join(present)}")
    model, data = _at_zero(spec, joints)
    bodies = [model.body(model.joint(name).bodyid[0]).name for name in joints]
    if "" in bodies or len(set(bodies)) < len(bodies):
        raise InputError(f"{source}: each joint of the arm must be alone in a body with a name; there are {bodies}")
    axes = np.array([data.joint(name).xaxis for name in joints])
    points = np.array([data.joint(name).xanchor for name in joints])
    return [_pose(data.body(name)) for name in bodies], axes, points, bodies


def _base_pose(N: Sequence[Array], axes: Array, points: Array, joints: Sequence[str], source: str) -> Array:
    """Return the pose of casadical's base in the model's world, (4, 4) [m], where axes coincide.

    N : joint frames of the nominal robot in its base frame at zero, shape (4, 4) [m] each
    axes, points : axes of the model's joints in its world, and points on them, shape (n, 3) [m]
    joints : names of the joints; source : name of the file, for messages
    Raises InputError: all axes are parallel, or they are not those of the nominal robot.
    """
    z = np.array([T[:3, 2] for T in N])
    p = np.array([T[:3, 3] for T in N])
    if np.linalg.svd(z, compute_uv=False)[1] < 1e-3:
        raise InputError(f"{source}: all axes are parallel; they do not determine the position of the base")
    R = nearest_rotation(axes.T @ z)
    across = [np.eye(3) - np.outer(a, a) for a in axes]
    A = np.concatenate(across)
    b = np.concatenate([P @ (x - R @ y) for P, x, y in zip(across, points, p, strict=True)])
    t, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-6)
    off = np.linalg.norm((A @ t - b).reshape(-1, 3), axis=1) + np.linalg.norm(axes - z @ R.T, axis=1)
    worst = int(np.argmax(off))
    if rank < 3 or off[worst] > 1e-5:
        raise InputError(
            f"{source}: the axis of {joints[worst]!r} is not that of the nominal robot's joint "
            f"{worst + 1} (off by {off[worst]:.3g} m or rad); zeros, signs and lengths must be "
            "those of the file that was calibrated"
        )
    return frame(R, t)


def refuse_unmoved(spec: Any, joints: Sequence[str], new: Sequence[Array], source: str) -> None:
    """Check that each joint's body is at its target, which one nested in a <frame> is not.

    spec : MuJoCo's specification of the changed model; joints : names of the arm's joints
    new : target poses of the joints' bodies in the model's world, shape (4, 4) [m] each
    source : name of the file, for messages
    Raises InputError: a body is off by more than 1e-9 [m, or entry of the rotation matrix].
    """
    model, data = _at_zero(spec, joints)
    for name, target in zip(joints, new, strict=True):
        body = data.body(model.joint(name).bodyid[0])
        off = float(np.abs(_pose(body) - target).max())
        if off > 1e-9:
            raise InputError(
                f"{source}: body {body.name!r} does not move to its target ({off:.3g} m or rad "
                "off); is it inside of a <frame>, or does it hold two joints? write it as a plain "
                "body"
            )
