"""Robots, planted truths and synthetic measurements that several folders of tests share."""

from dataclasses import replace

import numpy as np

from casadical import Body, FourBar, Joint, Measurements, Placement, Robot
from casadical.core.transforms import frame, from_rpy
from casadical.identification.accuracy import predicted

RIGHT = np.pi / 2
NOISE = 2e-5
TRACKER = frame(from_rpy(np.array([2.5, -0.8, 1.9])), np.array([2.1, -3.4, 0.7]))


def six_axis(**changes):
    """An elbow arm, axes 2 and 3 parallel, 1 m of reach; base pose and tool point unknown."""
    rows = [(0, 0, 0.4), (RIGHT, 0.1, 0), (0, 0.5, 0), (RIGHT, 0.05, 0.45), (-RIGHT, 0, 0), (RIGHT, 0, 0.1)]
    joints = tuple(Joint(alpha=alpha, a=a, d=d, lower=-2.6, upper=2.6) for alpha, a, d in rows)
    tool = Placement(frame(np.eye(3), np.array([0.05, 0.08, 0.12])), "position")
    return replace(Robot("elbow", joints, base=Placement(np.eye(4), "pose"), tool=tool), **changes)


def with_bodies(robot, bodies, compliant, compliance):
    """The robot with a body for each link; the joints of these numbers are compliant [rad/(N m)], all others rigid."""
    joints = [
        replace(joint, body=body, compliance=compliance if k in compliant else None)
        for k, (joint, body) in enumerate(zip(robot.joints, bodies, strict=True), 1)
    ]
    return replace(robot, joints=tuple(joints))


def elbow(**changes):
    """The same arm with 20 kg a link and a payload, joints 2 and 3 compliant."""
    body = Body(20.0, np.array([0.1, 0, 0]))
    return with_bodies(six_axis(payload=Body(10.0, np.zeros(3)), **changes), [body] * 6, (2, 3), 1e-6)


def planar():
    """Two parallel joints, position only, frames known."""
    joints = (Joint(), Joint(a=0.4, lower=-2.0, upper=2.0))
    return Robot("planar", joints, tool=Placement(frame(np.eye(3), np.array([0.3, 0, 0]))))


def hh800():
    """Table 1 of the paper, joint 6 rigid as there; masses, mass centres and payload are assumed."""
    rows = [(0, 0, 0), (90, 0.515, 0), (0, 1.6, 0), (90, 0.35, 1.9), (-90, 0, 0), (90, 0, 0.445)]
    ranges = [(-120, 120), (45, 125), (135, 225), (-170, 170), (-110, 110), (-170, 170)]
    masses = [1400, 520, 780, 260, 130, 60]
    centres = [(0.25, 0, -0.3), (0.75, 0, 0.1), (0.12, 0.25, 0), (0, 0, -0.55), (0, 0.05, 0), (0, 0, -0.1)]
    joints = tuple(
        Joint(
            alpha=np.deg2rad(alpha), a=a, d=d, beta=0.0 if i == 0 else None, b=0.0 if i == 0 else None,
            lower=np.deg2rad(lower), upper=np.deg2rad(upper), compliance=4e-7 if i < 5 else None,
            body=Body(mass, np.array(com)),
        )
        for i, ((alpha, a, d), (lower, upper), mass, com) in enumerate(zip(rows, ranges, masses, centres, strict=True))
    )  # fmt: skip
    return Robot(
        "HH800",
        joints,
        tool=Placement(frame(np.eye(3), np.array([-0.45, 0.11, 0.93])), "position"),
        loops=(FourBar(driven=3, carrier=2, crank=0.8, coupler=1.6, rocker=0.8, offset=-RIGHT),),
        payload=Body(300.0, np.array([-0.3, 0.08, 0.55])),
    )


def with_rail(robot):
    """The same arm on a horizontal rail."""
    rail = Joint(alpha=RIGHT, kind="prismatic", lower=-1.0, upper=1.0)
    first = replace(robot.joints[0], alpha=-RIGHT)
    return replace(robot, joints=(rail, first, *robot.joints[1:]))


