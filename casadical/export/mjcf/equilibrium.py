"""Static equilibrium of an exported MuJoCo model at many commands, found by Newton steps.

MuJoCo evaluates every force and constraint (weights, springs, actuators, loops, backlash). A step
is the force divided by the stiffness of the coordinate, which converges fast because weights change
little over a deflection.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from casadical.core.basics import Array, ConvergenceError, InputError, optional
from casadical.export.mjcf.mjcf import MEASURED_SITE
from casadical.measurements.measurements import Measurements

# Newton steps below this one count as convergence of an equilibrium or a closed loop [rad or m].
STILL_STEP = 1e-12
# Largest number of Newton steps to an equilibrium, and of limited ones that close a loop.
MAX_STEPS = 100


def positions(xml: str, m: Measurements, payload_factor: float = 1.0) -> Array:
    """Return equilibrium positions of the measured point, shape (n, 3) [m], in the measuring frame.

    They are those at the joint variables, logged payload masses and directions of approach.

    xml : text of a model as `mjcf` writes it
    payload_factor : true mass of the payload divided by the declared one
    Raises InputError: MuJoCo is not installed, or another number of joints; ConvergenceError: no
    equilibrium is found, or a loop cannot close.
    """
    model = EngineModel(xml)
    payload = next((b for b in range(model.m.nbody) if model.m.body(b).name == "payload"), None)
    if model.arm != m.q.shape[1]:
        raise InputError(f"{m.source}: {m.q.shape[1]} readings a pose, but the model has {model.arm} drives")
    measured = np.empty((len(m), 3))
    for k in range(len(m)):
        if "payload_kg" in m.conditions and payload is not None:
            mass = payload_factor * float(m.conditions["payload_kg"][k])
            if model.m.body_mass[payload] != mass:
                model.m.body_mass[payload] = mass
                model.mujoco.mj_setConst(model.m, model.d)
        ways = [m.conditions.get(f"approach{i}") for i in range(1, model.arm + 1)]
        approach = np.array([0.0 if way is None else np.sign(way[k]) for way in ways])
        measured[k] = model.rest(m.q[k], approach)
    return measured


class EngineModel:
    """A model compiled by MuJoCo that is brought to equilibrium at commands.

    xml : text of a model as `mjcf` writes it
    m, d : MuJoCo's model and data; arm : number n of drives
    servos, drives : indices of their actuators and of the joints these move, shape (n,)
    free, play, stopped, sprung : indices of passive hinges of loops, of backlash joints, of springs
        between stops, and of all joints with a spring or a servo
    """

    def __init__(self, xml: str) -> None:
        self.mujoco: Any = load_mujoco()
        self.m = self.mujoco.MjModel.from_xml_string(xml)
        self.m.opt.jacobian = self.mujoco.mjtJacobian.mjJAC_DENSE
        # Friction and limits are computed in this class, from the direction of approach.
        self.m.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_LIMIT)
        self.m.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
        self.d = self.mujoco.MjData(self.m)
        joint = int(self.mujoco.mjtTrn.mjTRN_JOINT)
        self.servos = np.flatnonzero(self.m.actuator_trntype == joint)
        self.arm = len(self.servos)
        self.drives = self.m.actuator_trnid[self.servos, 0]
        names = [self.m.joint(k).name for k in range(self.m.njnt)]
        loose = ("coupler", "rocker")
        self.free = [k for k, n in enumerate(names) if n.startswith(loose) or n.endswith("_driven")]
        self.play = [k for k, n in enumerate(names) if n.endswith("_play")]
        self.stopped = [k for k, n in enumerate(names) if n.endswith("_bed")]
        # Index of the drive whose direction of approach determines a joint's friction: all on its body.
        bodies = self.m.jnt_bodyid.tolist()
        self.way = {k: i for i, j in enumerate(self.drives) for k, body in enumerate(bodies) if body == bodies[j]}
        self.sprung = [k for k in range(self.m.njnt) if k not in (*self.free, *self.play)]
        self._loops = [names[k][6:] for k in self.free if names[k].startswith("rocker")]
        self._start: Array | None = None
        self._sides: Array | None = None

    def rest(self, command: Array, approach: Array) -> Array:
        """Return the measured point at equilibrium, shape (3,) [m], in the measuring frame.

        command : commanded joint variables, shape (n,) [rad or m]
        approach : direction of each joint's last motion, -1, 0 (unknown) or 1, shape (n,)
        Raises ConvergenceError: no equilibrium is found, or a loop does not close.
        """
        d, m = self.d, self.m  # joints are hinges and slides: the indices of q, of v and of joints agree
        d.qpos[:] = 0.0
        d.qvel[:] = 0.0
        d.qpos[self.drives] = command / m.actuator_gear[self.servos, 0]
        d.ctrl[self.servos] = command
        if self.free:
            self._assemble(command)
        ways = np.array([approach[self.way[k]] if k in self.way else 0.0 for k in range(m.nv)])
        for _ in range(MAX_STEPS):
            push, step = self._force() - m.dof_frictionloss * ways, np.zeros(m.nv)
            for k in self.sprung:
                step[k] = push[k] / self._slope(k)
                if k in self.stopped:
                    step[k] = np.clip(d.qpos[k] + step[k], *m.jnt_range[k]) - d.qpos[k]
            for k in self.play:
                step[k] = m.jnt_range[k, 1] * np.sign(push[k]) - d.qpos[k]
            d.qpos[:] += step
            if self.free:
                self._close()
            size = float(np.abs(step).max())
            if size < STILL_STEP:
                self.mujoco.mj_kinematics(m, d)
                return np.array(d.site(MEASURED_SITE).xpos)
        raise ConvergenceError(f"no equilibrium after {MAX_STEPS} steps, the last one of {size:.1e} rad or m")

    def _force(self) -> Array:
        """Return forces on the nv coordinates of the model, (nv,) [N m or N], loops included."""
        self.mujoco.mj_fwdPosition(self.m, self.d)
        self.mujoco.mj_fwdVelocity(self.m, self.d)
        self.mujoco.mj_fwdActuation(self.m, self.d)
        force: Array = self.d.qfrc_passive + self.d.qfrc_actuator - self.d.qfrc_bias
        if self.free:
            J, _ = self._constraints()
            rates = -np.linalg.lstsq(J[:, self.free], J, rcond=None)[0]
            force = force + rates.T @ force[self.free]
        return force

    def _slope(self, k: int) -> float:
        """Return the stiffness of the model's coordinate k at its present value [N m/rad or N/m].

        It is that of its springs and its servo; k counts from 0.
        """
        hit = self.servos[self.drives == k]
        stiffness = float(sum(self.m.actuator_gainprm[i, 0] * self.m.actuator_gear[i, 0] ** 2 for i in hit))
        x = self.d.qpos[k]
        cubic = self.m.jnt_stiffnesspoly[k, 1] if hasattr(self.m, "jnt_stiffnesspoly") else 0.0
        return stiffness + float(self.m.jnt_stiffness[k] + 3 * cubic * x**2)

    def _constraints(self) -> tuple[Array, Array]:
        """Return Jacobian, (c, nv), and violation, (c,), of the c equality constraints.

        Both are at the present coordinates.
        """
        self.mujoco.mj_fwdPosition(self.m, self.d)
        n = self.d.nefc
        return self.d.efc_J.reshape(n, self.m.nv).copy(), self.d.efc_pos[:n].copy()

    def _assemble(self, command: Array) -> None:
        """Set the passive hinges so that loops close as they do, uncrossed, in mid joint range.

        command : commanded joint variables, shape (n,) [rad or m]
        Raises InputError: no loop closes in mid range; ConvergenceError: none does at the command.
        """
        if self._sides is None:
            lower, upper = self.m.actuator_ctrlrange[self.servos].T
            self.d.qpos[self.drives] = (lower + upper) / 2
            closed = [c for c in self._closures() if self._close_from(c)]
            if not closed:
                raise InputError("the four-bar of this model does not close at the middle of its joints' ranges")
            best = max(closed, key=lambda c: min(crank @ rocker for crank, rocker, _, _ in self._bars(c)))
            self._start, self._sides = best, self._side(best)
            self.d.qpos[self.drives] = command / self.m.actuator_gear[self.servos, 0]
        for start in self._closures():
            if self._close_from(start) and (self._side(self.d.qpos[self.free].copy()) == self._sides).all():
                self._start = self.d.qpos[self.free].copy()
                return
        raise ConvergenceError(f"the four-bar does not close at the readings {np.round(command, 4).tolist()} rad")

    def _closures(self) -> Iterator[Array]:
        """Yield angles of the passive hinges [rad] from which to close the loops.

        They are those of the last closure, if any, then 100 random ones from -pi to pi.
        """
        if self._start is not None:
            yield self._start
        rng = np.random.default_rng(0)
        for _ in range(100):
            yield rng.uniform(-np.pi, np.pi, len(self.free))

    def _close_from(self, start: Array) -> bool:
        """Return whether the loops close from these angles of the passive hinges [rad].

        The array `start` is overwritten with the angles of the last step.
        """
        self.d.qpos[self.free] = start
        done = self._close(gentle=True)
        start[:] = self.d.qpos[self.free]
        return done

    def _bars(self, free: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Return a tuple of four vectors, shape (3,), for each loop.

        They are the unit vectors along crank and rocker, the vector from the rocker's pin to the
        crank's end [m], and the unit vector of the crank's axis, in the measuring frame.

        free : angles of the passive hinges [rad]
        """
        self.d.qpos[self.free] = free
        self.mujoco.mj_kinematics(self.m, self.d)
        bars = []
        for number in self._loops:
            crank, coupler, rocker = (self.d.body(f"{w}{number}") for w in ("crank", "coupler", "rocker"))
            turns = [body.xmat.reshape(3, 3) for body in (crank, rocker)]
            bars.append((turns[0][:, 0], turns[1][:, 0], coupler.xpos - rocker.xpos, turns[0][:, 2]))
        return bars

    def _side(self, free: Array) -> Array:
        """Return the side of its diagonal on which each loop's rocker is, -1, 0 or 1, (loops,).

        free : angles of the passive hinges [rad]
        """
        return np.array([np.sign(np.cross(along, rocker) @ axis) for _, rocker, along, axis in self._bars(free)])

    def _close(self, gentle: bool = False) -> bool:
        """Move the passive hinges onto the constraints by Newton steps; return whether these hold.

        They hold if the last step is below `STILL_STEP` and no violation reaches 1e-9.

        gentle : whether steps are at most 0.5 rad and `MAX_STEPS`, not six, for distant starts
        """
        for _ in range(MAX_STEPS if gentle else 6):
            J, off = self._constraints()
            step = -np.linalg.lstsq(J[:, self.free], off, rcond=None)[0]
            size = float(np.abs(step).max())
            self.d.qpos[self.free] += step * min(1.0, 0.5 / max(size, 1e-300)) if gentle else step
            if size < STILL_STEP:
                return bool(np.abs(off).max() < 1e-9)
        return False


def load_mujoco() -> Any:
    """Return the package mujoco. Raises InputError where it is missing."""
    return optional("mujoco", "this needs MuJoCo; install it with: pip install 'casadical[mujoco]'")
