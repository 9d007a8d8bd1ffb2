"""Touches, gauges and motions: planted robots are found again, and what such readings leave open is held and said."""

from dataclasses import replace

import arms
import numpy as np
import pytest

from casadical import InputError, Measurements
from casadical.core.transforms import from_rpy
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.identification.misfit import misfit_of
from casadical.identification.sessions import undetermined
from casadical.measurements.kinds.registry import find_kind

FREE = ["kinematic"]
NORMALS = np.array([[0.0, 0.1, 1.0], [1.0, 0.1, 0.2], [0.1, -1.0, 0.1]])
NORMALS /= np.linalg.norm(NORMALS, axis=1)[:, None]
INSIDE = np.array([[0.35, 0.1, 0.25], [0.4, -0.1, 0.4], [0.1, 0.45, 0.35]])


def off_by(size: float = 1.0) -> tuple:
    """A nominal arm and the arm as built, base at the origin of the measuring frame."""
    robot = arms.six_axis()
    return robot, arms.planted(robot, 4, size=size)


def length_errors(found) -> np.ndarray:
    """Identified less planted, over the standard error, of link lengths."""
    _, built = off_by()
    known = zip(found.names, found.estimate, found.standard_errors, strict=True)
    return np.array([(v - built.parameters[n].value) / e for n, v, e in known if n in ("a1", "a2", "a3", "d4")])


def on_planes(built, each: int) -> Measurements:
    """Touches of three planes, at points by chance on each, with noise along all directions."""
    rng, sets = np.random.default_rng(3), []
    for k, (normal, inside) in enumerate(zip(NORMALS, INSIDE, strict=True)):
        across = np.linalg.svd(normal[None])[2][1:]
        goals = inside + rng.uniform(-0.2, 0.2, (each, 2)) @ across
        touched = arms.contacts(built, {str(i): goal for i, goal in enumerate(goals)}, 1, k)
        sets.append(replace(touched, kind="plane", label=np.full(each, f"plane {k}", dtype=object)))
    q = np.concatenate([m.q for m in sets])
    return Measurements(q, "plane", label=np.concatenate([m.label for m in sets]))


def on_balls(built, each: int) -> Measurements:
    rng, sets, radius = np.random.default_rng(5), [], 0.15
    for k, centre in enumerate(INSIDE):
        way = rng.standard_normal((each, 3))
        goals = centre + radius * way / np.linalg.norm(way, axis=1)[:, None]
        touched = arms.contacts(built, {str(i): goal for i, goal in enumerate(goals)}, 1, 10 + k)
        sets.append(replace(touched, label=np.full(each, f"ball {k}", dtype=object)))
    q = np.concatenate([m.q for m in sets])
    label = np.concatenate([m.label for m in sets])
    return Measurements(q, "sphere", label=label, distance=np.full(len(q), radius))


def test_planes_tell_ratios_of_lengths_and_nothing_of_base_and_size() -> None:
    robot, built = off_by()
    found = identify(robot, on_planes(built, 40), FREE)
    reasons = found.identifiability.unidentifiable
    assert "scale" in reasons["a2"]
    assert "whole robot" in reasons["base_x"]
    assert not any(n.startswith("base") for n in found.names)
    assert found.sigmas[0][0] == pytest.approx(arms.NOISE, rel=0.25)
    # Where the planes are, by their unit normals and distances from the origin, but for how the whole robot stands.
    points = np.array([*found.unknown_points.values()])
    normals = points / np.linalg.norm(points, axis=1)[:, None]
    np.testing.assert_allclose(np.abs(normals @ normals.T), np.abs(NORMALS @ NORMALS.T), atol=5e-3)


def test_what_planes_leave_open_is_said_and_no_distance_between_them_is_taken() -> None:
    touched = Measurements(np.zeros((4, 6)), "plane", label=np.array(["A", "A", "B", "B"]))
    (said,) = undetermined([touched], {})
    assert "kind sphere" in said
    with pytest.raises(InputError, match="kind 'plane' has no points whose distance could be known"):
        touched.with_separations([("A", "B", 0.1)])


def test_balls_of_known_radius_tell_the_size() -> None:
    robot, built = off_by()
    found = identify(robot, on_balls(built, 40), FREE)
    assert not any("scale" in why for why in found.identifiability.unidentifiable.values())
    assert found.sigmas[0][0] == pytest.approx(arms.NOISE, rel=0.25)
    assert np.abs(length_errors(found)).max() < 4


def test_gauges_along_known_axes_find_the_base_too() -> None:
    robot, built = off_by()
    q = arms.readings(built, 240, 8)
    which, noise = np.arange(240) % 3, arms.NOISE * np.random.default_rng(9).normal(size=240)
    reading = (arms.points(built, q) * NORMALS[which]).sum(axis=1) + noise
    found = identify(robot, Measurements(q, "dial", extra={"reading": reading, "axis": NORMALS[which]}), FREE)
    assert {"base_x", "base_y", "base_z"} <= set(found.names)
    assert np.abs(length_errors(found)).max() < 4


def test_motions_from_pose_to_pose_find_the_arm_and_not_its_base() -> None:
    robot, built = off_by()
    rng, q = np.random.default_rng(2), arms.readings(built, 121, 8)
    p, R = predicted(built, arms.bare(q))
    shift = np.einsum("nji,nj->ni", R[:-1], p[1:] - p[:-1]) + arms.NOISE * rng.normal(size=(120, 3))
    turn = np.einsum("nji,njk->nik", R[:-1], R[1:]) @ np.stack([from_rpy(v) for v in 1e-4 * rng.normal(size=(120, 3))])
    m = Measurements(q[1:], "relative_pose", other=q[:-1], extra={"shift": shift, "turn": turn})
    found = identify(robot, m, FREE)
    assert np.abs(length_errors(found)).max() < 4
    assert not any(n.startswith("base") for n in found.names)


def test_places_of_wires_in_one_table_are_found_by_their_names() -> None:
    robot, built = off_by()
    q = arms.readings(built, 150, 8)
    far = np.array([[1.5, 0.2, 0.3], [-0.8, 1.4, 0.9], [-0.5, -1.6, 1.5]])
    which = np.arange(150) % 3
    length = np.linalg.norm(arms.points(built, q) - far[which], axis=1)
    length += arms.NOISE * np.random.default_rng(1).normal(size=150)
    label = np.array(["left", "right", "behind"], dtype=object)[which]
    found = identify(robot, Measurements(q, "distance", distance=length, label=label), FREE)
    assert 1 <= misfit_of(found) < 1.5  # of noise alone
    assert not [*undetermined(found.measurements, found.unknown_points)]  # three places, not in line
    where = np.array([found.unknown_points[f"0/{name}"] for name in ("left", "right", "behind")])
    apart = [np.linalg.norm(where[i] - where[j]) for i, j in ((0, 1), (1, 2), (0, 2))]
    assert apart == pytest.approx([np.linalg.norm(far[i] - far[j]) for i, j in ((0, 1), (1, 2), (0, 2))], abs=2e-3)
    assert np.abs(length_errors(found)).max() < 4


def test_a_radius_in_another_unit_is_told() -> None:
    sphere = find_kind("sphere")
    said = [sphere.unit_fault({"distance": np.array([0.02, r])}, np.zeros((2, 3)), None, 0.9) for r in (0.03, 30.0)]
    assert said[0] == ""
    assert said[1].startswith("a radius of 30 m does not fit the robot, which reaches 0.9 m")
