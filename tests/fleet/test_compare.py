"""What changed between campaigns: planted changes are named, nothing is named where nothing changed."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from command_line import run
from lives import NOISE, as_built, changed, measured, write_table
from scipy.stats import multivariate_normal
from typer.testing import CliRunner

from casadical import InputError, Robot, calibrate, identify, plot, read_robot, write_robot
from casadical.cli import app
from casadical.core.linear_gaussian.fit import Fit
from casadical.core.linear_gaussian.marginals import marginals_of
from casadical.core.reporting.blocks import Words, next_step
from casadical.core.reporting.result import plain_text
from casadical.fleet.campaigns import compare_files, day_of, in_order, name_of, other_regions
from casadical.fleet.changes import MEANINGS, Change, _per, in_words, times_in_words
from casadical.fleet.comparison import changes_in, compare, courses_of, evidence_of, shared_information
from casadical.fleet.estimates import Estimate, estimate, estimate_of_file, pooled_repeatability, with_common_noise
from casadical.fleet.evidence import (
    ANOTHER_ROBOT,
    KAPPAS,
    RELATIVE_FREQUENCY,
    Candidate,
    _usual_size,
    candidates_of,
    jumps,
    model_of_campaigns,
    shared_names,
)
from casadical.identification.accuracy import predicted
from casadical.identification.identification import with_unknown_masses
from casadical.identification.misfit import misfit_of, wide_fit
from casadical.robot.robot import with_joint_harmonics

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def arm() -> tuple[Robot, Robot]:
    return as_built(np.random.default_rng(1))


@pytest.fixture(scope="module")
def before(arm: tuple[Robot, Robot]) -> Estimate:
    return estimate((arm[0], measured(arm[1], 1)), "before")


def after(arm: tuple[Robot, Robot], seed: int = 3, **by: float) -> Estimate:
    return estimate((arm[0], measured(changed(arm[1], **by), seed)), "after")


def test_the_evidence_is_that_of_the_difference_of_two_estimates() -> None:
    """With nothing known of theta, log N(difference; C1 + C2 + W) - log N(difference; C1 + C2), by scipy."""
    rng = np.random.default_rng(0)
    A, B = (rng.normal(size=(4, 4)) for _ in range(2))
    C1, C2 = A @ A.T + np.eye(4), B @ B.T + np.eye(4)
    x1, x2 = rng.normal(size=(2, 4))
    E, sizes = rng.normal(size=(4, 2)), np.array([0.5, 2.0])
    H = np.linalg.inv([C1, C2])
    change, scores = Candidate("link", 1, (), E, sizes), np.array([H[0] @ x1, H[1] @ x2])
    model, groups = model_of_campaigns(H, scores, np.full(4, 1e-9**-0.5), [change], [(change, jumps(2))])
    logs = marginals_of(model).log_grids(groups)[0, 0, 0] - marginals_of(model).log_base()[0, 0]
    for kappa, found in zip(KAPPAS, logs, strict=True):
        wide = C1 + C2 + E @ np.diag((kappa * sizes) ** 2) @ E.T
        by_scipy = multivariate_normal(cov=wide).logpdf(x2 - x1) - multivariate_normal(cov=C1 + C2).logpdf(x2 - x1)
        assert found == pytest.approx(by_scipy, abs=1e-6)


def test_a_change_along_a_known_one_keeps_its_digits() -> None:
    """Of parameters that the data tell apart to 1e-2, with a change of all known: by fractions."""
    rng = np.random.default_rng(3)
    J = rng.integers(-9, 10, (2, 40, 5)).astype(float) * 8
    J[:, :, 4] = J[:, :, 3] + rng.integers(-1, 2, (2, 40)) / 16
    H, score = J.transpose(0, 2, 1) @ J, rng.integers(-99, 100, (2, 5)).astype(float)
    known, sizes = np.stack([np.zeros((5, 5)), np.eye(5)]), [np.full(5, 0.5), np.ones(1)]
    each = [Candidate("link", 1, (), np.eye(5)[:, -len(size) :], size) for size in sizes]
    model, _ = model_of_campaigns(H, score, np.full(5, 2.0), each, [(change, jumps(2)) for change in each])
    value, error = Fit(replace(model, cause_prior=np.ones(6)), np.arange(6), 1.0, 1.0).causes
    X = np.concatenate([np.stack([np.eye(5)] * 2), known, np.stack([np.zeros((5, 1)), np.eye(5)[:, 4:]])], axis=2)
    whole = np.einsum("nai,nab,nbj->ij", X, H, X) + np.diag([0.25] * 5 + [4.0] * 5 + [0.0])
    rows = [[*map(Fraction, row), Fraction(s)] for row, s in zip(whole, np.einsum("nai,na->i", X, score), strict=True)]
    for k in range(10):
        for row in rows[k + 1 :]:
            row[:] = [x - row[k] / rows[k][k] * y for x, y in zip(row, rows[k], strict=True)]
    information, b = float(rows[10][10]) + 1.0, float(rows[10][11])  # with the change's own prior
    assert (error[-1] ** -2, value[-1]) == pytest.approx((information, b / information), rel=1e-9)


def test_the_directions_of_what_is_anew_are_projected_out() -> None:
    """A change along a parameter that is fitted anew in each campaign leaves no evidence."""
    rng = np.random.default_rng(1)
    J = rng.normal(size=(30, 4))
    robot = read_robot(Path(__file__).parents[2] / "problems/ur10e/robot.toml")
    names = ("base_x", "a1", "a2", "a3")
    told = Estimate(robot, names, np.zeros(4), J.T @ J, J.T @ J[:, 0] * 0.7, np.full(4, 1e4))
    H, b = told.about(names[1:], np.zeros(3))
    assert np.abs(b).max() < 1e-4 * np.abs(J.T @ J[:, 0]).max()
    Q = np.eye(30) - np.outer(J[:, 0], J[:, 0]) / (J[:, 0] @ J[:, 0])
    assert pytest.approx(J[:, 1:].T @ Q @ J[:, 1:], rel=1e-5) == H


def test_harmonics_that_every_campaign_shows_are_no_change_after_the_first(arm: tuple[Robot, Robot]) -> None:
    """Twenty campaigns alike, a harmonic many times as large as their priors have it."""
    robot = with_joint_harmonics(arm[0], 2)
    rng = np.random.default_rng(3)
    names = ("a2", "theta3", "joint_error_curve.s1_q3", "joint_error_curve.c1_q3")
    spread = np.array([1.0, 1.0, 0.2, 0.2])
    told = []
    for k in range(20):
        J = rng.normal(size=(12, 4)) / 3
        y = J @ np.array([0.0, 0.0, 4.0, 0.0]) + rng.normal(size=12)
        told.append(Estimate(robot, names, np.zeros(4), J.T @ J, J.T @ y, spread, str(k)))
    assert not compare(told).changed
    shared, (H, b, _), curves = shared_information(told, same_tool=False, same_frame=False)
    assert shared == names
    assert changes_in(*evidence_of(H, b, spread, curves, np.arange(20) / 12, dated=False))[0]


def test_campaigns_by_one_instrument_have_one_noise(arm: tuple[Robot, Robot], before: Estimate) -> None:
    """The variance is the mean of theirs; an instrument ten times coarser keeps its own."""
    second, m = after(arm), measured(arm[1], 5)
    assert m.position is not None
    coarse = replace(m, position=m.position + 3e-4 * np.random.default_rng(0).normal(size=m.position.shape))
    third = estimate((arm[0], coarse))
    a, b, c = with_common_noise([before, second, third])
    assert a.spread.tolist() == b.spread.tolist() != c.spread.tolist()
    assert before.fit
    assert second.fit
    rhos = pooled_repeatability([before.fit, second.fit])
    first, other = before.fit.at(rhos), second.fit.at(rhos)
    mean = (first.s2 + other.s2) / 2
    assert first.s2 != pytest.approx(other.s2, rel=1e-3)
    assert a.information == pytest.approx(first.sums.H / (mean * before.misfit))
    assert b.score == pytest.approx(-other.sums.g / (mean * second.misfit))
    assert c.information == pytest.approx(third.information)


def test_a_campaign_of_many_poses_tells_its_own_noise(arm, before):
    many = estimate((arm[0], measured(arm[1], 6, 1001)))
    first, second = with_common_noise([before, many])
    assert second.information is many.information
    assert first.information == pytest.approx(before.information, rel=0.3)


def test_a_joint_that_repeats_badly_is_seen_in_all_campaigns(arm: tuple[Robot, Robot]) -> None:
    """Joint 1 repeats to 60 urad, the others to nothing: 2 rad/m of 30 um."""
    fits = []
    for seed in range(6):
        m = measured(arm[1], seed)
        read = m.q.copy()
        read[:, 0] += 6e-5 * np.random.default_rng(seed).normal(size=len(m))
        read = read.clip(m.q.min(axis=0), m.q.max(axis=0))
        fits.append(wide_fit(identify(arm[0], replace(m, q=read))))
    found = pooled_repeatability(fits)
    assert found[0] >= 1.3
    assert max(found[1:]) < found[0]


@pytest.mark.parametrize("seed", [2, 7])
def test_where_nothing_changed_nothing_is_named(arm: tuple[Robot, Robot], before: Estimate, seed: int) -> None:
    found = compare([before, after(arm, seed)])
    assert not found.changed
    assert found.log_odds < 0
    assert found.figures()["left"].series[0].y == pytest.approx([1e3 * c.sigma for c in found.campaigns])
    text = plain_text(found.blocks())
    assert ("NOTHING CHANGED" in text, "smaller changes" in text) == (True, False)
    assert dict(found.placements)["base"].endswith("the instrument stands elsewhere, or the robot's foot moved")


@pytest.mark.parametrize(
    ("by", "label", "parameter", "size"),
    [
        ({"theta2": 3e-4}, "joint_zero@2", "theta2", np.rad2deg(3e-4)),
        ({"c2": 1.5}, "joint_stiffness@2", "c2", None),
        ({"a2": 3e-4}, "link@3", "a2", 0.3),
    ],
)
def test_a_change_is_named_with_its_size(arm, before, by, label, parameter, size):
    found = compare([before, after(arm, **by)])
    (change,) = found.changes
    assert (change.cause.label, change.named, change.course) == (label, True, "jump")
    assert sum(rival.probability for rival in change.rivals) == pytest.approx(1)
    amount = next(a for a in change.amounts if a.name == parameter)
    true = 0.5e6 * arm[1].parameters[parameter].value if size is None else size
    assert abs(amount.value - true) < 4 * amount.std_error
    assert 0 < amount.std_error < 0.2 * abs(true)


def test_another_tool_is_said_and_is_no_change_of_the_robot(arm: tuple[Robot, Robot], before: Estimate) -> None:
    moved = after(arm, tool_x=0.05)
    found = compare([before, moved])
    assert not found.changed
    assert "another tool" in dict(found.placements)["tool"]
    assert dict(found.placements)["tool"].startswith("50 mm")
    (change,) = compare([before, moved], same_tool=True).changes
    assert change.cause.label == "tool"


def test_what_is_beside_a_change_is_judged_with_it(arm: tuple[Robot, Robot], before: Estimate) -> None:
    """With joint 3 at another zero the tool is where it was, and another change of that joint would be seen as well."""
    same, moved = compare([before, after(arm)]), compare([before, after(arm, theta3=8e-4)])
    assert [c.cause.label for c in moved.changes] == ["joint_zero@3"]
    usual, far = (float(dict(c.placements)["tool"].split(" mm")[0]) for c in (same, moved))
    assert far < 1.5 * usual
    assert dict(moved.placements)["tool"].endswith("the same point, as far as these poses show")
    limits = [{cause: size for cause, size, _ in c.seen_from}["joint_zero@3"] for c in (same, moved)]
    assert limits[1] == pytest.approx(limits[0], rel=0.2)


def test_a_tool_between_noise_and_another_one_is_said_so(arm: tuple[Robot, Robot], before: Estimate) -> None:
    words = dict(compare([before, after(arm, tool_x=3e-5)]).placements)["tool"]
    assert words.endswith("more than noise alone, too little for another tool")


def test_a_moved_foot_is_a_change_in_one_frame(arm: tuple[Robot, Robot]) -> None:
    robot, built = arm
    first = estimate((robot, measured(built, 5)), "before")
    m = measured(built, 5)
    assert m.position is not None
    noise = 3e-5 * np.random.default_rng(5).normal(size=m.position.shape)
    lifted = estimate((robot, replace(m, position=m.position + np.array([2e-4, 0, 1e-4]) + noise)), "later")
    assert [c.cause.label for c in compare([first, lifted], same_frame=True).changes] == ["foot"]
    assert not compare([first, lifted]).changed
    stood = replace(m, position=m.position + noise)
    for position, words in (
        (lifted, "or the robot's foot moved"),
        (estimate((robot, stood), "same"), "the same place"),
    ):
        assert words in dict(compare([first, position]).placements)["base"]


def test_robot_files_of_calibrate_are_compared(arm, tmp_path, monkeypatch):
    """The file has the covariance; of two files the change is named as from the measurements themselves."""
    robot, built = arm
    files = calibrate(ROOT / "problems/ur10e").files(tmp_path / "out")
    assert files[tmp_path / "out" / "SKCM.robot.toml"].count("[[covariance]]") == 1
    for name, truth in (("2026-01", built), ("2026-02", changed(built, theta2=5e-4))):
        result = identify(robot, measured(truth, 10 + len(name) + int(name[-1])))
        (tmp_path / name).mkdir()
        write_robot(replace(result.robot, knowledge=result.knowledge), tmp_path / name / "SKCM.robot.toml")
    old, new = tmp_path / "2026-01" / "SKCM.robot.toml", tmp_path / "2026-02"
    out, page = tmp_path / "out.json", tmp_path / "life.html"
    done = run("compare", old, new, "--json", out, "--report", page, width=100)
    assert done.returncode == 5, done.stderr
    text = page.read_text()
    assert "zero of joint 2 [deg]" in text
    assert '"shape":"hvh"' in text  # a step, not a slope
    assert "CHANGED: joint_zero@2, a jump since 2026-02: theta2 +0.02" in done.stdout
    (change,) = json.loads(out.read_text())["changes"]
    assert change["cause"] == "joint_zero@2"
    assert change["probability"] > 0.95
    same = run("compare", old, old, "--quiet")
    assert (same.returncode, same.stdout) == (0, "")
    assert "(--robot) smaller changes are seen" in " ".join(run("compare", old, old).stdout.split())


def test_a_robot_file_without_covariance_is_refused() -> None:
    with pytest.raises(InputError, match="no covariance of the geometry; write it with"):
        estimate_of_file(read_robot(ROOT / "problems/ur10e/robot.toml"))


@pytest.fixture(scope="module")
def tables(arm: tuple[Robot, Robot], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five monthly tables, joint 5 turned before the fourth; one in metres under the heading of millimetres."""
    folder = tmp_path_factory.mktemp("months")
    for k in range(5):
        truth = changed(arm[1], theta5=5e-4) if k >= 3 else arm[1]
        m = measured(truth, 20 + k)
        assert m.position is not None
        wrong = replace(m, position=1e-3 * m.position) if k == 1 else m
        write_table(wrong, folder / f"2026-{(k + 1):02d}-01.csv")
    return folder


