"""Laws found in simulated campaigns: the search against exact evidence, what is claimed, and the files of it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cases import case, following_noise, plant, robot, simulated
from planted import campaign, misread, planted
from scipy.integrate import solve_ivp

from casadical import Discovery, diagnose, discover
from casadical.blind_check.mujoco_physics import perturb
from casadical.blind_check.mujoco_physics.stops import Stops
from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import Words
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.details import Details, analyse
from casadical.diagnosis.json_answer import as_json as diagnosis_json
from casadical.diagnosis.laws import contest
from casadical.diagnosis.laws.answer import line_of
from casadical.diagnosis.laws.beams import Beam, stations
from casadical.diagnosis.laws.contest import aliases, held_out, with_law
from casadical.diagnosis.laws.discovery import laws_of_diagnosis
from casadical.diagnosis.laws.forms import (
    FORMS,
    FORMS_BY_KIND,
    Driver,
    drivers_of,
    values_of,
    variables,
    wave_by,
    wave_plus,
    with_columns,
)
from casadical.diagnosis.laws.problem import (
    NOT_JUDGED_LOG_EVIDENCE,
    SCREENED_RHO_INDICES,
    Problem,
    ScoredLaw,
    Screen,
    TriedLaws,
    scale_of,
)
from casadical.diagnosis.laws.problem import with_columns as seams_with_columns
from casadical.diagnosis.laws.search import search_laws
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import linearise
from casadical.diagnosis.noise_forms import HEAVY_TAILS, ar_form, best_form_given_ar, better_ar_form
from casadical.diagnosis.posterior import rank
from casadical.diagnosis.text import brief
from casadical.diagnosis.text import page_of as diagnosis_page
from casadical.effects import Effect, Law
from casadical.effects.formula import NUMERIC_FUNCTIONS, parse
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import from_table
from casadical.robot.effect_tables import read_effects
from casadical.robot.robot_file import read_robot

NAME = "kr210"
NONE = np.zeros(0, dtype=np.int64)
STOP_RAD = -360e-6
STOP_SHARE = 0.7  # of the poses, in which the cable is slack


def cable_stop(stops: Stops) -> Array:
    """Error of joint 3, shape (n,) [rad]: a cable becomes taut beyond an angle of joint 4 and pulls from there on."""
    q = stops.q[:, 3]
    return 2 * STOP_RAD * np.maximum(0.0, q - np.quantile(q, STOP_SHARE)) / np.ptp(q)


HIDDEN = {
    "stop": (misread(3, cable_stop),),
    "eccentric": (planted("gear_eccentricity", 4, size=250e-6),),
    "two eccentric": (planted("gear_eccentricity", 1, size=160e-6), planted("gear_eccentricity", 4, size=250e-6)),
    "nothing": (),
}


def table(seed: int, hidden: str = "nothing", poses: int = 80):
    p = perturb(plant(robot(NAME)), seed)
    return campaign(p, poses, seed, HIDDEN[hidden], noise_mm=0.02, approach="motion")


laws_alone = cache(lambda c: search_laws(c, NONE))


@cache
def discovered(seed: int, hidden: str = "nothing") -> Discovery:
    """Laws given a few listed effects, which take less time than all."""
    few = ["joint_coupling", "gear_eccentricity", "backlash"]
    return discover(robot(NAME), from_table(table(seed, hidden), 6), few)


@pytest.mark.parametrize("form", FORMS.values(), ids=lambda f: f.name)
def test_the_formula_that_is_written_out_is_the_one_that_was_judged(form) -> None:
    x = np.random.default_rng(0).uniform(-1.5, 1.0, 40)
    grid = form.grid(x)
    for k in (0, len(grid) // 2, len(grid) - 1):
        values = form.values(x, grid[[k]])[:, :, 0]
        for part, text in zip(values, form.texts("q1 + q2", grid[k].tolist()), strict=True):
            (found,) = parse(text).values({"q1": 0.4 * x, "q2": 0.6 * x}, NUMERIC_FUNCTIONS)
            np.testing.assert_allclose(found, part, rtol=1e-9, atol=1e-9)


def test_a_form_that_is_constant_over_the_poses_has_a_size() -> None:
    assert scale_of(np.ones((1, 20, 3))).tolist() == [[1e-3] * 3]
    x = np.linspace(0.0, 1.0, 20)
    assert scale_of(FORMS_BY_KIND["signed"][0].values(x, np.zeros((1, 0))))[0, 0] == pytest.approx(x.std())


def test_drivers_are_what_the_robot_and_the_table_say() -> None:
    r, m = robot(NAME), from_table(table(1), 6)
    m, drivers = with_columns(m, drivers_of(r))
    found, values = values_of(linearise(r, m, r.parameters.values), drivers)
    by = {d.text: v for d, v in zip(found, values.T, strict=True)}
    tau = r.model.function("torque", ("tau",)).map(len(m))
    w = m.condition_matrix(r.conditions, r.declared)
    load = tau(m.q.T, w.T, r.parameters.values).full() / np.reshape(r.torque_scale, (-1, 1))
    np.testing.assert_allclose(by["tau2"], load[1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(by["q3 - q4"], m.q[:, 2] - m.q[:, 3], atol=1e-12)
    np.testing.assert_allclose(by["move5"], derive(m, ["move5"])[0].conditions["move5"], atol=1e-12)
    np.testing.assert_allclose(by["t"], np.arange(80) / 79, atol=1e-12)


def where_noise_follows(name: str, stays: float) -> Case:
    c = case(name)
    # A screen leaves the prior of joint repeatability out, which is the same for all laws.
    c = replace(c, whole=replace(c.whole, noise_prior=replace(c.whole.noise_prior, lever=0.0)))
    return c.with_form(ar_form(stays, int(c.inliers.sum()))) if stays else c


@pytest.mark.parametrize("stays", [pytest.param(0.0, marks=pytest.mark.slow), 0.7])
def test_screened_evidence_is_the_exact_one_at_each_rho(stays: float) -> None:
    c = where_noise_follows("kr210-P02", stays)
    problem = Problem.of_case(c, NONE)
    by_rho = np.logaddexp.reduce(problem.log_base, axis=1)
    for s in laws_alone(c)[:8]:
        seam, x = s.tried.seams[s.seam], s.tried.x[s.seam]
        values = s.tried.form.values(x, s.settings[None])
        exact = np.logaddexp.reduce(problem.grids([s.columns])[0], axis=(1, 2)) - by_rho
        for rho in SCREENED_RHO_INDICES:
            screen = Screen.at_rho(problem.evidence, rho)
            G, b = screen.products(*problem.in_order(seam.columns * seam.size, values / scale_of(values)[:, None, :]))
            assert screen.gains(G, b) == pytest.approx(exact[rho], abs=1.0)


@pytest.mark.slow
def test_laws_that_cannot_reach_what_is_needed_are_left_out_and_no_others() -> None:
    c, rng = case("kr210-P02"), np.random.default_rng(5)
    problem, n = Problem.of_case(c, NONE), int(c.inliers.sum())
    screen = Screen.at_rho(problem.evidence, 2)
    G, b = screen.products(3e-4 * rng.standard_normal((n, 3, 2)), rng.standard_normal((1, n, 200)))
    gains, reach = screen.gains(G, b), screen.max_gains(G, b)
    assert np.all(gains <= reach)
    least = float(np.quantile(reach, 0.7))
    some = screen.gains(G, b, least)
    np.testing.assert_array_equal(some == NOT_JUDGED_LOG_EVIDENCE, reach < least)
    np.testing.assert_allclose(some[reach >= least], gains[reach >= least], rtol=1e-12)
    best = laws_alone(c)[0]
    assert search_laws(c, NONE, least=best.score - 1)[0].law == best.law
    assert not search_laws(c, NONE, least=best.score + 100)


@pytest.mark.slow
def test_a_law_of_every_joint_is_found_with_a_factor_each() -> None:
    c = discovered(6).diagnosis.case
    law = Law(None, "joints", "a*sin(3*q) + b*cos(3*q)", (("a", 3e-5), ("b", 3e-5)), count=6)
    values = np.array([120, 0, 60, 60, 0, 90, -90, 90, 0, 120, 150, 150]) * 1e-6
    planted = with_law(c, law)
    shift = planted.whole.take(planted.group((law,))) @ (values / planted.sizes(planted.group((law,))))
    hidden = replace(c, whole=replace(c.whole, r=c.whole.r + shift))
    best = search_laws(hidden, NONE)[0]
    assert (best.law.place, best.tried.driver.text, best.tried.form.name) == ("every joint", "q", "wave")
    assert best.settings[0] == pytest.approx(3.0, abs=0.1)
    more = with_law(c, best.law)
    found = more.whole.take(more.group((best.law,)))[c.inliers]
    np.testing.assert_allclose(found, best.columns, rtol=0, atol=1e-6 * np.abs(best.columns).max())
    names = best.law.sizes()
    assert line_of(law, dict(zip(names, values, strict=True))) == (
        "every joint += [120, 60, 0, -90, 0, 150] urad * sin(3*q) + [0, 60, 90, 90, 120, 150] urad * cos(3*q)"
    )


@pytest.mark.parametrize("text", ["memory2_300mrad", "tau2*memory2_1000mrad"])
def test_memory_and_waves_by_the_load_are_written_out_as_they_were_judged(text: str) -> None:
    c = case("kr210-P02")
    drivers = {d.text: d for d in drivers_of(c.given)}
    m, _ = with_columns(c.m, [drivers[text]])
    linear = linearise(c.given, m, c.values)
    known = variables(linear, ("tau2", "q2", text.removeprefix("tau2*")))
    x = known[text.removeprefix("tau2*")] * (known["tau2"] if "*" in text else 1.0)
    assert np.abs(known[text.removeprefix("tau2*")]).max() <= 1
    (seam,) = seams_with_columns(linear, [Law(2, "joint", "a")])
    waves = [TriedLaws((seam,), drivers["q2"], f("tau2", known["tau2"]), (known["q2"],)) for f in (wave_by, wave_plus)]
    judged = [
        (TriedLaws((seam,), drivers[text], FORMS["linear"], (x,)), []),
        (waves[0], [2.5]),
        (waves[1], [2.0, -1.5]),
    ]
    for tried, settings in ((tried, np.array(values)) for tried, values in judged):
        law, columns = tried.column(0, settings)
        np.testing.assert_allclose(linear.columns([law]) * [s for s, _ in law.sizes().values()], columns, atol=1e-12)


@pytest.mark.parametrize("towards", [(0.0, 0.0, 1.0), (0.6, -0.8, 0.0)])
@pytest.mark.parametrize("name", ["azimuth", "incidence"])
def test_the_beam_knows_its_direction_and_how_it_meets_the_target(name: str, towards) -> None:
    c = case("kr210-P02")
    linear, at = linearise(c.given, c.m, c.values), {"station": (3.0, -2.0, 1.0), "towards": towards}
    unit, law = (Law(None, "beam", f, **at) for f in ("a", f"a*{name}"))
    along, columns = linear.columns([unit])[:, :, 0], linear.columns([law])[:, :, 0]
    _, R = predicted(c.given, c.m)
    expected = (
        np.arctan2(along[:, 1], along[:, 0]) if name == "azimuth" else np.einsum("ni,nij,j->n", along, R, towards)
    )
    np.testing.assert_allclose(columns, along * expected[:, None], atol=5e-3)  # flange of the rigid robot


@pytest.mark.parametrize("text", ["r", "azimuth", "incidence", "head", "head*incidence", "head*r"])
@pytest.mark.parametrize("seam", ["beam", "across"])
def test_a_place_of_a_beam_is_that_of_the_law(seam: str, text: str) -> None:
    c, at = case("kr210-P02"), {"station": stations(robot(NAME))[5], "towards": (0.6, 0.0, -0.8)}
    law = Law(None, seam, f"a*{text}", **at)
    m, _ = derive(c.m, law.conditions)
    linear = linearise(c.given, m, c.values)
    place, x = Beam(linear, c.given.base.T[:3, 3], 1.0, seam, Driver(text, "linear", "")).at(**at)
    expected = linear.columns([law])[:, :, 0]
    np.testing.assert_allclose(place.columns[:, :, 0] * x[:, None], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("stays", [0.0, 0.7])
def test_what_is_left_pulls_at_columns_as_their_products_say(stays: float) -> None:
    c, rng = where_noise_follows("kr210-P02", stays), np.random.default_rng(3)
    problem = Problem.of_case(c, NONE)
    if stays:
        problem = replace(problem, order=rng.permutation(problem.order))
    screen, column = problem.screens[0][1], rng.standard_normal(c.evidence.r.shape)
    white = np.einsum("nab,nb->na", screen.W, problem.white(column[:, :, None])[:, :, 0])
    assert (problem.residual_weights * column).sum() == pytest.approx((white * screen.y).sum(), rel=1e-9)


def test_laws_of_several_places_pay_for_all_that_were_looked_at() -> None:
    c = case("kr210-P02")
    problem, linear = Problem.of_case(c, NONE), linearise(c.given, c.m, c.values).at(np.flatnonzero(c.inliers))
    beam = Beam(linear, c.given.base.T[:3, 3], 3.0, "beam", Driver("r", "range", "range"))
    there = beam.at_all(stations(robot(NAME))[:3])
    few, many = (beam.tried(problem, FORMS["wave"], there, settings) for settings in (0, 3000 * 63))
    assert many.mean - few.mean == pytest.approx(-np.log(1000))
    assert (many.best, many.seam) == (few.best, few.seam)


@pytest.mark.slow
def test_a_fold_knows_no_place_that_other_poses_said() -> None:
    law = law_of_instrument(ranged, 0.0)
    tried, poses = law.tried, np.arange(0, len(law.columns), 2)
    assert law.seam >= tried.given > 0
    c = diagnose(robot(NAME), from_table(table(4), 6), ["backlash"], laws=False).case
    other = tried.by(Problem.of_case(c, NONE), np.flatnonzero(c.inliers))  # of a campaign without the wave
    assert {s.law.station for s in other.seams}.isdisjoint({s.law.station for s in tried.seams[tried.given :]})
    assert {s.law.station for s in other.seams} != {s.law.station for s in tried.seams[: tried.given]}
    alone = replace(tried, again=None).by(Problem.of_case(c, NONE), poses)
    assert alone.seams == tried.seams[: tried.given]


def ranged(m: Measurements) -> Measurements:
    """A tracker whose range errs by a wave of .7 m."""
    beam = m.position - STATION
    r = np.linalg.norm(beam, axis=1, keepdims=True)
    return replace(m, position=m.position + 5e-5 * np.sin(9.0 * r + 0.4) * beam / r)


def glass(m: Measurements) -> Measurements:
    """A mark of glass, which looks along the flange's first axis: seen askew it seems to lie farther off."""
    beam, way = m.position - STATION, predicted(robot(NAME), m)[1][:, :, 0]
    r = np.linalg.norm(beam, axis=1, keepdims=True)
    askew = 1 - ((beam / r) * way).sum(axis=1, keepdims=True) ** 2
    return replace(m, position=m.position - 4e-4 * (np.sqrt(1.51**2 - askew) - 1.3) * beam / r)


