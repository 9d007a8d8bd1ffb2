"""Random robots, planted truths and noisy campaigns for the studies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadical import Joint, Measurements, Placement, Robot
from casadical.core.basics import Array
from casadical.core.transforms import frame, from_rpy
from casadical.identification.accuracy import predicted

RIGHT = np.pi / 2
NOISE = 2e-5


def random_robot(rng: np.random.Generator, parallel: bool, name: str = "random") -> Robot:
    """A six-axis robot in the nominal geometry of real ones: right angles, half of the lengths zero.

    parallel : whether one to three neighbouring pairs of axes are parallel (SCARA-, elbow- and UR-like arms)
    """
    alphas = [0.0, *rng.choice([-RIGHT, RIGHT], 5)]
    if parallel:
        for k in rng.choice(np.arange(1, 6), rng.integers(1, 4), replace=False):
            alphas[k] = rng.choice([0.0, np.pi])
    else:
        for k in range(1, 6):  # one axis in four stands at no particular angle
            if rng.random() < 0.25:
                alphas[k] = rng.choice([-1, 1]) * rng.uniform(np.deg2rad(15), np.deg2rad(165))
    joints = []
    for k, alpha in enumerate(alphas):
        a, d = rng.uniform(0.05, 0.8, 2) * (rng.random(2) < 0.5)
        if k and a == 0 and np.sin(alpha) ** 2 < 1e-9:
            a = rng.uniform(0.1, 0.8)  # two axes on one line are no robot
        joints.append(Joint(alpha=alpha, a=a, d=d, theta=rng.choice([0.0, RIGHT, -RIGHT]), lower=-2.8, upper=2.8))
    tool = frame(np.eye(3), rng.uniform(0.05, 0.25, 3))
    return Robot(name, tuple(joints), base=Placement(np.eye(4), "pose"), tool=Placement(tool, "position"))


def correct_set(robot: Robot) -> set[str]:
    """What positions can tell of a six-axis arm with base pose and tool point unknown, from its structure alone.

    The base takes up alpha0, a0, d1, theta1, the tool d6 and theta6. Between parallel axes beta comes in, and of all
    the d along them only the last can be identified - not even that where the base or the tool slides along them too.
    """
    chosen = {n for n in robot.parameters.names if n.startswith(("base", "tool"))}
    n = robot.n
    chosen |= {f"{w}{i}" for i in range(1, n) for w in ("alpha", "a")}
    parallel = [abs(np.sin(robot.joints[i].alpha)) < 1e-6 for i in range(1, n)]  # axes i and i+1, i = 1..5
    chosen |= {f"beta{i}" for i, p in enumerate(parallel, 1) if p}
    chosen |= {f"theta{i}" for i in range(2, n)}
    absorbed = True  # the base slides along axis 1
    for i in range(1, n + 1):
        along_next = i < n and parallel[i - 1]
        if not along_next:
            if not absorbed and i < n:
                chosen.add(f"d{i}")
            absorbed = False
    return chosen


def planted(robot: Robot, rng: np.random.Generator, size: float = 1.0) -> Robot:
    """The robot as built: every parameter off by about a millimetre and two milliradians, in a tracker's frame."""
    values = {}
    for p in robot.parameters:
        if p.group == "compliance":
            values[p.name] = p.value * rng.uniform(0.7, 1.3)
        elif p.group in ("geometry", "loop", "tool"):
            values[p.name] = p.value + size * rng.normal() * (1e-3 if p.unit == "m" else 2e-3)
    T = frame(from_rpy(rng.uniform(-np.pi, np.pi, 3)), rng.uniform(-3, 3, 3))
    built = robot.with_values(values)
    return replace(built, base=replace(built.base, T=T)) if robot.base.unknown == "pose" else built


def readings(robot: Robot, n: int, rng: np.random.Generator) -> Array:
    lower, upper = (np.array([getattr(j, w) for j in robot.joints]) for w in ("lower", "upper"))
    return rng.uniform(lower, upper, (n, robot.n))


def measured(built: Robot, q: Array, rng: np.random.Generator, sigma: float = NOISE) -> Measurements:
    """Positions with noise of `sigma` [m] a coordinate."""
    bare = Measurements(q=q, kind="position", position=np.zeros((len(q), 3)))
    p, _ = predicted(built, bare)
    return replace(bare, position=p + sigma * rng.normal(size=p.shape))
