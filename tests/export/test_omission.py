"""What an export cannot carry: how much would be lost, in words and numbers."""

from dataclasses import replace

import numpy as np
import pytest
from bench import robot

from casadical import InputError, Robot
from casadical.effects import Backlash, Effect, FrameDrift, JointScale, LinkFlexure, ThermalGrowth
from casadical.effects.base import Omission
from casadical.export.mjcf.mjcf import mjcf
from casadical.export.omission import displacement_without, distance_from_rigid, left_out, rigid_omissions
from casadical.robot.robot import Knowledge


def with_values(name: str, *effects: Effect, **values: float) -> Robot:
    return robot(name).with_effect(*effects).with_values({k.replace("__", "."): v for k, v in values.items()})


def test_loss_is_how_far_the_point_moves_over_the_learnt_range() -> None:
    r = with_values("ur10e", JointScale(1), **{"joint_scale@1__k": 1e-4})
    ranges = np.array([(j.lower, j.upper) for j in r.joints])
    ranges[0] = (0.5, 1.0)
    r = replace(r, knowledge=Knowledge(readings=ranges))
    mean, greatest = displacement_without(r, ["joint_scale@1.k"])
    # Worked out by turning joint 1 itself, at other poses of the same range.
    q = np.random.default_rng(7).uniform(*ranges.T, (4000, 6))
    turned = q.copy()
    turned[:, 0] *= 1 + 1e-4
    f, phi = robot("ur10e").position.map(len(q)), robot("ur10e").parameters.values
    moved = np.linalg.norm((f(turned.T, phi) - f(q.T, phi)).full(), axis=0)
    assert mean == pytest.approx(moved.mean(), rel=0.05)
    assert greatest == pytest.approx(moved.max(), rel=0.1)
    assert displacement_without(replace(r, knowledge=None), ["joint_scale@1.k"])[1] > 2 * greatest


def test_what_a_rigid_file_leaves_is_the_springs_and_effects_together() -> None:
    values = {"joint_scale@1__k": 1e-4, "frame_drift__x": 1e-3}
    r = with_values("ur10e", JointScale(1), FrameDrift(), ThermalGrowth(2), **values)
    ranges = np.array([(j.lower, j.upper) for j in r.joints])
    ranges[0] = (0.5, 1.0)
    r = replace(r, knowledge=Knowledge(readings=ranges))
    # Worked out by turning joint 1 of the compliant robot, against the rigid one, at other poses of the same range.
    soft = robot("ur10e")
    stiff = replace(soft, joints=tuple(replace(j, compliance=None) for j in soft.joints))
    q = np.random.default_rng(7).uniform(*ranges.T, (4000, 6))
    turned = q.copy()
    turned[:, 0] *= 1 + 1e-4
    far = [x.position.map(len(q))(at.T, x.parameters.values).full() for x, at in ((soft, turned), (stiff, q))]
    moved = np.linalg.norm(far[0] - far[1], axis=0)
    known = r.with_only(e for e in r.effects if e.label != ThermalGrowth(2).label)
    mean, most = distance_from_rigid(known)
    assert mean == pytest.approx(moved.mean(), rel=0.05)
    assert most == pytest.approx(moved.max(), rel=0.1)
    first, second = rigid_omissions(r)
    assert first.startswith("compliance of joints ")
    assert "joint_scale@1, frame_drift: without them the point is off by " in first
    assert f"{1e3 * mean:.4f} mm on average" in first
    assert "what would be lost is unknown, for the robot file gives no range of warmth_600s" in second
    assert rigid_omissions(stiff) == ()


def test_poses_in_which_a_loop_does_not_close_are_none() -> None:
    mean, greatest = displacement_without(
        with_values("hh800", Backlash(5), **{"backlash@5__half": 5e-5}), ["backlash@5.half"]
    )
    assert 0 < mean < greatest < 1e-3


def test_effects_are_refused_by_name_with_what_is_lost() -> None:
    r = with_values("ur10e", Backlash(2), FrameDrift(), **{"backlash@2__half": 5e-5, "frame_drift__x": 1e-4})
    omissions = [Omission("backlash@2", "no place"), Omission("frame_drift", "of the instrument")]
    with pytest.raises(InputError) as error:
        left_out(r, omissions, "a book", leave_out=False)
    mean, greatest = displacement_without(r, ["backlash@2.half"])
    for words in (
        "a book cannot hold 1 of its effects",
        f"backlash@2: no place; lost without it: {1e3 * mean:.4f} mm on average, {1e3 * greatest:.4f} mm at most",
        "over the range of the joints",
        "--leave-out",
    ):
        assert words in str(error.value)
    assert "frame_drift" not in str(error.value)  # no loss to the robot
    lines = left_out(r, omissions, "a book", leave_out=True)
    assert [line.partition(":")[0] for line in lines] == ["backlash@2", "frame_drift"]
    assert left_out(r, omissions[1:], "a book", leave_out=False) == ("frame_drift: of the instrument",)


def test_loss_with_an_unknown_temperature_is_not_made_up() -> None:
    r = with_values("ur10e", ThermalGrowth(None, 0.0), thermal_growth__alpha=12e-6)
    (line,) = left_out(r, [Omission("thermal_growth", "no sensor")], "C", leave_out=True)
    assert line.endswith("what would be lost is unknown, for the robot file gives no range of warmth_0s")
    r = replace(r, knowledge=Knowledge(conditions={"warmth_0s": (-5.0, 5.0)}))
    (line,) = left_out(r, [Omission("thermal_growth", "no sensor")], "C", leave_out=True)
    assert "mm on average" in line


def test_of_an_effect_that_is_carried_in_part_only_the_rest_is_lost() -> None:
    whole = {"link_flexure__rx2": 5e-5, "link_flexure__ry2": -1e-5, "link_flexure__rz2": 5e-5}
    r = with_values("ur10e", LinkFlexure(None, 2), **whole)
    (omission,) = mjcf(r).omitted
    assert omission.parts == ("ry2",)
    (line,) = left_out(r, [omission], "a MuJoCo model", leave_out=True)
    assert f"{1e3 * displacement_without(r, ['link_flexure.ry2'])[0]:.4f} mm on average" in line
    assert (
        displacement_without(r, ["link_flexure.ry2"])[0]
        < 0.5 * displacement_without(r, [k.replace("__", ".") for k in whole])[0]
    )
