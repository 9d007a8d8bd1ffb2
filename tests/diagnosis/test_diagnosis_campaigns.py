"""Whole diagnoses: the practice campaigns, the simulator's own, and what was not logged."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cases import ANSWERS, ROOT, diagnose, diagnosed, plant, practice, robot, simulated
from planted import campaign, planted

from casadical.diagnosis.candidates import candidates_of, choose
from casadical.diagnosis.details import analyse
from casadical.diagnosis.diagnose import Diagnosis
from casadical.diagnosis.laws.discovery import describe_unlisted
from casadical.diagnosis.text import as_json, page_of
from casadical.effects import BacklashByLoad
from casadical.effects.plugins import effects_by_name
from casadical.fleet.run import one_robot
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.measurements.derived_columns import derive
from casadical.measurements.reading import from_table, read_measurements

VERDICTS = {"none", "explained", "ambiguous", "unknown"}


def named(d: Diagnosis) -> set[tuple[str, int | None]]:
    return {(c.effect, c.joint) for c in d.causes}


FAST = ("hh800-P01", "ur10e-P06")
slow = pytest.mark.slow


@pytest.mark.parametrize("name", [name if name in FAST else pytest.param(name, marks=slow) for name in ANSWERS])
def test_practice_campaign_gets_its_answer(name: str) -> None:
    d, truth = diagnosed(name), ANSWERS[name]
    assert named(d) == {(e["effect"], e["joint"]) for e in truth["effects"]}
    assert d.verdict == ("explained" if truth["effects"] else "none")
    assert d.noise.sigma == pytest.approx(1e-3 * truth["noise_mm"], rel=0.35)
    assert 1 - d.gap.after / d.gap.before == pytest.approx(truth["true_shrink"], abs=0.15)
    assert 1e3 * d.gap.before == pytest.approx(truth["gap_mean_mm"], rel=0.2)
    assert d.gap.floor <= d.gap.after * 1.1


@pytest.mark.parametrize(
    "name", ["hh800-P01", *(pytest.param(name, marks=slow) for name in ("ur10e-P09", "kr210-P08"))]
)
def test_answer_has_the_campaigns_format(name: str) -> None:
    answer = json.loads(json.dumps(as_json(diagnosed(name), name, analyse(diagnosed(name))), allow_nan=False))
    assert answer["campaign"] == name
    assert answer["verdict"] in VERDICTS
    assert set(answer["gap_mm"]) == {"before", "after", "floor"}
    assert answer["gap_mm"]["before"] > 0
    assert isinstance(answer["where"], dict)
    assert isinstance(answer["next_measurements"], list)
    for cause in answer["causes"]:
        assert isinstance(cause["effect"], str)
        assert cause["joint"] is None or cause["joint"] in range(1, 7)
        assert 0 <= cause["confidence"] <= 1
        low, high = cause["shrink_interval"]
        assert low <= cause["shrink"] <= high
        assert all(isinstance(k, str) for k in cause["indistinguishable"])
    shrinks = [cause["shrink"] for cause in answer["causes"]]
    assert shrinks == sorted(shrinks, reverse=True)


@pytest.mark.slow
def test_what_several_joints_do_is_one_cause() -> None:
    """Drives of one make stay wound up alike: no single joint explains it; those that do not are left out."""
    sizes = {1: 50, 2: 40, 4: 90, 5: 80}
    wound = [planted("friction_windup", j, size=1e-6 * size) for j, size in sizes.items()]
    d = diagnose(robot("ur10e"), simulated("ur10e", 15, *wound))
    assert (d.verdict, named(d)) == ("explained", {("friction_windup", None)})
    assert {e.joint for e in d.effects()} == {*sizes}
    assert d.gap.after < 1.2 * d.gap.floor
    assert "a lag behind the last motion, joints 1, 2, 4 and 5" in page_of(d)
    assert "explained: friction_windup (joints 1, 2, 4 and 5); " in page_of(d)
    assert set(d.causes[0].estimates) == {f"{name}@{j}" for name in ("constant", "load") for j in sizes}
    # Beside something on no list: what is left is not described by one of these joints again.
    d = diagnose(robot("ur10e"), simulated("ur10e", 15, *wound, planted("hose_pull", size=400e-6)))
    left = describe_unlisted(d)
    assert (d.verdict, named(d), left.labels[0]) == ("unknown", {("friction_windup", None)}, "hose_drag")
    assert not {f"friction_windup@{j}" for j in sizes} & {*left.further.order}


@pytest.mark.slow
def test_hose_is_unknown_to_the_standard_list_and_found_by_the_extended_one() -> None:
    m = simulated("ur10e", 31, planted("hose_pull", size=500e-6))
    d = diagnose(robot("ur10e"), m)
    assert (d.verdict, d.causes, d.cause_set) == ("unknown", (), None)
    assert not {c.label: c for c in d.case.candidates}[d.rankings[0].order[0]].listed
    assert d.unknown_rest > 0.1
    d = diagnose(robot("ur10e"), m, "extended")
    assert named(d) == {("hose_drag", None)}
    assert d.causes[0].shrink > 0.25
    # The true hose pulls more sharply than the effect's: a remainder of the wrist is left, and said to be.
    assert d.verdict == "unknown"
    assert "most like poor repeatability of joint 4" in " ".join(page_of(d).split())


def test_outliers_are_a_cause_of_their_own() -> None:
    m = simulated("ur10e", 41)
    position = m.position.copy()
    wrong = np.array([1e-3, -8e-4, 5e-4])
    position[[7, 30, 61]] += wrong
    d = diagnose(robot("ur10e"), replace(m, position=position))
    assert d.verdict == "explained"
    assert named(d) == {("outliers", None)}
    assert sorted(o.row for o in d.outliers) == list(m.row[[7, 30, 61]])
    assert [o.distance for o in d.outliers] == pytest.approx([np.linalg.norm(wrong)] * 3, rel=0.05)


@pytest.mark.slow
def test_outliers_along_one_joint_are_no_single_points() -> None:
    """A damaged tooth errs at few poses, of which each lies far out along the motion of its joint."""
    arm, m = robot("ur10e"), simulated("ur10e", 41)
    at, turn = [7, 30, 61, 66], np.zeros((len(m), 6))
    turn[at, 1] = 1.5e-3, 1.2e-3, -1.4e-3, 1.6e-3
    wrong = predicted(arm, replace(m, q=m.q + turn))[0] - predicted(arm, m)[0]
    d = diagnose(arm, replace(m, position=m.position + wrong))
    assert (d.verdict, d.causes, d.joint_of_outliers) == ("unknown", (), 2)
    assert sorted(o.row for o in d.outliers) == list(m.row[at])
    assert "they deviate along the motion of joint 2" in " ".join(page_of(d).split())
    assert as_json(d, "x")["outliers_along_joint"] == 2


def test_typing_errors_of_one_coordinate_are_no_joint() -> None:
    """Joint 2 moves a stretched arm nearly along z, and so would two typing errors in z."""
    arm, m = robot("ur10e"), simulated("ur10e", 41)
    turn = np.zeros((len(m), 6))
    turn[:, 1] = 1e-6
    motion = predicted(arm, replace(m, q=m.q + turn))[0] - predicted(arm, m)[0]
    at = np.argsort(-np.abs(motion[:, 2]) / np.linalg.norm(motion, axis=1))[:2]
    position = m.position.copy()
    position[at, 2] += [9e-3, -2e-3]
    d = diagnose(arm, replace(m, position=position))
    assert (d.joint_of_outliers, sorted(o.row for o in d.outliers)) == (None, sorted(m.row[at].tolist()))


@pytest.mark.slow
def test_missing_columns_are_reported_and_never_fatal() -> None:
    drift = planted("frame_drift")
    d = diagnose(robot("kr210"), simulated("kr210", 13, drift, drop=("temp", "time")))
    assert {"thermal_growth", *(f"thermal_zero_drift@{j}" for j in range(1, 7))} == set(d.missing)
    assert all(c.startswith("warmth") for c in d.missing["thermal_growth"])
    assert named(d) == {("frame_drift", None)}  # the order of the poses still tells
    assert "not the robot, shows frame_drift: do not compensate it" in " ".join(page_of(d).split())
    bare = replace(simulated("kr210", 13, drift), conditions={})
    d = diagnose(robot("kr210"), bare, ["backlash@2", "thermal_growth", "payload_error", "frame_drift"])
    assert d.verdict in VERDICTS
    assert set(d.missing) == {"thermal_growth"}  # a payload that was not logged is the declared one


@pytest.mark.slow
def test_a_wrong_payload_is_found_though_it_was_not_logged() -> None:
    wrong = planted("payload_error", size=0.1, shift_m=(0.04, 0.0, 0.02))
    m = simulated("ur10e", 14, wrong)
    always = {k: v for k, v in m.conditions.items() if k != "payload_kg"}
    mounted = m.conditions["payload_kg"] > 0
    d = diagnose(robot("ur10e"), replace(m, conditions=always)[mounted])
    assert d.verdict == "explained"
    assert named(d) == {("payload_error", None)}
    as_json(d, "bare")


def test_applied_cause_can_be_identified() -> None:
    d = diagnosed("ur10e-P06")
    with_cause = d.apply()
    assert [e.label for e in with_cause.effects] == ["friction_windup@3"]
    free = ("kinematic", "compliance", *(p.name for e in with_cause.effects for p in e.parameters()))
    m, _ = derive(practice("ur10e-P06"), with_cause.conditions)
    refit = identify(with_cause, m, free, priors=True)
    base = identify(robot("ur10e"), m, priors=True)
    assert refit.sigmas[0][0] < 0.7 * base.sigmas[0][0]
    found = dict(zip(refit.names, refit.estimate, strict=True))
    for name, (value, error, _) in d.causes[0].estimates.items():
        assert found[f"friction_windup@3.{name}"] == pytest.approx(value, abs=2 * error + 2e-6)


@pytest.mark.slow
def test_a_fleet_says_of_the_hh800_what_a_diagnosis_says() -> None:
    row = one_robot(str(ROOT / "problems" / "hh800"), True)
    table = read_measurements(ROOT / "data" / "hh800_twin" / "hh800_twin.csv", 6)
    d = diagnose(robot("hh800"), table, laws=True)
    assert (row["status"], row["verdict"], row["causes"]) == ("ok", d.verdict, ", ".join(c.label for c in d.causes))
    assert len(set(row["names"]) & {f"c{j}" for j in range(1, 7)}) == 6  # what robots of a type share is of it, too


@pytest.mark.slow
def test_backlash_is_in_question_without_the_approaches_and_they_are_said_to_be_taken_from_the_order() -> None:
    """Play that friction holds needs the approach, which is not that from the order here."""
    m = simulated("kr210", 5, planted("backlash", 2, size=60e-6), n=80, drop=("approach",))
    d = diagnose(robot("kr210"), m)
    (cause,) = d.causes
    assert "backlash@2" in (cause.label, *cause.indistinguishable)
    assert "ASSUMED  approach1,2,3,4,5,6: the direction from the pose before" in page_of(d)
    assert any(text.startswith("approach1,2,3,4,5,6") for text in as_json(d, "campaign")["assumed"])


def test_what_stands_for_a_missing_column_is_no_candidate_where_it_was_logged() -> None:
    r = robot("ur10e")
    logged = simulated("ur10e", 3, n=30)
    bare = replace(logged, conditions={k: v for k, v in logged.conditions.items() if not k.startswith(("app", "temp"))})
    for m, there in ((logged, False), (bare, True)):
        found, _ = choose(candidates_of(r, "standard"), m)
        kinds = {type(e) for c in found if c.label == "backlash@3" for v in c.variants for e in v}
        assert (BacklashByLoad in kinds) is there
        assert ("a warm-up that was not measured" in {c.label for c in found}) is there


@pytest.mark.parametrize(("lean_deg", "said"), [(1.35, True), (0.0, False)])
def test_a_claim_that_hangs_on_the_level_of_the_instrument_says_so(lean_deg: float, said: bool) -> None:
    """No weight turns the upright joint 1; as the instrument leans, wind-up and backlash seem to differ by its sign."""
    table = campaign(plant(robot("ur10e")), 100, 1, [planted("friction_windup", 1, size=80e-6)], noise_mm=0.015)
    m = from_table(table, 6)
    c, s = np.cos(np.radians(lean_deg)), np.sin(np.radians(lean_deg))
    d = diagnose(robot("ur10e"), replace(m, position=m.position @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])))
    assert d.causes[0].joint == 1
    assert (d.rankings[0].probability["friction_windup@1"] > 0.9) == said
    assert ('or say frame = "base"' in " ".join(page_of(d).split())) == said


@pytest.mark.parametrize(
    ("logged", "shuffled", "said"), [(True, False, False), (False, False, True), (False, True, False)]
)
def test_a_claim_that_hangs_on_the_order_of_the_rows_says_so(logged: bool, shuffled: bool, said: bool) -> None:
    """Shuffled, the same rows do not show the cause: it did hang on their order."""
    arm, m = robot("ur10e"), simulated("ur10e", 5, n=60, drop=("app", "pose", "time"))
    columns = {f"approach{j}": derive(m, [f"approach{j}"])[0].conditions[f"approach{j}"] for j in range(1, 7)}
    effect = effects_by_name()["friction_windup"](2)
    true = arm.with_effect(effect).with_values({f"{effect.label}.{name}": 2e-4 for name in effect.sizes()})
    there = replace(m, conditions={**m.conditions, **columns})
    m = replace(there if logged else m, position=m.position + predicted(true, there)[0] - predicted(arm, there)[0])
    order = np.random.default_rng(1).permutation(len(m)) if shuffled else np.arange(len(m))
    m = replace(m[order], row=m.row)
    d = diagnose(arm, m, ["friction_windup@2", "gear_eccentricity@2", "nonlinear_stiffness@2"])
    assert ([c.label for c in d.causes if c.confidence > 0.9] == ["friction_windup@2"]) is not shuffled
    words = [text for text in d.case.assumed if text.startswith("the rows are in the order of measuring: friction")]
    assert bool(words) == said
    assert all(text.endswith("log approach2") for text in words)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur10e-P06", "hh800-P04"])
def test_more_rows_never_name_less(name: str) -> None:
    """What halves or thirds of a shipped series name for certain, the whole names."""
    m, arm = practice(name), robot(name.split("-")[0])
    whole = {c.label for c in diagnose(arm, m).causes}
    parts = [m[np.arange(start, len(m), step)] for step in (2, 3) for start in range(step)]
    for part in parts:
        sure = {c.label for c in diagnose(arm, part).causes if c.confidence > 0.9 and not c.indistinguishable}
        assert sure <= whole