def test_a_life_in_tables_with_units_that_changed_midway(tables: Path) -> None:
    problem, files = ROOT / "problems/ur10e", sorted(tables.glob("*.csv"))
    found = compare_files([files[2], *files[:2], *files[3:]], problem)
    assert [c.label for c in found.campaigns] == ["2026-01-01", "2026-03-01", "2026-04-01", "2026-05-01"]
    (change,) = found.changes
    assert change.cause.label == "joint_zero@5"
    assert found.campaigns[change.since].label == "2026-04-01"
    assert any("2026-02-01.csv is left out" in note for note in found.notes)
    assert any("dates go back (2026-03-01, then 2026-01-01)" in note for note in found.notes)
    with pytest.raises(InputError):
        compare_files(files[:2], problem)


def test_rows_with_an_empty_cell_are_not_used_and_said(tables: Path, tmp_path: Path) -> None:
    first, _, third, *_ = sorted(tables.glob("*.csv"))
    gaps = pd.read_csv(third)
    gaps.iloc[6, 3] = gaps.iloc[8, 6] = np.nan
    gaps.to_csv(tmp_path / "2026-03-03.csv", index=False)
    found = compare_files([first, tmp_path / "2026-03-03.csv"], Path(__file__).parents[2] / "problems/ur10e")
    assert [c.poses for c in found.campaigns] == [40, 38]
    assert found.campaigns[1].notes == ("2026-03-03.csv: rows 8, 10 not used, a reading or a position is empty",)