@pytest.mark.slow
@pytest.mark.parametrize("stays", [0.0, 0.6])
def test_a_short_wave_over_the_range_is_found_with_the_direction_to_the_instrument(stays: float) -> None:
    found = law_of_instrument(ranged, stays)
    assert (found.law.place, found.tried.driver.text, found.tried.form.name) == ("beam", "r", "wave")
    assert found.settings[0] == pytest.approx(9.0, abs=0.3)
    # How far off it is matters little.
    ways = [at / np.linalg.norm(at) for at in (np.array(found.law.station), STATION)]
    assert np.linalg.norm(ways[0] - ways[1]) < 0.05


@pytest.mark.slow
def test_a_target_that_looks_aside_is_found() -> None:
    found = law_of_instrument(glass, 0.0)
    assert (found.law.place, found.tried.driver.text, found.score > 12.0) == ("beam", "incidence", True)
    assert abs(found.law.towards[0]) > 0.95
    assert "the target looks along" in line_of(found.law)


def law_of_instrument(changed, stays: float) -> ScoredLaw:
    """The best law of a robot without another fault."""
    c = diagnose(robot(NAME), changed(from_table(table(4), 6)), ["backlash"], laws=False).case
    return search_laws(c.with_form(ar_form(stays, 80)) if stays else c, NONE)[0]


