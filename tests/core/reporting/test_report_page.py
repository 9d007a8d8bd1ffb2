"""The file: its order, what it says of where it comes from, user's text in it, and that it is whole or not there."""

import hashlib
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from parsed import Parsed

from casadical import report
from casadical.core.reporting.blocks import Words, mm
from casadical.core.reporting.page import provenance_of
from casadical.diagnosis.page import diagnosis_page
from casadical.project.problem import read_problem
from casadical.project.reporting import campaign_files, problem_files

ROOT = Path(__file__).parents[3]


def test_the_order_is_that_of_a_reader(calibration_file, diagnosis_file) -> None:
    calibration = Parsed(calibration_file.read_text(encoding="utf-8"))
    diagnosis = Parsed(diagnosis_file.read_text(encoding="utf-8"))
    first = ["Verdict", "Errors before and after", "Error of each pose", "In the workspace", "Where the gap lies"]
    assert calibration.texts["h2"] == [
        *first, "Which causes", "Parameters", "Can the fit be trusted", "Training of the networks",
        "What to measure next", "Provenance",
    ]  # fmt: skip
    assert diagnosis.texts["h2"] == [
        *first, "Which causes, and how sure", "Joint error curves", "What these poses cannot tell",
        "Replayed in a simulator", "Parameters of the base model", "Can the fit be trusted", "What to measure next",
        "Provenance",
    ]  # fmt: skip
    for page in (calibration, diagnosis):
        assert page.sources == []
        assert page.open == []


def test_it_is_below_six_megabytes_and_holds_plotly_once(calibration_file) -> None:
    text = calibration_file.read_text(encoding="utf-8")
    assert len(text.encode()) < 6e6
    assert len(re.findall(r"<script>\s*/\*\*\s*\* plotly\.js v", text)) == 1


def test_the_tables_say_what_the_command_prints(hh800, calibration_file) -> None:
    text = calibration_file.read_text(encoding="utf-8")
    a = hh800.accuracies["SKCM"]["report"]["calibrated"]
    cells = "".join(f'<td class="n">{1e3 * v:.3f}</td>' for v in (a.mean, a.max, a.std, a.rms, a.p95))
    assert f"<td>after SKCM</td>{cells}" in text


def test_the_diagnosis_tells_what_it_cannot_see_and_what_chance_does(diagnosis, details) -> None:
    def words(**changes: object) -> list[str]:
        blocks = [
            b for s in diagnosis_page(replace(diagnosis, **changes), "made up", details).sections for b in s.blocks
        ]
        return [b.text for b in blocks if isinstance(b, Words)]

    lost = words(p_nothing=0.0004998, missing={"payload_error": ("payload_kg",)}, unknown_rest=0.2)
    assert any(w.endswith(", p < 0.0005.") for w in lost)
    assert "payload_kg: not logged; it would show payload_error." in lost
    assert any(w.startswith("Explained in part only: backlash@5; yet ") for w in lost)
    hidden = details.isolability.effects
    hidden = [k for k in hidden.index[hidden["absorbed"] > 0.98] if k != "backlash@5"]
    assert hidden
    seen = next(w for w in lost if w.startswith("These data cannot see, as the base model"))
    assert all(k.partition("@")[0] in seen for k in hidden)


def test_provenance_names_hash_versions_command_and_date() -> None:
    files = problem_files(read_problem(ROOT / "problems/hh800"))
    found = provenance_of(files, ["casadical", "calibrate", "my robot"], datetime(2026, 11, 21, 5, 7, tzinfo=UTC))
    hashes = found["files"]
    data = next(path for path in hashes if path.endswith("hh800_twin.csv"))
    assert hashes[data] == hashlib.sha256((ROOT / "data/hh800_twin/hh800_twin.csv").read_bytes()).hexdigest()
    assert found["command"] == "casadical calibrate 'my robot'"
    assert found["date"] == "2026-11-21 05:07 UTC"
    assert found["versions"]["casadical"]
    names = [path.name for path in campaign_files(ROOT / "problems/hh800", [Path("a.csv")])]
    assert names == ["problem.toml", "campaign.robot.toml", "a.csv"]


def test_a_users_text_stays_text(calibrated) -> None:
    calibration = calibrated("planar")
    problem = calibration.problem
    evil = "<script>alert(1)</script> & <img src=x onerror=alert(1)>"
    named = replace(problem, title=evil, robot=replace(problem.robot, name=evil, notes=(evil,)))
    text = report([replace(calibration, problem=named)])
    assert evil not in text
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 3


def test_the_tiles_are_the_figures_of_the_held_out_poses(calibrated) -> None:
    planar = calibrated("planar")
    states = planar.accuracies["KM"]
    held_out = next(name for name in states if name.startswith("report"))
    after, before = states[held_out]["calibrated"], states[held_out]["placed"]
    shown = {tile.label: tile.value for tile in planar.page().tiles}
    assert shown == {
        "Mean error before": mm(before.mean),
        "Mean error after KM": mm(after.mean),
        "95 % of the poses below": mm(after.p95),
        "Largest error": mm(after.max),
    }
    assert "training" not in planar.figures()  # no networks, no figure of their training
