"""Planted truths are found again, from every kind of measurement and from mixtures."""

from dataclasses import replace

import arms
import numpy as np
import pytest

from casadical import InputError, Placement, identify
from casadical.core.transforms import frame, from_rpy, from_xyz
from casadical.identification.placement import FrameEstimate, PlacementProblem, Readings, place_frames, solve_placement
from casadical.measurements.measurements import Measurements

# Frames known, so that the planted parameters can be compared one by one.
FIXED = arms.six_axis(base=arms.Placement(arms.TRACKER), tool=arms.Placement(arms.six_axis().tool.T))
POINT = np.array([2.4, -2.9, 0.2])
FREE = ("alpha*", "a*", "beta*", "theta*", "d*")


def compare(result, built):
    """Estimates agree with the truth within their standard errors, all together and one by one."""
    assert result.is_optimal()
    assert 0.3 < arms.chi2_per_parameter(result, built) < 2.2
    truth = np.array([built.parameters[n].value for n in result.names])
    assert np.abs((result.estimate - truth) / result.standard_errors).max() < 4.5


def identified_by(make, seed):
    """Truth planted in those parameters that this kind of data can tell, found by a first run on the nominal robot."""
    names = identify(FIXED, make(FIXED), FREE).names
    built = arms.planted_in(FIXED, names, seed)
    return identify(FIXED, make(built), FREE), built


@pytest.mark.parametrize("kind", ["position", "pose", "known point", "unknown point", "pair"])
def test_each_kind_recovers_the_planted_parameters(kind):
    q, other = arms.readings(FIXED, 120, 1), arms.readings(FIXED, 120, 2)
    make = {
        "position": lambda robot: arms.positions(robot, q, 3),
        "pose": lambda robot: arms.poses(robot, q, 3),
        "known point": lambda robot: arms.distances(robot, q, POINT, 3, known=True),
        "unknown point": lambda robot: arms.distances(robot, q, POINT, 3),
        "pair": lambda robot: arms.pair_distances(robot, q, other, 3),
    }[kind]
    result, built = identified_by(make, 4)
    # All 24 rows' numbers; one turn about the known point is not seen; else no motion of the whole robot is.
    expected = {"position": 24, "pose": 24, "known point": 23, "unknown point": 20, "pair": 20}[kind]
    assert len(result.names) == expected
    compare(result, built)
    assert result.sigmas[0][0] == pytest.approx(arms.NOISE, rel=0.25)
    if kind == "pose":
        assert result.sigmas[0][1] == pytest.approx(1e-4, rel=0.15)


def test_frames_and_geometry_together_reach_the_noise_floor():
    robot = arms.six_axis()
    built = arms.planted(robot, 7, arms.TRACKER)
    result = identify(robot, arms.positions(built, arms.readings(built, 60, 8), 9), ["kinematic"])
    assert len(result.names) == 27
    floor = np.sqrt(np.trace(result.predict(arms.readings(built, 300, 99))[1], axis1=1, axis2=2).mean())
    assert arms.model_error(result.robot, built) < 1.8 * floor
    assert floor < 2 * arms.NOISE
    assert result.accuracy(arms.positions(built, arms.readings(built, 40, 10), 11))["placed"].mean > 1e-3


def test_mixed_kinds_with_unknown_sigmas():
    q, far = arms.readings(FIXED, 80, 1), arms.readings(FIXED, 200, 2)

    def make(robot):
        return (arms.positions(robot, q, 3, sigma=1e-4), arms.distances(robot, far, POINT, 4, sigma=1e-5))

    names = identify(FIXED, make(FIXED), FREE).names
    built = arms.planted_in(FIXED, names, 5)
    result = identify(FIXED, make(built), FREE)
    compare(result, built)
    coordinate, length = (s[0] for s in result.sigmas)
    assert coordinate == pytest.approx(1e-4, rel=0.15)
    assert length == pytest.approx(1e-5, rel=0.15)
    # The accurate distances count: far more is known than from the positions alone.
    alone = identify(FIXED, make(built)[0], FREE)
    shared = [n for n in result.names if n in alone.names]
    gain = [alone.standard_errors[alone.names.index(n)] / result.standard_errors[result.names.index(n)] for n in shared]
    assert np.median(gain) > 2


