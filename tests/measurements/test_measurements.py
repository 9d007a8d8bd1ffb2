"""Measurements: units by name, kinds by their columns, named and disjoint splits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from casadical import InputError, Measurements, from_table, read_measurements
from casadical.measurements.arrangement import _target_names
from casadical.measurements.kinds.distance import distance_fault
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.measurements import Noise, same_readings
from casadical.measurements.reading import refuse_shared_rows
from casadical.project.problem_file import SetsTable


def readings(n, joints=2, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, joints))


def positions(q):
    return Measurements(q=q, kind="position", position=np.arange(3.0 * len(q)).reshape(-1, 3))


def keys(m):
    return {row.tobytes() for row in m.q}


def test_units_are_read_from_the_names():
    t = pd.DataFrame(
        {
            "q1_deg": [90.0, 180.0],
            "q2_rad": [0.5, 1.0],
            "q3_mm": [250.0, 300.0],
            "x_mm": [1.0, 2],
            "y_m": [3.0, 4],
            "z_mm": [5.0, 6],
        }
    )
    m = from_table(t, ["revolute", "revolute", "prismatic"], sigma_mm=0.02)
    assert np.allclose(m.q, [[np.pi / 2, 0.5, 0.25], [np.pi, 1.0, 0.3]])
    assert np.allclose(m.position, [[1e-3, 3, 5e-3], [2e-3, 4, 6e-3]])
    assert m.sigma == pytest.approx(2e-5)
    assert m.kind == "position"


def test_a_file_s_own_names(tmp_path):
    path = tmp_path / "mine.csv"
    pd.DataFrame({" A1 ": [10.0, 20], "X": [1.0, 2], "Y": [3.0, 4], "Z": [5.0, 6]}).to_csv(path, index=False)
    m = read_measurements(path, 1, columns={"q1_deg": "A1", "x_mm": "X", "y_mm": "Y", "z_mm": "Z"})
    assert np.allclose(np.rad2deg(m.q.ravel()), [10, 20])
    assert m.row.tolist() == [2, 3]
    assert m.source == "mine.csv"


@pytest.mark.parametrize("form", ["angles", "radians", "matrix", "quaternion"])
def test_orientations_against_scipy(form):
    R = Rotation.random(6, random_state=3)
    angles = R.as_euler("XYZ")  # intrinsic x-y-z
    columns = {
        "angles": dict(zip(("rx_deg", "ry_deg", "rz_deg"), np.rad2deg(angles).T, strict=True)),
        "radians": dict(zip(("rx_rad", "ry_rad", "rz_rad"), angles.T, strict=True)),
        "matrix": {f"R{i}{j}": R.as_matrix()[:, i, j] for i in range(3) for j in range(3)},
        "quaternion": dict(zip(("qx", "qy", "qz", "qw"), R.as_quat().T, strict=True)),
    }[form]
    t = pd.DataFrame({"q1_deg": np.arange(6.0) * 10, "x_mm": np.arange(6.0), "y_mm": 0.0, "z_mm": 0.0} | columns)
    m = from_table(t, 1)
    assert m.kind == "pose"
    assert np.allclose(m.orientation, R.as_matrix(), atol=1e-12)


def test_every_other_column_is_a_condition():
    t = pd.DataFrame(
        {"pose": [1, 2], "time_s": [0.0, 9], "approach1": [-1, 1], "payload_kg": [2.0, 3], "quality": [1.0, 0.9],
         "remark": ["a", "b"], "void": [None, None], "q1_deg": [1.0, 2], "x_mm": [1.0, 2], "y_mm": [1.0, 2],
         "z_mm": [1.0, 2], "weight": [1.0, 2], "set": ["a", "b"]}
    )  # fmt: skip
    m = from_table(t, 1)
    assert set(m.conditions) == {"pose", "time_s", "approach1", "payload_kg", "quality"}
    assert m.weight.tolist() == [1, 2]
    matrix = m.condition_matrix(["payload_kg", "temperature_degC"], np.array([9.0, 20.0]))
    assert matrix.tolist() == [[2, 20], [3, 20]]


def test_points_are_named_by_the_columns_that_are_given(tmp_path):
    path = tmp_path / "touched.csv"
    path.write_text("q1_deg,plate,hole\n1,front,1\n2,front,2\n3,back,1\n4,front,1\n5,back,1\n6,front,2\n")
    m = read_measurements(path, 1, point_from=["plate", "hole"])
    assert (m.kind, [*m.label]) == ("contact", ["front/1", "front/2", "back/1", "front/1", "back/1", "front/2"])


def test_pairs_take_the_readings_of_the_other_pose():
    t = pd.DataFrame({"pose": [5, 6, 7], "other_pose": [7, 5, 6], "q1_deg": [10.0, 20, 30], "distance_mm": [1.0, 2, 3]})
    m = from_table(t, 1)
    assert m.kind == "pair_distance"
    assert np.allclose(np.rad2deg(m.other.ravel()), [30, 10, 20])


def test_a_part_keeps_its_rows_and_conditions():
    m = from_table(
        pd.DataFrame(
            {
                "q1_deg": np.arange(5.0) * 9,
                "payload_kg": np.arange(5.0),
                "x_mm": np.arange(5.0),
                "y_mm": 0.0,
                "z_mm": 0.0,
            }
        ),
        1,
    )
    for part in (m[[1, 4]], m[np.array([False, True, False, False, True])], m[1::3]):
        assert part.row.tolist() == [3, 6]
        assert part.conditions["payload_kg"].tolist() == [1, 4]
    assert len(m[2]) == 1


def test_split_is_disjoint_seeded_and_of_the_asked_sizes():
    m = positions(readings(100))
    sizes = {"identify": 40, "train": 0.25, "choose": 5, "report": 0.3}
    sets = m.split(sizes, seed=3)
    assert [len(s) for s in sets.values()] == [40, 25, 5, 30]
    assert len(set().union(*(keys(s) for s in sets.values()))) == 100
    again = m.split(sizes, seed=3)
    assert all(np.array_equal(sets[name].row, again[name].row) for name in sizes)
    assert not np.array_equal(sets["identify"].row, m.split(sizes, seed=4)["identify"].row)


def test_shares_that_add_up_to_one_use_every_pose():
    for n in (3, 7, 10, 101):
        sets = positions(readings(n)).split({"identify": 0.5, "report": 0.5}, seed=n)
        assert sum(len(s) for s in sets.values()) == n
        (whole,) = positions(readings(n)).split(SetsTable(identify=1).sizes()).values()
        assert len(whole) == n


@settings(max_examples=60, deadline=None)
@given(copies=st.lists(st.integers(1, 4), min_size=4, max_size=25), seed=st.integers(0, 99), share=st.floats(0.2, 0.8))
def test_replicates_stay_together(copies, seed, share):
    q = np.repeat(readings(len(copies), seed=seed), copies, axis=0)
    q = q + 1e-8 * np.random.default_rng(1).normal(size=q.shape)  # an encoder's last digit
    try:
        sets = positions(q).split({"identify": share, "report": 1 - share}, seed)
    except InputError:  # so few readings that a set was left empty
        return
    source = np.repeat(np.arange(len(copies)), copies)
    first, second = ({int(source[k]) for k in s.row} for s in sets.values())
    assert not first & second
    assert len(first | second) == len(copies)
    assert sum(len(s) for s in sets.values()) == len(q)


def test_pairs_across_two_sets_are_left_out():
    q = readings(60)
    m = Measurements(q=q, kind="pair_distance", distance=np.ones(60), other=np.roll(q, -1, axis=0))
    sets = m.split({"identify": 0.6, "report": 0.4}, seed=1)
    ends = [keys(s) | {row.tobytes() for row in s.other} for s in sets.values()]
    assert not ends[0] & ends[1]
    assert 20 < sum(len(s) for s in sets.values()) < 60
    apart = replace(m, other=readings(60, seed=1) + 4).split({"identify": 0.3, "report": 0.3}, seed=1)
    assert all(len(s) > 0 for s in apart.values())  # no pose is an end of two pairs


def test_the_docs_list_every_kind_as_it_describes_itself():
    page = (Path(__file__).parents[2] / "docs" / "measurements.md").read_text()
    table = page[page.index("| kind | columns") :].partition("\n\n")[0].splitlines()[2:]
    assert table == [f"| `{kind.name}` | {kind.columns} | {kind.unknown} |" for kind in kinds().values()]


def test_columns_of_another_kind_are_no_conditions():
    t = pd.DataFrame(
        {"q1_deg": [1.0, 2], "x_mm": [1.0, 2], "y_mm": [3.0, 4], "z_mm": [5.0, 6], "distance_mm": [1.0, 2]}
    )
    t = t.assign(qw=[1.0, 0], point=[1.0, 2], position=[7.0, 8])
    m = from_table(t, 1, "position")
    assert list(m.conditions) == ["position"]
    assert m.conditions["position"].tolist() == [7, 8]


def test_poses_of_one_position_that_differ_in_orientation_are_no_copies():
    t = pd.DataFrame({"q1_deg": [1.0, 1], "x_mm": [1.0, 1], "y_mm": [3.0, 3], "z_mm": [5.0, 5], "rx_deg": [0.0, 1.0]})
    assert len(from_table(t.assign(ry_deg=0.0, rz_deg=0.0), 1)) == 2
    once = from_table(t.assign(rx_deg=0.0, ry_deg=0.0, rz_deg=0.0), 1)
    assert (len(once), once.copies) == (1, (3,))
    assert "row 3 repeats another to the last digit and is counted once" in once.copies_in_words


def test_copied_rows_are_counted_once_and_said() -> None:
    rng = np.random.default_rng(1)
    t = pd.DataFrame(rng.normal(size=(6, 4)), columns=["q1_deg", "x_mm", "y_mm", "z_mm"])
    m = from_table(pd.concat([t, t.iloc[[4, 1]]]), 1)
    plain = from_table(t, 1)
    np.testing.assert_array_equal(m.position, plain.position)
    np.testing.assert_array_equal(m.row, plain.row)
    assert m.copies == (8, 9)
    assert "rows 8, 9 repeat another to the last digit and are counted once" in m.copies_in_words
    assert (plain.copies, plain.copies_in_words) == ((), "")


def test_positions_with_a_covariance_each_weigh_by_it() -> None:
    """Whitened residuals of noise drawn from the covariances are white; a matrix that is none is refused by row."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(4000, 3, 3)) * 1e-4
    C = A @ A.transpose(0, 2, 1) + 1e-9 * np.eye(3)
    noise = (np.linalg.cholesky(C) @ rng.normal(size=(4000, 3, 1)))[:, :, 0]
    table = pd.DataFrame({"q1_deg": rng.uniform(-90, 90, 4000), **dict.fromkeys(("x_mm", "y_mm", "z_mm"), 0.0)})
    pairs = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
    for name, (i, j) in pairs.items():
        table[f"cov_{name}_mm2"] = 1e6 * C[:, i, j]
    m = from_table(table, 1)
    assert m.kind == "position_covariance"
    white = (m.extra["whitening"] @ noise[:, :, None])[:, :, 0]
    sigma = np.sqrt(np.trace(C, axis1=1, axis2=2).mean() / 3)
    np.testing.assert_allclose(np.cov(white.T), sigma**2 * np.eye(3), atol=0.06 * sigma**2)
    table.loc[7, "cov_xx_mm2"] = -1.0
    with pytest.raises(InputError, match=r"row 9, columns cov_xx_mm2 to cov_zz_mm2: no covariance"):
        from_table(table, 1)


