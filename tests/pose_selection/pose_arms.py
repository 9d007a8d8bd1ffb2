"""Robots of known truth for the tests of this folder."""

from dataclasses import replace

import numpy as np

from casadical import Body, FourBar, Joint, Measurements, Placement, Robot
from casadical.core.transforms import frame
from casadical.identification.accuracy import predicted

RIGHT = np.pi / 2


def elbow(**changes):
    """Six axes, 1 m of reach, compliant joints 2 and 3, base pose and tool point unknown."""
    rows = [(0, 0, 0.4), (RIGHT, 0.1, 0), (0, 0.5, 0), (RIGHT, 0.05, 0.45), (-RIGHT, 0, 0), (RIGHT, 0, 0.1)]
    joints = tuple(
        Joint(
            alpha=alpha, a=a, d=d, lower=-2.6, upper=2.6, compliance=1e-6 if i in (1, 2) else None,
            body=Body(20.0, np.array([0.1, 0, 0])),
        )
        for i, (alpha, a, d) in enumerate(rows)
    )  # fmt: skip
    tool = Placement(frame(np.eye(3), np.array([0.05, 0.08, 0.12])), "position")
    robot = Robot("elbow", joints, base=Placement(np.eye(4), "pose"), tool=tool, payload=Body(10.0, np.zeros(3)))
    return replace(robot, **changes)


def planar():
    """Two parallel joints, frames known: few parameters, so that every set of poses can be tried."""
    joints = (Joint(), Joint(a=0.4, lower=-2.0, upper=2.0))
    return Robot("planar", joints, tool=Placement(frame(np.eye(3), np.array([0.3, 0, 0]))))


def with_loop():
    """Joint 3 driven by a parallelogram."""
    joints = (
        Joint(d=0.5, lower=-2, upper=2),
        Joint(alpha=RIGHT, a=0.3, lower=0.5, upper=2.5),
        Joint(a=0.8, lower=1.0, upper=4.0),
    )
    loop = FourBar(driven=3, carrier=2, crank=0.4, coupler=0.8, rocker=0.4, offset=-RIGHT)
    return Robot("loop", joints, tool=Placement(frame(np.eye(3), np.array([0.6, 0, 0]))), loops=(loop,))


def readings(robot, n, seed):
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    return np.random.default_rng(seed).uniform(lower, upper, (n, robot.n))


def positions(built, q, seed, sigma):
    m = Measurements(q=q, kind="position", position=np.zeros((len(q), 3)))
    p = predicted(built, m)[0]
    return replace(m, position=p + sigma * np.random.default_rng(seed).normal(size=p.shape))
