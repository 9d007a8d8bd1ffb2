"""Five touches: planned, judged with and without a history, corrected where that is better, charted."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from arms import NOISE, positions, six_axis
from command_line import main
from scipy.stats import chi2

from casadical import InputError, Placement, Robot, identify, read_robot, write_robot
from casadical.core.reporting.figure import Figure
from casadical.core.transforms import frame, from_rpy
from casadical.fleet.touch_model import CHANGE_FREQUENCY, TouchModel
from casadical.fleet.touches import Touches, _widened_remaining, changes_in_fleet, judge_touches, plan_touches
from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured
from casadical.project.calibration import with_knowledge
from casadical.robot.robot import RemainingErrors

BASE = Placement(frame(from_rpy(np.array([0.1, 0.0, 0.4])), np.array([1.0, 0.3, 0.0])), "pose")
ARM = six_axis(base=BASE)


def moved(robot: Robot, by: dict[str, float]) -> Robot:
    return robot.with_values({n: robot.parameters[n].value + v for n, v in by.items()})


def grown(robot: Robot, share: float) -> Robot:
    lengths = [p for p in robot.parameters if p.unit == "m" and p.group in ("geometry", "tool")]
    return moved(robot, {p.name: share * p.value for p in lengths})


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Robot, np.ndarray]:
    """A calibrated robot's file, the robot as it is, and five planned readings."""
    folder = tmp_path_factory.mktemp("touches")
    rng = np.random.default_rng(5)
    names = [p.name for p in ARM.parameters if p.group in ("geometry", "tool")]
    true = moved(ARM, {n: 3e-4 * rng.normal() for n in names})
    found = identify(ARM, positions(true, rng.uniform(-2.5, 2.5, (80, 6)), 1), method="KM")
    file = folder / "six.robot.toml"
    write_robot(with_knowledge(found), file)
    plan = plan_touches(file, 5)
    return file, true, np.deg2rad(plan[[f"q{j}_deg" for j in range(1, 7)]].to_numpy(dtype=float))


def day(folder: Path, number: int, robot: Robot, q: np.ndarray, **more: float) -> Path:
    m = positions(robot, q, 100 + number)
    assert m.position is not None
    table = pd.DataFrame(np.rad2deg(m.q), columns=[f"q{j}_deg" for j in range(1, 7)])
    for k, axis in enumerate("xyz"):
        table[f"{axis}_mm"] = 1e3 * m.position[:, k]
    path = folder / f"2026-03-{number:02d}.csv"
    table.assign(**more).to_csv(path, index=False)
    return path


def error(model: Robot, real: Robot) -> float:
    m = unmeasured(np.random.default_rng(9).uniform(-2.5, 2.5, (300, 6)))
    return float(np.sqrt(((predicted(model, m)[0] - predicted(real, m)[0]) ** 2).sum(axis=1).mean()))


def test_the_same_robot_is_valid_and_a_crash_is_found_and_corrected(place, tmp_path):
    file, true, q = place
    same = [day(tmp_path, k, true, q) for k in (1, 2)]
    found = judge_touches(file, same)
    assert found.verdict == "valid"
    assert not found.better
    assert found.next == ()
    hit = moved(true, {"theta3": 4e-4})
    found = judge_touches(file, [*same, day(tmp_path, 3, hit, q)])
    assert found.verdict == "changed"
    assert (found.label, found.draws.probability("joint_zero@3") > 0.95) == ("joint_zero@3", True)
    (name, amount, std_error, unit), *_ = found.moved
    assert (name, unit) == ("theta3", "deg")
    assert abs(amount - np.rad2deg(4e-4)) < 4 * std_error
    assert found.more is None  # it is sure
    (chart,) = (b for s in found.page().sections for b in s.blocks if isinstance(b, Figure))
    for series in chart.series:
        assert (list(series.x), list(series.y)) == ([1, 2, 3], [row[4] / row[5] for row in found.rows()])
    assert list(chart.series[1].colour) == ["blue", "blue", "red"]
    low, high = np.quantile(found.errors, [0.005, 0.995])
    assert low < np.hypot(error(read_robot(file), hit), NOISE * np.sqrt(3)) < high
    assert found.better
    (tmp_path / "new.robot.toml").write_text(found.updated_text())
    new = read_robot(tmp_path / "new.robot.toml")
    assert error(new, hit) < 0.25 * error(read_robot(file), hit)
    assert judge_touches(tmp_path / "new.robot.toml", [tmp_path / "2026-03-03.csv"]).verdict == "valid"
    assert new.remaining is not None
    assert new.knowledge is not None
    before = read_robot(file).knowledge.std_errors["theta3"]
    assert new.knowledge.std_errors["theta3"] > before
    assert "Corrected by touches of 2026-03-03.csv" in new.notes[-1]


