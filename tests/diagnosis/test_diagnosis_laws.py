"""Laws found in simulated campaigns: the search against exact evidence, what is claimed, and the files of it."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cases import case, following_noise, plant, robot, simulated
from planted import campaign, misread, planted
from scipy.integrate import solve_ivp

from casadical import Body, Discovery, diagnose, discover
from casadical.blind_check.mujoco_physics import perturb
from casadical.blind_check.mujoco_physics.stops import Stops
from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import Words
from casadical.core.reporting.result import plain_text
from casadical.diagnosis.details import Details, analyse
from casadical.diagnosis.evidence import KAPPA_WEIGHTS
from casadical.diagnosis.laws import discovery
from casadical.diagnosis.laws.answer import line_of
from casadical.diagnosis.laws.candidates import Round, descriptions, places_of, prior_weight
from casadical.diagnosis.laws.discovery import laws_of_diagnosis
from casadical.diagnosis.laws.forms import (
    FORMS,
    SMOOTH_FORM,
    Function,
    StateVariable,
    state_variables,
    value_of,
    varying,
)
from casadical.diagnosis.laws.search import (
    aliases,
    held_out,
    laws_before_causes,
    ranked_laws,
    ranking_of,
    replaces_causes,
    thinned,
    with_law,
)
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import linearise
from casadical.diagnosis.noise_forms import ar_form, better_ar_form
from casadical.diagnosis.posterior import PRIOR_FIRST
from casadical.diagnosis.text import as_json as diagnosis_json
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


@cache
def laws_alone(name: str, stays: float = 0.0) -> Round:
    """Laws of a practice campaign beside all other candidates, without a cause in the model."""
    c = where_noise_follows(name, stays)
    found = ranked_laws(c, NONE, ranking_of(c, NONE))
    assert found is not None
    return found


@cache
def discovered(seed: int, hidden: str = "nothing") -> Discovery:
    """Laws given a few listed effects, which take less time than all."""
    few = ["joint_coupling", "gear_eccentricity", "backlash"]
    return discover(robot(NAME), from_table(table(seed, hidden), 6), few)


def function_of(form, x: Array) -> Function:
    return Function(StateVariable("angle", (1,), (), ()), "q1 + q2", form, x, {})


@pytest.mark.parametrize("form", FORMS.values(), ids=lambda f: f.name)
def test_the_formula_that_is_written_out_is_the_one_that_was_judged(form) -> None:
    x = np.random.default_rng(0).uniform(-1.5, 1.0, 40)
    f = function_of(form, x)
    for k in (0, len(f.settings) // 2, len(f.settings) - 1):
        values = f.values(f.settings[[k]])[:, :, 0]
        for part, text in zip(values, form.texts("q1 + q2", f.settings[k].tolist()), strict=True):
            (found,) = parse(text).values({"q1": 0.4 * x, "q2": 0.6 * x}, NUMERIC_FUNCTIONS)
            np.testing.assert_allclose(found, part, rtol=1e-9, atol=1e-9)


def test_a_form_that_is_constant_over_the_poses_has_a_size() -> None:
    x = np.linspace(0.0, 1.0, 20)
    assert function_of(FORMS["linear"], np.ones(20)).scaled(np.zeros((1, 0)))[1].tolist() == [[1e-3]]
    assert function_of(FORMS["linear"], x).scaled(np.zeros((1, 0)))[1][0, 0] == pytest.approx(x.std())


def test_a_smooth_function_is_a_random_walk_of_its_driver() -> None:
    """Its variance is that of a Brownian motion with reflected ends: what cosines of size 1/h sum to."""
    x = np.linspace(-2.0, 1.0, 400)
    f = Function.smooth(StateVariable("angle", (1,), (), (("q1", "angle"),)), {"q1": x})
    _, units = f.scaled(f.settings)
    assert (f.form.name, len(f.settings)) == (SMOOTH_FORM, 1)
    np.testing.assert_allclose(units[:, 0], np.arange(1, 7) * np.sqrt(0.5), rtol=0.01)
    np.testing.assert_allclose(f.values(f.settings)[1, :, 0], np.cos(2 * np.pi * (x + 2) / 3), atol=2e-3)


def test_drivers_are_what_the_robot_and_the_table_say() -> None:
    r, m = robot(NAME), from_table(table(1), 6)
    every = state_variables(r)
    m, _ = derive(m, ["progress", "move5"], r.loads)
    found, values = varying(linearise(r, m, r.parameters.values), every)
    tau = r.model.function("torque", ("tau",)).map(len(m))
    w = m.condition_matrix(r.conditions, r.declared)
    load = tau(m.q.T, w.T, r.parameters.values).full() / np.reshape(r.torque_scale, (-1, 1))
    np.testing.assert_allclose(values["tau2"], load[1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(value_of("q3 - q4", values), m.q[:, 2] - m.q[:, 3], atol=1e-12)
    np.testing.assert_allclose(values["move5"], m.conditions["move5"], atol=1e-12)
    np.testing.assert_allclose(values["t"], np.arange(80) / 79, atol=1e-12)
    names = {v.words for v in found}
    assert {"load of joint 2", "angles of joints 3 and 4", "time"} <= names
    # The first joint stands upright, and no column of motions was derived for the others.
    assert not {"load of joint 1", "motion history of joint 2"} & names


def test_a_driver_beyond_all_measure_is_none() -> None:
    """A load over a rated torque of zero; a sealed robot of four axes was refused for it."""
    r, m = robot(NAME), from_table(table(1), 6)
    usual, great = (StateVariable("load", (2,), (), ((text, "signed"),)) for text in ("tau2", "1e7*tau2"))
    assert varying(linearise(r, m, r.parameters.values), [great, usual])[0] == [usual]


def test_a_part_errs_by_what_is_its_own() -> None:
    variables = {v.words: v for v in state_variables(robot(NAME))}
    joint, payload = Law(3, "joint", "a"), Law(None, "payload", "a", (("a", 0.01),))
    at_joint = {words: prior_weight(joint, v) for words, v in variables.items()}
    assert at_joint["load history of joint 3"] == at_joint["angle of joint 4"] == at_joint["time"] == 1.0
    assert at_joint["angle of joint 6"] == 0.1
    assert at_joint["load history of joint 5"] == 0.0
    assert [w for w, v in variables.items() if prior_weight(payload, v)] == ["time", "temperature", "payload"]


def where_noise_follows(name: str, stays: float) -> Case:
    c = case(name)
    return c.with_form(ar_form(stays, int(c.inliers.sum()))) if stays else c


@pytest.mark.parametrize("stays", [0.0, 0.7])
def test_laws_are_judged_as_the_effects_that_they_are(stays: float) -> None:
    """Law and effect have the same columns, and the evidence that the ranking of causes gives the effect."""
    c, laws = where_noise_follows("kr210-P02", stays), laws_alone("kr210-P02", stays).laws
    c = replace(c, whole=replace(c.whole, near=(0, 2, 4)))._with_evidence(replace(c.evidence, near=(0, 2, 4)))
    base = float(np.logaddexp.reduce(c.judged.log_base(NONE), axis=None))
    for s in [next(s for s in laws if (s.form == SMOOTH_FORM) == smooth) for smooth in (True, False)]:
        more = with_law(c, s.law)
        columns = s.candidate.columns(s.settings[None])[:, :, 0]
        found = more.whole.take(more.group((s.law,)))[c.inliers]
        np.testing.assert_allclose(found, columns, rtol=0, atol=6e-3 * np.abs(columns).max())
        grid = more.judged.log_grids([more.group((s.law,))], NONE) + np.log(KAPPA_WEIGHTS)
        assert float(np.logaddexp.reduce(grid, axis=None)) - base == pytest.approx(s.evidence, abs=0.1)


@pytest.mark.slow
def test_laws_that_cannot_reach_what_is_needed_are_left_out() -> None:
    c, best = case("kr210-P02"), laws_alone("kr210-P02").best
    assert ranked_laws(c, NONE, ranking_of(c, NONE), needed=best.score + 100) is None


@pytest.mark.parametrize("text", ["memory2_300mrad", "tau2*memory2_1000mrad", "wave"])
def test_memory_and_waves_by_the_load_are_written_out_as_they_were_judged(text: str) -> None:
    c = case("kr210-P02")
    words = "angle and load of joint 2" if text == "wave" else "motion history of joint 2"
    smooth = next(d for d in descriptions(c) if (d.place.place, d.function.variable.words) == ("joint 2", words))
    function = next(f for f in smooth.function.others() if f.driver == text or text in f.form.name)
    one = replace(smooth, function=function)
    settings = function.settings[len(function.settings) // 2]
    more = with_law(c, one.law(settings))
    found = more.whole.take(more.group((one.law(settings),)))[c.inliers]
    expected = one.columns(settings[None])[:, :, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=6e-3 * np.abs(expected).max())


def test_a_cable_that_stops_a_joint_is_found() -> None:
    found = discovered(5, "stop")
    (s,) = found.laws
    assert (s.law.place, s.candidate.function.driver, s.form) == ("joint 3", "q4", "hinge")
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


@pytest.mark.slow
def test_a_law_is_looked_for_where_all_would_be_noise_of_any_size() -> None:
    m, arm = from_table(table(4), 6), robot(NAME)
    there = heated(m)
    there = replace(m, position=there.position + predicted(arm, there)[0] - predicted(arm, m)[0])
    found = diagnose(arm, there)
    said = laws_of_diagnosis(found)
    assert (found.verdict, found.causes) == ("unknown", ())
    first = next(iter(said.rounds[0].drivers))
    assert (first.words, said.rounds[0].description.law.place) == ("load history of joint 3", "joint 3")


@pytest.mark.slow
def test_a_law_that_is_a_listed_effect_by_another_name_is_said_as_such() -> None:
    case = discovered(7, "eccentric").diagnosis.case
    ranking = ranking_of(case, NONE)
    first = ranked_laws(case, NONE, ranking).best
    assert ranking.order[0] == "gear_eccentricity@4"
    assert "gear_eccentricity@4" in aliases(case, NONE, first, ranking.variant)


PRODUCT = Law(2, "joint", "a*tau2*tau3", (("a", 1e-4),))


def shift_of(c: Case, law: Law, rms: float) -> Array:
    """What a law of one factor does to the positions, of this rms [m], shape (n, 3)."""
    planted = with_law(c, law)
    unit = planted.whole.take(planted.group((law,)))[:, :, 0]
    return rms * unit / unit.std()


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
    assert found.law.best.candidate.function.driver == "tau2*tau3"
    law = found.law.best.law
    assert_noise_is_best_beside(with_law(found.case, law), [law])
    said, later = laws_of_diagnosis(found), laws_of_diagnosis(cause)  # which has no law yet
    assert later.rounds[0].form.ar_coefficient == said.rounds[0].form.ar_coefficient == found.case.form.ar_coefficient
    assert later.lines == said.lines
    note = "Probabilities and factors assume autocorrelated noise with the coefficient"
    assert f"{note} {found.case.form.ar_coefficient:.2g}" in plain_text(said.blocks(), 200)
    assert said.to_json()["rounds"][0]["noise_ar_coefficient"] == pytest.approx(
        found.case.form.ar_coefficient, abs=1e-4
    )


def test_a_form_is_claimed_only_if_nothing_further_and_no_listed_effect_is_probable() -> None:
    (first, *_) = discovered(5, "stop").rounds
    assert first.claimed
    assert first.probability >= 0.97
    assert not replace(first, further=0.4).claimed
    assert not replace(first, alias=("joint_coupling@3",)).claimed
    smooth = next(s for s in first.laws if s.form == SMOOTH_FORM)
    assert not replace(first, laws=(smooth, *first.laws)).claimed
    noise = max(first.rivals, key=lambda k: ("noise" in k, first.rivals[k]))
    doubted = replace(first.ranking, log_mass={**first.ranking.log_mass, noise: 1e3})
    assert not replace(first, ranking=doubted).claimed


def two_bumps(q: Array) -> Array:
    """Error of a joint over another's reading q, shape (n,) [rad]."""
    share = (q - q.min()) / np.ptp(q)
    return np.asarray(4e-4 * (np.exp(-(((share - 0.25) / 0.1) ** 2)) - np.exp(-(((share - 0.6) / 0.1) ** 2))))


