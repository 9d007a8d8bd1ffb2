"""Searches against all sets of a tiny problem; updates against computing anew; an order of short travel."""

from itertools import combinations, pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from casadical import InputError, read_robot
from casadical.core.statistics import thirds
from casadical.identification.pose_selection import forecast
from casadical.identification.pose_selection.experimental_design import Design, improve, inverse, search
from casadical.identification.pose_selection.selection import short_tour

ROOT = Path(__file__).parents[3]

N, M, P = 11, 2, 4


def rows(seed, n=N, m=M, p=P):
    return np.random.default_rng(seed).normal(size=(n, m, p)) * np.linspace(0.3, 3, p)


def design(A, fixed=None, weight=None, apart=0.0, places=None):
    places = np.arange(len(A))[:, None].astype(float) if places is None else places
    p = A.shape[2]
    nothing = np.zeros((p, p))
    weight = np.eye(p) if weight is None else weight
    return Design(weight, A, nothing if fixed is None else fixed, places, apart, places[:0])


def variance(A, chosen, fixed, weight):
    """V by its definition."""
    return np.trace(weight @ np.linalg.inv(sum(A[k].T @ A[k] for k in chosen) + fixed))


@pytest.mark.parametrize("seed", range(6))
def test_the_best_of_all_sets_is_found(seed) -> None:
    A = rows(seed)
    B = rows(seed + 100)[:3].reshape(-1, P)
    weight, fixed = B.T @ B, np.zeros((P, P)) if seed % 2 else 0.1 * B.T @ B
    found = search(design(A, fixed, weight), 5, 20, seed)
    best = min(variance(A, c, fixed, weight) for c in combinations(range(N), 5))
    assert len(set(found.tolist())) == 5
    assert variance(A, found, fixed, weight) == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("m", [1, 3, 6])