def test_the_columns_of_a_law_are_those_of_its_effect() -> None:
    c = case("kr210-P02")
    for s in laws_alone(c)[:6]:
        more = with_law(c, s.law)
        found = more.whole.take(more.group((s.law,)))[c.inliers]
        np.testing.assert_allclose(found, s.columns, rtol=0, atol=1e-6 * np.abs(s.columns).max())


def test_a_cable_that_stops_a_joint_is_found() -> None:
    found = discovered(5, "stop")
    (s,) = found.laws
    assert (s.law.place, s.tried.driver.text, s.tried.form.name) == ("joint 3", "q4", "hinge")
    q4 = found.case.m.q[:, 3]
    where = np.quantile(q4, STOP_SHARE)
    assert s.settings[0] == pytest.approx(where, abs=3 * s.errors[0])
    (value, error, unit), slope = found.values[f"{s.law.label}.a"], 2 * STOP_RAD / np.ptp(q4)
    assert unit == "rad"
    assert value == pytest.approx(slope, abs=4 * error + 0.2 * abs(slope))
    assert found.gap["law"] < min(found.gap["base"], found.gap.get("smooth", 1.0))
    assert found.best_model == "law"
    assert found.shrink is not None
    assert found.shrink[1][0] > 0.1


def heated(m: Measurements) -> Measurements:
    """Joint 3 errs as its motor warms up under load."""
    square, time = robot(NAME).loads(m.q, m.conditions)[:, 2] ** 2, m.conditions["time_s"]
    ends, start = (time[0], time[-1]), [square[0]]
    heat = solve_ivp(lambda t, x: (np.interp(t, time, square) - x) / 280, ends, start, t_eval=time, max_step=20).y[0]
    return replace(m, q=m.q + 4e-4 * heat[:, None] * (np.arange(6) == 2))


