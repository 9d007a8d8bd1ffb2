"""A URDF read by casadical moves and weighs what Pinocchio says."""

import numpy as np
import pandas as pd
import pytest
from urdf_arms import UR10, Oracle, joint, link, pose_of, random_arm, readings, robot

from casadical.core.basics import InputError
from casadical.identification.identification import identify
from casadical.measurements.reading import read_measurements
from casadical.project.check.check import precheck
from casadical.robot.robot import modified_dh
from casadical.robot.urdf import read_urdf


def agree_with_pinocchio(path, base, tip, seed=0):
    arm, oracle, rng = read_urdf(path, base, tip), Oracle(path, base, tip), np.random.default_rng(seed)
    assert arm.n == len(oracle.joints)
    for q in readings(arm, rng, 8):
        np.testing.assert_allclose(pose_of(arm, q), oracle.pose(q), rtol=0, atol=1e-12)
        torque = arm.torque(q, arm.parameters.values).full().ravel()
        np.testing.assert_allclose(torque, oracle.gravity_torques(q), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("seed", [*range(10), *(pytest.param(k, marks=pytest.mark.slow) for k in range(10, 40))])
def test_random_arm(tmp_path, seed):
    path = tmp_path / "arm.urdf"
    path.write_text(random_arm(seed, n=1 + seed % 8))
    agree_with_pinocchio(path, "base", "tip", seed)


def test_ur10_table_is_the_published_one(tmp_path):
    # Maker's standard DH: d = 127.3, 0, 0, 163.941, 115.7, 92.2; a = 0, -612, -572.3; alpha = 90, 0, 0, 90, -90, 0.
    path = tmp_path / "ur10.urdf"
    path.write_text(UR10)
    agree_with_pinocchio(path, "base_link", "tool0")
    arm = read_urdf(path)
    rows = modified_dh(arm)
    np.testing.assert_allclose([r["a_mm"] for r in rows], [0, 0, 612, 572.3, 0, 0], atol=1e-9)
    np.testing.assert_allclose([r["d_mm"] for r in rows], [127.3, 0, 0, 163.941, 115.7, 92.2], atol=1e-9)
    np.testing.assert_allclose([abs(r["alpha_deg"]) for r in rows], [0, 90, 0, 0, 90, 90], atol=1e-9)
    assert [r["beta_deg"] is not None for r in rows] == [False, False, True, True, False, False]
    np.testing.assert_allclose(arm.base.T, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(arm.tool.T, np.eye(4), atol=1e-12)
    assert [j.body.mass for j in arm.joints] == [7.778, 12.93, 3.87, 1.96, 1.96, 0.202]


def test_frames_to_identify_and_limits(tmp_path):
    path = tmp_path / "arm.urdf"
    parts = [link(n, 1.0) for n in "abcd"]
    path.write_text(
        robot(
            *parts,
            joint("j1", "revolute", "a", "b", limit=(-1.5, 2.5)),
            joint("j2", "prismatic", "b", "c", (1, 0, 0), limit=(0.0, 0.3)),
            joint("j3", "continuous", "c", "d", (0, 0, 1), axis=(1, 0, 0)),
        )
    )
    arm = read_urdf(path)
    assert (arm.base.unknown, arm.tool.unknown, arm.gravity_frame) == ("pose", "position", "base")
    assert [(j.lower, j.upper) for j in arm.joints] == [(-1.5, 2.5), (0.0, 0.3), (-2 * np.pi, 2 * np.pi)]
    assert [j.kind for j in arm.joints] == ["revolute", "prismatic", "revolute"]
    assert arm.notes == ("from arm.urdf: a to d",)
    path.write_text(path.read_text().replace('lower="-1.5"', 'lower="-150"'))
    assert read_urdf(path).notes[1] == "the range of j1 looks like degrees, and is read as radians, as a URDF has them"


def test_compliant_joints_are_named_by_number(tmp_path):
    path = tmp_path / "ur10.urdf"
    path.write_text(UR10)
    arm = read_urdf(path, compliant=[2, 3])
    assert [p.name for p in arm.parameters if p.group == "compliance"] == ["c2", "c3"]
    with pytest.raises(InputError, match=r"compliant joint 7 is not there; the chain has 1\.\.6"):
        read_urdf(path, compliant=[2, 7])


def test_no_masses_and_side_joints_are_noted(tmp_path):
    path = tmp_path / "arm.urdf"
    parts = [link(n) for n in ("base", "l1", "tip", "finger")]
    joints = [
        joint("j1", "revolute", "base", "l1"),
        joint("grip", "prismatic", "l1", "finger"),
        joint("flange", "fixed", "l1", "tip", (0, 0, 1)),
    ]
    path.write_text(robot(*parts, *joints))
    assert [n.split()[0:2] for n in read_urdf(path, tip_link="tip").notes[1:]] == [["masses", "on"], ["the", "URDF"]]


def two_axes(tmp_path, xyz, rpy):
    path = tmp_path / "pair.urdf"
    parts = [link(n, 1.0) for n in ("base", "l1", "l2", "tip")]
    joints = [
        joint("j1", "revolute", "base", "l1"),
        joint("j2", "revolute", "l1", "l2", xyz, rpy),
        joint("flange", "fixed", "l2", "tip", (0.1, 0.2, 0.3)),
    ]
    path.write_text(robot(*parts, *joints))
    agree_with_pinocchio(path, "base", "tip")
    return read_urdf(path).joints


def test_parallel_axes_get_beta_and_no_offset_in_front(tmp_path):
    first, second = two_axes(tmp_path, (0.3, 0.4, 0.7), (0, 0, 1.0))
    assert first.d == 0.0
    assert second.beta == pytest.approx(0, abs=1e-15)
    assert second.a == pytest.approx(0.5)
    assert second.alpha == 0.0


def test_antiparallel_axes(tmp_path):
    _, second = two_axes(tmp_path, (0.3, 0.4, 0.7), (np.pi, 0, 0))
    assert second.beta == pytest.approx(0, abs=1e-15)
    assert abs(second.alpha) == pytest.approx(np.pi)


@pytest.mark.parametrize("roll", [0.0, np.pi])
def test_coincident_axes(tmp_path, roll):
    first, second = two_axes(tmp_path, (0, 0, 0.7), (roll, 0, 0))
    assert (first.theta, first.d, second.a) == (0.0, 0.0, 0.0)


def test_intersecting_axes_within_rounding_keep_their_sense(tmp_path):
    # 1 um of rounding to either side must not turn the table over.
    tables = [two_axes(tmp_path, (0, y, 0.7), (-np.pi / 2, 0, 0)) for y in (0.0,)]
    tables += [two_axes(tmp_path, (x, 0, 0.7), (-np.pi / 2, 0, 0)) for x in (1e-6, -1e-6)]
    assert [t[0].theta for t in tables] == pytest.approx([0, 0, 0])
    assert [t[1].a for t in tables] == pytest.approx([0, 1e-6, -1e-6], abs=1e-15)
    assert [t[1].alpha for t in tables] == pytest.approx([-np.pi / 2] * 3)


def test_nearly_parallel_axes_stay_near(tmp_path):
    # The common normal of these lies 570 m away; Hayati's form keeps every number within the arm's size.
    first, second = two_axes(tmp_path, (0.3, 0.1, 0.5), (1e-3 * 0.5, 0.0005, 0))
    assert max(abs(first.d), second.a, abs(second.d)) < 1
    assert second.beta is not None


@pytest.mark.parametrize(("fingers", "joints"), [(2, 3), (3, 3), (1, 4)])
def test_a_gripper_is_no_end_of_the_arm(tmp_path, fingers: int, joints: int) -> None:
    """Its fingers begin at one link; a single one is a joint more."""
    parts = ['<link name="l0"/>']
    for k in range(1, 4 + fingers):
        parent, kind = (k - 1, "revolute") if k < 4 else (3, "prismatic")
        mimic = '<mimic joint="j4" multiplier="-1"/>' if k > 4 else ""
        parts.append(
            f'<link name="l{k}"/><joint name="j{k}" type="{kind}"><parent link="l{parent}"/><child link="l{k}"/>'
            f'<origin xyz="0.1 0 0.{k}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1"/>{mimic}</joint>'
        )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    assert read_urdf(path).n == joints


def test_a_mass_centre_far_beyond_the_reach_names_its_link_and_stops_no_geometry(tmp_path):
    """The same arm without that slip has the same geometry, to a rounding, and no remark."""
    good, bad = tmp_path / "good.urdf", tmp_path / "bad.urdf"
    good.write_text(UR10)
    bad.write_text(UR10.replace("0.0 0.0 0.306", "0.0 0.0 500.0"))
    arm, rng = read_urdf(good), np.random.default_rng(1)
    q = readings(arm, rng, 40)
    seen = np.array([pose_of(arm, each)[:3, 3] for each in q]) + rng.normal(0, 2e-5, (40, 3))
    names = [f"q{i}_rad" for i in range(1, 7)] + ["x_m", "y_m", "z_m"]
    pd.DataFrame(np.hstack([q, seen]), columns=names).to_csv(tmp_path / "poses.csv", index=False)
    checks = [precheck(path, tables=[tmp_path / "poses.csv"]) for path in (good, bad)]
    assert [c.ok for c in checks] == [True, True]
    said = [[f.text for f in c.of_level("warning") if f.topic == "masses"] for c in checks]
    assert (said[0], len(said[1])) == ([], 1)
    assert "link 'upper_arm'" in said[1][0]
    assert "500 m" in said[1][0]
    m = read_measurements(tmp_path / "poses.csv", 6)
    found = [identify(read_urdf(path), m, ["kinematic"]).robot.parameters.values for path in (good, bad)]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)