def test_updates_are_what_computing_anew_gives(m) -> None:
    A, weight = rows(3, n=40, m=m, p=8), np.diag(np.arange(1.0, 9))
    updated = design(A, weight=weight)
    rng = np.random.default_rng(0)
    updated.start(list(range(15)))
    for _ in range(30):
        updated.remove(int(rng.integers(len(updated.chosen))))
        updated.add(int(rng.choice(np.flatnonzero(updated.closed == 0))))
    anew = design(A, weight=weight)
    anew.start(updated.chosen)
    assert updated.value == pytest.approx(anew.value, rel=1e-9)
    np.testing.assert_allclose(updated.C, anew.C, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(updated.D, anew.D, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(updated.L, anew.L, rtol=1e-7, atol=1e-10)
    np.testing.assert_array_equal(updated.closed, anew.closed)


@pytest.mark.parametrize("sign", [1, -1])
def test_gains_are_differences_of_variances(sign) -> None:
    A, weight = rows(4, n=20), np.diag([1.0, 2.0, 3.0, 4.0])
    d = design(A, weight=weight)
    d.start(list(range(8)))
    which = np.arange(8, 20) if sign > 0 else np.arange(8)
    for k, gain in zip(which, d.gains(which, sign), strict=True):
        other = [*range(8), k] if sign > 0 else [i for i in range(8) if i != k]
        step = variance(A, range(8), d.fixed, weight) - variance(A, other, d.fixed, weight)
        assert gain == pytest.approx(step, rel=1e-6, abs=1e-9)


def test_where_poses_determine_nothing_gains_are_those_of_the_determinant() -> None:
    A = rows(6, n=30, m=3, p=20)
    d = design(A)
    d.start([0, 1])
    assert not d.regular
    steps = [np.linalg.slogdet(d.M + A[k].T @ A[k])[1] - np.linalg.slogdet(d.M)[1] for k in range(2, 30)]
    np.testing.assert_allclose(d.gains(np.arange(2, 30), 1), steps, rtol=1e-4)
    found = search(d, 8, 2, 0)
    assert np.linalg.matrix_rank(A[found].reshape(-1, 20)) == 20


def test_the_unit_of_the_rows_changes_nothing() -> None:
    """A search that took round-off for a gain went round for ever where the index was above one."""
    # Every candidate twice: exchanging one for its twin gains nothing.
    twins = np.concatenate([rows(7, n=40, p=8)] * 2)
    found = [sorted(search(design(unit * twins), 12, 3, 1).tolist()) for unit in (2.0**-10, 1.0, 2.0**10)]
    assert found[0] == found[1] == found[2]


class Counted(Design):
    """Keeps how many poses were chosen after each step."""

    counts: ClassVar[list[int]] = []

    def _change(self, k: int, sign: int) -> None:
        super()._change(k, sign)
        self.counts.append(len(self.chosen))


def test_an_exchange_goes_as_deep_as_it_is_told_step_by_step() -> None:
    d = Counted(np.eye(P), rows(2), np.eye(P), np.arange(N)[:, None].astype(float), 0.0, np.zeros((0, 1)))
    d.start(search(d, 6, 20, 0).tolist())  # of which no exchange gains
    d.counts.clear()
    improve(d, 3)
    assert list(dict.fromkeys(d.counts)) == [7, 6, 5, 8, 4, 9, 3]


def test_a_pose_may_be_chosen_again_where_that_is_allowed() -> None:
    A, nothing = rows(8, n=12), np.zeros((P, P))
    once = search(design(A), 9, 20, 0)
    again = search(design(A, apart=-1.0), 9, 20, 0)
    assert len(set(once.tolist())) == 9 > len(set(again.tolist()))
    assert variance(A, once, nothing, np.eye(P)) > 1.01 * variance(A, again, nothing, np.eye(P))


def test_poses_keep_their_distance_from_each_other() -> None:
    places = np.linspace(0, 1, 30)[:, None]
    found = search(design(rows(5, n=30), apart=0.1, places=places), 6, 2, 0)
    assert np.diff(np.sort(places[found, 0])).min() > 0.1
    with pytest.raises(InputError, match=r"only \d of 9 poses can be chosen"):
        search(design(rows(5, n=30), apart=0.2, places=places), 9, 1, 0)


def test_rounding_chooses_no_pose() -> None:
    """Sets that lack a pose determine nothing: which pose leaves them next was rounding, and all that followed, too."""
    arm = read_robot(ROOT / "problems" / "planar" / "robot.toml")
    first = forecast(arm, 8).error
    for k in (-3, 1, 3):
        moved = arm.with_values({"a1": arm.parameters["a1"].value * (1 + k * 1e-13)})
        np.testing.assert_allclose(forecast(moved, 8).error, first, rtol=1e-6)


def test_what_no_reading_tells_of_is_left_aside() -> None:
    told = np.array([[4.0, 1.0], [1.0, 2.0]])
    M = np.zeros((3, 3))
    M[:2, :2] = told
    np.testing.assert_allclose(inverse(M)[:2, :2] @ told, np.eye(2), atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_the_path_is_the_shortest_of_the_nearest_neighbour_tours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, before = rng.uniform(size=(9, 2)), rng.uniform(0, 0.5, 9)
    D = np.linalg.norm(at[:, None] - at, axis=2)

    def length(path) -> float:
        return float(before[path[0]] + sum(D[i, j] for i, j in pairwise(path)))

    greedy = []
    for start in range(9):
        path, left = [start], {*range(9)} - {start}
        while left:
            path.append(min(left, key=lambda j: D[path[-1], j]))
            left.remove(path[-1])
        greedy.append(length(path))
    assert length(short_tour(D, before)) == pytest.approx(min(greedy))


def test_of_equal_tours_the_first_is_taken_whatever_rounding_says() -> None:
    turn = 2 * np.pi * np.arange(9) / 9
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    D = np.linalg.norm(ring[:, None] - ring, axis=2) * (1 + 1e-9 * np.random.default_rng(0).normal(size=(9, 9)))
    assert short_tour(D).tolist() == [*range(9)]


def test_thirds_hold_a_third_each_and_rounding_moves_no_value_over_an_edge() -> None:
    """Of joints that stand at few angles, readings moved by 1e-12 made other parts."""
    rng = np.random.default_rng(0)
    values = rng.permutation(np.arange(300.0))
    assert (thirds(values)[0] == values // 100).all()
    few = rng.integers(0, 5, 301) * 0.5
    for _ in range(5):
        assert (thirds(few + 1e-12 * rng.standard_normal(301))[0] == thirds(few)[0]).all()
