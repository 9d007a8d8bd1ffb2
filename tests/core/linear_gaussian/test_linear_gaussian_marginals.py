"""Marginal likelihoods against the normal density that they are, for every kind of model."""

from dataclasses import replace

import numpy as np
import pytest
from models import FALLING, KAPPAS, NONE, RATIOS, SIGMAS, log_density, small_model, without_last_rows
from scipy.stats import multivariate_normal

from casadical.core.linear_gaussian.columns import array_columns, serial_columns
from casadical.core.linear_gaussian.marginals import Marginals, marginals_of, take_over_cache
from casadical.core.linear_gaussian.model import LinearModel, MemoryLimits
from casadical.core.linear_gaussian.noise import SIGMA_LOG_LIKELIHOOD_WINDOW, serial_noise
from casadical.core.linear_gaussian.sums import MAX_NARROW_GROUP_COLUMNS

GROUPS = [np.array([0]), np.array([1, 2]), np.array([5]), np.array([0, 1, 2])]


def twin_columns() -> LinearModel:
    """Two columns alike, and one that the base reproduces."""
    model = small_model()
    E = model.E.take(np.arange(6)).copy()
    E[:, :, 2] = E[:, :, 1]
    E[:, :, 5] = 0.1 * model.J[:, :, 3]
    return replace(model, E=array_columns(E))


def far_prior() -> LinearModel:
    """The data lie hundreds of the prior's sigmas from its mean."""
    model = small_model()
    return replace(model, delta0=model.delta0 + np.array([0.0, 9.0, -50.0, 0.0]))


MODELS = {
    "ratios that rise": small_model(),
    "ratios that fall": small_model(FALLING),
    "blocks of different sizes": without_last_rows(small_model(FALLING), np.array([1, 4])),
    "columns of deficient rank": twin_columns(),
    "priors far away": far_prior(),
    "blocks of one row": small_model(n=20, m=1),
}


CHOSEN = {
    "alone": NONE,
    "beside one": np.array([3]),
    "beside two": np.array([3, 4]),
    "beside its own": np.array([1, 3]),
}


@pytest.mark.parametrize("chosen", CHOSEN.values(), ids=CHOSEN)
@pytest.mark.parametrize("name", MODELS)
def test_marginal_likelihood_is_the_normal_density(name: str, chosen: np.ndarray) -> None:
    model = MODELS[name]
    judged = Marginals(model)
    base, grids = judged.log_base(chosen), judged.log_grids(GROUPS, chosen)
    expected = [[log_density(model, point, sigma, chosen, NONE, 0.0) for sigma in SIGMAS] for point in range(3)]
    np.testing.assert_allclose(base, expected, rtol=1e-7, atol=1e-6)
    assert_densities(model, grids, GROUPS, chosen)


def assert_densities(model: LinearModel, grids: np.ndarray, groups: list[np.ndarray], chosen: np.ndarray) -> None:
    """They are those of the normal distribution, or left out where that is negligible."""
    every = np.ndindex(*grids.shape)
    expected = [log_density(model, p, SIGMAS[s], chosen, groups[g], KAPPAS[k]) for g, p, s, k in every]
    expected, counts = np.reshape(expected, grids.shape), np.isfinite(grids)
    assert counts.mean() > 0.15
    np.testing.assert_allclose(grids[counts], expected[counts], rtol=1e-7, atol=1e-6)
    assert np.all(counts | (expected < expected.max(axis=(2, 3), keepdims=True) - SIGMA_LOG_LIKELIHOOD_WINDOW))


def test_other_columns_take_over_the_base_alone() -> None:
    """Likelihoods are those of a model of its own, and those of the first columns stay as they were."""
    model, rng = small_model(), np.random.default_rng(5)
    first = Marginals(model)
    known = first.log_grids(GROUPS)
    columns = array_columns(0.2 * rng.normal(size=(7, 3, 3)))
    alone = Marginals(replace(model, E=columns, cause_prior=np.full(3, 4.0)))
    of_others = Marginals(alone.model, first.sums)
    for also in (NONE, np.array([2])):
        some = [np.array([0]), np.array([0, 1])]
        np.testing.assert_allclose(of_others.log_grids(some, also), alone.log_grids(some, also), rtol=1e-12)
    np.testing.assert_array_equal(first.log_grids(GROUPS), known)


