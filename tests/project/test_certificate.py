"""Certificate data: a budget whose sum is right, a decision with a guard band, fields as text, both languages."""

import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import ROOT, main
from test_iso9283 import ROBOT, SHEET

from casadical import InputError, calibrate, read_problem, read_robot
from casadical.core.reporting.blocks import Table
from casadical.core.reporting.figure import Figure
from casadical.identification import errors, predicted
from casadical.measurements.measurements import unmeasured
from casadical.project.acceptance.budget import budget_of, repeats_of
from casadical.project.acceptance.certificate import certificate
from casadical.project.acceptance.iso9283 import evaluated_table
from casadical.project.new import new_problem

PLANAR = ROOT / "problems" / "planar"
MARKUP = "<b>Lab</b> & **Sons** {x} %s [link](http://x)"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    calibrate(PLANAR).write(folder)
    return folder


def details(folder: Path, text: str = "") -> Path:
    path = folder / "certificate.toml"
    path.write_text(f"casadical = 1\n{text}", encoding="utf-8")
    return path


def drawn_in(pdf: bytes) -> str:
    """Operators of a PDF of fpdf2, whose streams are deflated and whose letters are Latin-1."""
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL)
    return b"".join(zlib.decompress(s) for s in streams).decode("latin-1")


def text_of(pdf: bytes) -> str:
    words = (re.sub(r"\\([()\\])", r"\1", t) for t in re.findall(r"\(((?:\\.|[^()\\])*)\) Tj", drawn_in(pdf)))
    return " ".join(words)


def test_the_command_writes_two_pages_with_fields_as_text(results, tmp_path, monkeypatch, capfd):
    said = f'issuer = "{MARKUP}"\ncustomer = "Łódź"\n[instrument]\nname = "T"\nnoise_mm = 0.01\n'
    given = details(tmp_path, said + "[decision]\ntolerance_mm = 0.1")
    out, kept = tmp_path / "cert.pdf", tmp_path / "cert.json"
    options = ("--details", given, "--problem", PLANAR, "--out", out, "--json", kept)
    assert main(monkeypatch, "certificate", results, *options) == 0
    printed = capfd.readouterr().out
    assert "CONFORMS" in printed
    assert "the whole budget" not in printed
    for kept_too in ((), ("--json", tmp_path / "budget.json")):
        assert main(monkeypatch, "certificate", results, "--problem", PLANAR, *kept_too) == 0
        assert ("the whole budget: --out FILE.pdf" in capfd.readouterr().out) is (not kept_too)
    pdf = out.read_bytes()
    assert len(re.findall(rb"/Type /Page\b", pdf)) == 2
    text = text_of(pdf)
    assert MARKUP in text
    assert r"\u0141ód" in text  # a letter that the fonts have not
    assert "certificate data" in text
    assert "Traceability of the instrument is not stated" in text
    assert "SYNTHETIC" in text
    assert "accredited" not in text
    assert "They state no accreditation" in text
    told = json.loads(kept.read_text())
    filled = re.findall(r"\bf$", drawn_in(pdf), re.MULTILINE)
    assert len(filled) == 2 * told["after"]["poses"]  # a point a pose, before and after
    assert told["missing"] == ["traceability", "calibrated", "repeatability", "temperature"]
    assert main(monkeypatch, "certificate", results, *options) == 0  # its own file is replaced
    assert out.read_bytes() == pdf


def test_points_of_a_picture_lie_where_they_are_in_one_scale(results, tmp_path):
    found = certificate(results, details(tmp_path), problem=PLANAR)
    T = read_robot(results / f"{found.method}.robot.toml").base.T
    measured = np.concatenate([m.position for m in read_problem(PLANAR).sets["report"]])
    np.testing.assert_allclose(found.places @ T[:3, :3].T + T[:3, 3], measured, atol=1e-9)
    curves = r"^([\d.]+) ([\d.]+) m .* c\n.*\n.*\n.* c f$"
    drawn = np.array(re.findall(curves, drawn_in(found.pdf()), re.MULTILINE), float).reshape(2, -1, 2)
    blocks = [block for page in found.pages() for part in page.sections for block in part.blocks]
    figures = [block for block in blocks if isinstance(block, Figure)]
    (results,) = [block for block in blocks if isinstance(block, Table) and block.columns[-1] == "n"]
    assert [results.rows[k][0] for k in results.strong] == ["after calibration"]
    for figure, at in zip(figures, drawn, strict=True):
        told = np.column_stack([figure.series[0].x, figure.series[0].y])
        scale = np.ptp(at[:, 0]) / np.ptp(told[:, 0])
        np.testing.assert_allclose(at - at[0], scale * (told - told[0]), atol=0.05)  # points of PDF, with two digits