def planted(robot, seed, T_M0=None, size=1.0):
    """The robot as built: lengths off by a millimetre, angles by two milliradians, compliances by a third."""
    rng = np.random.default_rng(seed)
    values = {}
    for p in robot.parameters:
        if p.group == "compliance":
            values[p.name] = p.value * rng.uniform(0.7, 1.3)
        elif not p.name.startswith("base_"):
            values[p.name] = p.value + size * rng.normal() * (1e-3 if p.unit == "m" else 2e-3)
    built = robot.with_values(values)
    return built if T_M0 is None else replace(built, base=replace(built.base, T=T_M0))


def readings(robot, n, seed):
    """Joint readings over the whole range; those at which a four-bar comes near its folded position left out."""
    rng = np.random.default_rng(seed)
    lower, upper = np.array([(j.lower, j.upper) for j in robot.joints]).T
    q = rng.uniform(lower, upper, (4 * n, robot.n))
    if robot.loops:
        margin = robot.model.at_declared("loop", ("margin",)).map(len(q))(q.T, robot.parameters.values).full()
        q = q[margin.min(axis=0) > 0.3]
    return q[:n]


def bare(q):
    return Measurements(q=q, kind="position", position=np.zeros((len(q), 3)))


def points(robot, q):
    return predicted(robot, bare(q))[0]


def positions(built, q, seed, sigma=NOISE):
    """Measured positions with noise."""
    p = points(built, q)
    return replace(bare(q), position=p + sigma * np.random.default_rng(seed).normal(size=p.shape))


def poses(built, q, seed, sigma=NOISE, sigma_angle=1e-4):
    """Measured poses with noise."""
    rng = np.random.default_rng(seed)
    p, R = predicted(built, bare(q))
    turn = np.stack([from_rpy(v) for v in sigma_angle * rng.normal(size=p.shape)])
    return Measurements(q=q, kind="pose", position=p + sigma * rng.normal(size=p.shape), orientation=R @ turn)


def distances(built, q, point, seed, sigma=NOISE, known=False):
    """Distances to a fixed point, in the measuring frame."""
    length = np.linalg.norm(points(built, q) - point, axis=1)
    noise = sigma * np.random.default_rng(seed).normal(size=len(q))
    return Measurements(
        q=q, kind="distance", distance=length + noise, target=np.tile(point, (len(q), 1)) if known else None
    )


def pair_distances(built, q, other, seed, sigma=NOISE):
    """Distances between the tool's positions at two readings."""
    length = np.linalg.norm(points(built, q) - points(built, other), axis=1)
    noise = sigma * np.random.default_rng(seed).normal(size=len(q))
    return Measurements(q=q, kind="pair_distance", distance=length + noise, other=other)


def contacts(built, centres, each, seed, sigma=NOISE):
    """Readings at which the tool touches points, found by damped Newton steps; noise moves where it touches."""
    rng = np.random.default_rng(seed)
    step = built.position.factory("step", ["q", "phi"], ["jac:p:q", "p"])
    lower, upper = np.array([(j.lower, j.upper) for j in built.joints]).T
    found, labels = [], []
    for name, centre in centres.items():
        got = 0
        while got < each:
            q, goal = rng.uniform(lower, upper), centre + sigma * rng.normal(size=3)
            for _ in range(60):
                J, p = (v.full() for v in step(q, built.parameters.values))
                miss = goal - p.ravel()
                if np.linalg.norm(miss) < 1e-12:
                    break
                q = q + np.clip(J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(3), miss), -0.3, 0.3)
            if np.linalg.norm(miss) < 1e-9 and (q > lower).all() and (q < upper).all():
                found.append(q)
                labels.append(name)
                got += 1
    return Measurements(q=np.array(found), kind="contact", label=np.array(labels, dtype=object))


def model_error(robot, built, seed=99, n=300):
    """RMS distance [m] between two robots' points over their range."""
    q = readings(built, n, seed)
    return float(np.sqrt(np.mean(np.sum((points(robot, q) - points(built, q)) ** 2, axis=1))))


def chi2_per_parameter(result, built):
    """Squared departures from the truth in units of the covariance, per parameter; near one if the covariance is right.

    Only for robots whose planted errors lie in the identified parameters alone (see `planted_in`).
    """
    truth = np.array([built.parameters[n].value for n in result.names])
    miss = result.estimate - truth
    return float(miss @ np.linalg.solve(result.covariance, miss) / len(miss))


def planted_in(robot, names, seed):
    """Like `planted`, but only the given parameters depart."""
    full = planted(robot, seed)
    return robot.with_values({n: full.parameters[n].value for n in names})
