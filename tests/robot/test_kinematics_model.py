"""Position, pose and torque against numpy; every Jacobian against finite differences."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numeric_arm import (
    compliances,
    derivative,
    generic_arm,
    hh800,
    loaded_torques,
    pose,
    readings,
    slider_arm,
    torques,
    vector,
)

from casadical.robot.model import rigid_chain

ARMS = {
    "hh800": hh800,
    "hh800, no parallelogram": lambda: hh800(bars=(0.7, 1.65, 0.9)),
    "slider": slider_arm,
    "generic": lambda: generic_arm(0),
    "seven axes": lambda: generic_arm(1, n=7),
}


@pytest.fixture(params=ARMS, scope="module")
def arm(request):
    return ARMS[request.param]()


def rigid(arm):
    return replace(arm, joints=tuple(replace(j, compliance=None) for j in arm.joints))


def at_poses(arm, count=4):
    return readings(arm, np.random.default_rng(3), count)


def test_pose_of_the_rigid_arm(arm):
    stiff = rigid(arm)
    for q in at_poses(arm):
        p, R = stiff.pose(q, stiff.parameters.values)
        T = pose(arm, q)
        np.testing.assert_allclose(p.full().ravel(), T[:3, 3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(R.full(), T[:3, :3], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["slider", "generic", "seven axes"])
def test_chain_in_numpy_is_the_numeric_arm_and_its_jacobian_the_derivative(name):
    """All poses at once, by every parameter: base, rows of turning and sliding joints, tool, with their factors."""
    arm = rigid(ARMS[name]())
    arm = replace(arm, tool=replace(arm.tool, unknown="pose"))
    q, rng, names = at_poses(arm), np.random.default_rng(4), arm.parameters.names
    phi = arm.parameters.values + rng.normal(0, 1e-2, len(names))
    scale, weight = rng.uniform(1, 2, len(names)), rng.uniform(1, 2, len(q))
    chain = rigid_chain(tuple(j.kind for j in arm.joints), names, tuple(range(len(names))))
    p, axes, J = chain(q.T, phi, arm.constants, scale, weight)
    moved, by_parameters = arm.with_values(dict(zip(names, phi, strict=True))), jacobian(arm.position, 1)
    for k, of_pose in enumerate(q):
        expected = pose(moved, of_pose)
        assert np.allclose(p[:, k], expected[:3, 3], atol=1e-12)
        assert np.allclose(axes[:, :, k].T, expected[:3, :3], atol=1e-12)
        by_graph = by_parameters(of_pose, phi).full()
        assert np.allclose(J[:, k].T, by_graph * scale * weight[k], atol=1e-9)
    assert np.array_equal(chain(q.T, phi, arm.constants)[0], p)


def test_torque_is_minus_the_gradient_of_the_energy(arm):
    stiff = rigid(arm)
    for q in at_poses(arm):
        found = vector(stiff.torque, q, stiff.parameters.values)
        expected = torques(arm, q)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_torque_of_a_compliant_arm_is_that_of_the_sunken_one(arm):
    for q in at_poses(arm):
        found = vector(arm.torque, q, arm.parameters.values)
        np.testing.assert_allclose(found, loaded_torques(arm, q), rtol=0, atol=1e-9 * np.abs(found).max())


def test_deflection_enters_the_kinematics_itself(arm):
    stiff = rigid(arm)
    for q in at_poses(arm):
        moved = q + compliances(arm) * loaded_torques(arm, q)
        np.testing.assert_allclose(
            vector(arm.position, q, arm.parameters.values), pose(stiff, moved)[:3, 3], rtol=0, atol=1e-11
        )


def sinking(arm, q, deflection):
    """The arm made so soft that its joints give by at most `deflection` [rad or m] at q, to first order."""
    factor = deflection / np.abs(compliances(arm) * torques(arm, q)).max()
    return arm.with_values({p.name: factor * p.value for p in arm.parameters if p.group == "compliance"})


def test_model_stands_next_to_equilibrium(arm):
    # theta = q + c tau(theta); the model goes two steps of this iteration, so its error falls with the cube of c.
    q, left = at_poses(arm, 1)[0], []
    for deflection in (0.01, 0.02):
        soft, theta = sinking(arm, q, deflection), q
        for _ in range(10):
            theta = q + compliances(soft) * torques(soft, theta)
        stood = pose(soft, theta)[:3, 3]
        left.append(np.linalg.norm(vector(soft.position, q, soft.parameters.values) - stood))
        sunk = np.linalg.norm(stood - pose(soft, q)[:3, 3])
        assert left[-1] < 0.02 * sunk
    assert left[0] > 1e-9
    assert left[1] / left[0] == pytest.approx(8, rel=0.3)


@pytest.mark.parametrize("output", ["position", "torque"])
def test_jacobian_by_parameters(arm, output):
    function, phi = getattr(arm, output), arm.parameters.values
    J = jacobian(function, 1)
    for q in at_poses(arm, 2):
        load = np.abs(vector(arm.torque, q, phi)).max()
        steps = np.array([1e-4 / load if p.group == "compliance" else 1e-3 for p in arm.parameters])
        exact = J(q, phi).full()
        found = derivative(lambda x, q=q: vector(function, q, x), phi, steps)
        scale = np.maximum(np.abs(exact).max(axis=0), 1.0)
        np.testing.assert_allclose(found / scale, exact / scale, rtol=0, atol=1e-7)


@pytest.mark.parametrize("output", ["position", "torque"])
def test_jacobian_by_readings(arm, output):
    function, phi = getattr(arm, output), arm.parameters.values
    J = jacobian(function, 0)
    for q in at_poses(arm, 2):
        exact = J(q, phi).full()
        found = derivative(lambda x: vector(function, x, phi), q, np.full(arm.n, 1e-3))
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-8 * max(np.abs(exact).max(), 1))


def test_every_parameter_of_the_geometry_moves_something(arm):
    J = jacobian(arm.position, 1)
    columns = np.concatenate([J(q, arm.parameters.values).full() for q in at_poses(arm)])
    still = [p.name for p, size in zip(arm.parameters, np.abs(columns).max(axis=0), strict=True) if size < 1e-12]
    # Only turns of the tool leave its point where it is.
    assert set(still) == {n for n in arm.parameters.names if n.startswith("tool_r")}


def jacobian(function, by):
    q, phi = ca.SX.sym("q", function.numel_in(0)), ca.SX.sym("phi", function.numel_in(1))
    return ca.Function("J", [q, phi], [ca.jacobian(function(q, phi), (q, phi)[by])])


def test_gravity_in_the_base_frame_does_not_turn_with_the_base():
    arm = generic_arm(2)
    q = at_poses(arm, 1)[0]
    fixed = replace(arm, gravity_frame="base")
    tilted = {"base_rx": 0.2, "base_ry": -0.1}
    for robot, changes in ((arm, True), (fixed, False)):
        before, after = (vector(r.torque, q, r.parameters.values) for r in (robot, robot.with_values(tilted)))
        np.testing.assert_allclose(after, loaded_torques(robot.with_values(tilted), q), rtol=0, atol=1e-8)
        assert (np.abs(after - before).max() > 1) == changes
