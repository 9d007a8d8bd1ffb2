"""Parts of the diagnosis on small made-up problems: posteriors by enumeration, odds, gains, words, next poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from types import SimpleNamespace
from typing import Any

import arms
import numpy as np
import pytest
from cases import ROOT, diagnose, made_up, planar, robot, small_problem, with_none
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import chi2, multivariate_normal, norm

from casadical import InputError, Joint, Measurements, Robot
from casadical.core.linear_gaussian.noise import SIGMA_LOG_LIKELIHOOD_WINDOW, log_gain
from casadical.diagnosis import bootstrap, noise_account
from casadical.diagnosis.candidates import Candidate, candidates_of
from casadical.diagnosis.conclusion import rivals_of
from casadical.diagnosis.evidence import (
    KAPPA_GRID,
    KAPPA_WEIGHTS,
    RHO_GRID,
    SIGMA_GRID_M,
    BaseParameters,
    NoisePrior,
    log_noise_prior,
)
from casadical.diagnosis.laws.candidates import LawProblem
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.localisation import thirds_of
from casadical.diagnosis.next_poses import table_of
from casadical.diagnosis.posterior import PRIOR_FIRST, PRIOR_FURTHER, prior_weights, rank
from casadical.diagnosis.search import Step
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.statements import Statement, statements
from casadical.diagnosis.structure import _drivers
from casadical.diagnosis.text import things_to_know
from casadical.effects import Backlash, GearEccentricity, NonlinearStiffness
from casadical.effects.base import CAUSE_PRIOR_SIGMA
from casadical.identification.identification import prepare
from casadical.identification.prior import Prior
from casadical.measurements.measurements import Noise
from casadical.project.problem import read_problem

NONE = np.zeros(0, dtype=np.int64)


def small_case() -> Case:
    """Backlash of joint 2 with two settings, another cause of joint 2, and something unknown."""
    soft, hard, other, unknown = Backlash(2, 0.04), Backlash(2, 0.3), NonlinearStiffness(2), GearEccentricity(3)
    candidates = (
        Candidate("backlash@2", "backlash", 2, ((soft,), (hard,))),
        Candidate("nonlinear_stiffness@2", "nonlinear_stiffness", 2, ((other,),)),
        Candidate("unknown", "unknown", None, ((unknown,),), listed=False),
    )
    columns = {e: np.array([k]) for k, e in enumerate((soft, hard, other, unknown))}
    e = small_problem()
    nothing: Any = None
    base, kept = BaseParameters(e.J, e.delta0, e.prior, np.diag(e.prior), np.zeros((5, 0))), np.ones(len(e.r), bool)
    return Case(nothing, nothing, np.zeros(5), nothing, candidates, {}, e, base, kept, columns, nothing)


def log_odds(case: Case, column: int) -> float:
    """Log Bayes factor of one column against none: densities summed over the grids, each written out in full."""
    e = case.whole
    grid = np.full((len(RHO_GRID), len(SIGMA_GRID_M), len(KAPPA_GRID) + 1), -np.inf)
    rows, J, E = e.r.size, e.J.reshape(e.r.size, -1), e.take(np.arange(e.width)).reshape(e.r.size, -1)
    for a, rho in enumerate(RHO_GRID):
        for b, sigma in enumerate(SIGMA_GRID_M):
            C = (J * (sigma / e.reference * e.prior) ** 2) @ J.T
            for k, Jq in enumerate(e.Jq):
                C[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += sigma**2 * (np.eye(3) + rho**2 * Jq @ Jq.T)
            for c, kappa in enumerate([0.0, *KAPPA_GRID]):
                whole = C + kappa**2 * np.outer(E[:, column], E[:, column])
                left = e.r.ravel() - J @ e.delta0
                half = np.linalg.solve(np.linalg.cholesky(whole), left)
                grid[a, b, c] = -0.5 * (half @ half + np.linalg.slogdet(whole)[1] + rows * np.log(2 * np.pi))
    return float(logsumexp(grid[:, :, 1:] + np.log(KAPPA_WEIGHTS)) - logsumexp(grid[:, :, 0]))


@pytest.fixture(scope="module")
def odds() -> list[float]:
    case = small_case()
    return [log_odds(case, k) for k in range(4)]


def test_a_posterior_is_prior_times_likelihood_over_all_settings(odds: list[float]) -> None:
    found = rank(small_case(), NONE)
    factor = {
        "backlash@2": np.logaddexp(odds[0], odds[1]) - np.log(2),
        "nonlinear_stiffness@2": odds[2],
        "unknown": odds[3],
    }
    assert found.log_factor == pytest.approx(factor, abs=1e-6)
    share = {"backlash@2": PRIOR_FIRST["listed"] / 2, "nonlinear_stiffness@2": PRIOR_FIRST["listed"] / 2}
    weights = {k: np.log(share.get(k, PRIOR_FIRST["unknown"])) + f for k, f in factor.items()}
    total = logsumexp([np.log(PRIOR_FIRST["none"]), *weights.values()])
    assert found.none == pytest.approx(np.exp(np.log(PRIOR_FIRST["none"]) - total), abs=1e-9)
    assert found.probability == pytest.approx({k: np.exp(w - total) for k, w in weights.items()}, abs=1e-7)
    assert found.variant["backlash@2"] == int(np.argmax(odds[:2]))


def test_a_second_cause_at_a_joint_has_a_twentieth_of_the_prior() -> None:
    found = rank(small_case(), np.array([0]), skip=frozenset({"backlash@2"}))
    assert set(found.probability) == {"nonlinear_stiffness@2", "unknown"}
    prior = found.log_mass["nonlinear_stiffness@2"] - found.log_factor["nonlinear_stiffness@2"]
    assert np.exp(prior) == pytest.approx(0.05 * PRIOR_FURTHER["listed"])


def test_a_law_is_judged_against_none_by_the_same_densities(odds: list[float]) -> None:
    case = small_case()
    E = case.whole.take(np.arange(case.whole.width))
    found, _ = LawProblem(case.judged.with_causes_alone(NONE)).grids(E[:, :, [0, 2], None])
    assert_allclose(found, [odds[0], odds[2]], atol=1e-6)


def test_odds_of_a_draw_are_those_of_its_density() -> None:
    """One rho, without a base: independent normal coordinates, and one column of random size."""
    rng = np.random.default_rng(0)
    column, Y, sigma = 4e-5 * rng.normal(size=(12, 1)), 3e-5 * rng.normal(size=(12, 3)), np.array([2e-5, 3e-5])
    value, vector = np.linalg.eigh(column.T @ column)
    group = (np.array([0]), np.log(0.3), value, vector)
    nothing, something = bootstrap.log_likelihoods(column, Y, [group], sigma, 0.0, 12)
    for k, y in enumerate(Y.T):
        parts = [[multivariate_normal(cov=s**2 * np.eye(12) + kappa**2 * column @ column.T).logpdf(y)
                  for kappa in (0.0, *KAPPA_GRID)] for s in sigma]  # fmt: skip
        logs = np.array(parts) + 6 * np.log(2 * np.pi)
        assert nothing[k] == pytest.approx(logsumexp(logs[:, 0]))
        assert something[k] == pytest.approx(np.log(0.3) + logsumexp(logs[:, 1:] + np.log(KAPPA_WEIGHTS)))


def test_gains_are_left_out_only_where_they_cannot_count() -> None:
    """A group that explains nothing is judged near the best sigma alone, and there by the determinant it costs."""
    sigmas, base = np.geomspace(1e-6, 1e-3, 40), np.full(40, 0.0)
    base[:10] = -SIGMA_LOG_LIKELIHOOD_WINDOW - 30
    value, turned = np.array([[2.0, 1.0]]), np.array([[0.0, 0.0]])
    kappas = 1e-4 * KAPPA_GRID
    found = log_gain(sigmas, kappas, base, value, turned)
    direct = -0.5 * np.log1p(value[:, :, None, None] * (kappas / sigmas[:, None]) ** 2).sum(axis=1)
    seen = np.isfinite(found[0])
    assert not seen[:10].any()
    assert seen[-10:].all()
    assert_allclose(found[0][seen], direct[0][seen], rtol=1e-9)


def test_a_group_that_would_explain_more_than_the_residual_is_refused() -> None:
    """Round-off took its columns: 1e-20 is left of their square, and a product of 1 with the residual."""
    sigmas, value, turned = np.geomspace(1e-6, 1e-3, 40), np.array([[1e-20], [2.0]]), np.array([[1e-5], [1e-5]])
    found = log_gain(sigmas, 1e-4 * KAPPA_GRID, np.zeros(40), value, turned, residual_square=1e-8)
    assert np.isneginf(found[0]).all()
    assert np.isfinite(found[1]).any()


def test_joints_repeat_as_data_sheets_say() -> None:
    """At a lever of 1 m 0.1 mm (ISO 9283) is 27.6 urad, two standard deviations of a half-normal density."""
    e = small_problem()
    plain, known = (log_noise_prior(replace(e, noise_prior=NoisePrior(lever=a)), e.Jq) for a in (0.0, 1.0))
    urad = 1e6 * RHO_GRID[:, None] * e.sigmas
    assert_allclose(known - plain, norm(scale=13.81).logpdf(urad) - norm(scale=13.81).logpdf(0.0), rtol=1e-3)


def test_what_is_prepared_is_not_given_again() -> None:
    planar = read_problem(ROOT / "problems" / "planar")
    (m,) = planar.sets["identify"]
    prepared = prepare(planar.robot, (m,))
    for what, more in (("m", {"m": m}), ("masses", {"masses": "nuisance"})):
        with pytest.raises(InputError, match=f"{what}: robot and measurements are prepared already"):
            diagnose(prepared, **more)
    with pytest.raises(InputError, match="method='KM': a diagnosis has its own base model"):
        diagnose(prepare(planar.robot, (m,), method="KM"))


@pytest.mark.parametrize(("off", "named"), [(0.25e-3, []), (0.35e-3, ["outliers"])])
def test_a_single_outlier_is_a_cause_only_if_it_is_far_out(off: float, named: list[str]) -> None:
    planar = read_problem(ROOT / "problems" / "planar")
    (m,) = planar.sets["identify"]
    moved = np.array(m.position)
    moved[3, 0] += off
    found = diagnose(planar.robot, replace(m, position=moved))
    assert [o.row for o in found.outliers] == [m.row[3]]
    assert [c.effect for c in found.causes] == named


def test_before_any_data_all_is_shared_out_and_a_second_cause_at_a_joint_is_rare() -> None:
    assert sum(PRIOR_FIRST.values()) == pytest.approx(1.0)
    candidates = candidates_of(robot("ur10e"), ["backlash", "transmission_ripple"])
    first, second = (prior_weights(candidates, PRIOR_FIRST, skip) for skip in (frozenset(), frozenset(["backlash@2"])))
    assert second["transmission_ripple@2"] == pytest.approx(second["transmission_ripple@3"] / 20)
    assert first["transmission_ripple@2"] == first["transmission_ripple@3"] == second["transmission_ripple@3"]
    weights = prior_weights(candidates_of(robot("ur10e"), ["backlash", "thermal_bend"]), PRIOR_FIRST, frozenset())
    shares = [sum(w for k, w in weights.items() if k.split("@")[0] == name) for name in ("backlash", "thermal_bend")]
    assert shares[1] == pytest.approx(shares[0] / 4 * (1 - 1 / 7))  # a name of the extended list


def test_thirds_are_named_to_a_tenth() -> None:
    found = planar().case
    case = replace(found, m=replace(found.m, conditions={"temperature_degC": np.linspace(20.0, 29.0, len(found.m))}))
    assert thirds_of(case, "temperature", "time_s", "degC") == []
    names = [name for _, name, _ in thirds_of(case, "temperature", "temperature_degC", "degC")]
    assert names == ["20.0 .. 23.0 degC", "23.0 .. 26.0 degC", "26.0 .. 29.0 degC"]


@pytest.mark.parametrize(("p", "told"), [(None, "P(nothing) = 0.2"), (5e-4, "p < 0.0005"), (1e-3, "p = 0.001")])
def test_a_p_value_is_told_to_a_thousandth(p: float | None, told: str) -> None:
    d = replace(planar(), p_nothing=p, rankings=(with_none(planar().rankings[0], 0.2),))
    assert next(s for s in statements(d) if s.about == "GAP").text.endswith(told)


def test_the_short_answer_has_each_kind_once_and_doubts_first() -> None:
    told = [
        Statement("UNKNOWN", "much"), Statement("UNKNOWN", "more"), Statement("UNKNOWN", "doubt", doubtful=True),
        Statement("CANNOT", "tell"), Statement("WHERE", "joint 2"), Statement("GAP", "0.1 mm", doubtful=True),
    ]  # fmt: skip
    explained = replace(planar(), verdict="explained")
    assert [(s.about, s.text) for s in things_to_know(explained, told)] == [("UNKNOWN", "doubt"), ("WHERE", "joint 2")]
    assert [s.about for s in things_to_know(planar(), told)] == ["UNKNOWN"]


def test_next_poses_have_the_unit_of_their_joint() -> None:
    joints = (Joint(), Joint(kind="prismatic"))
    q = np.array([[np.pi / 6, 0.25], [0.1, 0.2]])
    m = Measurements(q=q, kind="position", position=np.zeros((2, 3)))
    plain = SimpleNamespace(plain=True)
    case: Any = SimpleNamespace(robot=Robot("two joints", joints), m=m, observations=plain)
    table = table_of(case, (), m[:1], np.array([-1]), None, [0.5])
    assert table.loc[0, ["q1_deg", "q2_mm"]].tolist() == [30.0, 250.0]


def test_only_sigmas_near_the_best_are_judged() -> None:
    """A column that explains nearly all makes small sigmas likely, and large ones not worth a look."""
    sigmas = np.geomspace(1e-6, 1e-3, 40)
    found = log_gain(sigmas, 1e-3 * KAPPA_GRID, np.zeros(40), np.array([[1.0]]), np.array([[2e-4]]))
    assert np.isfinite(found[0]).all(axis=1).tolist() == [True] + 39 * [False]


class Parted:
    """An effect of two parts whose sizes are learnt."""

    parts = {0: np.array([0]), 1: np.array([1])}  # noqa: RUF012

    def with_sizes(self, factors: Any) -> Parted:
        self.given = factors
        return Parted()


@pytest.mark.parametrize(("ratio", "near"), [(0.0, (0, 1)), (0.2, (1, 2, 3)), (0.39, (3, 4, 2)), (5.0, (4, 5))])
def test_learnt_sizes_hold_about_the_noise_at_which_they_were_learnt(ratio: float, near: tuple[int, ...]) -> None:
    case, effect = small_case(), Parted()
    any_effect: Any = effect
    with_it = replace(case, columns={**case.columns, any_effect: np.array([1, 3])})
    more, _ = with_it.with_sizes(any_effect, {0: 0.5, 1: 2.0}, Noise(3e-5, ratio * 3e-5))
    assert set(more.whole.near) == set(near)
    assert more.whole.reference == 3e-5
    assert more.whole.cause_prior is not None
    assert more.whole.cause_prior.tolist() == [
        CAUSE_PRIOR_SIGMA,
        0.5 * CAUSE_PRIOR_SIGMA,
        CAUSE_PRIOR_SIGMA,
        2 * CAUSE_PRIOR_SIGMA,
    ]


def test_rivals_of_a_cause_are_the_others_that_remain_probable() -> None:
    probability = {"backlash@2": 0.7, "nonlinear_stiffness@2": 0.2, "unknown": 0.01}
    ranking = made_up(probability, 0.09)
    assert rivals_of(Step(ranking, ("backlash@2",), ()), [*probability]) == ("nonlinear_stiffness@2",)
    assert rivals_of(Step(ranking, ("backlash@2", "unknown"), ()), [*probability]) == ("unknown",)


def test_repeated_poses_weigh_sigmas_as_their_scatter_does() -> None:
    """Sums of squares over a variance are chi-squared; the noise of joints adds to that of the instrument."""
    e = replace(small_problem(), noise_prior=NoisePrior(repeats=4e-5, freedom=12))
    for k in (0, 3):
        variance = SIGMA_GRID_M**2 * (1 + RHO_GRID[k] ** 2 * (e.Jq**2).sum(axis=2).mean())
        direct = chi2(12).logpdf(12 * 4e-5**2 / variance) - np.log(variance)
        found = log_noise_prior(e, e.Jq)[k]
        assert_allclose(found - found[0], direct - direct[0], rtol=1e-9, atol=1e-9)


def test_a_prior_of_correlated_parameters_is_one_of_independent_units() -> None:
    case = small_case()
    names = tuple("abcde")
    group = SimpleNamespace(group="x")
    parameters: Any = type("Of", (), {"names": names, "__getitem__": lambda _s, _n: group})()
    given: Any = SimpleNamespace(parameters=parameters)
    C = np.array([[4e-10, 3e-10], [3e-10, 9e-10]])
    prior = Prior(names, {"b": (1e-5, 2e-5), "d": (-3e-5, 3e-5)}, ((("b", "d"), C),), ("x",))
    found = replace(case, given=given).with_prior(prior, 2e-5)
    assert found.units is not None
    mean = case.whole.delta0.copy()
    mean[[1, 3]] = 1e-5, -3e-5
    assert_allclose(found.units @ found.base.delta0, mean, atol=1e-18)
    spread = found.units @ np.diag(found.base.prior**2) @ found.units.T
    expected = np.diag(case.whole.prior**2)
    expected[np.ix_([1, 3], [1, 3])] = C
    assert_allclose(spread, expected, rtol=1e-9, atol=1e-25)
    assert_allclose(found.base.J, case.whole.J @ found.units, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [("the base moved", "The base moved."), ("it moved (a)", "It moved (a)"), ("x_mm drifts.", "x_mm drifts.")],
)
def test_a_statement_is_a_sentence_with_one_full_stop(text: str, sentence: str) -> None:
    assert Statement.sentence.fget(SimpleNamespace(about="", text=text)) == sentence


def test_every_kind_of_event_is_a_candidate_at_the_time_of_another() -> None:
    @dataclass(frozen=True)
    class Event:
        at: float = 0.0

    case = SimpleNamespace(columns={}, candidates=[SimpleNamespace(label="jump", variants=[(Event(),)])])
    case.with_variants = lambda variants: variants
    assert Case.with_events_at(case, None) is case
    assert Case.with_events_at(case, 3.0) == {(Event(3.0),): "jump"}


def test_sums_and_differences_of_joints_drive_by_the_same_harmonics() -> None:
    arm = arms.six_axis()
    m = replace(arms.positions(arm, arms.readings(arm, 9, 0), 1), conditions={"progress": np.linspace(0, 1, 9)})
    found = dict(islice(_drivers(arm, m, m.position), 6 + 2 * 15))  # one joint, and two
    for sign, word in ((1, "+"), (-1, "-")):
        angle = (m.q[:, 0] + sign * m.q[:, 1])[:, None] * np.arange(1, SETTINGS.max_joint_harmonic + 1)
        waves = np.sort(np.hstack([np.sin(angle), np.cos(angle)]), axis=1)
        np.testing.assert_allclose(np.sort(found[f"q1 {word} q2"], axis=1), waves, atol=1e-12)


@pytest.mark.parametrize(("fitted", "rule"), [(1e-5, "declared"), (5e-6, "fit"), (2e-5, "fit")])
def test_a_declared_noise_rules_unless_the_fit_differs(fitted: float, rule: str, monkeypatch) -> None:
    monkeypatch.setattr(noise_account, "scatter_of_coordinate", lambda _, noise: noise.sigma)
    prior = NoisePrior(declared=1e-5)
    case = SimpleNamespace(evidence=SimpleNamespace(noise_prior=prior, count=600, absorbed_by_base=6))
    found = noise_account._by_statement(case, Noise(fitted, 0.0), like_noise=True)
    assert found == (False, rule, fitted)
