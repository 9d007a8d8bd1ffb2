"""Inverse dynamics of a robot and its regressor, tau = Y(q, v, a) pi, by Newton-Euler recursion.

tau is linear in ten numbers of each link (Atkeson, An and Hollerbach 1986): mass, first moment and
inertia about the origin of its frame, and in the rotor inertia of each drive. Physical bodies are
those whose pseudo-inertia is positive definite (Wensing, Kim and Slotine 2018); `Dynamics.at` leads
to no others (log-Cholesky, Rucker and Wensing 2022).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.mapped_function import MappedFunction
from casadical.core.parts import Body, Coupling, lacks_masses, with_estimated_masses
from casadical.core.transforms import Symbolic, product
from casadical.robot.kinematics import own_variables, row_factors
from casadical.robot.model import Structure, base_frame, gravity_in_base
from casadical.robot.robot import Robot

# Coupling of each joint to other joints, None for one that moves by itself. Only dynamics use it:
# for poses all joint variables are given.
Couplings = tuple[Coupling | None, ...]
# Prior standard deviation of the logarithm of a link's declared moment of inertia.
INERTIA_LOG_SIGMA = 0.3


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Inverse dynamics of a robot; if no link has a mass, all are estimated from its reach.

    given : the robot, whose geometry counts, while effects and compliance do not
    """

    given: Robot

    @cached_property
    def robot(self) -> Robot:
        """Return the given robot without effects, with link masses estimated if it has none."""
        bare = self.given.with_only(())
        return with_estimated_masses(bare) if lacks_masses(bare) else bare

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of the 11 n inertial parameters pi.

        m1, mx1 .. Izz1, m2 .. Izzn [kg, kg m, kg m^2], then Ia1 .. Ian [kg m^2 or kg].
        """
        # Mass [kg], first moments [kg m], inertia about the origin of the link's frame [kg m^2].
        body_parameters = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
        links = tuple(f"{name}{i}" for i in self.robot.numbers for name in body_parameters)
        return (*links, *(f"Ia{i}" for i in self.robot.numbers))

    @cached_property
    def values(self) -> Array:
        """Return the nominal parameters pi, declared or else estimated, shape (11 n,) [SI].

        The declared payload is part of the last link.
        """
        return self.at(np.zeros(len(self.names)))

    @cached_property
    def payload(self) -> Array:
        """Return the declared payload's inertial parameters, (10,) [kg, kg m, kg m^2].

        They are in the order of a link's in `names` and in the last link's frame, with inertias
        about its origin, for the last link's columns of the regressor; zero without a payload.
        """
        return body_numbers(self.robot.payload) if self.robot.payload else np.zeros(10)

    @cached_property
    def gravity(self) -> Array:
        """Return gravity in the nominal base frame, (3,) [m/s^2]; the declared vector if logged."""
        T_M0 = base_frame(self.robot, dict.fromkeys(self.robot.parameters.names, 0.0), ca.DM(self.robot.base.T))
        frame = self.robot.gravity_frame
        vector = self.robot.gravity if frame == "logged" else ca.DM(gravity_in_base(self.robot, T_M0, {})).full()
        return np.asarray(vector).ravel()

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Return the regressor Y at many states, shape (N, n, 11 n): tau = Y pi.

        It is large for many thousand states: evaluate them in parts.

        q, v, a : joint variables (those of coupled joints are ignored), velocities, accelerations,
            each (N, n) [rad or m, per s, per s^2]
        """
        (Y,) = self._evaluated("regressor", q, v, a, np.zeros(0), self.gravity)
        return Y.T.reshape(len(q), len(self.names), self.robot.n).transpose(0, 2, 1)

    def torque(self, q: Array, v: Array, a: Array, pi: Array | None = None, gravity: Array | None = None) -> Array:
        """Return the torques tau of the drives against inertia and weight, (N, n) [N m or N].

        pi : inertial parameters, shape (11 n,) [SI], by default `values`
        gravity : in the base frame, shape (3,) [m/s^2], by default the robot's
        """
        g = self.gravity if gravity is None else gravity
        return self._evaluated("torque", q, v, a, self.values if pi is None else pi, g)[0].T

    def _evaluated(self, what: str, q: Array, v: Array, a: Array, pi: Array, gravity: Array) -> list[Array]:
        """Return [Y], (n, 11 n N), or [tau], (n, N), at N states, side by side, by `_mapped`.

        what : "regressor" or "torque"; q, v, a : shape (N, n) each; pi : empty for the regressor
        gravity : in the base frame, shape (3,) [m/s^2]
        """
        shared = (pi, self.robot.parameters.values, gravity)
        return _mapped(self.robot.structure, self._couplings, what)(np.hstack([q, v, a]).T, np.concatenate(shared))

    @property
    def _couplings(self) -> Couplings:
        """Return the coupling of each joint to others, None for one that moves by itself."""
        return tuple(joint.coupling for joint in self.robot.joints)

    @cached_property
    def function(self) -> ca.Function:
        """Return the CasADi function inverse_dynamics:(q[n], v[n], a[n], pi[11 n])->(tau[n]) [N m or N].

        q, v, a : as of `regressor`; pi : inertial parameters (see `names`)
        """
        point, geometry, gravity, Y = _expressions(self.robot.structure, self._couplings)
        pi = ca.SX.sym("pi", len(self.names))
        inputs = [ca.DM(self.robot.parameters.values), ca.DM(self.gravity)]
        (tau,) = ca.Function("rows", [point, geometry, gravity, pi], [Y @ pi]).call([point, *inputs, pi])
        return ca.Function(
            "inverse_dynamics", [*ca.vertsplit(point, self.robot.n), pi], [tau], ["q", "v", "a", "pi"], ["tau"]
        )

    @cached_property
    def rotors(self) -> Array:
        """Return the inertia of each rotor seen at its joint, shape (n,) [kg m^2 or kg].

        It is the declared one, or else a share of the links' inertia at the joint in mid range.
        """
        drive = self.robot.drive
        if drive and (stated := drive.inertia_at_joint(self.robot.n)) is not None:
            return np.asarray(stated)
        n, links = self.robot.n, self._links(np.zeros(10 * self.robot.n))
        middle = np.tile(np.mean(self.robot.limits, axis=0), (n, 1))
        pi = np.concatenate([links, np.zeros(n)])
        inertia = np.diag(self.torque(middle, np.zeros((n, n)), np.eye(n), pi, np.zeros(3)))
        # A rotor inertia that is not declared is 30 % of the links' at the joint in mid range, and
        # at least 3 % of the largest such inertia of all joints.
        return np.asarray(np.maximum(0.3 * inertia, 0.03 * inertia.max()))

    @cached_property
    def sigma(self) -> Array:
        """Return the prior standard deviation of each coordinate of `at`, (11 n,) [1 or m].

        It follows from the robot's `body_width` and from whether inertias are declared: of the
        logarithm of an estimated inertia of a link it is 1, of a rotor 2, of a declared one 0.1.
        """
        width, drive = self.robot.body_width, self.robot.drive
        sigma = []
        for joint in self.robot.joints:
            shape = INERTIA_LOG_SIGMA if joint.body and joint.body.inertia is not None else 1.0
            sigma += [width.mass_share / 2, *[width.com] * 3, *[shape / 2] * 6]
        stated = drive is not None and drive.inertia_at_joint(self.robot.n) is not None
        return np.array([*sigma, *[0.1 if stated else 2.0] * self.robot.n])

    def at(self, coordinates: Array) -> Array:
        """Return physical parameters pi, shape (11 n,) [SI], for any coordinates, shape (11 n,).

        Zero gives `values`. The coordinates are ten for each link (see `_deformed_numbers`), then
        the logarithm of each rotor inertia over its nominal value.
        """
        n = self.robot.n
        links = self._links(coordinates[: 10 * n])
        links[10 * (n - 1) :] += self.payload
        return np.concatenate([links, self.rotors * np.exp(coordinates[10 * n :])])

    def _links(self, coordinates: Array) -> Array:
        """Return the inertial parameters of the links, shape (10 n,) [SI], without the payload.

        coordinates : of the links as of `at`, shape (10 n,)
        """
        none = Body(0.0, np.zeros(3))
        bodies = [joint.body or none for joint in self.robot.joints]
        return np.concatenate(
            [_deformed_numbers(b, x) for b, x in zip(bodies, coordinates.reshape(-1, 10), strict=True)]
        )

    @cached_property
    def tangent(self) -> Array:
        """Return the derivatives of pi by the coordinates of `at`, at zero, shape (11 n, 11 n).

        With the regressor Y, Y @ tangent is the regressor by the coordinates.
        """
        step = 1e-6
        both = ([self.at(sign * step * unit) for unit in np.eye(len(self.names))] for sign in (1, -1))
        ahead, behind = (np.array(side) for side in both)
        return np.asarray((ahead - behind).T / (2 * step))