def test_days_in_names_and_what_is_odd_about_them(before: Estimate) -> None:
    assert day_of(Path("a/2026-03-14.csv")) == day_of(Path("2026_03_14/KM.robot.toml"))
    assert day_of(Path("x/20260314-ur10.csv")) == day_of(Path("2026-03-14"))
    assert day_of(Path("run7/ur10.csv")) is None

    def on(
        *days: float | None, names: dict[int, str] | None = None, begun: bool = False, same: bool = False
    ) -> tuple[list[str], str]:
        given = [
            replace(
                before, label=str(k), day=d, robot=replace(before.robot, name=(names or {}).get(k, "arm")),
                values=before.values + 1e-9 * k * (not same),
            )
            for k, d in enumerate(days)
        ]  # fmt: skip
        ordered, said = in_order(given, begun=begun)
        return [c.label for c in ordered], " | ".join(said)

    assert on(0, 30, 60, 120, 150) == (
        list("01234"), "campaigns seem to be missing between 2 and 3; a change there is dated to the later one"
    )  # fmt: skip
    assert on(0, 30, 30) == (list("012"), "two campaigns of one day, both used: 2")
    order, said = on(30, 0, 60)
    assert order == list("102")
    assert said.startswith("dates go back (0, then 1)")
    assert on(0, None, 60)[1].startswith("no date in the name of 1: the campaigns are in the order given")
    assert on(0, 30, 13000)[1].startswith("2 is 35.5 years after 1, by their names: if a clock was wrong, rename")
    assert on(0, 30, names={1: "left arm"})[1] == "the robot is called 'arm' and 'left arm': taken for one, renamed"
    assert on(None, 60, 30, begun=True) == (
        list("021"), "dates go back (1, then 2): the campaigns are put in the order of their dates"
    )  # fmt: skip
    assert on(None, 30, 60, begun=True) == (list("012"), "")
    assert day_of(Path("1970-01-01.csv")) == 0.0
    assert on(0, 20000, begun=True)[1].startswith("1 is 54.8 years after 0")
    alike = "all campaigns are the same measurements, to the last digit: no change can be seen"
    assert on(0, 30, same=True)[1] == alike


