"""Equilibrium of a mechanism in MuJoCo, found by a simulation until it is at rest.

The simulation is not in real time: the joints' inertia and damping (``mechanism.spring``) are chosen so
that every joint comes to rest in a second or so, whatever its stiffness, and steps of 20 ms
suffice. The equilibrium of weights, springs, loops, stops and dry friction depends on neither.

The mechanism is translated to MJCF, the XML format of MuJoCo.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from casadical.blind_check.mujoco_physics.mechanism import Body, Mechanism
from casadical.blind_check.mujoco_physics.plant import Array
from casadical.core.basics import ConvergenceError, optional

# Time step of the integrator [s].
TIME_STEP_S = 0.02
# MuJoCo's parameters `solimp` of constraints that are as hard as possible at every violation.
HARDEST_IMPEDANCE = "0.9999 0.9999 0.001 0.5 2"


def mjcf(mechanism: Mechanism, gravity: Sequence[float] = (0.0, 0.0, -9.81)) -> str:
    """Return the mechanism as text in MuJoCo's XML; its world is the measuring frame.

    The loop is an equality constraint between sites, motors are the rest positions of joint springs
    (`qpos_spring` and `tendon_lengthspring`, which the model keeps at `ref`). The body `tracker` is
    at the world's origin, and a sensor gives the site `reflector` in its frame.

    gravity : in the measuring frame, shape (3,) [m/s^2]
    """
    stiff = f"{2 * TIME_STEP_S!r} 1"
    # The solver's tolerance is in units of the mean inertia, which is large here, so any tolerance
    # above 0 would end it too early.
    root = ET.Element("mujoco", model="robot")
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    option = ET.SubElement(
        root, "option", timestep=repr(TIME_STEP_S), integrator="implicitfast", gravity=numbers(*gravity), tolerance="0"
    )
    ET.SubElement(option, "flag", contact="disable")
    default = ET.SubElement(root, "default")
    hard = {
        "solreflimit": stiff,
        "solimplimit": HARDEST_IMPEDANCE,
        "solreffriction": stiff,
        "solimpfriction": HARDEST_IMPEDANCE,
    }
    ET.SubElement(default, "joint", hard)
    ET.SubElement(default, "tendon", hard)
    ET.SubElement(default, "equality", solref=stiff, solimp=HARDEST_IMPEDANCE)
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "body", name="tracker")
    nodes = {"world": world}
    for body in mechanism.bodies:
        nodes[body.name] = _body(nodes[body.parent], body)
    if mechanism.loop is not None:
        first, second = mechanism.loop
        ET.SubElement(ET.SubElement(root, "equality"), "connect", name="four_bar", site1=first, site2=second)
    if mechanism.cords or mechanism.shafts:
        parent = ET.SubElement(root, "tendon")
        for cord in mechanism.cords:
            about = {"name": cord.name, "stiffness": numbers(cord.stiffness)}
            node = ET.SubElement(parent, "spatial", about)
            node.set("springlength", numbers(*cord.rest))
            for mark in (cord.first, cord.second):
                ET.SubElement(node, "site", site=mark)
        for shaft in mechanism.shafts:
            about = {"name": shaft.name, "stiffness": numbers(shaft.stiffness)}
            node = ET.SubElement(parent, "fixed", about)
            rest = sum(share * mechanism.joint(j).ref for j, share in shaft.joints.items())
            node.set("springlength", numbers(rest - shaft.slack, rest + shaft.slack))
            node.set("frictionloss", numbers(shaft.friction))
            node.set("damping", numbers(shaft.damping))
            for joint, share in shaft.joints.items():
                ET.SubElement(node, "joint", joint=joint, coef=numbers(share))
    sensor = ET.SubElement(root, "sensor")
    seen = {"objtype": "site", "objname": "reflector", "reftype": "body", "refname": "tracker"}
    ET.SubElement(sensor, "framepos", {"name": "measured", **seen})
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def numbers(*values: float) -> str:
    """Return numbers as the text of an MJCF attribute, exact to the last bit."""
    return " ".join(repr(float(v)) for v in values)


def quaternion(R: Array) -> Array:
    """Return the unit quaternion of a rotation matrix R, (3, 3), shape (4,), scalar first."""
    return np.roll(Rotation.from_matrix(R).as_quat(canonical=True), 1)


def _body(parent: ET.Element, body: Body) -> ET.Element:
    """Add a body with its mass, inertia, joints and sites to its parent's XML; return it."""
    place = {"pos": numbers(*body.place[:3, 3]), "quat": numbers(*quaternion(body.place[:3, :3]))}
    node = ET.SubElement(parent, "body", {"name": body.name, **place})
    mass = max(body.mass, 1e-6) if body.joints else body.mass  # the engine moves no body without mass
    if mass > 0:
        moment = max(mass * body.gyration**2, 1e-9)
        about = {"pos": numbers(*body.com), "mass": numbers(mass), "diaginertia": numbers(moment, moment, moment)}
        ET.SubElement(node, "inertial", about)
    for joint in body.joints:
        about = {"name": joint.name, "type": joint.kind, "axis": numbers(*joint.axis), "pos": numbers(*joint.at)}
        about |= {"ref": numbers(joint.ref), "armature": numbers(joint.inertia), "damping": numbers(joint.damping)}
        about |= {"springref": numbers(joint.ref if joint.motor else 0.0), "frictionloss": numbers(joint.friction)}
        about["stiffness"] = numbers(joint.stiffness, 0.0, joint.hardening)
        if joint.limits is not None:
            about["range"] = numbers(*joint.limits)
        ET.SubElement(node, "joint", about)
    for mark, at in body.marks.items():
        ET.SubElement(node, "site", name=mark, pos=numbers(*at))
    return node


