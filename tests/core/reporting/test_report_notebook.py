"""What a notebook shows: short texts with units, tables that parse, and every figure by one call."""

import json
import re
from pathlib import Path

import pytest
from parsed import Parsed

from casadical import plot
from casadical.core.basics import InputError
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.result import Result, Shown, html


@pytest.fixture(scope="module")
def shown(calibrated, diagnosis):
    c = calibrated("planar")
    i = c.identification
    return {
        "calibration": c,
        "identification": i,
        "robot": i.robot,
        "measurements": i.measurements[0],
        "diagnosis": diagnosis,
    }


@pytest.mark.parametrize("name", ["calibration", "identification", "robot", "measurements", "diagnosis"])
def test_results_show_themselves_in_a_line_and_in_tables(shown, name) -> None:
    text = repr(shown[name])
    assert len(text) < 200
    assert "\n" not in text
    page = Parsed(shown[name]._repr_html_())
    assert page.open == []
    assert len(page.texts["th"] + page.texts["td"]) > 4
    assert len(shown[name]._repr_html_()) < 40_000


def test_results_are_plain_data_and_files(shown) -> None:
    for result in (found for found in shown.values() if isinstance(found, Result)):
        data, files = result.to_json(), result.files(Path("out"))
        assert json.loads(json.dumps(data, allow_nan=False)).keys() == data.keys()
        assert all(files.values())
        assert {path.parent for path in files} == {Path("out")}


def test_a_line_is_made_of_the_first_block_and_is_short() -> None:
    class Made(Shown):
        def blocks(self):
            return [Words("a title", "title"), Words("a verdict " + 100 * "and more ", "verdict")]

    assert repr(Made()).startswith("<Made: a verdict and more")
    assert len(repr(Made())) < 165


def test_problems_and_sets_of_a_problem_are_told_and_taken(shown) -> None:
    problem, found = shown["calibration"].problem, shown["identification"]
    assert repr(problem) == "<Problem planar: Planar arm of two links; identify 25, report 15 poses; KM>"
    assert found.accuracy(problem.sets["report"]) == found.accuracy(*problem.sets["report"])


def test_every_length_has_its_unit(shown) -> None:
    a = shown["calibration"].accuracies["KM"]["report"]["calibrated"]
    assert re.fullmatch(r"<Accuracy of 15 poses: mean [\d.]+ mm, 95 % below [\d.]+ mm, max [\d.]+ mm>", repr(a))
    assert f"{1e3 * a.mean:.4f} mm" in repr(a)
    assert f"-> {1e3 * a.mean:.4f} mm" in repr(shown["calibration"])
    assert {"a [mm]", "theta [deg]"} <= {*Parsed(shown["robot"]._repr_html_()).texts["th"]}


def test_bars_are_as_long_as_their_values_and_text_stays_text() -> None:
    page = html([Words("<b>"), Table("<i>", ("<u>",), [("<s>",)])], [("half", 1e-3), ("whole", 2e-3)])
    assert not re.search(r"<[bius]>", page)
    half, whole = (float(w) for w in re.findall(r'rect [^>]*width="([\d.]+)"', page))
    assert whole == pytest.approx(2 * half)
    assert "2.000 mm" in page


def test_plot_has_every_figure_of_the_report(shown) -> None:
    c = shown["calibration"]
    assert list(plot(c)) == list(c.figures())
    assert plot(c, "fit/residuals").layout.title.text == "Residuals: are they noise?"
    assert {"parameters/lengths", "fit/coverage"} <= set(plot(shown["identification"]))
    with pytest.raises(InputError, match=r"'gap' is no figure of this result; there are errors/report"):
        plot(c, "gap")
    assert plot(shown["diagnosis"], "gap").layout.title.text == "Gap on held-out poses"