def test_readings_so_dense_that_no_gap_separates_them_are_not_one() -> None:
    q = np.random.default_rng(3).uniform(-1, 1, (5000, 2))
    q = np.concatenate([q, q[:100] + 1e-7])
    found = same_readings(q, 5e-3)
    sizes = np.bincount(found)
    assert sizes.max() < 40  # a cell is 0.1 x 0.1 of 2 x 2
    assert np.mean(found[5000:] == found[:100]) > 0.97


def test_a_separation_is_kept_only_with_both_its_points() -> None:
    m = Measurements(q=np.zeros((4, 2)), kind="contact", label=np.array(list("ABBC"), dtype=object))
    m = m.with_separations([("A", "B", 0.1), ("C", "B", 0.2)])
    assert m.residuals == 3 * 4 + 2
    assert m[1:].separations == (("C", "B", 0.2),)
    assert m[:3].separations == (("A", "B", 0.1),)
    assert m[[0, 3]].separations == ()


@pytest.mark.parametrize(("sigma", "repeatability"), [(0.0, 0.0), (-1e-5, 0.0), (1e-5, -1e-6), (0.0, 1e-5)])
def test_noise_that_cannot_be_is_refused(sigma: float, repeatability: float) -> None:
    with pytest.raises(InputError, match="allowed: above zero, and zero or more"):
        Noise(sigma, repeatability)
    assert Noise(1e-5, 0.0).sigma == 1e-5


