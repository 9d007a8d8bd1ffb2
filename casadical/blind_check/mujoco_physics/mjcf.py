"""MJCF, the XML of MuJoCo, of a mechanism."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import numpy as np

from casadical.blind_check.mujoco_physics.mechanism import Body, Joint, Mechanism, Shaft
from casadical.blind_check.mujoco_physics.rigid import Array

STEP = 0.02  # s, of the integrator
HARD = "0.9999 0.9999 0.001 0.5 2"  # the hardest impedance that MuJoCo has, at every violation


def mjcf(mechanism: Mechanism, gravity: Sequence[float] = (0.0, 0.0, -9.81)) -> str:
    """The mechanism in MuJoCo's XML: world = the measuring frame.

    Loops are equality constraints between sites, motors the rests of joint springs (``qpos_spring`` and
    ``tendon_lengthspring``, which the model keeps at ``ref``). The body ``tracker`` stands at the world's origin, and
    a sensor gives the site ``reflector`` in its frame.
    """
    stiff = f"{2 * STEP!r} 1"
    # The solver's tolerance is in units of the mean inertia, which is large here: any but 0 would end it too early.
    root = ET.Element("mujoco", model="robot")
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    option = ET.SubElement(
        root, "option", timestep=repr(STEP), integrator="implicitfast", gravity=numbers(*gravity), tolerance="0"
    )
    ET.SubElement(option, "flag", contact="disable")
    default = ET.SubElement(root, "default")
    hard = {"solreflimit": stiff, "solimplimit": HARD, "solreffriction": stiff, "solimpfriction": HARD}
    ET.SubElement(default, "joint", hard)
    ET.SubElement(default, "tendon", hard)
    ET.SubElement(default, "equality", solref=stiff, solimp=HARD)
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "body", name="tracker")
    nodes = {"world": world}
    for body in mechanism.bodies:
        nodes[body.name] = _body(nodes[body.parent], body)
    if mechanism.loops:
        equality = ET.SubElement(root, "equality")
        for loop in mechanism.loops:
            ET.SubElement(equality, "connect", name=loop.name, site1=loop.first, site2=loop.second)
    if mechanism.cords or mechanism.shafts:
        _tendons(ET.SubElement(root, "tendon"), mechanism)
    sensor = ET.SubElement(root, "sensor")
    seen = {"objtype": "site", "objname": "reflector", "reftype": "body", "refname": "tracker"}
    ET.SubElement(sensor, "framepos", {"name": "measured", **seen})
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def numbers(*values: float) -> str:
    """Numbers as MJCF writes them, to the last bit."""
    return " ".join(repr(float(v)) for v in values)


def quaternion(R: Array) -> Array:
    """Unit quaternion (4,), scalar first, of the rotation matrix ``R`` (3, 3)."""
    K = np.array(
        [
            [R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
            [R[0, 2] - R[2, 0], R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], R[1, 2] + R[2, 1]],
            [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    q: Array = np.linalg.eigh(K)[1][:, -1]
    return q if q[0] >= 0 else -q


def _body(parent: ET.Element, body: Body) -> ET.Element:
    place = {"pos": numbers(*body.place[:3, 3]), "quat": numbers(*quaternion(body.place[:3, :3]))}
    node = ET.SubElement(parent, "body", {"name": body.name, **place})
    mass = max(body.mass, 1e-6) if body.joints else body.mass  # the engine moves no body without mass
    if mass > 0:
        moment = max(mass * body.gyration**2, 1e-9)
        about = {"pos": numbers(*body.com), "mass": numbers(mass), "diaginertia": numbers(moment, moment, moment)}
        ET.SubElement(node, "inertial", about)
    for joint in body.joints:
        ET.SubElement(node, "joint", _joint(joint))
    for mark, at in body.marks.items():
        ET.SubElement(node, "site", name=mark, pos=numbers(*at))
    return node


def _joint(joint: Joint) -> dict[str, str]:
    node = {"name": joint.name, "type": joint.kind, "axis": numbers(*joint.axis), "pos": numbers(*joint.at)}
    node |= {"ref": numbers(joint.ref), "armature": numbers(joint.inertia), "damping": numbers(joint.damping)}
    node |= {"springref": numbers(joint.ref if joint.motor else 0.0), "frictionloss": numbers(joint.friction)}
    node["stiffness"] = numbers(joint.stiffness, 0.0, joint.hardening)
    if joint.limits is not None:
        node["range"] = numbers(*joint.limits)
    return node


def _tendons(parent: ET.Element, mechanism: Mechanism) -> None:
    for cord in mechanism.cords:
        node = ET.SubElement(parent, "spatial", name=cord.name, stiffness=numbers(cord.stiffness))
        node.set("springlength", numbers(*cord.rest))
        for mark in (cord.first, cord.second):
            ET.SubElement(node, "site", site=mark)
    for shaft in mechanism.shafts:
        node = ET.SubElement(parent, "fixed", {"name": shaft.name, **_shaft(shaft, mechanism)})
        for joint, share in shaft.joints.items():
            ET.SubElement(node, "joint", joint=joint, coef=numbers(share))


def _shaft(shaft: Shaft, mechanism: Mechanism) -> dict[str, str]:
    rest = sum(share * mechanism.joint(j).ref for j, share in shaft.joints.items())
    return {
        "stiffness": numbers(shaft.stiffness),
        "springlength": numbers(rest - shaft.slack, rest + shaft.slack),
        "frictionloss": numbers(shaft.friction),
        "damping": numbers(shaft.damping),
    }
