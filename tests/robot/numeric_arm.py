"""A robot's kinematics and potential energy in plain numpy and scipy, derived apart from the symbolic model."""

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from casadical.core.parts import Body, FourBar, Joint, Placement
from casadical.robot.robot import Robot


def turn(axis, angle):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
    return T


def shift(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def rocker_angle(crank, ground, bars, start):
    """Angle of the rocker that closes the loop, by bracketing the coupler's length error next to `start` [rad]."""
    L5, L4, L3, g = bars

    def error(angle):
        end = g * np.exp(1j * ground) + L3 * np.exp(1j * angle)
        return abs(end - L5 * np.exp(1j * crank)) - L4

    grid = start + np.linspace(-1.2, 1.2, 481)
    signs = np.sign([error(a) for a in grid])
    brackets = np.nonzero(signs[:-1] * signs[1:] <= 0)[0]
    roots = [brentq(error, grid[k], grid[k + 1], xtol=1e-15, rtol=1e-14) for k in brackets]
    return min(roots, key=lambda a: abs(a - start)) if roots else None


def own_variables(robot, q):
    """The variable of each row: the reading, or the passive angle of its loop."""
    own = list(map(float, q))
    for loop in robot.loops:
        driven, carrier = robot.joints[loop.driven - 1], robot.joints[loop.carrier - 1]
        crank, ground = q[loop.driven - 1] + driven.theta, q[loop.carrier - 1] + carrier.theta
        rocker = rocker_angle(crank, ground, (loop.crank, loop.coupler, loop.rocker, driven.a), crank)
        own[loop.driven - 1] = rocker - ground + loop.offset - driven.theta
    return own


def link_frames(robot, q):
    """Frames of the links in the measuring frame, n of (4, 4)."""
    T, frames = robot.base.T, []
    for j, value in zip(robot.joints, own_variables(robot, q), strict=True):
        theta, d = (j.theta + value, j.d) if j.kind == "revolute" else (j.theta, j.d + value)
        T = T @ turn("x", j.alpha) @ shift(j.a, 0, 0) @ turn("y", j.beta or 0) @ shift(0, j.b or 0, 0)
        T = T @ turn("z", theta) @ shift(0, 0, d)
        frames.append(T)
    return frames


def pose(robot, q):
    return link_frames(robot, q)[-1] @ robot.tool.T


def energy(robot, q):
    """Potential energy in a gravity field given in the measuring frame [J]."""
    frames = link_frames(robot, q)
    loads = [(j.body, T) for j, T in zip(robot.joints, frames, strict=True) if j.body]
    if robot.payload:
        loads.append((robot.payload, frames[-1]))
    gravity = robot.gravity if robot.gravity_frame == "measuring" else robot.base.T[:3, :3] @ robot.gravity
    return -sum(body.mass * gravity @ (T @ [*body.com, 1.0])[:3] for body, T in loads)


def torques(robot, q, step=1e-4):
    """-dV/dq by central differences of fourth order."""
    q, found = np.asarray(q, float), []
    for e in step * np.eye(len(q)):
        near, far = (energy(robot, q + k * e) - energy(robot, q - k * e) for k in (1, 2))
        found.append(-(8 * near - far) / (12 * step))
    return np.array(found)


def compliances(robot):
    """Shape (n,) [rad/(N m) or m/N]; rigid joints have zero."""
    return np.array([j.compliance or 0.0 for j in robot.joints])


def loaded_torques(robot, q):
    """Torques of the robot that has sunk once under its own: the first step towards equilibrium."""
    return torques(robot, q + compliances(robot) * torques(robot, q))


def derivative(function, x, steps):
    """Jacobian of a vector function by central differences of fourth order, shape (m, n)."""
    columns = []
    for k, h in enumerate(steps):
        e = h * np.eye(len(x))[k]
        near, far = (function(x + m * e) - function(x - m * e) for m in (1, 2))
        columns.append((8 * near - far) / (12 * h))
    return np.array(columns).T


def hh800(compliance=True, bars=(0.8, 1.6, 0.8)):
    """The paper's robot with a closed loop; masses and compliances are made up."""
    rows = [(0, 0, 0, 0), (90, 0.515, 0, 0), (0, 1.6, 0, 0), (90, 0.35, 0, 1.9), (-90, 0, 0, 0), (90, 0, 0, 0.445)]
    limits = [(-120, 120), (45, 125), (135, 225), (-170, 170), (-110, 110), (-170, 170)]
    bodies = [(900, 0.2, 0, -0.3), (400, 0.7, 0.02, 0.1), (600, 0.1, 0.2, 0), (200, 0, 0, -0.5), (90, 0, 0.05, 0)]
    bodies.append((40, 0, 0, -0.1))
    joints = []
    for i, ((alpha, a, theta, d), span, (mass, *com)) in enumerate(zip(rows, limits, bodies, strict=True), 1):
        soft = 1e-7 * i if compliance and 2 <= i <= 5 else None
        first = {"beta": 0.0, "b": 0.0} if i == 1 else {}
        lower, upper = np.deg2rad(span)
        joints.append(
            Joint(
                np.deg2rad(alpha), a, np.deg2rad(theta), d, **first, lower=lower, upper=upper, compliance=soft,
                body=Body(mass, np.array(com)),
            )
        )  # fmt: skip
    return Robot(
        name="hh800",
        joints=tuple(joints),
        tool=_tool(-0.45, 0.11, 0.93),
        loops=(FourBar(driven=3, carrier=2, crank=bars[0], coupler=bars[1], rocker=bars[2], offset=-np.pi / 2),),
        payload=Body(300.0, np.array([-0.3, 0.08, 0.5])),
    )


def _tool(x, y, z):
    return Placement(shift(x, y, z), "position")


def slider_arm():
    """A slide, a swinging link, a slide and a wrist: prismatic joints first and in the middle."""
    joints = (
        Joint(a=0.1, d=0.2, theta=0.3, kind="prismatic", lower=0.0, upper=0.5, compliance=2e-7, body=_body(40, 0.1)),
        Joint(a=0.25, theta=0.4, lower=-2.0, upper=2.0, compliance=3e-5, body=_body(12, 0.2)),
        Joint(np.pi / 2, 0.05, 0.2, 0.3, kind="prismatic", lower=-0.1, upper=0.4, compliance=1e-7, body=_body(6, 0.1)),
        Joint(-1.2, 0.15, -0.5, 0.1, lower=-3.0, upper=3.0, compliance=2e-4, body=_body(2, 0.05)),
    )
    base = Placement(turn("xyz", (0.5, -0.3, 0.2)))  # tilted: gravity loads every joint
    return Robot("slider", joints, base, tool=_tool(0.03, -0.05, 0.12))


def generic_arm(seed, n=6):
    """A revolute arm with no special geometry, its base tilted and unknown, with payload."""
    rng = np.random.default_rng(seed)
    joints = tuple(
        Joint(
            rng.choice([-1.2, 1.2]) + rng.uniform(-0.3, 0.3),
            *rng.uniform(-0.5, 0.5, 3),
            compliance=1e-5 * i,
            body=Body(20.0 / i, 0.2 * rng.normal(size=3)),
        )
        for i in range(1, n + 1)
    )
    base = shift(*rng.normal(size=3)) @ turn("xyz", rng.uniform(-0.5, 0.5, 3))
    tool = shift(0.1, 0.05, 0.2) @ turn("xyz", rng.uniform(-0.5, 0.5, 3))
    return Robot("generic", joints, Placement(base, "pose"), Placement(tool, "pose"), payload=Body(5.0, np.ones(3) / 5))


def _body(mass, offset):
    return Body(float(mass), np.array([offset, 0.02, -0.5 * offset]))


def readings(robot, rng, count):
    """Random readings within the limits, shape (count, n)."""
    return rng.uniform([j.lower for j in robot.joints], [j.upper for j in robot.joints], (count, robot.n))


def vector(function, *arguments):
    """The first output of a CasADi function, flat."""
    found = function(*arguments)
    return (found[0] if isinstance(found, tuple) else found).full().ravel()