def test_columns_in_the_base_without_directions_that_move_nothing() -> None:
    """Four columns of a part, of which two are alike and one is nothing, are two of the base."""
    model = small_model()
    E = model.E.take(np.arange(6)).copy()
    E[:, :, 3], E[:, :, 4] = E[:, :, 2], 0.0
    V = np.array([[1.0, 0, 0, 0], [0, np.sqrt(0.5), np.sqrt(0.5), 0]]).T
    held = np.full(6, 2.0)
    combined = replace(model, E=array_columns(E, ((np.arange(1, 5), V),)), cause_prior=held)
    as_they_are = replace(model, E=array_columns(E), cause_prior=held)
    part, group = np.arange(1, 5), [np.array([5])]
    assert combined.with_base(part).J.shape[2] == 6
    two, four = (Marginals(m.with_base(part)).log_grids(group) for m in (combined, as_they_are))
    np.testing.assert_allclose(two - two[:, :, -1:], four - four[:, :, -1:], atol=1e-8)


def test_a_projection_has_the_same_likelihood() -> None:
    model = small_model()
    for base, ratio in zip(Marginals(model).log_base(), RATIOS, strict=True):
        projected = model.projection(ratio)
        likelihood = model.log_over_sigmas(float(projected.y @ projected.y), projected.log_norm)
        np.testing.assert_allclose(likelihood, base, rtol=1e-7)


@pytest.mark.parametrize("ratios", [RATIOS, FALLING], ids=["rising", "falling"])
def test_looking_ahead_changes_nothing(ratios: np.ndarray) -> None:
    model, sets = small_model(ratios), [np.array([3]), np.array([4])]
    ready = Marginals(model)
    ready.look_ahead(sets, GROUPS)
    for chosen in (*sets, np.array([3, 4])):
        np.testing.assert_allclose(
            ready.log_grids(GROUPS, chosen), Marginals(model).log_grids(GROUPS, chosen), rtol=1e-9
        )


def test_what_else_is_known_of_the_noise_is_added() -> None:
    model = small_model()
    known = np.random.default_rng(1).normal(size=(3, len(SIGMAS)))
    found = Marginals(replace(model, log_noise=known)).log_base()
    np.testing.assert_allclose(found, Marginals(model).log_base() + known, rtol=1e-12)


@pytest.mark.parametrize("ratios", [RATIOS, FALLING], ids=["rising", "falling"])
def test_a_wide_group_is_the_normal_density(ratios: np.ndarray) -> None:
    """Judged given one column, and given to one column."""
    model, rng, last = small_model(ratios, n=30), np.random.default_rng(2), MAX_NARROW_GROUP_COLUMNS + 1
    E = 0.02 * rng.normal(size=(30, 3, last + 1))
    r = model.r + E @ rng.normal(size=last + 1)
    model = replace(model, r=r, E=array_columns(E), cause_prior=np.full(last + 1, 8.0))
    for group, chosen in ((np.arange(last), np.array([last])), (np.array([last]), np.arange(last))):
        assert_densities(model, Marginals(model).log_grids([group], chosen), [group], chosen)


def test_a_wide_group_far_behind_a_narrow_one_is_judged_at_fewer_points_and_no_sum_changes() -> None:
    model, rng, last = small_model(n=60), np.random.default_rng(3), MAX_NARROW_GROUP_COLUMNS + 2
    E = 0.02 * rng.normal(size=(60, 3, last))
    model = replace(model, r=model.r + 200 * E[:, :, 0], E=array_columns(E), cause_prior=np.full(last, 8.0))
    groups = [np.array([0]), np.arange(1, last)]
    both = Marginals(model).log_grids(groups)
    alone = np.stack([Marginals(model).log_grids([group])[0] for group in groups])
    there = np.isfinite(both)
    np.testing.assert_allclose(both[there], alone[there], rtol=1e-9)
    assert there[1].any(axis=(1, 2)).sum() < np.isfinite(alone[1]).any(axis=(1, 2)).sum()
    every = [np.logaddexp.reduce(grids.ravel()) for grids in (both, alone)]
    assert every[0] == pytest.approx(every[1], rel=1e-12)