def test_the_same_measurements_count_once(before: Estimate) -> None:
    other = replace(before, label="other", values=before.values + 1e-9)
    ordered, said = in_order([before, other, replace(before, label="copy")])
    assert [c.label for c in ordered] == ["before", "other"]
    assert said[0] == "copy is left out: the same measurements as before, to the last digit"


def test_campaigns_in_other_regions_of_the_joints_are_named(before: Estimate) -> None:
    """A change may then be an error that the model leaves in one region only."""
    low, high = np.tile([-1.0, 1.0], (6, 1)), np.tile([-1.0, 1.0], (6, 1))
    high[1] = [0.5, 2.5]
    first, other = (replace(before, label=str(k), readings=r) for k, r in enumerate((low, high)))
    (text,) = other_regions([first, other])
    assert text.startswith("other regions of the joints than in 0 were measured in 1 (joint 2): errors that the model")
    assert other_regions([first, first]) == []
    assert before.readings is not None
    assert before.readings.shape == (6, 2)


def test_another_robot_and_one_campaign_are_refused(before: Estimate, tables: Path) -> None:
    with pytest.raises(InputError, match="1 campaign; a comparison needs two or more"):
        compare([before])
    other = read_robot(Path(__file__).parents[2] / "problems/hh800/robot.toml")
    with pytest.raises(InputError, match="campaign 'Hyundai HH800'"):
        compare([before, replace(before, robot=other)])
    with pytest.raises(InputError, match="a table needs --robot"):
        compare_files(sorted(tables.glob("*.csv"))[:2])
    with pytest.raises(InputError, match=r"no result\.json of a calibration is in it, and 0 robot files"):
        compare_files([tables, tables])


