"""Predicted positions are as unsure as they are wrong, also where the measured poses determined nothing."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scipy.special import stdtrit

from casadical import Body, Measurements, identify
from casadical.effects import GearEccentricity
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured
from casadical.robot.robot import Covariance, Knowledge

ARM = arms.six_axis()


# Axes 2 and 3 are parallel, joints 2 to 5 compliant, joint 1 reaches both half turns.
BODIES = [
    Body(mass, np.array([0.2 if k in (2, 3) else 0.0, 0.02, 0.05]))
    for k, mass in enumerate((20.0, 12.0, 8.0, 4.0, 2.0, 1.0), 1)
]
SOFT = arms.with_bodies(arms.six_axis(payload=Body(5.0, np.array([0, 0, 0.1]))), BODIES, (2, 3, 4, 5), 2e-5)
FIRST = replace(SOFT.joints[0], lower=-1.01 * np.pi, upper=1.01 * np.pi)
TURNING = replace(SOFT, joints=(FIRST, *SOFT.joints[1:]))
LIMITS = np.array([(j.lower, j.upper) for j in TURNING.joints]).T


def poses(design: str, rng: np.random.Generator) -> np.ndarray:
    """Readings (n, 6) of a design: 14 to 20 poses anywhere, or 60."""
    q = rng.uniform(*LIMITS, (int(rng.integers(14, 21)) if design == "few poses" else 60, 6))
    if design == "one plane":
        q[:, [0, 3, 5]] = q[0, [0, 3, 5]]
    elif design == "one pose":
        q[:] = q[0]
    elif design == "+-180 deg":
        q[:, 0] = np.pi * rng.choice([-1, 1], 60)
    elif design == "half the workspace":
        q = (LIMITS[int(rng.integers(2))] + q) / 2
    return q


def identified(design: str, size: float, rng: np.random.Generator):
    """What one robot with errors of ``size`` times its priors gave, other poses, and the errors predicted there [m]."""
    values = {p.name: p.value + size * p.prior * rng.normal() for p in TURNING.parameters}
    soft = TURNING.parameters.select(["compliance"])
    truth = TURNING.with_values({n: max(v, 0.0) if n in soft else v for n, v in values.items()})
    q, probe = poses(design, rng), rng.uniform(*LIMITS, (50, 6))
    seen = predicted(truth, unmeasured(q))[0] + 2e-5 * rng.normal(size=(len(q), 3))
    result = identify(TURNING, Measurements(q=q, kind="position", position=seen))
    return result, probe, result.predict(probe)[0] - predicted(truth, unmeasured(probe))[0]


def held(result, covariance, miss) -> dict[str, float]:
    """Share of coordinates in their 95 % intervals, rms error and standard deviation [m]."""
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    share = np.mean(np.abs(miss) <= stdtrit(max(1, result.degrees_of_freedom), 0.975) * deviation)
    error, promised = (float(np.sqrt(np.mean(x**2))) for x in (miss, deviation))
    return {"held": float(share), "error": error, "sigma": promised}


@pytest.fixture(scope="module")
def built():
    return arms.planted(ARM, 4)


def sigma(result, q):
    """Standard deviation of predicted positions, shape (n,) [m]."""
    return np.sqrt(np.trace(result.predict(q)[1], axis1=1, axis2=2))


def identified_only(result, q):
    """Covariance of positions by the identified parameters alone, shape (n, 3, 3) [m^2]."""
    names, step = result.names, 1e-6
    columns = []
    for name in names:
        p = result.start.parameters[name]
        sides = []
        for sign in (1, -1):
            values = dict(zip(names, result.estimate, strict=True))
            values[name] += sign * step * p.scale
            sides.append(predicted(result.start, unmeasured(q), values)[0])
        columns.append((sides[0] - sides[1]) / (2 * step * p.scale))
    J = np.stack(columns, axis=2)
    return np.asarray(J @ np.nan_to_num(result.covariance) @ J.transpose(0, 2, 1))


@pytest.mark.slow
@pytest.mark.parametrize("design", ["one plane", "few poses", "one pose", "+-180 deg", "half the workspace"])
def test_intervals_hold_the_truth_anywhere(design) -> None:
    """Sixty poses, or fewer, that leave much undetermined, of robots with errors of their priors' size."""
    cases = [identified(design, 1.0, np.random.default_rng([3, n])) for n in range(4)]
    every, only = (
        {key: np.mean([c[key] for c in found]) for key in found[0]}
        for found in (
            [held(r, r.predict(q)[1], miss) for r, q, miss in cases],
            [held(r, identified_only(r, q), miss) for r, q, miss in cases],
        )
    )
    assert every["held"] > 0.9
    assert every["sigma"] < 4 * every["error"]  # and they are not merely wide
    if design not in ("few poses", "half the workspace"):
        assert only["held"] < 0.6  # by the identified parameters alone