@dataclass(frozen=True)
class Setting:
    """A deviation of a body or a named point from the built mechanism at one pose.

    kind : shift or turn of a body, in its parent's frame and before its joints; mark: shift of a
        named point in its body's frame
    name : name of the body or point
    value : displacement [m] or rotation vector [rad], shape (3,)
    """

    kind: Literal["shift", "turn", "mark"]
    name: str
    value: Array


@dataclass(frozen=True)
class Stop:
    """Input of the equilibrium at one pose.

    motors : coordinates at which the motors stop, shape (joints,) [rad or m]
    approach : direction of each motor's last motion, -1 or 1, shape (joints,)
    start : coordinate of each joint, by name, at which the search for the equilibrium starts
    payload_kg : declared mass of the payload [kg]
    settings : deviations from the built mechanism
    """

    motors: Array
    approach: Array
    start: Mapping[str, float]
    payload_kg: float
    settings: Iterable[Setting] = field(default_factory=tuple)


class Engine:
    """A mechanism, effects included, compiled by MuJoCo, that is brought to rest at poses.

    gravity : in the measuring frame, shape (3,) [m/s^2]
    Raises InputError: MuJoCo is missing.
    """

    def __init__(self, mechanism: Mechanism, gravity: Sequence[float] = (0.0, 0.0, -9.81)) -> None:
        self.mujoco = optional("mujoco", "the engine needs MuJoCo; install it with: pip install 'casadical[withheld]'")
        self.mujoco.set_mju_user_warning(lambda _text: None)  # into a file otherwise; what matters is raised below
        self.mechanism = mechanism
        self.xml = mjcf(mechanism, gravity)
        self.model = self.mujoco.MjModel.from_xml_string(self.xml)
        self.data = self.mujoco.MjData(self.model)
        m = self.model
        joints = [j for b in mechanism.bodies for j in b.joints]
        self._row = {j.name: int(m.joint(j.name).qposadr[0]) for j in joints}
        self._motors = [(self._row[j.name], j.motor - 1) for j in joints if j.motor]
        self._shafts = [(m.tendon(s.name).id, s.motor - 1, s.slack) for s in mechanism.shafts if s.motor]
        self._moves = np.array([int(m.joint(j.name).dofadr[0]) for j in joints if not j.keeps])
        self._keeps = [self._row[j.name] for j in joints if j.keeps]
        self._rubs = [
            (self._row[j.name], int(m.joint(j.name).dofadr[0]), j.rubbing * j.stiffness) for j in joints if j.rubbing
        ]
        self._payload = m.body("payload").id
        names = ("body_pos", "body_quat", "site_pos", "dof_frictionloss", "tendon_frictionloss")
        self._built = {name: getattr(m, name).copy() for name in names}

    def rest(self, stop: Stop) -> Array:
        """Return the reflector's position in equilibrium, as the tracker sees it, shape (3,) [m].

        Raises ConvergenceError: no rest within 1500 steps, after those of the motion to the pose.
        """
        m, d = self.model, self.data
        saved = d.qpos[self._keeps].copy()
        self.mujoco.mj_resetData(m, d)
        for name, value in self._built.items():
            getattr(m, name)[:] = value
        for setting in stop.settings:
            self._set(setting)
        mass = stop.payload_kg * self.mechanism.payload_factor
        if m.body_mass[self._payload] != mass:
            m.body_mass[self._payload] = mass
            self.mujoco.mj_setConst(m, d)
            self.mujoco.mj_resetData(m, d)
        for joint, value in stop.start.items():
            d.qpos[self._row[joint]] = value
        d.qpos[self._keeps] = saved
        if self.mechanism.travels:
            back = stop.motors - 1.5e-3 * stop.approach  # rad or m that every joint moves before it stops
            m.dof_frictionloss[self._moves] = m.tendon_frictionloss[:] = 0.0
            self._drive(back)
            self.mujoco.mj_step(m, self.data, 100)
            for name in ("dof_frictionloss", "tendon_frictionloss"):
                getattr(m, name)[:] = self._built[name]
            for row, dof, torque in self._rubs:
                m.dof_frictionloss[dof] += torque * abs(m.qpos_spring[row] - self.data.qpos[row])
            for share in 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 81) / 80):
                self._drive(back + share * (stop.motors - back))
                self.mujoco.mj_step(m, self.data)
            self.mujoco.mj_step(m, self.data, 80)
            self._until_still(creep=2e-7)  # what friction holds creeps in the engine
        else:
            self._drive(stop.motors)
            self._until_still()
        self.mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.sensor("measured").data)

    def _set(self, setting: Setting) -> None:
        """Apply one setting to the compiled model, in addition to those before."""
        m = self.model
        if setting.kind == "mark":
            m.site_pos[m.site(setting.name).id] += setting.value
        elif setting.kind == "shift":
            m.body_pos[m.body(setting.name).id] += setting.value
        else:
            quat, angle = np.empty(4), float(np.linalg.norm(setting.value))
            if angle > 0:
                self.mujoco.mju_axisAngle2Quat(quat, setting.value / angle, angle)
                before = m.body_quat[m.body(setting.name).id].copy()
                self.mujoco.mju_mulQuat(m.body_quat[m.body(setting.name).id], quat, before)

    def _drive(self, motors: Array) -> None:
        """Set the rest positions of the joint springs to the motors' coordinates, (joints,)."""
        for row, motor in self._motors:
            self.model.qpos_spring[row] = motors[motor]
        for shaft, motor, slack in self._shafts:
            self.model.tendon_lengthspring[shaft] = motors[motor] - slack, motors[motor] + slack

    def _until_still(self, creep: float = 2e-9) -> None:
        """Step until no coordinate moves faster than `creep` [rad/s or m/s].

        The remaining motion is about a tenth of that number [rad or m].
        """
        for _ in range(0, 1500, 10):
            self.mujoco.mj_step(self.model, self.data, 10)
            if np.abs(self.data.qvel).max() < creep:
                return
        raise ConvergenceError(
            f"the engine finds no rest: after 1500 steps something still moves at "
            f"{np.abs(self.data.qvel).max():.1e} rad/s; are the joints too soft for their loads?"
        )