def test_the_file_says_how_much_less_it_is_sure_where_its_model_does_not_fit(arm: tuple[Robot, Robot]) -> None:
    """Errors that drift slowly push the estimates more than noise; of independent noise the factor is near one."""
    robot, built = arm
    m = measured(built, 30, 300)
    assert m.position is not None
    slow = 1e-4 * np.sin(np.arange(300)[:, None] / 30 + np.arange(3))
    smooth, bent = (misfit_of(identify(robot, replace(m, position=m.position + d))) for d in (0 * slow, slow))
    assert smooth < 1.2
    assert bent > 1.5
    # A parameter at its bound, whose variance is not known, does not count.
    narrow = replace(robot.widths["geometry"], length_bound=8e-4, angle_bound=8e-4)
    held = replace(robot, widths={**robot.widths, "geometry": narrow})
    found = identify(held, replace(m, position=m.position + slow))
    assert found.at_bounds
    assert misfit_of(found) > 1.5


def test_what_is_left_is_the_noise_however_much_was_fitted(arm: tuple[Robot, Robot]) -> None:
    """Of 120 numbers 32 parameters take their share, and the harmonics theirs; the mean of four campaigns."""
    left = [estimate((arm[0], measured(arm[1], seed))).sigma for seed in range(100, 104)]
    assert np.sqrt(np.mean(np.square(np.array(left, dtype=float)))) == pytest.approx(NOISE, rel=0.1)