@pytest.mark.slow
def test_a_form_outside_the_grammar_is_described_by_its_driver() -> None:
    """Two bumps over the angle of joint 4: no form of the grammar has them."""
    bumps = misread(3, lambda stops: two_bumps(stops.q[:, 3]))
    m = from_table(campaign(perturb(plant(robot(NAME)), 5), 100, 5, [bumps], noise_mm=0.02, approach="motion"), 6)
    found = discover(robot(NAME), m, ["backlash"])
    assert not found.laws
    assert found.description.variable.words == "angle of joint 4"
    assert found.described.startswith("the error of joint 3 depends on the angle of joint 4, ")
    assert found.gap["described"] < 0.9 * found.gap["base"]
    kept = found.to_json()
    assert (kept["verdict"], kept["described"]["driver"]) == ("described", "angle of joint 4")
    (low, high), unit = kept["described"]["rms"]["interval"], kept["described"]["rms"]["unit"]
    assert (0 < low < two_bumps(m.q[:, 3]).std() < high < 2.5 * low, unit) == (True, "rad")
    assert len(found.apply().effects) == len(found.diagnosis.identification.robot.effects) + 1


@pytest.mark.slow
def test_laws_of_a_large_campaign_are_searched_on_some_of_its_poses() -> None:
    d = discovered(5, "stop").diagnosis
    together = replace(d.case, whole=replace(d.case.whole, stop=np.arange(80) // 2), inliers=d.case.inliers)
    assert laws_of_diagnosis(replace(d, law=None, case=together), poses=64).shrink
    found = laws_of_diagnosis(replace(d, law=None), poses=64)
    assert found.thinned == (64, 80)
    assert found.case.inliers.sum() == 64
    assert [s.law.place for s in found.laws] == ["joint 3"]
    assert "Laws were searched on 64 of 80 poses." in plain_text(found.blocks(), 100)
    assert found.to_json("stop")["poses"] == {"searched": 64, "all": 80}
    assert len(found.refit().measurements[0]) == 80
    c = where_noise_follows("kr210-P02", 0.8)
    assert thinned(c, 36).form.ar_coefficient == pytest.approx(
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
    assert "no form is claimed: " in diagnosis_page(found.diagnosis, nothing)


@pytest.mark.slow
def test_laws_are_searched_beside_a_curve_alone_unless_they_are_declined(monkeypatch: pytest.MonkeyPatch) -> None:
    found = diagnose(robot(NAME), from_table(table(5, "stop"), 6), ["joint_error_curve"])
    assert found.verdict == "unknown"
    assert laws_of_diagnosis(found).laws
    assert analyse(found, laws=False).laws is None
    # Nothing may vary over the poses that a law may follow: the first ranking is the last one then.
    monkeypatch.setattr(discovery, "ranked_laws", lambda *_rest: None)
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
    law, _ = laws_before_causes(right)
    sure = next(s for s in law.laws if s.form != SMOOTH_FORM)
    sure = replace(sure, score=1e6)
    ranking = law.ranking.with_rivals({sure.candidate.label: (1e6, sure.noise)}, PRIOR_FIRST)
    claimed = replace(law, laws=(sure,), ranking=ranking, alias=(), further=1.0)
    assert claimed.claimed
    assert replaces_causes(replace(right, causes=()), claimed)
    by_law = held_out(right.case, NONE, [sure], sure.noise, right.seed).mean()
    by_cause = held_out(right.case, right.columns, (), right.noise, right.seed).mean()
    assert replaces_causes(right, claimed) == bool(by_law < by_cause)
    blind = replace(sure, candidate=replace(sure.candidate, unit=0 * sure.candidate.unit))
    assert not replaces_causes(right, replace(claimed, laws=(blind,)))


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


@pytest.mark.parametrize("payload", [None, Body(3.0, np.zeros(3))])
def test_a_law_is_tried_at_every_place_and_no_direction_is_preferred(payload: Body | None) -> None:
    places = places_of(replace(robot("ur10e"), payload=payload))
    seams = Counter(law.seam for law in places)
    assert seams.pop("payload", 0) == (payload is not None)
    assert seams == {"joint": 6, "tilt": 6, "shift": 5, "base tilt": 1, "base shift": 1, "tool shift": 1}
    for sizes in ({size for _, size in law.factors} for law in places if len(law.factors) == 3):
        assert len(sizes) == 1
