"""Equilibrium of a mechanism in MuJoCo, found by a simulation until it is at rest.

Time is slowed down: the joints' own inertia and damping (``robot.spring``) make every joint come to rest in a second
or so, whatever its stiffness, so that steps of 20 ms suffice. The equilibrium of
weights, springs, loops, stops and dry friction depends on neither.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from casadical.blind_check.mujoco_physics.mechanism import Mechanism
from casadical.blind_check.mujoco_physics.mjcf import mjcf
from casadical.blind_check.mujoco_physics.rigid import Array
from casadical.core.basics import ConvergenceError, optional

STILL = 2e-9  # rad/s or m/s; the way left to go is a tenth of it in rad or m
CREEP = 2e-7  # rad/s or m/s; what friction holds creeps in the engine
APPROACH = 1.5e-3  # rad that every joint moves before it stops, where the way matters
BESIDE, MOVING, WAITING, AT_MOST = 100, 80, 80, 1500  # steps


@dataclass(frozen=True)
class Setting:
    """A body or a mark that is at one pose not as it was built: shifted (3,) [m] or turned (3,) [rad].

    Bodies are shifted and turned in their parent's frame, before their joints; marks in their body's frame.
    """

    kind: Literal["shift", "turn", "mark"]
    name: str
    value: Array


@dataclass(frozen=True)
class Stop:
    """What the robot does at one pose; start : coordinates of joints to start from; settings : what is not as built.

    motors : where they stop [rad or m]; approach : of -1 and 1, from which side they come, shapes (joints,)
    """

    motors: Array
    approach: Array
    start: Mapping[str, float]
    payload_kg: float
    settings: Iterable[Setting] = field(default_factory=tuple)


class Engine:
    """A mechanism, effects included, compiled by MuJoCo, that can be brought to rest at one pose after the other.

    travels : whether it moves to every pose from the side it is approached from, which only friction and play need
    factor : true over declared mass of the payload; gravity : in the measuring frame [m/s^2]
    Raises InputError: MuJoCo is missing.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        *,
        travels: bool = False,
        factor: float = 1.0,
        gravity: Sequence[float] = (0.0, 0.0, -9.81),
    ) -> None:
        self.mujoco = optional("mujoco", "the engine needs MuJoCo; install it with: pip install 'casadical[withheld]'")
        self.mujoco.set_mju_user_warning(lambda _text: None)  # into a file otherwise; what matters is raised below
        self.mechanism, self.travels, self.factor = mechanism, travels, factor
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
        """The reflector as the tracker sees it when all has come to rest.

        Raises ConvergenceError where it does not come to rest within some thousand steps.
        """
        self._arrange(stop)
        if self.travels:
            self._travel(stop)
        else:
            self._drive(stop.motors)
            self._until_still()
        self.mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.sensor("measured").data)

    def coordinate(self, joint: str) -> float:
        """The coordinate of a joint now."""
        return float(self.data.qpos[self._row[joint]])

    def _arrange(self, stop: Stop) -> None:
        m, d = self.model, self.data
        kept = d.qpos[self._keeps].copy()
        self.mujoco.mj_resetData(m, d)
        for name, value in self._built.items():
            getattr(m, name)[:] = value
        for setting in stop.settings:
            self._set(setting)
        if m.body_mass[self._payload] != stop.payload_kg * self.factor:
            m.body_mass[self._payload] = stop.payload_kg * self.factor
            self.mujoco.mj_setConst(m, d)
            self.mujoco.mj_resetData(m, d)
        for joint, value in stop.start.items():
            d.qpos[self._row[joint]] = value
        d.qpos[self._keeps] = kept

    def _set(self, setting: Setting) -> None:
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
        for row, motor in self._motors:
            self.model.qpos_spring[row] = motors[motor]
        for shaft, motor, slack in self._shafts:
            self.model.tendon_lengthspring[shaft] = motors[motor] - slack, motors[motor] + slack

    def _travel(self, stop: Stop) -> None:
        """Find the rest beside the pose without friction, then move to the pose with it and wait."""
        m = self.model
        back = stop.motors - APPROACH * stop.approach
        m.dof_frictionloss[self._moves] = m.tendon_frictionloss[:] = 0.0
        self._drive(back)
        self.mujoco.mj_step(m, self.data, BESIDE)
        for name in ("dof_frictionloss", "tendon_frictionloss"):
            getattr(m, name)[:] = self._built[name]
        for row, dof, torque in self._rubs:
            m.dof_frictionloss[dof] += torque * abs(m.qpos_spring[row] - self.data.qpos[row])
        for share in 0.5 - 0.5 * np.cos(np.pi * np.arange(1, MOVING + 1) / MOVING):
            self._drive(back + share * (stop.motors - back))
            self.mujoco.mj_step(m, self.data)
        self.mujoco.mj_step(m, self.data, WAITING)
        self._until_still(creep=CREEP)

    def _until_still(self, creep: float = STILL) -> None:
        for _ in range(0, AT_MOST, 10):
            self.mujoco.mj_step(self.model, self.data, 10)
            if np.abs(self.data.qvel).max() < creep:
                return
        raise ConvergenceError(
            f"the engine finds no rest: after {AT_MOST} steps something still moves at "
            f"{np.abs(self.data.qvel).max():.1e} rad/s; are the joints too soft for their loads?"
        )