def test_contact_takes_its_scale_from_the_separations_alone():
    robot = arms.six_axis()
    built = robot.with_values({p.name: 1.004 * p.value for p in robot.parameters if p.unit == "m"})  # 4 mm in a metre
    corners = np.array([[0.5, 0.2, 0.3], [0.3, 0.55, 0.4], [-0.4, 0.4, 0.35], [0.35, -0.5, 0.5]])
    touched = arms.contacts(built, dict(zip("ABCD", corners, strict=True)), 30, 1)
    apart = [("A", "B"), ("A", "C"), ("C", "D")]
    place = dict(zip("ABCD", corners, strict=True))
    known = touched.with_separations((i, j, float(np.linalg.norm(place[i] - place[j]))) for i, j in apart)

    with_scale = identify(robot, known, ["kinematic"])
    a2 = with_scale.names.index("a2")
    assert with_scale.estimate[a2] == pytest.approx(1.004 * 0.5, abs=4 * with_scale.standard_errors[a2])
    assert with_scale.standard_errors[a2] < 1e-4

    without = identify(robot, touched, ["kinematic"])
    reasons = without.identifiability.unidentifiable
    assert "scale" in reasons["a2"]  # the longest link
    assert len(without.names) == len(with_scale.names) - 1
    lengths = {n: v for n, v in zip(without.names, without.estimate, strict=True) if n in ("d4", "a3", "tool_z")}
    for name, value in lengths.items():
        assert value == pytest.approx(robot.parameters[name].value, abs=3e-4)  # in units of a2: the true ratios
    assert not any(n.startswith("base") for n in without.names)
    assert "whole robot" in reasons["base_rx"]


@pytest.mark.parametrize("seed", range(1))
def test_prismatic_joint(seed):
    robot = arms.with_rail(arms.six_axis())
    built = arms.planted(robot, seed, arms.TRACKER)
    q = arms.readings(built, 150, 20 + seed)
    result = identify(robot, arms.positions(built, q, seed), ["kinematic"])
    # 4 numbers a turning joint, 2 for the rail's direction, 6 for the base, less 3 of the tool's orientation
    assert len(result.names) == 4 * 6 + 2 + 6 - 3
    assert result.is_optimal()
    assert arms.model_error(result.robot, built) < 1.2 * arms.NOISE


def test_skewed_parallel_axes_give_the_same_set_again():
    """Axes 1 to 3 nearly parallel, off by milliradians: no d is told from one ten-thousandth of a lever."""
    rows = [
        (0.0, 0.0, 0.3),
        (0.0, 0.35, 0.0),
        (0.0, 0.3, 0.1),
        (arms.RIGHT, 0.1, 0.2),
        (-arms.RIGHT, 0, 0),
        (arms.RIGHT, 0, 0.1),
    ]
    joints = tuple(arms.Joint(alpha=alpha, a=a, d=d, lower=-2.6, upper=2.6) for alpha, a, d in rows)
    robot = arms.six_axis(joints=joints)
    built = arms.planted(robot, 11, arms.TRACKER)
    m = arms.positions(built, arms.readings(built, 80, 12), 13)
    once = identify(robot, m, ["kinematic"])
    assert len(once.names) == 27
    assert not {"d1", "d2", "d3"} & set(once.names)
    assert identify(once.robot, m, ["kinematic"]).names == once.names


def test_place_with_full_poses_finds_the_tool_s_orientation():
    robot = arms.six_axis(tool=replace(arms.six_axis().tool, unknown="pose"))
    tool = frame(from_rpy(np.array([0.3, -1.2, 2.0])), np.array([0.02, 0.1, 0.15]))
    built = replace(robot, base=replace(robot.base, T=arms.TRACKER), tool=replace(robot.tool, T=tool))
    m = arms.poses(built, arms.readings(built, 20, 1), 0, sigma=0, sigma_angle=0)
    placed = place_frames(robot, m)
    assert np.allclose(placed.tool.T, tool, rtol=0, atol=1e-10)
    result = identify(robot, arms.poses(built, m.q, 2), ["placement"])
    assert set(result.names) == {f"{w}_{c}" for w in ("base", "tool") for c in ("x", "y", "z", "rx", "ry", "rz")}


def test_place_with_compliance_and_a_tilted_frame():
    """Gravity known in the measuring frame: the start is turned with it."""
    body = arms.Body(15.0, np.array([0.2, 0.02, 0.01]))
    joints = tuple(replace(j, compliance=3e-5, body=body) for j in arms.six_axis().joints)
    robot = arms.six_axis(joints=joints, gravity=np.array([9.8, 0, 0]))
    T = frame(from_rpy(np.array([0, np.pi / 2, 0])) @ from_rpy(np.array([0, 0, np.pi])), np.array([1.0, 2.0, 3.0]))
    built = replace(robot, base=replace(robot.base, T=T))
    placed = place_frames(robot, arms.positions(built, arms.readings(built, 30, 1), 0, sigma=0))
    assert np.allclose(placed.base.T, T, rtol=0, atol=1e-6)