@pytest.mark.parametrize("ratios", [RATIOS, FALLING], ids=["rising", "falling"])
def test_sums_in_parts_are_those_of_all_blocks(ratios: np.ndarray) -> None:
    model, chosen = small_model(ratios, n=40), np.array([3, 4])
    parts = replace(model, memory=MemoryLimits(column_bytes=1, min_blocks=7))
    expected = Marginals(model).log_grids(GROUPS, chosen)
    np.testing.assert_allclose(Marginals(parts).log_grids(GROUPS, chosen), expected, rtol=1e-9)


@pytest.mark.parametrize("ratios", [RATIOS, FALLING], ids=["rising", "falling"])
def test_known_sums_are_extended_and_moved(ratios: np.ndarray) -> None:
    """More columns, then a block fewer and another one more, are as if they were added up anew."""
    whole, chosen = small_model(ratios, n=41), np.array([3, 4])

    first, fewer = whole.at(np.arange(40)), array_columns(whole.E.take(np.arange(5)))
    few = replace(whole, E=fewer, cause_prior=whole.cause_prior_sigmas[:5]).at(np.arange(40))
    marginals_of(few).log_grids(GROUPS[:2], chosen)
    take_over_cache(first, few)
    extended = marginals_of(first).log_grids(GROUPS, chosen)
    np.testing.assert_allclose(extended, Marginals(first).log_grids(GROUPS, chosen))
    second = whole.at(np.arange(1, 41))
    take_over_cache(second, first, (whole.at(np.array([0])), whole.at(np.array([40]))))
    moved = marginals_of(second).log_grids(GROUPS, chosen)
    np.testing.assert_allclose(moved, Marginals(second).log_grids(GROUPS, chosen), rtol=1e-8)


def test_columns_less_a_share_of_the_block_before_are_judged_as_their_arrays() -> None:
    """Autocorrelated noise: each block is taken less a share of the one before, in the order of measuring."""
    whole = small_model(n=30)
    order, n = np.random.default_rng(6).permutation(30), 30
    moved = serial_columns(whole.E, order, serial_noise(0.6, np.arange(n) == 0))
    every = np.arange(whole.width)
    E = whole.E.take(every)[order]
    array = 1.25 * E - 0.75 * np.concatenate([E[:1], E[:-1]])
    array[0] = E[0]
    np.testing.assert_allclose(moved.take(every), array, rtol=1e-12)
    np.testing.assert_allclose(moved.factors().columns_at(moved.levers()), array, rtol=1e-12, atol=1e-18)
    groups = [np.array([0, 1]), np.array([2])]
    a, b = (Marginals(replace(whole, E=c)).log_grids(groups) for c in (moved, array_columns(array)))
    np.testing.assert_allclose(a, b, rtol=1e-9)


def test_noise_that_keeps_a_share_is_white_without_it() -> None:
    """Two runs of blocks, of which each row keeps a share of its own: the density of the normal covariance."""
    stays, first = np.array([[0.8, 0.3]]), np.array([True, False, False, True, False])
    rng = np.random.default_rng(8)
    weight = np.broadcast_to([0.5, 2.0], (5, 2))
    rows = rng.standard_normal((5, 2, 1))
    noise = serial_noise(stays, first[:, None], weight)
    white = noise.whiten(rows)
    for row in range(2):
        apart = np.abs(np.subtract.outer(np.arange(5), np.arange(5)))
        same_run = np.equal.outer(np.cumsum(first), np.cumsum(first))
        covariance = np.where(same_run, stays[0, row] ** apart, 0.0) / weight[0, row] ** 2
        log_det = -2 * np.log(noise.weight[:, row]).sum()
        own = -0.5 * (5 * np.log(2 * np.pi) + log_det + (white[:, row, 0] ** 2).sum())
        assert own == pytest.approx(multivariate_normal.logpdf(rows[:, row, 0], np.zeros(5), covariance))
    other = rng.standard_normal((5, 2))
    assert (noise.whiten_transposed(other) * rows[:, :, 0]).sum() == pytest.approx((other * white[:, :, 0]).sum())
