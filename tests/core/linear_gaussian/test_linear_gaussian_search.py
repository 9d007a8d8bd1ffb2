"""The posterior over the next cause by hand, and the steps by which causes are added."""

import numpy as np
import pytest

from casadical.core.linear_gaussian.search import Posterior, compared_again, log_factors, stepwise


def test_a_bayes_factor_is_the_mean_likelihood_over_sizes_and_the_sum_over_noise() -> None:
    base = np.array([[1.0, 3.0]])  # likelihoods, at two sigmas
    grids = np.array([[[[2.0, 4.0], [6.0, 8.0]]], [[[1.0, 1.0], [3.0, 3.0]]]])  # and two sizes
    factors, weighted = log_factors(np.log(grids), np.log(base), np.array([0.25, 0.75]))
    assert np.exp(factors) == pytest.approx([(0.25 * (2 + 6) + 0.75 * (4 + 8)) / 4, 1.0])
    assert np.exp(weighted[0, 0, 1]) == pytest.approx([0.25 * 6, 0.75 * 8])


def test_the_posterior_weighs_the_mean_over_settings_by_the_prior() -> None:
    logs = {("a", 0): np.log(2.0), ("a", 1): np.log(6.0), ("b", 0): np.log(3.0), ("taken", 0): 99.0}
    posterior = Posterior.of_variants(logs, {"a": 0.2, "b": 0.3}, 0.5)
    assert np.exp(posterior.log_total) == pytest.approx(0.5 + 0.2 * 4 + 0.3 * 3)
    assert posterior.none == pytest.approx(0.5 / 2.2)
    assert posterior.probability == pytest.approx({"a": 0.8 / 2.2, "b": 0.9 / 2.2})
    assert (posterior.order, posterior.variant) == (("b", "a"), {"a": 1, "b": 0})
    assert posterior.restricted_to({"a"}).probability == pytest.approx({"a": 0.8 / 1.3})


def test_items_are_added_while_they_are_enough_and_compared_again_given_the_others() -> None:
    """The best item is what remains of 10, at most 4: 4, 4, 2, then nothing."""

    def rest(given: list[int]) -> int:
        return min(4, 10 - sum(given))

    assert stepwise(rest, lambda item, _: item > 0, 9) == ([4, 4, 2], 0)
    assert stepwise(rest, lambda item, _: item > 0, 2) == ([4, 4], 2)
    assert stepwise(rest, lambda _, given: sum(given) < 3, 9) == ([4], 4)
    assert compared_again([1, 4, 2], rest) == [4, 4, 2]
    assert compared_again([1], rest) == [1]