def test_where_all_is_identified_the_covariance_is_that_of_the_identified(built) -> None:
    robot = replace(ARM, base=replace(ARM.base, unknown="none"))
    q, probe = arms.readings(built, 60, 5), arms.readings(built, 20, 7)
    result = identify(robot, arms.positions(built, q, 6), ["theta*"])
    held = [p.name for p in robot.parameters if p.name not in result.names]
    surely = replace(result, start=known_exactly(result.start, held))
    problem = replace(result.problem, robot=surely.start)
    alone = replace(surely, problem=problem).predict(probe)[1]
    np.testing.assert_allclose(alone, identified_only(result, probe), rtol=1e-4, atol=1e-13)
    assert (sigma(result, probe) > 3 * np.sqrt(np.trace(alone, axis1=1, axis2=2))).all()


def known_exactly(robot, names):
    """The robot, of which a file says that these parameters have no variance to speak of."""
    C = Covariance(tuple(names), 1e-24 * np.eye(len(names)))
    return replace(robot, knowledge=Knowledge((C,)))


def test_what_the_robots_file_knows_counts_for_its_priors(built) -> None:
    """One sigma of a held length, known from elsewhere: along the last axis it is that of the point, to the digit."""
    q, probe = arms.readings(built, 60, 5), arms.readings(built, 5, 7)
    found = []
    for error in (1e-3, 2e-3):
        names = [p.name for p in ARM.parameters if p.group == "geometry"]
        variances = [error**2 if n == "d6" else 1e-24 for n in names]
        robot = replace(ARM, knowledge=Knowledge((Covariance(tuple(names), np.diag(variances)),)))
        robot = replace(robot, base=replace(robot.base, unknown="none"), tool=replace(robot.tool, unknown="none"))
        result = identify(robot, arms.positions(ARM, q, 6), ["theta2"])
        found.append(sigma(result, probe))
    assert found[0] == pytest.approx(1e-3, rel=0.3)
    assert found[1] == pytest.approx(2 * found[0], rel=0.02)


def test_a_prior_counts_from_its_mean_wherever_the_robots_file_begins(built) -> None:
    """Readings of one plane; one prior of an effect, whose sizes are 0 in one file, and the prior's in another."""
    effect = GearEccentricity(2)
    told = {p.name: 1e-2 for p in effect.parameters()}
    q, probe = arms.readings(built, 60, 5), arms.readings(built, 20, 7)
    q[:, [0, 3, 5]] = q[0, [0, 3, 5]]
    m = arms.positions(built.with_effect(effect).with_values(told), q, 6)
    empty = ARM.with_effect(effect)
    priors = {name: (mean, 1e-3) for name, mean in told.items()}
    free = ["kinematic", effect.label]
    found = [sigma(identify(robot, m, free, priors=priors), probe) for robot in (empty, empty.with_values(told))]
    assert found[0] == pytest.approx(found[1], rel=2e-5)


def test_held_parameters_move_identified_ones() -> None:
    """A straight arm of two links in a plane, the second reading fixed: only the sum of its lengths can be told.

    With the joint bent by b the end is off by e (cos b - 1, sin b) if the second length is e longer and the first e
    shorter: the variance at the pose is that of the length times 2 (1 - cos b).
    """
    flat = replace(arms.planar(), tool=replace(arms.planar().tool, unknown="position"))
    names = [p.name for p in flat.parameters]
    C = Covariance(tuple(names), np.diag([1e-6 if n == "tool_x" else 1e-24 for n in names]))
    q = np.column_stack([np.linspace(-1, 1, 40), np.zeros(40)])
    robot = replace(flat, knowledge=Knowledge((C,)))
    result = identify(robot, arms.positions(flat, q, 1), ["a1", "theta1"], priors=False)
    bent = np.array([0.3, 1.0, 2.0])
    probe = np.column_stack([np.zeros(3), bent])
    assert sigma(result, probe) == pytest.approx(1e-3 * np.sqrt(2 * (1 - np.cos(bent))), rel=0.02)
