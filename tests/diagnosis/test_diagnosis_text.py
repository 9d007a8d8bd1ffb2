"""The page that a person reads: a golden text of fixed numbers, its width, and what further poses promise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cases import diagnose, made_up, practice, robot, with_none

from casadical.core.reporting.result import plain_text
from casadical.diagnosis.details import Details, analyse
from casadical.diagnosis.diagnose import Diagnosis
from casadical.diagnosis.held_out_gap import COURSE_COLUMNS, Check, NetworkGap
from casadical.diagnosis.isolability import Isolability
from casadical.diagnosis.localisation import BIN_COLUMNS, DIRECTION_COLUMNS, PART_COLUMNS, Localisation
from casadical.diagnosis.next_poses import probability_after
from casadical.diagnosis.noise_account import NoiseAccount
from casadical.diagnosis.noise_floor import Replicates
from casadical.diagnosis.result import Cause, CauseSet, Gap, Outlier
from casadical.diagnosis.statements import headline, missing_columns, not_logged
from casadical.diagnosis.text import PAGE_WIDTH, as_json, brief, page_of
from casadical.effects import Backlash, ThermalZeroDrift
from casadical.measurements.measurements import Noise

GOLDEN = Path(__file__).parent / "golden"


@pytest.fixture(scope="module")
def true() -> Diagnosis:
    return diagnose(robot("ur10e"), practice("ur10e-P09"), ["backlash@2", "nonlinear_stiffness@2", "frame_drift"])


@pytest.fixture(scope="module")
def fixed(true: Diagnosis) -> Diagnosis:
    """A diagnosis of made-up numbers."""
    label, rival = "backlash@2", "nonlinear_stiffness@2"
    causes = (
        Cause(
            "backlash", 2, 0.55, 0.44, (0.38, 0.49), (rival,), (Backlash(2, 0.04, 0.02),),
            {"half": (61e-6, 7e-6, "rad")},
        ),
        Cause(
            "thermal_zero_drift", 3, 0.97, 0.2, (0.14, 0.25), (), (ThermalZeroDrift(3, 600.0),),
            {"drift": (4.1e-6, 0.6e-6, "rad/K")},
        ),
        Cause("outliers", None, 0.99, 0.03, (0.01, 0.08), ()),
    )  # fmt: skip
    rows = [
        ("base", 0.127, 0.118, 0.136, 0.126, 0.131, 0.124, 0.112, 0.135),
        (f"+ {label}", 0.071, 0.066, 0.077, 0.07, 0.075, 0.066, 0.058, 0.073),
        ("+ thermal_zero_drift@3", 0.046, 0.041, 0.052, 0.045, 0.055, 0.038, 0.031, 0.044),
    ]
    noise = Noise(12e-6, 5e-6)
    account = NoiseAccount(14e-6, 12e-6, 5e-6, 20e-6, 0.0, 12e-6, 36, "repeats", 0.0, "", (), like_noise=True)
    one = replace(made_up({label: 0.55, rival: 0.45}, 1e-9), noise={"": noise})
    return replace(
        true,
        verdict="ambiguous",
        causes=causes,
        gap=Gap(131e-6, 46e-6, 21e-6, 127e-6),
        noise=noise,
        account=account,
        unknown_rest=0.2,
        course=pd.DataFrame(rows, columns=list(COURSE_COLUMNS)),
        replicates=Replicates(12e-6, 18, 6, 36),
        rankings=(one,),
        cause_set=CauseSet(
            0.52, 0.04, {label: 0.98, "thermal_zero_drift@3": 0.97}, (), {label: {label: 0.55, rival: 0.43}}
        ),
        case=replace(true.case, m=replace(true.case.m, conditions={})),
        outliers=(Outlier(31, 1.7e-3, 80.0), Outlier(62, 0.9e-3, 40.0)),
        missing={
            "payload_error": ("payload_kg",),
            "thermal_growth": ("warmth_0s", "warmth_300s"),
            "thermal_zero_drift@1": ("warmth_0s", "warmth_300s"),
            "thermal_zero_drift@2": ("warmth_0s", "warmth_300s"),
        },
    )


@pytest.fixture(scope="module")
def seen() -> Details:
    """Where it lies and what the poses show, made up."""
    label, rival = "backlash@2", "nonlinear_stiffness@2"
    parts = [
        ("joint 2", 0.41, 0.34, 0.48, 0.05),
        ("joint 3", 0.22, 0.15, 0.3, 0.03),
        ("elsewhere", 0.37, 0.3, 0.4, 0.04),
    ]
    links = [("base", 0.08, 0.05, 0.12, 0.02), ("tool", 0.01, 0.0, 0.02, 0.001), ("elsewhere", 0.91, 0.88, 0.95, 0.07)]
    payload = [
        ("payload", "0 kg", 50, 0.3, 0.22, 0.38, 0.1, 0.09, 0.11),
        ("payload", "10 kg", 50, 0.7, 0.62, 0.78, 0.16, 0.14, 0.18),
    ]
    none = pd.DataFrame(columns=list(BIN_COLUMNS))
    tables = [pd.DataFrame(parts, columns=list(PART_COLUMNS)), pd.DataFrame(links, columns=list(PART_COLUMNS))]
    directions = pd.DataFrame(columns=list(DIRECTION_COLUMNS))
    where = Localisation(*tables, directions, none, pd.DataFrame(payload, columns=list(BIN_COLUMNS)), none, none, none)
    effects = pd.DataFrame(
        {"size_mm": [0.1, 0.1, 0.1, 0.0], "absorbed": [0.6, 0.7, 0.99, 1.0], "findable_from": [0.5, 0.6, 9.0, np.inf]},
        index=[label, rival, "gravity_compensator", "link_flexure"],
    )
    alike = pd.DataFrame([[1, 0.78], [0.7, 1]], index=[label, rival], columns=[label, rival])
    return Details(where, Isolability(effects, lambda _: alike, {}))


@pytest.fixture(scope="module")
def poses() -> pd.DataFrame:
    """Four poses, upright and stretched out."""
    q = {f"q{i}_deg": [0.0] * 4 for i in range(1, 7)} | {"q2_deg": [-90.0, -90.0, -90.0, 0.0]}
    more = {
        "payload_kg": [0.0, 10.0, 0.0, 10.0],
        "approach2": [1, -1, 1, -1],
        "repeats": ["row 3", "", "", ""],
        "new": ["", "range of q2", "", ""],
    }
    return pd.DataFrame({"order": [1, 2, 3, 4], **q, **more, "separation": [0.1, 0.4, 0.9, 1.5]})


@pytest.fixture(scope="module")
def details(seen: Details, poses: pd.DataFrame) -> Details:
    networks = NetworkGap(127e-6, 120e-6, 131e-6, 3), NetworkGap(46e-6, 46e-6, 60e-6, 5)
    return replace(seen, check=Check(47e-6, 46e-6), networks=networks, poses=poses, file="next.csv")


def test_page_is_the_golden_one(fixed: Diagnosis, details: Details) -> None:
    """If the change is wanted: write page_of(...) to the file."""
    assert page_of(fixed, details) + "\n" == (GOLDEN / "page.txt").read_text(encoding="utf-8")


def test_the_short_answer_fits_a_screen_and_has_the_verdict_first(fixed: Diagnosis, details: Details) -> None:
    lines = plain_text(brief("made-up", fixed, details), 100).splitlines()
    assert lines[0].strip() == "made-up"
    assert lines[1].startswith("Ambiguous: backlash@2 (0.55) or nonlinear_stiffness@2 (0.43); thermal_zero_drift@3;")
    assert len(lines) <= 25
    text = " ".join(" ".join(lines).split())
    for words in ("before: calibrated, without causes 0.127", "after: with the causes in the model 0.0460"):
        assert words in text
    assert "backlash@2 0.55 38 to 49 %" in text
    assert "These data cannot tell backlash@2 from nonlinear_stiffness@2" in text
    assert "before, outliers in 0.131" in text
    assert as_json(fixed, "made-up")["set"]["names"] == {
        "backlash@2": {"backlash@2": 0.55, "nonlinear_stiffness@2": 0.43}
    }


@pytest.mark.parametrize("verdict", ["none", "unknown"])
def test_verdicts_without_a_cause(fixed: Diagnosis, seen: Details, verdict: str) -> None:
    d = replace(fixed, verdict=verdict, causes=(), cause_set=None, course=fixed.course[:1], outliers=(), missing={})
    assert page_of(d, seen) + "\n" == (GOLDEN / f"{verdict}.txt").read_text(encoding="utf-8")


def test_an_explained_gap_of_which_much_is_left_says_so_first(fixed: Diagnosis) -> None:
    def first(**changes: object) -> str:
        d = replace(fixed, verdict="explained", causes=fixed.causes[:2], outliers=(), cause_set=None, **changes)
        assert as_json(d, "made-up").get("in_part_only", False) is (not changes)
        return " ".join(page_of(d).partition("\nGAP")[0].split())

    named = "backlash@2 and thermal_zero_drift@3"
    rest = "yet 0.038 of 0.124 mm rms beyond the noise (31 % of the rms) has no named cause"
    assert first() == f"VERDICT explained in part only: {named}; {rest}"
    none = first(unknown_rest=0.01)
    assert none == f"VERDICT explained: {named}; 0.127 -> 0.046 mm, noise alone would leave 0.021"


@pytest.mark.parametrize(("n", "end"), [(6, "row 6 (1.00 mm)"), (8, "row 6 (1.00 mm) and 2 more")])
def test_six_outliers_are_named_and_more_are_counted(fixed: Diagnosis, n: int, end: str) -> None:
    d = replace(fixed, outliers=tuple(Outlier(row, 1e-3, 50.0) for row in range(1, n + 1)))
    said = page_of(d).partition("\nOUT ")[2].partition("\nMISSING ")[0]
    assert " ".join(said.split()).endswith(end)


def test_what_to_log_is_named_as_a_table_names_it(fixed: Diagnosis) -> None:
    assert missing_columns(fixed)["thermal_growth"] == ("temperature_degC", "time_s")
    timed = replace(fixed.case, m=replace(fixed.case.m, conditions={"time_s": np.zeros(120)}))
    assert missing_columns(replace(fixed, case=timed))["thermal_growth"] == ("temperature_degC",)
    lagless = replace(fixed.case, m=replace(fixed.case.m, conditions={"temperature_degC": np.zeros(120)}))
    assert "lag behind" in not_logged(replace(fixed, case=lagless, missing={}))["time_s"]


def test_true_page_is_no_wider_than_it_says(true: Diagnosis) -> None:
    text = page_of(true, analyse(true, poses=3, file="a_rather_long_name_of_a_file.csv"))
    assert max(map(len, text.splitlines())) <= PAGE_WIDTH
    for word in ("VERDICT", "GAP", "WHERE", "WHICH", "AFTER"):
        assert f"\n{word}" in f"\n{text}"


def test_json_holds_what_the_page_says(fixed: Diagnosis, details: Details) -> None:
    answer = as_json(fixed, "made-up", details)
    assert answer["refit_mm"] == {"held_out": 0.047, "linearised": 0.046}
    assert answer["network_mm"][0] == {"before": 0.127, "used": 0.12, "forced": 0.131, "refused": 3}
    assert answer["course"][2]["blocks_mm"] == 0.055
    assert answer["outliers"][0] == {"row": 31, "distance_mm": 1.7, "sigmas": 80.0}
    assert answer["replicates"] == {"sigma_mm": 0.012, "poses": 18, "used": True}
    assert answer["causes"][1]["settings"] == [{"lag": 600.0}]
    assert answer["missing_columns"]["payload_error"] == ["payload_kg"]
    assert answer["where"]["joints"][0]["part"] == "joint 2"
    before, after = answer["told_rightly"]
    assert before == pytest.approx(0.55)
    assert after == pytest.approx(probability_after(0.55, 1.5), abs=1e-4)
    noisy = as_json(replace(fixed, noise=Noise(1.2346e-5, 5.4321e-6)), "made-up", details)["noise"]
    assert noisy["repeatability_urad"] == 5.43


@pytest.mark.parametrize(("share", "gain"), [(0.5, 1.0), (0.7, 0.5), (0.9, 3.0), (0.98, 0.2)])
def test_probability_of_a_right_choice(share: float, gain: float) -> None:
    """Against drawn data: the observation is normal, its mean apart by sqrt(2 gain) under the two causes."""
    rng = np.random.default_rng(0)
    first = rng.random(400_000) < share
    apart = np.sqrt(2 * gain)
    x = rng.standard_normal(first.size) + np.where(first, apart, 0.0)
    odds = np.log(share / (1 - share)) + apart * x - gain
    assert probability_after(share, gain) == pytest.approx(((odds > 0) == first).mean(), abs=0.003)
    assert probability_after(share, 0.0) == max(share, 1 - share)


def test_one_more_cause_is_said_with_its_names_and_the_gap_it_leaves(fixed: Diagnosis) -> None:
    more = {"backlash@1": 0.55, "friction_windup@1": 0.44}
    one = CauseSet(0.01, 0.99, {}, further=more, further_gap=40e-6)
    d = replace(fixed, cause_set=one)
    words = (
        "a further cause is present with probability 0.99, but is not claimed: backlash@1 (0.55) or friction_windup@1 "
        "(0.44); with the first 0.046 -> 0.040 mm on held-out poses"
    )
    assert words in " ".join(page_of(d).split())
    assert "A further cause" in plain_text(brief("arm", d))
    answer = as_json(d, "arm")["set"]
    assert (answer["further"], answer["further_gap_mm"]) == (more, 0.04)


@pytest.mark.parametrize(("probability", "said"), [(0.905, "just above"), (0.93, ""), (0.89, "just below"), (0.8, "")])
def test_a_claim_at_its_threshold_is_said_as_such(fixed: Diagnosis, probability: float, said: str) -> None:
    cause = replace(fixed.causes[1], confidence=probability)
    one = CauseSet(0.9, 0.02, {cause.label: probability})
    d = replace(fixed, verdict="explained" if probability > 0.9 else "ambiguous", causes=(cause,), cause_set=one)
    text = " ".join(page_of(d).split())
    words = f"thermal_zero_drift@3 is {said} the threshold of a claim: probability {probability:.3f}, claimed from 0.9"
    assert (words in text) == bool(said)
    assert ("the threshold of a claim: probability" in text) == bool(said)


@pytest.mark.parametrize(("nothing", "said"), [(0.12, "just below"), (0.09, "just above"), (0.2, ""), (0.01, "")])
def test_something_at_its_threshold_is_said_as_such(fixed: Diagnosis, nothing: float, said: str) -> None:
    first = with_none(fixed.rankings[0], nothing)
    d = replace(fixed, verdict="none", causes=(), cause_set=None, rankings=(first, with_none(first, 0.049)))
    text = " ".join(page_of(d).split())
    assert ("an effect is just" in text) == bool(said)
    assert f"{said} the threshold of detection: P(nothing) = {nothing:.3f}, detected up to 0.1" in text or not said
    assert "a further effect is" not in text  # that was judged again is not beside a cause


def test_where_the_refit_disagrees_its_figure_is_said(fixed: Diagnosis, details: Details) -> None:
    explained = replace(fixed, verdict="explained", unknown_rest=0.0, course=fixed.course.assign(model_mm=0.0))
    wrong = replace(details, check=Check(319e-6, 4.91e-3))  # the linear model of a robot that is far off
    assert [f"-> {said} mm" in headline(explained, more) for more, said in ((details, "0.046"), (wrong, "0.319"))] == [
        True, True
    ]  # fmt: skip