STATION = np.array([4.2, -2.5, 0.6])


def turned_head(m: Measurements, across: float, along: float) -> Measurements:
    """A tracker whose head has play: its points lie to a side, or farther off, by the way it turned last."""
    beam = m.position - STATION
    turn = np.angle(beam @ [1, 1j, 0])
    sense = np.sign(np.angle(np.exp(1j * np.diff(turn, prepend=turn[0]))))
    aside = np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1) * np.linalg.norm(beam, axis=1, keepdims=True)
    way = across * aside + along * beam / np.linalg.norm(beam, axis=1, keepdims=True)
    return replace(m, position=m.position + sense[:, None] * way)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "places", "driver"),
    [
        (heated, {"joint 3", "tilt of link 3"}, "heat3_300s"),
        (lambda m: turned_head(m, 2e-5, 0.0), {"the beam's side"}, "head*r"),
        (lambda m: turned_head(m, 0.0, 8e-5), {"beam"}, "head"),
    ],
    ids=["heat", "across", "along"],
)
def test_a_law_is_looked_for_where_all_would_be_noise_of_any_size(changed, places: set[str], driver: str) -> None:
    m, arm = from_table(table(4), 6), robot(NAME)
    there = changed(m)
    there = replace(m, position=there.position + predicted(arm, there)[0] - predicted(arm, m)[0])
    found = diagnose(arm, there)
    best = laws_of_diagnosis(found).rounds[0].best
    # Where a smooth function or unequal noise ranks first, the verdict is unknown without a law.
    assert (found.verdict, found.causes, found.law is None) == ("unknown", (), driver != "head")
    assert (best.law.place in places, best.tried.driver.text) == (True, driver)