def body_numbers(body: Body) -> Array:
    """Return the inertial parameters of a body: m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz.

    They have shape (10,) [kg, kg m, kg m^2], in the frame of `body.com`, with inertias about its
    origin. An unknown inertia about the mass centre counts as zero.
    """
    inertia = np.zeros((3, 3)) if body.inertia is None else body.inertia
    about = inertia + body.mass * (body.com @ body.com * np.eye(3) - np.outer(body.com, body.com))
    return np.array([body.mass, *(body.mass * body.com), *about[np.triu_indices(3)]])


def _deformed_numbers(body: Body, coordinates: Array) -> Array:
    """Return the inertial parameters, shape (10,) as of `body_numbers`, of a deformed body.

    The deformation is an affine map of its density, so that the result is a physical body. An
    unknown inertia is estimated first (`likely_inertia`).

    coordinates : half the logarithm of the factor on its mass, shift of the centre [m], logarithms
        of three stretches, three shears; shape (10,), zero leaves the body unchanged
    """
    half, centre, lengths, shears = coordinates[0], coordinates[1:4], coordinates[4:7], coordinates[7:]
    stretch = np.diag(np.exp(lengths))
    stretch[np.triu_indices(3, 1)] = shears
    moments = body.likely_inertia
    second = stretch @ (np.trace(moments) / 2 * np.eye(3) - moments) @ stretch.T
    factor = np.exp(2 * half)
    return body_numbers(Body(body.mass * factor, body.com + centre, factor * (np.trace(second) * np.eye(3) - second)))