@pytest.mark.parametrize(("times", "word"), [(100.0, ""), (101.0, "distance_mm"), (0.0101, ""), (0.0099, "distance_m")])
def test_a_distance_of_another_unit_is_told_by_a_factor_beyond_a_hundred(times: float, word: str) -> None:
    p = np.zeros((5, 3))
    far = np.tile([0.0, 0.0, 1.0], (5, 1))
    told = distance_fault({"distance": np.full(5, times)}, p, far, 1.5)
    assert told.endswith(f"should the column be named {word}?") if word else told == ""


@pytest.mark.parametrize("kind", ["position", "contact"])
def test_tables_that_share_half_of_their_poses_are_refused(kind):
    q = np.arange(24.0).reshape(8, 3) / 10
    seen = {"position": q + 1} if kind == "position" else {"label": np.array(["a", "b"] * 4)}

    def part(rows):
        return Measurements(q[rows], kind, source=f"{rows[0]}.csv", **{name: v[rows] for name, v in seen.items()})

    refuse_shared_rows([part([0, 1, 2, 3]), part([4, 5, 6]), part([7, 0])][:2])
    for other in ([0, 1, 2, 3], [7, 0], [5, 6, 2, 3, 7]):
        with pytest.raises(InputError, match=r"poses are in 0\.csv, too; a pose counts once: take one"):
            refuse_shared_rows([part([0, 1, 2, 3]), part(other)])
    if kind == "contact":  # another point at the same readings is another pose
        refuse_shared_rows([part([0, 1]), Measurements(q[:2], kind, label=np.array(["b", "a"]))])


def test_targets_are_named_by_the_words_that_their_headings_do_not_share() -> None:
    assert _target_names([{"ball", "left"}, {"ball", "right"}]) == ["left", "right"]
    assert _target_names([{"ball", "1"}, {"ball", "2"}]) == ["target1", "target2"]
    assert _target_names([{"ball"}, {"ball", "b"}]) == ["target1", "b"]
    assert _target_names([{"ball"}, {"ball"}]) == ["target1", "target2"]
    assert _target_names([{"ball", "2"}, {"ball"}]) == ["target1", "target2"]


def test_a_condition_that_is_not_finite_is_refused_behind_names_too() -> None:
    m = Measurements(np.zeros((3, 1)), "contact", label=np.array(["a", "a", "b"]))
    with pytest.raises(InputError, match="row 1: payload_kg is nan; only finite numbers are allowed"):
        replace(m, conditions={"payload_kg": np.array([1.0, np.nan, 2.0])})