@pytest.mark.slow
def test_a_law_that_is_a_listed_effect_by_another_name_is_said_as_such() -> None:
    case = discovered(7, "eccentric").diagnosis.case
    ranking, first = rank(case, NONE), search_laws(case, NONE)[0]
    assert ranking.order[0] == "gear_eccentricity@4"
    assert "gear_eccentricity@4" in aliases(case, NONE, first, ranking.variant)


PRODUCT = Law(2, "joint", "a*tau2*tau3", (("a", 1e-4),))


def shift_of(c: Case, law: Law, rms: float) -> Array:
    """What a law of one factor does to the positions, of this rms [m], shape (n, 3)."""
    planted = with_law(c, law)
    unit = planted.whole.take(planted.group((law,)))[:, :, 0]
    return rms * unit / unit.std()


@pytest.mark.slow
def test_a_law_is_found_in_noise_that_follows_itself() -> None:
    c = discovered(6).diagnosis.case
    r = following_noise(c.whole.r.shape, 0.95, 40e-6, 4) + shift_of(c, PRODUCT, 20e-6)
    hidden = replace(c, whole=replace(c.whole, r=r))
    follows = contest.with_ar_noise(hidden, rank(hidden, NONE))
    assert follows is not None
    assert follows.form.ar_coefficient > 0.85
    plain, first = (contest.round_of(case, NONE, rank(case, NONE)) for case in (hidden, follows))
    assert not plain.claimed
    assert plain.rival == plain.noise  # waves over time are what the noise is
    assert first.claimed
    assert first.form is follows.form
    assert first.noise[1] < 3
    assert (first.best.law.place, first.best.tried.driver.text) == ("joint 2", "tau2*tau3")
    assert contest.with_ar_noise(c, rank(c, NONE)) is None


