"""Nearly parallel axes and nearly singular poses: sampled by hypothesis, checked against products of exponentials."""

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numeric_arm import derivative, shift, turn, vector
from scipy.linalg import expm

from casadical.core.parts import Joint, Placement
from casadical.robot.axes import rows_from_axes
from casadical.robot.robot import Robot

SAMPLING = settings(deadline=None, max_examples=30, derandomize=True)
# Degrees between an axis and the one before: 1e-6..5, off 0 or off 180.
off_parallel = st.tuples(st.floats(-6, np.log10(5)).map(lambda e: 10**e), st.sampled_from([0.0, 180.0])).map(
    lambda pair: np.deg2rad(pair[1] + pair[0])
)
place = st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array)
direction = st.floats(0, 2 * np.pi)


def screw(axis, angle):
    """The motion about an axis in space, shape (4, 4), as a matrix exponential."""
    point, (x, y, z) = axis
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = -np.cross((x, y, z), point)
    return expm(angle * generator)


@SAMPLING
@given(st.lists(st.tuples(off_parallel, direction, place), min_size=1, max_size=5), st.integers(0, 1000))
def test_rows_of_nearly_parallel_axes_move_like_their_screws(steps, seed):
    z, axes = np.array([0.0, 0.0, 1.0]), [(np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.0, 1.0]))]
    for angle, towards, offset in steps:
        aside = np.cross(z, [np.cos(towards), np.sin(towards), 0.3])
        aside /= np.linalg.norm(aside)
        z = np.cos(angle) * z + np.sin(angle) * np.cross(aside, z)
        z /= np.linalg.norm(z)
        axes.append((axes[-1][0] + offset, z))
    rng = np.random.default_rng(seed)
    tip = shift(*rng.uniform(-1, 1, 3)) @ turn("xyz", rng.uniform(-3, 3, 3))
    base, rows, _, tool = rows_from_axes(*zip(*axes, strict=True), tip)
    arm = Robot("near", rows, Placement(base), Placement(tool))
    q = rng.uniform(-3, 3, len(axes))
    expected = np.eye(4)
    for axis, angle in zip(axes, q, strict=True):
        expected = expected @ screw(axis, angle)
    p, R = arm.pose(q, arm.parameters.values)
    np.testing.assert_allclose(p.full().ravel(), (expected @ tip)[:3, 3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(R.full(), (expected @ tip)[:3, :3], rtol=0, atol=1e-12)
    # No offset runs away along a common normal far off: all stay within the size of the arm.
    assert max(max(abs(j.a), abs(j.d)) for j in rows) < 1 + len(axes)
    assert all(j.beta is not None for j in rows[1:])


def test_the_length_between_skew_axes_is_positive():
    for side in (0.3, -0.3):
        _, rows, _, _ = rows_from_axes(np.array([[0, 0, 0], [side, 0, 0.2]]), np.eye(3)[[2, 1]], np.eye(4))
        assert rows[1].a == 0.3


@SAMPLING
@given(st.lists(off_parallel, min_size=1, max_size=3), st.integers(0, 1000))
def test_jacobian_of_nearly_parallel_rows_is_bounded_and_exact(twists, seed):
    rng = np.random.default_rng(seed)
    rows = [Joint(), *(Joint(alpha, *rng.uniform(0.1, 0.6, 3)) for alpha in twists), Joint(1.3, 0.1, 0.2, 0.3)]
    arm = Robot("near", tuple(rows), tool=Placement(shift(0.1, 0.2, 0.3), "position"))
    names = arm.parameters.names
    assert [f"beta{i}" in names for i in range(1, arm.n)] == [True] * len(twists) + [False]
    assert [bool(arm.parameters[f"d{i}"].fixed_reason) for i in range(1, arm.n + 1)] == [True] * len(twists) + [
        False
    ] * 2
    agree(arm, rng.uniform(-3, 3, arm.n))


def agree(arm, q):
    """Jacobian by the parameters, against finite differences and the longest lever there is."""
    x, phi = ca.SX.sym("q", arm.n), ca.SX.sym("phi", len(arm.parameters))
    J = ca.Function("J", [x, phi], [ca.jacobian(arm.position(x, phi), phi)])
    exact = J(q, arm.parameters.values).full()
    found = derivative(lambda v: vector(arm.position, q, v), arm.parameters.values, np.full(phi.numel(), 1e-3))
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)
    assert np.linalg.norm(exact, axis=0).max() <= max(arm.reach, 1.0) + 1e-12