def test_a_test_by_iso_9283_is_part_of_it(results, tmp_path):
    (tmp_path / "sheet.csv").write_text(SHEET)
    found = certificate(results, details(tmp_path), problem=PLANAR)
    found = replace(found, iso9283=evaluated_table(tmp_path / "sheet.csv", read_robot(ROBOT)))
    _, second = found.pages()
    budget = next(b for part in second.sections for b in part.blocks if isinstance(b, Table))
    assert float(budget.rows[0][2]) == pytest.approx(1e6 * found.after.rms**2, rel=1e-3)
    (section,) = [part for part in second.sections if part.title == "ISO 9283:1998"]
    assert section.blocks[1].text.startswith("dAP = 0.200 mm, dRP = 0.100 mm. ")


def test_the_same_in_german_with_everything_stated(results, tmp_path):
    said = 'language = "de"\n[instrument]\ntraceability = "PTB"\ncalibrated = "2026"\nnoise_mm = 0.001\n'
    said += "[conditions]\nrepeatability_mm = 0.001\n"
    found = certificate(
        results, details(tmp_path, said + "temperature_degC = 21\n[decision]\ntolerance_mm = 0.001"), problem=PLANAR
    )
    assert found.missing == []
    assert found.decision == "fails"
    text = text_of(found.pdf())
    assert "NICHT KONFORM" in text
    assert "Zertifikatsdaten" in text
    assert "bescheinigen keine Akkreditierung" in text


def test_the_lines_of_the_budget_add_up(results, tmp_path):
    said = "[instrument]\nnoise_mm = 0.01\nscale_um_per_m = 10\n[conditions]\ntemperature_degC = 20\nrange_K = 3\n"
    found = certificate(results, details(tmp_path, said), problem=PLANAR)
    after = found.after
    assert {line.source for line in after.lines} == {
        "instrument", "repeatability", "model", "frames", "temperature", "sampling"
    }  # fmt: skip
    assert after.square == pytest.approx(after.rms**2 + sum(line.square for line in after.lines))
    assert after.u() ** 2 == pytest.approx(sum(after.u(line) ** 2 for line in after.lines))
    assert after.expanded == pytest.approx(after.factor * after.u())
    assert after.error < found.before.error / 20
    # By hand: nothing was fitted, noise of 10 um in three coordinates is taken out, scale and growth are put in.
    p = np.concatenate([m.position for m in found.problem.sets["report"]])
    spread = np.mean(((p - p.mean(axis=0)) ** 2).sum(axis=1))
    grown = (12e-6 * 3) ** 2 / 3
    assert after.square == pytest.approx(after.rms**2 - 3e-10 + spread * (1e-10 + grown))


@pytest.mark.parametrize(("tolerance", "word"), [(0.028, "open"), (0.06, "conforms"), (0.005, "fails")])
def test_a_tolerance_is_guarded_by_the_uncertainty(results, tmp_path, tolerance, word):
    given = details(tmp_path, f"[decision]\ntolerance_mm = {tolerance}")
    assert certificate(results, given, problem=PLANAR).decision == word


def test_errors_below_the_noise_that_is_stated_have_an_upper_limit_only(results, tmp_path):
    found = certificate(results, details(tmp_path, "[instrument]\nnoise_mm = 0.05"), problem=PLANAR)
    assert not found.after.resolved
    assert found.after.square < 0
    assert "<= 0.0" in found.blocks()[0].text
    assert text_of(found.pdf())