@cache
def quiet_campaign() -> tuple[Measurements, Case]:
    """Poses with little noise, and their case, by which laws are planted."""
    m = from_table(campaign(perturb(plant(robot(NAME)), 6), 80, 6, noise_mm=0.004, approach="motion"), 6)
    return m, diagnose(robot(NAME), m, ["backlash@1"], laws=False).case


def hidden_in(stays: float, sigma: float, seed: int, laws: Mapping[Law, float]) -> Measurements:
    """The same poses with laws, each of an rms [m], in autocorrelated noise."""
    m, c = quiet_campaign()
    shifts = sum(shift_of(c, law, rms) for law, rms in laws.items())
    return replace(m, position=m.position + following_noise(m.position.shape, stays, sigma, seed) + shifts)


def assert_noise_is_best_beside(case: Case, effects: Sequence[Effect]) -> None:
    assert case.form.ar_coefficient > 0
    assert better_ar_form(case, np.unique(case.group(effects))) is None


@pytest.mark.slow
def test_a_law_takes_the_place_of_a_cause_that_was_found_under_noise_that_follows_itself() -> None:
    m = hidden_in(0.75, 20e-6, 5, {PRODUCT: 42e-6})
    cause = diagnose(robot(NAME), m, laws=False)
    assert [c.label for c in cause.causes] == ["nonlinear_stiffness@2"]
    found = diagnose(robot(NAME), m)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert found.law.form.ar_coefficient == found.case.form.ar_coefficient
    assert found.law.best.tried.driver.text == "tau2*tau3"
    law = found.law.best.law
    assert_noise_is_best_beside(with_law(found.case, law), [law])
    said, later = laws_of_diagnosis(found), laws_of_diagnosis(cause)  # which has no law yet
    assert later.rounds[0].form.ar_coefficient == said.rounds[0].form.ar_coefficient == found.case.form.ar_coefficient
    assert later.lines == said.lines
    note = f"Nats and factors assume autocorrelated noise with the coefficient {found.case.form.ar_coefficient:.2g}"
    assert note in plain_text(said.blocks(), 200)
    assert said.to_json()["rounds"][0]["noise_ar_coefficient"] == pytest.approx(
        found.case.form.ar_coefficient, abs=1e-4
    )


def test_noise_that_follows_itself_has_rivals_of_its_own() -> None:
    c, rng = where_noise_follows("kr210-P02", 0.6), np.random.default_rng(7)
    noise = following_noise(c.whole.r.shape, 0.6, 20e-6, 7)
    usual = replace(c, whole=replace(c.whole, r=noise.copy()))
    assert best_form_given_ar(usual, NONE)[1] < 3
    noise[rng.choice(len(noise), 6, replace=False)] *= 5
    label, gain = best_form_given_ar(replace(c, whole=replace(c.whole, r=noise)), NONE)
    assert label == HEAVY_TAILS
    assert gain > 10
    # Poses that are left out later have no part in how likely this noise is.
    kept = usual.inliers & (np.arange(len(usual.inliers)) > 5)
    fewer = usual.with_inliers(kept)
    anew = fewer.with_form(ar_form(0.6, int(kept.sum())))
    assert best_form_given_ar(fewer, NONE)[1] == pytest.approx(best_form_given_ar(anew, NONE)[1], abs=1e-6)