@pytest.mark.parametrize(
    ("by", "label"), [({"tool_x": 5e-4, "tool_y": 3e-4}, "tool"), ({"base_x": 4e-4, "base_rz": 4e-4}, "foot")]
)
def test_another_tool_and_a_moved_foot_are_told_apart(place, tmp_path, by, label):
    file, true, q = place
    days = [day(tmp_path, k, true, q) for k in (1, 2)]
    found = judge_touches(file, [*days, day(tmp_path, 3, moved(true, by), q)])
    assert found.label == label
    assert found.verdict == "changed"
    sure = [abs(amount) / error for _, amount, error, _ in found.moved]
    assert sure == sorted(sure, reverse=True)


def test_a_logged_temperature_explains_growth(place, tmp_path):
    file, true, q = place
    days = [day(tmp_path, k, true, q, temperature_degC=20.0) for k in (1, 2)]
    days.append(day(tmp_path, 3, grown(true, 1.2e-4), q, temperature_degC=30.0))
    told = judge_touches(file, days)
    assert told.draws.probability("") > 0.5
    assert "temperature is logged" in " ".join(told.notes)
    assert told.rows()[-1][-1] == "yes"
    days = [day(tmp_path, k, true if k < 3 else grown(true, 1.2e-4), q) for k in (1, 2, 3)]
    silent = judge_touches(file, days)
    assert silent.label == "lengths"
    assert abs(silent.moved[0][1] - 120) < 4 * silent.moved[0][2]
    assert silent.rows()[-1][4] > 2 * told.rows()[-1][4]


def test_where_touches_do_not_decide_two_more_are_named(place, tmp_path):
    file, true, q = place
    tolerance = 1.4 * judge_touches(file, [day(tmp_path, 1, true, q)]).model.stated
    found = judge_touches(file, [day(tmp_path, 1, true, q[:2])], tolerance_mm=tolerance)
    assert found.verdict == "open"
    assert found.more is not None
    assert len(found.more) == 2
    assert "touch 2 more" in found.blocks()[-2 if found.notes else -1].title
    more = np.deg2rad(found.more[[f"q{j}_deg" for j in range(1, 7)]].to_numpy(dtype=float))
    again = judge_touches(file, [day(tmp_path, 1, true, np.vstack([q, more]))], tolerance_mm=tolerance)
    assert again.probability > found.probability
    assert again.page().tiles[0].value == f"{100 * again.probability:.1f}" > "50"


def test_a_fleet_whose_tools_are_hit_makes_the_tool_more_probable(place, tmp_path):
    file, true, q = place
    robots = [{"changes": "tool, a jump since C7 (tool, foot): tool_z +0.2 mm +/- 0.01"}] * 30
    (tmp_path / "fleet.json").write_text(json.dumps({"robots": robots}))
    table = day(tmp_path, 1, moved(true, {"tool_z": 2e-4}), q[:3])
    plain, known = (judge_touches(file, [table], fleet=f) for f in (None, tmp_path / "fleet.json"))
    assert known.draws.probability("tool") > plain.draws.probability("tool")
    assert changes_in_fleet(tmp_path / "fleet.json") == CHANGE_FREQUENCY | {"tool": CHANGE_FREQUENCY["tool"] + 30}
    (tmp_path / "fleet.json").write_text("{}")
    with pytest.raises(InputError, match="holds no robots"):
        judge_touches(file, [table], fleet=tmp_path / "fleet.json")


def test_a_day_that_changed_does_not_widen_its_own_limit(place, tmp_path) -> None:
    """Of a file that leaves much unexplained, beside which the days differ by the noise alone."""
    file, true, q = place
    arm = read_robot(file)
    rough = tmp_path / "rough.robot.toml"
    write_robot(replace(arm, remaining=replace(arm.remaining, rest=4e-4)), rough)
    robots = [true, true, true, moved(true, {"theta3": 1e-3})]
    tables = [day(tmp_path, number, robot, q) for number, robot in enumerate(robots, 1)]
    assert [row[-1] for row in judge_touches(rough, tables).rows()] == ["yes", "yes", "yes", "no"]


def test_the_command_plans_judges_charts_and_corrects(place, tmp_path, monkeypatch, capfd):
    file, true, q = place
    monkeypatch.chdir(tmp_path)
    assert main(monkeypatch, "plan", file.parent, "--touches", 3) == 0
    pd.testing.assert_frame_equal(pd.read_csv("touches.csv"), plan_touches(file, 3, seed=0), check_exact=False)
    hit = moved(true, {"theta2": -5e-4})
    days = [day(tmp_path, k, true if k < 3 else hit, q) for k in (1, 2, 3)]
    kept = ("--update", "new.robot.toml", "--chart", "chart.csv", "--report", "page.html", "--json", "touched.json")
    assert main(monkeypatch, "verify", file, *days, "--touches", *kept) == 5
    said = capfd.readouterr().out
    assert "NO LONGER VALID" in said
    assert "joint zero of joint 2" in said
    assert "--update" not in said  # it was given
    assert "casadical verify new.robot.toml DAY.csv --touches" in said
    chart = pd.read_csv("chart.csv")
    assert chart["within"].tolist() == ["yes", "yes", "no"]
    assert chart["day"].tolist() == ["2026-03-01", "2026-03-02", "2026-03-03"]
    told = json.loads(Path("touched.json").read_text())
    assert (told["verdict"], told["correction"]["written"]) == ("changed", True)
    assert "Touches day by day" in Path("page.html").read_text()
    assert main(monkeypatch, "verify", "new.robot.toml", days[2], "--touches", "--update", "no.robot.toml") == 0
    assert "is not written" in capfd.readouterr().out
    assert not Path("no.robot.toml").exists()
    assert main(monkeypatch, "verify", file, days[0], "--chart", "c.csv") == 2
    assert "--chart: is for --touches" in capfd.readouterr().err
    assert main(monkeypatch, "verify", file, "--touches", "5") == 2
    assert "--touches 5 plans points" in " ".join(capfd.readouterr().err.split())