def test_a_robot_whose_first_row_places_it_may_have_a_moved_foot() -> None:
    """The HH800 has no base beside the first row of its table: six numbers that each campaign fits again."""
    robot = with_joint_harmonics(read_robot(Path(__file__).parents[2] / "problems/hh800/campaign.robot.toml"), 2)
    row = ("alpha0", "a0", "beta0", "b0", "d1", "theta1")
    names = [p.name for p in robot.parameters]
    foot = next(c for c in candidates_of(robot, names) if c.kind == "foot")
    assert foot.names == row
    assert set(row).isdisjoint(shared_names(robot, names, same_tool=True, same_frame=False))
    k = len(names)
    told = Estimate(robot, tuple(names), robot.parameters.values, np.eye(k), np.zeros(k), np.ones(k))
    moved = robot.with_values({"a0": 0.5, "theta1": 0.01})
    there = replace(told, robot=moved, values=moved.parameters.values)
    assert dict(compare([told, there]).placements)["base"].startswith("500 mm and 0.573 deg from where it stood")


def test_a_table_without_noise_is_compared_too(arm, before: Estimate) -> None:
    """As a simulator writes it: its information is bounded, or its sums would lose their digits."""
    m = measured(arm[1], 3)
    exact = replace(m, position=predicted(arm[1], m)[0])
    found = compare([before, estimate((arm[0], exact), "exact")])
    assert not found.changes
    assert np.linalg.eigvalsh(estimate((arm[0], exact)).information)[-1] < 1e12


def test_a_hall_that_is_warm_in_summer_makes_lengths_come_and_go(arm: tuple[Robot, Robot]) -> None:
    nominal, real = arm
    lengths = {p.name: p.value for p in real.parameters if p.unit == "m" and p.group in ("geometry", "tool")}
    told = []
    for k, day in enumerate(np.arange(0.0, 400.0, 61.0)):
        share = 1 + 3e-4 * np.sin(2 * np.pi * day / 365.25)
        longer = real.with_values({name: share * value for name, value in lengths.items()})
        told.append(estimate((nominal, measured(longer, k)), str(k), day))
    (change,) = compare(told).changes
    assert change.course == "season"
    sizes = {a.name: (a.value, a.std_error, a.unit) for a in change.amounts}
    for name, value in (("lengths, sine", 300.0), ("lengths, cosine", 0.0)):
        found, error, unit = sizes[name]
        assert (unit, error < 30) == ("um/m", True)
        assert abs(found - value) < 3 * error


def test_a_change_may_begin_between_any_two_campaigns() -> None:
    """Half by a chance that falls with the square of the number, half by one of 3 % each time."""
    for n in (2, 5, 40):
        ((course, weights, since, _),) = courses_of("lengths?", np.arange(n) / 12, dated=False)
        assert (course, since.tolist()) == ("jump", list(range(1, n)))
        assert weights.sum() == pytest.approx(1 - 0.5 / n - 0.5 * 0.97 ** (n - 1))


def test_a_result_with_masses_that_only_their_priors_know_can_be_compared(arm: tuple[Robot, Robot]) -> None:
    """A DH table without masses: its estimated masses are in the covariance, and the poses leave them open."""
    nominal, built = arm
    stiff = [replace(j, compliance=j.compliance if k in (1, 2, 3) else None) for k, j in enumerate(nominal.joints)]
    m = measured(built, 4, 60)
    bare, free = with_unknown_masses(replace(nominal, joints=tuple(stiff), masses="estimated"), [m])
    found = identify(bare, m, ["kinematic", "compliance", *free], priors=True)
    own, by_poses = estimate_of_file(replace(found.robot, knowledge=found.knowledge)), estimate((bare, m))
    assert 1 / 3 < np.linalg.norm(own.information) / np.linalg.norm(by_poses.information) < 3
    assert not compare([own, by_poses]).changes