def test_noise_is_a_rival_of_every_law() -> None:
    (first, *_) = discovered(5, "stop").rounds
    assert first.claimed
    assert first.noise[0] in ("autocorrelated noise", "noise with heavy tails", "poor repeatability of joint 3")
    assert not replace(first, noise=("autocorrelated noise", first.best.score)).claimed


@pytest.mark.slow
def test_laws_of_a_large_campaign_are_searched_on_some_of_its_poses() -> None:
    found = laws_of_diagnosis(replace(discovered(5, "stop").diagnosis, law=None), poses=36)
    assert found.thinned == (36, 80)
    assert found.case.inliers.sum() == 36
    assert [s.law.place for s in found.laws] == ["joint 3"]
    assert "Laws were searched on 36 of 80 poses." in plain_text(found.blocks(), 100)
    assert found.to_json("stop")["poses"] == {"searched": 36, "all": 80}
    assert len(found.refit().measurements[0]) == 80
    c = where_noise_follows("kr210-P02", 0.8)
    assert contest.thinned(c, 36).form.ar_coefficient == pytest.approx(
        0.8 ** (c.inliers.sum() / 36)
    )  # less stays over longer ways


def test_a_diagnosis_that_is_unknown_says_the_law() -> None:
    found = discovered(5, "stop")
    assert found.diagnosis.verdict == "unknown"
    more = Details(laws=found)
    assert "LAW      joint 3 += " in diagnosis_page(found.diagnosis, more)
    assert any(
        b.text.startswith("Law: joint 3 += ") for b in brief("stop", found.diagnosis, more) if isinstance(b, Words)
    )
    assert diagnosis_json(found.diagnosis, "stop", more)["laws"]["laws"][0]["driver"] == "q4"
    nothing = Details(laws=replace(found, laws=()))
    assert "no law is claimed: " in diagnosis_page(found.diagnosis, nothing)


@pytest.mark.slow
def test_laws_are_searched_beside_a_curve_alone_unless_they_are_declined(monkeypatch: pytest.MonkeyPatch) -> None:
    found = diagnose(robot(NAME), from_table(table(5, "stop"), 6), ["joint_error_curve"])
    assert found.verdict == "unknown"
    assert laws_of_diagnosis(found).laws
    assert analyse(found, laws=False).laws is None
    # A search given curves may find no law that is better than none: it is the last one.
    monkeypatch.setattr(contest, "search_laws", lambda c, chosen, *rest: [] if len(chosen) else search_laws(c, chosen))
    assert len(laws_of_diagnosis(found).rounds) == 1


@pytest.mark.slow
def test_no_law_is_searched_where_only_the_size_of_the_noise_is_in_doubt() -> None:
    """Joints that repeat to 60 urad, which is more than those of any arm should, scatter as independent noise."""
    m = simulated(NAME, 5, planted("gear_eccentricity", 4, size=400e-6), n=100, noise_mm=0.002)
    scattered = m.q + 60e-6 * np.random.default_rng(1).standard_normal(m.q.shape)
    assert m.position is not None
    shift = predicted(robot(NAME), replace(m, q=scattered))[0] - predicted(robot(NAME), m)[0]
    found = diagnose(robot(NAME), replace(m, position=m.position + shift))
    assert (found.verdict, [c.label for c in found.causes]) == ("unknown", ["gear_eccentricity@4"])
    assert "repeat to" in found.account.doubt
    more = analyse(found)
    assert more.laws is None
    assert "no law was searched" in diagnosis_page(found, more)