def test_of_many_parameters_that_moved_the_eight_first_are_shown() -> None:
    found = SimpleNamespace(moved=[(f"a{k}", 0.1, 0.01, "mm") for k in range(12)])
    (shown,) = Touches.what_moved.fget(found)
    assert [row[0] for row in shown.rows] == [f"a{k}" for k in range(8)]


def test_what_a_correction_does_not_know_is_added_to_the_remaining_errors() -> None:
    rng = np.random.default_rng(0)
    before = RemainingErrors(("a", "b", "c"), rng.normal(size=(3, 2)) * 1e-5, 2e-5, 30)
    root, scale = rng.normal(size=(2, 2)) * 1e-4, np.array([2.0, 5.0])
    after = _widened_remaining(before, ["c", "a"], root @ root.T, scale)
    expected = before.factor @ before.factor.T
    expected[np.ix_([2, 0], [2, 0])] += root @ root.T * np.outer(scale, scale)
    np.testing.assert_allclose(after.factor @ after.factor.T, expected, rtol=1e-9, atol=1e-22)
    assert _widened_remaining(None, ["a"], root, scale) is None


def test_the_touches_that_are_told_are_those_of_the_last_day() -> None:
    (key,) = [key for key in Touches.derived if key.name == "touches"]
    assert key.of(SimpleNamespace(model=SimpleNamespace(days=[[1, 2, 3], [1, 2]]))) == 2


@pytest.mark.parametrize(("dates", "last", "dated"), [((0.0, 365.25), 13 / 12, True), ((0.0, None), 2 / 12, False)])
def test_the_calibration_was_a_month_before_the_first_day(dates, last, dated) -> None:
    times, known = TouchModel._times.fget(SimpleNamespace(dates=dates, days=dates))
    assert (times.tolist(), known) == ([0.0, pytest.approx(1 / 12), pytest.approx(last)], dated)


def test_levels_of_noise_weigh_as_the_days_before_say() -> None:
    rng, day = np.random.default_rng(0), np.repeat([1, 2, 3], 4)
    terms = [(0.0, None, rng.normal(size=12) * scale, rng.normal(size=12) - np.log(scale)) for scale in (1.0, 1.5)]
    chart = TouchModel.control_chart(SimpleNamespace(day=day, likelihood_terms=terms))
    for k in (1, 2, 3):
        before = np.array([(-0.5 * z**2 - roots)[day < k].sum() for *_, z, roots in terms])
        weight = np.exp(before - before.max())
        tails = [chi2.sf((z[day == k] ** 2).sum(), 4) for *_, z, _ in terms]
        assert chart[k - 1] == pytest.approx(chi2.isf(np.average(tails, weights=weight), 4))


def test_bad_touches_are_refused_or_said(place, tmp_path):
    file, true, q = place
    first = day(tmp_path, 1, true, q)
    copy = tmp_path / "2026-03-02.csv"
    copy.write_bytes(first.read_bytes())
    assert "same readings as 2026-03-01.csv" in " ".join(judge_touches(file, [first, copy]).notes)
    late = day(tmp_path, 3, true, q)
    notes = judge_touches(file, [late, first]).notes
    assert "by its date 2026-03-03.csv is the last day" in " ".join(notes)
    with pytest.raises(InputError, match="2 or more"):
        judge_touches(file, [day(tmp_path, 4, true, q[:1])])
    elsewhere = replace(true, base=replace(true.base, T=frame(np.eye(3), np.array([0.0, 2.0, 0.0])) @ true.base.T))
    said = r"2026-03-05\.csv: .*the instrument stands elsewhere, or it is another robot"
    with pytest.raises(InputError, match=said):
        judge_touches(file, [first, day(tmp_path, 5, elsewhere, q)])
    bare = tmp_path / "bare.robot.toml"
    write_robot(ARM, bare)
    with pytest.raises(InputError, match="does not say how far it may be off"):
        judge_touches(bare, [first])
    broken = tmp_path / "2026-03-06.csv"
    broken.write_text(re.sub(r",[^,\n]*\n(?=[^\n]*\n?$)", ",\n", first.read_text()))
    assert "left out, a cell is no number" in " ".join(judge_touches(file, [broken]).notes)