ARM = arms.six_axis()
BASE = frame(from_xyz([0.4, -0.2, 1.1]), [1.5, -0.7, 0.3])
TOOL = np.array([0.05, -0.02, 0.15])


def path(turns: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flange, its orientation, which departs from one by so much [rad], and measured points of an uncalibrated arm."""
    rng = np.random.default_rng(seed)
    s = np.linspace(-1, 1, 120)
    p = np.array([0.8, 0.1, 0.5]) + 0.3 * s[:, None] * np.array([0.6, 0.8, 0.0]) + 0.1 * np.cos(3 * s)[:, None]
    waves = np.stack([np.sin(2 * s), np.cos(3 * s), s**2], axis=1)
    R = np.array([from_xyz(turns * w) for w in waves])
    # What the nominal model does not know of, smooth along the path.
    wrong = 2e-3 * np.stack([np.sin(1.5 * s), np.cos(2 * s), np.sin(2.5 * s)], axis=1)
    flange = p + wrong + rng.normal(0, 3e-5, p.shape)
    return p, R, (flange + R @ TOOL) @ BASE[:3, :3].T + BASE[:3, 3]


def test_one_orientation_leaves_the_tool_where_the_file_has_it() -> None:
    p, R, y = path(1e-3)
    file = np.add(TOOL, [0.012, -0.012, 0.0105])
    plain = solve_placement(p, R, y, None, np.eye(4), file)[1]
    assert np.linalg.norm(plain - TOOL) > 0.2  # what least squares make of it
    held = PlacementProblem([Readings(p, R, y)], np.eye(4), file, tool_fixed=False)
    start = FrameEstimate(*(solve_placement(p, R, y, file, np.eye(4), file)[0][:3, c] for c in (slice(3), 3)), file)
    assert not held.determined(start)
    found = held.best([start])
    assert np.linalg.norm(found.t - TOOL) < 0.05
    left = (p + R @ found.t) @ found.R.T + found.p - y
    assert np.linalg.norm(left, axis=1).max() < 0.01


def test_many_orientations_free_the_tool_of_the_file() -> None:
    p, R, y = path(1.0)
    held = PlacementProblem([Readings(p, R, y)], np.eye(4), np.zeros(3), tool_fixed=False)
    T, t = solve_placement(p, R, y, None, np.eye(4), np.zeros(3))
    assert held.determined(FrameEstimate(T[:3, :3], T[:3, 3], t))
    np.testing.assert_allclose(held.best([FrameEstimate(T[:3, :3], T[:3, 3], t)]).t, TOOL, atol=5e-3)


def test_distances_to_three_known_points_place_the_base() -> None:
    built = arms.planted(ARM, 4)
    q = arms.readings(built, 40, 3)
    measured = arms.positions(built, q, 0, sigma=0.0)
    assert measured.position is not None
    y = measured.position @ BASE[:3, :3].T + BASE[:3, 3]
    anchors = np.array([[3.0, 0.2, 0.1], [0.1, 2.5, 1.0], [-0.5, -2.0, 2.0]])
    sets = [
        Measurements(q, "distance", distance=np.linalg.norm(y - a, axis=1), target=np.tile(a, (len(q), 1)))
        for a in anchors
    ]
    placed = place_frames(ARM, sets)
    stood = BASE @ built.base.T
    np.testing.assert_allclose(placed.base.T[:3, 3], stood[:3, 3], atol=0.02)
    np.testing.assert_allclose(placed.base.T[:3, :3], stood[:3, :3], atol=0.02)


@pytest.mark.parametrize("poses", [2, 3, 4])
def test_few_poses_place_the_base_by_the_files_tool(poses: int) -> None:
    q = arms.readings(ARM, poses, 1)
    m = arms.positions(ARM, q, 0, sigma=0.0)
    placed = place_frames(ARM, m)
    assert np.linalg.norm(placed.tool.T[:3, 3] - ARM.tool.T[:3, 3]) < 0.05


def test_lists_are_taken_as_arrays_and_known_frames_are_named_where_nothing_fits() -> None:
    robot = arms.six_axis(base=Placement(np.eye(4)))
    moved = arms.planted(robot, 5, arms.TRACKER)
    q = arms.readings(robot, 40, 6)
    position = arms.positions(moved, q, 7).position
    with pytest.raises(InputError, match=r'known here: base; unknown = "pose" or "position" has them fitted'):
        identify(robot, Measurements(q.tolist(), "position", position=position.tolist()))
    with pytest.raises(InputError, match=r"are these degrees\? readings of joints that turn are in rad"):
        identify(robot, Measurements(np.degrees(q), "position", position=position))
    with pytest.raises(InputError, match="table: q is no array of numbers"):
        Measurements([["a", "b"]], "position", position=position)