@pytest.mark.slow
def test_a_cause_that_a_law_explains_better_is_not_named() -> None:
    alone = diagnose(robot(NAME), from_table(table(5, "stop"), 6), laws=False)
    held = diagnose(robot(NAME), from_table(table(5, "stop"), 6))
    assert [c.label for c in alone.causes] == ["joint_coupling@3"]
    assert (held.verdict, held.causes) == ("unknown", ())
    assert held.law is not None
    assert held.law.best.law.place == "joint 3"
    right = discovered(7, "eccentric").diagnosis
    assert right.law is None  # none is claimed
    assert [c.label for c in right.causes] == ["gear_eccentricity@4"]


@pytest.mark.slow
def test_a_law_takes_the_place_of_causes_only_where_it_predicts_better() -> None:
    """A right flexure was replaced by a law of more evidence that was worse on poses held out."""
    right = discovered(7, "eccentric").diagnosis
    law = contest.laws_before_causes(right)
    sure = replace(law.best, score=1e6)
    claimed = replace(law, laws=(sure,), listed=("", 0.0), smooth=("", 0.0), noise=("", 0.0), alias=())
    assert claimed.claimed
    assert contest.replaces_causes(replace(right, causes=()), claimed)
    by_law = held_out(right.case, NONE, [sure], sure.noise, right.seed).mean()
    by_cause = held_out(right.case, right.columns, (), right.noise, right.seed).mean()
    assert contest.replaces_causes(right, claimed) == bool(by_law < by_cause)
    blind = replace(
        sure, columns=0 * sure.columns, tried=replace(sure.tried, form=FORMS["linear"], x=(0 * sure.tried.x[0],))
    )
    assert not contest.replaces_causes(right, replace(claimed, laws=(blind,)))


def test_a_driver_beyond_all_measure_is_none() -> None:
    """A load over a rated torque of zero; a sealed robot of four axes was refused for it."""
    r, m = robot(NAME), from_table(table(1), 6)
    usual, great = (Driver(text, "signed", "load") for text in ("tau2", "1e7*tau2"))
    kept, values = values_of(linearise(r, m, r.parameters.values), [great, usual])
    assert (kept, values.shape) == ([usual], (80, 1))


def test_a_line_a_person_can_read() -> None:
    law = Law(2, "joint", "a*max(0, abs(tau3) - 0.3)")
    assert line_of(law, {"a": 84e-6}) == "joint 2 += 84 urad * max(0, |tau3| - 0.3)"
    vector = Law(3, "tilt", "[a, b, c]*sin(2*q4) + [d, e, f]*cos(2*q4)", tuple((n, 1e-5) for n in "abcdef"))
    values = dict(zip("abcdef", (1e-6, -2e-6, 3e-6, 0.0, 0.0, 4e-5), strict=True))
    assert line_of(vector, values) == "tilt of link 3 += [1, -2, 3] urad * sin(2*q4) + [0, 0, 40] urad * cos(2*q4)"
    assert FORMS["wave"].texts("q4", [2.0]) == ("sin(2*q4)", "cos(2*q4)")


def test_the_files_are_read_again(tmp_path: Path) -> None:
    found = discovered(5, "stop")
    for path, text in found.files(tmp_path, "stop").items():
        path.write_text(text)
    whole, alone = read_robot(tmp_path / "discovered.robot.toml"), read_effects(tmp_path / "law.effect.toml")
    m = found.case.m
    again = found.apply()
    # Files of results have the digits that are known.
    np.testing.assert_allclose(predicted(whole, m)[0], predicted(again, m)[0], rtol=0, atol=1e-9)
    assert alone.effects == tuple(s.law for s in found.laws)
    assert alone.values == pytest.approx({k: again.effect_values[k] for k in alone.values}, rel=1e-5)
    kept = json.loads((tmp_path / "discovery.json").read_text())
    assert kept["verdict"] == "law"
    assert kept["laws"][0]["line"] in (tmp_path / "law.effect.toml").read_text()
    assert kept["rounds"][0]["claimed"]
    bad = (tmp_path / "law.effect.toml").read_text().replace("a*max(", "a*open(")
    (tmp_path / "bad.toml").write_text(bad)
    with pytest.raises(InputError, match=r"bad.toml: effect\[1\].*unknown function 'open'"):
        read_effects(tmp_path / "bad.toml")