ZERO = Candidate("joint_zero", 2, ("theta2",), np.ones((1, 1)), np.array([3e-4]))
JUMP = Change(ZERO, "jump", 1, (1, 1), 1.0, 1.0, 9.0, (), (), np.zeros((2, 2)))


def test_a_drift_of_a_zero_is_no_crash() -> None:
    assert JUMP.words == "the zero of joint 2 is another: a crash, a slipped belt or a lost reference"
    drift = replace(JUMP, course="drift")
    assert "crash" not in drift.words
    assert "wear" in drift.words
    units = [_per(SimpleNamespace(campaigns=[SimpleNamespace(day=day)]), drift) for day in (None, 1)]
    assert units == [" in 12 campaigns", " a year"]


def test_a_spring_usually_changes_by_a_third_of_itself_or_a_tenth_of_what_is_unknown() -> None:
    for value, prior, size in ((-2e-6, 1e-6, 6e-7), (0.0, 1e-6, 1e-7)):
        p = SimpleNamespace(group="compliance", value=value, prior=prior)
        assert _usual_size("joint_stiffness", p) == pytest.approx(size)


def test_of_another_robot_parameters_count_that_differ_by_three_standard_errors() -> None:
    amounts = [SimpleNamespace(value=v, std_error=2.0) for v in (5.9, -6.1, 7.0, 0.0)]
    found = SimpleNamespace(campaigns=[SimpleNamespace(label="before"), SimpleNamespace(label="2026")])
    cause = SimpleNamespace(kind=ANOTHER_ROBOT, label="another robot")
    change = SimpleNamespace(since=1, named=True, cause=cause, course="jump", amounts=amounts)
    assert "2 of 4 parameters differ by more than 3 standard errors" in in_words(found, change)


@pytest.mark.parametrize(("changed", "unexplained", "code"), [(0, 0, 0), (1, 0, 5), (0, 1, 5), (1, 1, 5)])
def test_a_change_or_what_is_unexplained_ends_a_comparison_in_5(changed, unexplained, code, monkeypatch) -> None:
    blocks = [*[Words("told")] * 20, next_step("to act", "calibrate", "arm")]
    found = SimpleNamespace(changed=bool(changed), unexplained=bool(unexplained), next=())
    found.to_json, found.blocks = dict, lambda: blocks
    monkeypatch.setattr("casadical.fleet.campaigns.compare_files", lambda *_, **__: found)
    done = CliRunner().invoke(app, ["compare", "problems/planar", "problems/planar"])
    assert (done.exit_code, "casadical calibrate arm" in done.output) == (code, True)


def test_each_kind_of_change_has_words_for_the_courses_that_it_may_have() -> None:
    for kind in RELATIVE_FREQUENCY:
        possible = {course for course, *_ in courses_of(kind, np.arange(4) / 12, dated=True)}
        assert possible == {course for course, words in MEANINGS.items() if kind in words}


def test_a_change_is_drawn_in_the_unit_of_its_parameter() -> None:
    pytest.importorskip("plotly")

    robot, built = as_built(np.random.default_rng(1))
    truths = (built, built, changed(built, theta5=5e-4))
    figures = plot(compare([estimate((robot, measured(t, k)), str(k)) for k, t in enumerate(truths)]))
    figure = figures["change/joint_zero@5"]
    assert figure.layout.yaxis.title.text == "zero of joint 5 [deg]"
    (drawn,) = figure.data
    assert drawn.y == pytest.approx([0.0, 0.0, np.rad2deg(5e-4)], abs=5e-3)
    assert (drawn.error_y.array[1:] > 0.001).all()
    assert (drawn.error_y.array < 0.01).all()


def test_odds_beyond_all_measure_are_not_counted() -> None:
    assert [times_in_words(odds * np.log(10)) for odds in (2, 99, 8871)] == ["100", "1e99", "more than 1e100"]


def test_a_robot_is_called_by_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = tmp_path / "R-1207"
    tables = [own / "campaigns" / f"2026-0{k}.csv" for k in (1, 2)]
    monkeypatch.chdir(tmp_path)
    assert name_of(tables) == "R-1207"
    assert name_of(tables, own) == "R-1207"
    assert name_of(tables, tmp_path / "ur10e") == "R-1207"
    assert name_of([tmp_path / "1.csv", tmp_path / "2.csv"], tmp_path / "ur10e") == "ur10e"
    assert name_of([own / "2026-01" / "KM.robot.toml", own / "2026-02"]) == "R-1207"