@lru_cache(maxsize=16)
def _mapped(structure: Structure, couplings: Couplings, what: str) -> MappedFunction:
    """Return the function from N states (q, v, a), (3 n, N), to [Y], (n, 11 n N), or [tau], (n, N).

    Shared inputs are pi (torque only), the robot's parameters, and gravity in its base frame.
    """
    point, geometry, gravity, Y = _expressions(structure, couplings)
    pi = ca.SX.sym("pi", Y.shape[1] if what == "torque" else 0)
    output = Y @ pi if what == "torque" else Y
    return MappedFunction(what, point, ca.vertcat(pi, geometry, gravity), [output])


@lru_cache(maxsize=16)
def _expressions(structure: Structure, couplings: Couplings) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return symbols of state (q, v, a), parameters and gravity, and the regressor Y of these.

    Shapes (3 n,), (P,), (3,) in the base frame [m/s^2], and (n, 11 n). A coupled joint, or one that
    a four-bar drives, has a variable u(q) of its own: tau = (du/dq)^T tau_u.
    """
    arm, n = structure.arm, structure.arm.n
    point, geometry = ca.SX.sym("state", 3 * n), ca.SX.sym("geometry", len(structure.parameters.names))
    gravity = ca.SX.sym("gravity", 3)
    q, v, a = (point[k : k + n] for k in (0, n, 2 * n))
    values = dict(zip(structure.parameters.names, ca.vertsplit(geometry), strict=True))
    readings: list[Symbolic] = ca.vertsplit(q)
    for i, coupling in enumerate(couplings):
        if coupling:
            readings[i] = coupling.at + sum(k * readings[j - 1] for j, k in coupling.follows)
    u: Symbolic = ca.vertcat(*own_variables(arm, readings, values))
    speed: Symbolic = ca.jtimes(u, q, v)
    moved: list[Symbolic] = [u, speed, ca.jtimes(u, q, a) + ca.jtimes(speed, q, v)]
    frames = [product(row_factors(arm, i, u[i - 1], values)) for i in arm.numbers]
    sliding = [joint.kind == "prismatic" for joint in arm.joints]
    slopes: Symbolic = ca.jacobian(u, q)
    links = slopes.T @ _links_regressor(frames, sliding, moved, gravity)
    return point, geometry, gravity, ca.horzcat(links, ca.diag(a))


def _links_regressor(frames: list[Symbolic], sliding: list[bool], moved: list[Symbolic], gravity: Symbolic) -> ca.SX:
    """Return the links' part of the regressor, shape (n, 10 n): row per joint, ten columns a link.

    Angular velocity w, its derivative and the acceleration of each origin minus gravity are
    propagated outwards; each link's force and moment, as ten columns, inwards.

    frames : of each link in the previous one, shape (4, 4) [m]; sliding : whether each joint is
        prismatic
    moved : the rows' variables and their first and second time derivatives, shape (n,) each
    gravity : in the base frame, shape (3,) [m/s^2]
    """
    n, z = len(frames), ca.DM([0, 0, 1])
    w, dw, acc = ca.SX.zeros(3), ca.SX.zeros(3), -gravity
    wrenches: list[tuple[Symbolic, Symbolic]] = []
    for i, T in enumerate(frames):
        back, p, du, ddu = T[:3, :3].T, T[:3, 3], moved[1][i], moved[2][i]
        acc = back @ (acc + ca.cross(dw, p) + ca.cross(w, ca.cross(w, p)))
        w, dw = back @ w, back @ dw
        if sliding[i]:
            acc = acc + 2 * ca.cross(w, z * du) + z * ddu
        else:
            dw = dw + z * ddu + ca.cross(w, z * du)
            w = w + z * du
        W = ca.skew(w)
        force = ca.horzcat(acc, ca.skew(dw) + W @ W, ca.SX(3, 6))
        wrenches.append((force, ca.horzcat(ca.SX(3, 1), -ca.skew(acc), _moments(dw) + W @ _moments(w))))
    rows = ca.SX(n, 10 * n)
    for i, (force, moment) in enumerate(wrenches):
        for k in range(i, -1, -1):
            rows[k, 10 * i : 10 * i + 10] = force[2, :] if sliding[k] else moment[2, :]
            R, p = frames[k][:3, :3], frames[k][:3, 3]
            force = R @ force
            moment = R @ moment + ca.skew(p) @ force
    return rows


def _moments(w: Symbolic) -> Symbolic:
    """Return the matrix, (3, 6), whose product with Ixx, Ixy, Ixz, Iyy, Iyz, Izz is I w, w (3,)."""
    x, y, z = ca.vertsplit(w)
    return ca.blockcat([[x, y, z, 0, 0, 0], [0, x, 0, y, z, 0], [0, 0, x, 0, y, z]])