def test_a_robot_is_judged_with_its_own_tool():
    """The held-out poses place the base again, and not the tool."""
    robot = read_problem(ROOT / "problems" / "ur10e").robot
    q = np.random.default_rng(1).uniform(*robot.limits, (40, 6))
    m = replace(unmeasured(q), position=predicted(robot, unmeasured(q))[0])
    wrong = robot.with_values({"tool_z": robot.parameters["tool_z"].value + 2e-3})
    own, fitted = (budget_of(wrong, [m], groups=g) for g in (("base",), ("base", "tool")))
    assert own.rms > 1e-3
    assert fitted.rms < 1e-8


def test_repeats_tell_the_scatter_of_a_coordinate():
    robot = read_problem(PLANAR).robot
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform(-1, 1, (40, 2)), 10, axis=0)
    m = unmeasured(q)
    m = replace(m, position=2e-5 * rng.normal(size=(400, 3)))
    s, freedom = repeats_of(robot, [m])
    assert freedom == 3 * 40 * 9
    assert s == pytest.approx(2e-5, rel=0.05)
    assert repeats_of(robot, [m[::10]]) == (0.0, 0.0)
    with_repeats = budget_of(robot, [m], (s, freedom), (), noise=1.0)
    assert next(line.square for line in with_repeats.lines if line.source == "instrument") == 0.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('language = "fr"', "language = 'fr'"),
        ('issued = "last May"', "write the day as 2026-03-14"),
        ("[instrument]\nnoise_mm = -1", "above zero"),
        ("[instrument]\nnoise = 1", "write its unit too"),
        ("[decision]\ntolerance_mm = 0", "above zero"),
        ('[instrument]\nnam = "x"', "is name meant?"),
        (f'issuer = "{"x" * 400}"', "at most 300"),
    ],
)
def test_details_that_cannot_be_are_refused_in_a_sentence(results, tmp_path, text, words):
    with pytest.raises(InputError, match=re.escape(words)):
        certificate(results, details(tmp_path, text), problem=PLANAR).pdf()


def test_long_words_shrink_to_two_pages(results, tmp_path):
    long = " ".join(["word"] * 59)
    said = f'issuer = "{long}"\ncustomer = "{"W" * 300}"\nremarks = ["{long}", "{long}", "{long}", "{long}"]'
    pdf = certificate(results, details(tmp_path, said), problem=PLANAR).pdf()
    assert len(re.findall(rb"/Type /Page\b", pdf)) == 2
    assert text_of(pdf).count("word") == 5 * 59


def test_results_of_other_measurements_are_refused(results, tmp_path):
    told = json.loads((results / "result.json").read_text())
    told["methods"]["KM"]["sets"]["report"]["mean_mm"] *= 1.1
    (tmp_path / "result.json").write_text(json.dumps(told))
    (tmp_path / "KM.robot.toml").write_text((results / "KM.robot.toml").read_text())
    with pytest.raises(InputError, match=r"measured, split \(--seed\) or calibrated otherwise \(--loss, --prior\)"):
        certificate(tmp_path, details(tmp_path), problem=PLANAR)
    with pytest.raises(InputError, match="name it with --problem"):
        certificate(tmp_path, details(tmp_path))


def test_a_robot_that_was_fitted_again_to_all_poses_is_judged_as_it_was_before(tmp_path):
    new_problem(tmp_path / "arm")
    calibrated = calibrate(tmp_path / "arm")
    calibrated.write(tmp_path / "results")
    found = certificate(tmp_path / "results", problem=tmp_path / "arm")
    assert found.refit == 60
    problem = read_problem(tmp_path / "arm")
    before = calibrate(replace(problem, whole=()), method="SKCM").identification.robot
    (held_out,) = problem.sets["report"]
    told = calibrated.accuracies["SKCM"]["report"]["calibrated"]
    assert errors(before, held_out).mean() == pytest.approx(told.mean, rel=1e-3)
    assert found.after.rms == pytest.approx(budget_of(before, [held_out]).rms, rel=1e-6)
    assert "fitted to all 60" in text_of(found.pdf())
    assert len(found.missing) == 6
