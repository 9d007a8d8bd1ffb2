"""A calibrated robot written into its URDF moves in Pinocchio as it does in casadical."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from urdf_arms import UR10, Oracle, joint, link, pose_of, random_arm, readings, robot

from casadical import Joint, Robot
from casadical.core.basics import InputError
from casadical.identification.identification import identify
from casadical.measurements.reading import from_table
from casadical.robot.urdf import calibrated_urdf_text, new_urdf, read_urdf


def perturbed(arm, seed, groups=("base", "geometry", "tool")):
    """The robot with every parameter of these groups off by some mm and mrad (the base by much more)."""
    rng = np.random.default_rng(seed)
    size = {"base": 0.3, "geometry": 5e-3, "tool": 5e-2}
    return arm.with_values(
        {p.name: p.value + size[p.group] * rng.uniform(-1, 1) for p in arm.parameters if p.group in groups}
    )


def written(tmp_path, text):
    path = tmp_path / "in.urdf"
    path.write_text(text)
    return path, tmp_path / "out.urdf"


def calibrated_urdf(before, after, path, out, *links, **options):
    out.write_text(calibrated_urdf_text(before, after, path, *links, **options), encoding="utf-8")


def canonical(tree):
    return ElementTree.canonicalize(ElementTree.tostring(tree.getroot()), strip_text=True)


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(k, marks=pytest.mark.slow) for k in range(4, 16))])
@pytest.mark.parametrize("base", ["robot", "measuring"])
def test_random_arm(tmp_path, seed, base):
    path, out = written(tmp_path, random_arm(seed, n=1 + seed % 7))
    before = read_urdf(path, "base", "tip")
    after = perturbed(before, seed)
    calibrated_urdf(before, after, path, out, "base", "tip", base=base)
    oracle, foot = Oracle(out, "base", "tip"), np.eye(4)
    if base == "robot":  # frame 0 stays in the base link where it was
        foot = before.base.T @ np.linalg.inv(after.base.T)
    moved = 0.0
    for q in readings(after, np.random.default_rng(seed), 5):
        np.testing.assert_allclose(oracle.pose(q), foot @ pose_of(after, q), rtol=0, atol=1e-12)
        moved = max(moved, np.abs(oracle.pose(q) - pose_of(before, q)).max())
    assert moved > 1e-3


def test_compliance_is_left_out_and_named(tmp_path):
    path, out = written(tmp_path, UR10)
    before = read_urdf(path)
    soft = tuple(replace(j, compliance=2e-5 * i) for i, j in enumerate(before.joints))
    after = perturbed(replace(before, joints=soft), 1, ("geometry",))
    calibrated_urdf(before, after, path, out)
    rigid = replace(after, joints=tuple(replace(j, compliance=None) for j in after.joints))
    q = np.array([0.3, -1.0, 0.8, 0.2, 0.5, 0.1])
    np.testing.assert_allclose(Oracle(out, "base_link", "tool0").pose(q), pose_of(rigid, q), rtol=0, atol=1e-12)
    assert np.abs(pose_of(after, q) - pose_of(rigid, q)).max() > 1e-4
    text = out.read_text()
    assert "compliance has no place in a URDF and is NOT in this file" in text
    assert "(c2 = 2e-05, c3 = 4e-05," in text
    assert text.startswith(
        '<?xml version="1.0" encoding="utf-8"?>\n<!-- the file\'s own header -->\n<robot name="ur10">'
    )


def test_unchanged_robot_keeps_every_origin_and_inertia(tmp_path):
    path, out = written(tmp_path, UR10)
    arm = read_urdf(path)
    calibrated_urdf(arm, arm, path, out)
    assert canonical(ElementTree.parse(path)) == canonical(ElementTree.parse(out))


def test_only_origins_change(tmp_path):
    path, out = written(tmp_path, random_arm(4))
    before = read_urdf(path, "base", "tip")
    calibrated_urdf(before, perturbed(before, 4), path, out, "base", "tip")
    trees = [ElementTree.parse(p) for p in (path, out)]
    for tree in trees:
        for origin in tree.getroot().findall("joint/origin"):
            origin.attrib.clear()
    assert canonical(trees[0]) == canonical(trees[1])


def test_measured_point_as_new_link_leaves_the_flange(tmp_path):
    path, out = written(tmp_path, UR10)
    before = read_urdf(path)
    after = before.with_values({"a2": 0.6125, "tool_x": 0.05, "tool_z": 0.2})
    calibrated_urdf(before, after, path, out, measured_link="reflector")
    oracle, q = Oracle(out, "base_link", "tool0"), np.array([0.3, -1.0, 0.8, 0.2, 0.5, 0.1])
    np.testing.assert_allclose(oracle.pose(q, "reflector"), pose_of(after, q), rtol=0, atol=1e-12)
    flange = before.with_values({"a2": 0.6125})
    np.testing.assert_allclose(oracle.pose(q), pose_of(flange, q), rtol=0, atol=1e-12)


def test_identified_robot_predicts_in_pinocchio(tmp_path):
    # Truth: a perturbed UR10. From 60 positions in a tracker frame to a URDF that is right at new readings.
    path, out = written(tmp_path, UR10)
    nominal = read_urdf(path)
    truth = perturbed(nominal, 7)
    rng = np.random.default_rng(7)
    q, new = readings(truth, rng, 60), readings(truth, rng, 20)
    table = {f"q{i + 1}_rad": q[:, i] for i in range(6)}
    positions = np.array([pose_of(truth, row)[:3, 3] for row in q])
    table |= {f"{c}_m": positions[:, k] for k, c in enumerate("xyz")}
    result = identify(nominal, from_table(pd.DataFrame(table), joints=6), method="KM")
    calibrated_urdf(nominal, result.robot, path, out, base="measuring")
    oracle = Oracle(out, "base_link", "tool0")
    errors = [np.linalg.norm(oracle.pose(row)[:3, 3] - pose_of(truth, row)[:3, 3]) for row in new]
    assert max(errors) < 1e-7


def test_nothing_is_written_on_a_fault(tmp_path):
    path, out = written(tmp_path, robot(link("a"), link("b", 1.0), joint("j1", "revolute", "a", "b")))
    arm = read_urdf(path)
    out.write_text("old")
    with pytest.raises(InputError, match=r"turns on joint 'j1' itself; name a new link .* measured_link"):
        calibrated_urdf(arm, arm.with_values({"tool_x": 0.1}), path, out)
    with pytest.raises(InputError, match="'b': a link or joint of this name is there already"):
        calibrated_urdf(arm, arm, path, out, measured_link="b")
    assert out.read_text() == "old"
    assert sorted(f.name for f in tmp_path.iterdir()) == ["in.urdf", "out.urdf"]
    calibrated_urdf(arm, arm.with_values({"tool_x": 0.1}), path, out, measured_link="ball")
    assert Oracle(out, "a", "ball").pose([0.0])[0, 3] == pytest.approx(0.1)


def test_another_robot_is_refused(tmp_path):
    path, out = written(tmp_path, UR10)
    arm = read_urdf(path)
    with pytest.raises(InputError, match="row 3 of robot_before is not that of the file between"):
        calibrated_urdf(arm.with_values({"a2": 0.6}), arm, path, out)
    with pytest.raises(InputError, match="6 joints in the chain, 5 in robot"):
        calibrated_urdf(replace(arm, joints=arm.joints[:5]), arm, path, out)
    assert not out.exists()


@pytest.mark.parametrize("compliance", [None, 1e-6])
def test_a_new_urdf_says_which_springs_it_lacks(compliance: float | None) -> None:
    arm = Robot("arm", (Joint(), Joint(a=0.5, compliance=compliance)))
    said = "The springs of joints 2 have no place in a URDF: the arm is rigid here."
    assert (said in new_urdf(arm)) is bool(compliance)
