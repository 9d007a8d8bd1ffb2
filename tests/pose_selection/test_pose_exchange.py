"""Searches against all sets of a tiny problem; updates against computing anew."""

from itertools import combinations
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from casadical import InputError, read_robot
from casadical.pose_selection import forecast
from casadical.pose_selection.experimental_design import Determinant, Linear, Spectral, improve, search

ROOT = Path(__file__).parents[2]

N, M, P = 11, 2, 4


def rows(seed, n=N, m=M, p=P):
    return np.random.default_rng(seed).normal(size=(n, m, p)) * np.linspace(0.3, 3, p)


def design(kind, A, fixed=None, weight=None, apart=0.0, places=None):
    places = np.arange(len(A))[:, None].astype(float) if places is None else places
    p = A.shape[2]
    common = (A, np.zeros((p, p)) if fixed is None else fixed, places, apart, places[:0])
    if kind == "D":
        return Determinant(*common)
    if kind in ("A", "V"):
        return Linear(np.eye(p) if weight is None else weight, *common)
    return Spectral(kind, *common)


def worth(kind, A, chosen, fixed, weight):
    """Each criterion by its definition."""
    M_ = sum(A[k].T @ A[k] for k in chosen) + fixed
    s = np.sqrt(np.linalg.eigvalsh(M_))
    return {
        "D": lambda: np.linalg.det(M_) ** 0.5,
        "A": lambda: -np.trace(np.linalg.inv(M_)),
        "V": lambda: -np.trace(weight @ np.linalg.inv(M_)),
        "O2": lambda: s[0] / s[-1],
        "O3": lambda: s[0],
        "O4": lambda: s[0] ** 2 / s[-1],
        "O5": lambda: 1 / np.sum(1 / s),
    }[kind]()


@pytest.mark.parametrize("kind", ["D", "A", "V", "O2", "O3", "O4", "O5"])
@pytest.mark.parametrize("seed", range(6))
def test_the_best_of_all_sets_is_found(kind, seed) -> None:
    A = rows(seed)
    B = rows(seed + 100)[:3].reshape(-1, P)
    weight = B.T @ B if kind == "V" else np.eye(P)
    fixed = np.zeros((P, P)) if seed % 2 else 0.1 * B.T @ B
    found = search(design(kind, A, fixed, weight), 5, 20, seed)
    best = max(worth(kind, A, c, fixed, weight) for c in combinations(range(N), 5))
    assert len(set(found.tolist())) == 5
    assert worth(kind, A, found, fixed, weight) == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("kind", ["D", "V"])
@pytest.mark.parametrize("m", [1, 3, 6])
def test_updates_are_what_computing_anew_gives(kind, m) -> None:
    A = rows(3, n=40, m=m, p=8)
    weight = np.diag(np.arange(1.0, 9))
    updated = design(kind, A, weight=weight)
    rng = np.random.default_rng(0)
    updated.start(list(range(15)))
    for _ in range(30):
        updated.remove(int(rng.integers(len(updated.chosen))))
        updated.add(int(rng.choice(np.flatnonzero(updated.closed == 0))))
    anew = design(kind, A, weight=weight)
    anew.start(updated.chosen)
    assert updated.value == pytest.approx(anew.value, rel=1e-9)
    np.testing.assert_allclose(updated.C, anew.C, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(updated.D, anew.D, rtol=1e-7, atol=1e-10)
    np.testing.assert_array_equal(updated.closed, anew.closed)
    if kind == "V":
        np.testing.assert_allclose(updated.L, anew.L, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("kind", ["D", "V", "O5"])
@pytest.mark.parametrize("sign", [1, -1])
def test_gains_are_differences_of_values(kind, sign) -> None:
    A, weight = rows(4, n=20), np.diag([1.0, 2.0, 3.0, 4.0])
    d = design(kind, A, weight=weight)
    d.start(list(range(8)))
    which = np.arange(8, 20) if sign > 0 else np.arange(8)
    for k, gain in zip(which, d.gains(which, sign), strict=True):
        other = design(kind, A, weight=weight)
        other.start([*range(8), k] if sign > 0 else [i for i in range(8) if i != k])
        step = other.value - d.value
        if kind == "V":
            step = np.exp(-d.value) - np.exp(-other.value)
        assert gain == pytest.approx(step * (2 * P if kind == "D" else 1), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("kind", ["D", "V"])
def test_the_unit_of_the_rows_changes_nothing(kind) -> None:
    """A search that took round-off for a gain went round for ever where the index was above one."""
    # Every candidate twice: exchanging one for its twin gains nothing.
    twins = np.concatenate([rows(7, n=40, p=8)] * 2)
    found = [sorted(search(design(kind, unit * twins), 12, 3, 1).tolist()) for unit in (2.0**-10, 1.0, 2.0**10)]
    assert found[0] == found[1] == found[2]


class Counted(Determinant):
    """Keeps how many poses were chosen after each step."""

    counts: ClassVar[list[int]] = []

    def _change(self, k: int, sign: int) -> None:
        super()._change(k, sign)
        self.counts.append(len(self.chosen))


def test_an_exchange_goes_as_deep_as_it_is_told_step_by_step() -> None:
    d = Counted(rows(2), np.eye(P), np.arange(N)[:, None].astype(float), 0.0, np.zeros((0, 1)))
    d.start(search(d, 6, 20, 0).tolist())  # of which no exchange gains
    d.counts.clear()
    improve(d, 3)
    assert list(dict.fromkeys(d.counts)) == [7, 6, 5, 8, 4, 9, 3]


def test_a_pose_may_be_chosen_again_where_that_is_allowed() -> None:
    A = rows(8, n=12)
    once = search(design("D", A), 9, 20, 0)
    again = search(design("D", A, apart=-1.0), 9, 20, 0)
    assert len(set(once.tolist())) == 9 > len(set(again.tolist()))
    nothing = np.zeros((P, P))
    assert worth("D", A, again, nothing, nothing) > 1.01 * worth("D", A, once, nothing, nothing)


def test_poses_keep_their_distance_from_each_other() -> None:
    places = np.linspace(0, 1, 30)[:, None]
    found = search(design("D", rows(5, n=30), apart=0.1, places=places), 6, 2, 0)
    assert np.diff(np.sort(places[found, 0])).min() > 0.1


def test_a_distance_that_leaves_too_few_is_said() -> None:
    places = np.linspace(0, 1, 30)[:, None]
    with pytest.raises(InputError, match=r"only \d of 9 poses can be chosen"):
        search(design("D", rows(5, n=30), apart=0.2, places=places), 9, 1, 0)


def test_a_set_too_small_to_tell_anything_can_still_grow() -> None:
    A = rows(6, n=30, m=3, p=20)
    found = search(design("D", A), 8, 2, 0)
    assert np.linalg.matrix_rank(A[found].reshape(-1, 20)) == 20


def test_rounding_chooses_no_pose() -> None:
    """Sets that lack a pose determine nothing: which pose leaves them next was rounding, and all that followed, too."""
    arm = read_robot(ROOT / "problems" / "planar" / "robot.toml")
    first = forecast(arm, 8).error
    for k in range(-3, 4):
        moved = arm.with_values({"a1": arm.parameters["a1"].value * (1 + k * 1e-13)})
        np.testing.assert_allclose(forecast(moved, 8).error, first, rtol=1e-6)
