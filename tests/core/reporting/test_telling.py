"""Blocks and figures as data: every renderer shows the same words, cells and numbers, and none what is not there."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from casadical.cli.terminal import refusal, wrapped
from casadical.core.reporting import pdf
from casadical.core.reporting.blocks import Page, Section, Table, Tile, Words, figures_named, mm
from casadical.core.reporting.figure import Axis, Figure, Note, Panel, Rule, Series, ticks_of_decades
from casadical.core.reporting.page import html_of
from casadical.core.reporting.result import html, plain_text

TABLE = Table("Errors [mm]", ("model", "mean"), [("before", "1.70"), ("after [KM]", "0.03")], frozenset({1}))
BLOCKS = [
    Words("Falls from 1.70 to 0.03 mm.", "verdict"),
    Words("reading: a column is missing", "error", mark="ERROR"),
    Words("Then:", code="casadical plan arm"),
    TABLE,
]
TOLD = ("Falls from 1.70", "ERROR", "a column is missing", "Errors [mm]", "after [KM]", "0.03")


def drawn(**more: object) -> Figure:
    line = Series("line", [1, 2, 3], [0.1, 1.0, 10.0], name="a <b>", colour="red", tip="%{y:.1f}")
    return Figure("errors/a", "Errors <i>", [line], Axis("n", (1, 3)), Axis("mm", log=True), **more)


def test_the_terminal_leaves_figures_out_and_blank_lines_about_tables() -> None:
    text = plain_text([*BLOCKS, drawn(), Words("end")])
    assert [line.strip() for line in text.splitlines()] == [
        "Falls from 1.70 to 0.03 mm.", "ERROR reading: a column is missing", "Then:", "casadical plan arm", "",
        "Errors [mm]", "model       mean", "before      1.70", "after [KM]  0.03", "", "end",
    ]  # fmt: skip


def test_a_long_command_is_broken_so_that_it_can_be_copied() -> None:
    command = " ".join(["casadical plan arm", *(f"--option{k} value" for k in range(20))])
    _, *lines = plain_text([Words("Then:", code=command)]).splitlines()
    assert len(lines) > 2
    assert " ".join(line.strip().removesuffix("\\").strip() for line in lines) == command
    assert all(line.rstrip().endswith("\\") for line in lines[:-1])


def test_terminal_notebook_and_page_say_the_same() -> None:
    page = Page("Calibration", "arm", "of two links", [Section("All", [*BLOCKS, drawn(caption="How to read it.")])])
    for text in (plain_text(BLOCKS), html(BLOCKS), html_of([page])):
        assert [words for words in TOLD if words not in text] == []
    assert "How to read it." in html_of([page])


def test_a_page_has_tiles_and_no_empty_section() -> None:
    page = Page("Fleet", "arms", "", [Section("Nothing", []), Section("All", BLOCKS)], [Tile("Mean", "0.03", "mm")])
    text = html_of([page], ["casadical", "fleet", "a b"])
    assert "Nothing" not in text
    assert "<dt>Mean</dt><dd><b>0.03</b> mm</dd>" in text
    assert "casadical fleet &#39;a b&#39;" in text


@pytest.mark.parametrize("width", [24, 30, 40, 44, 50, 60, 80])
def test_a_narrow_terminal_breaks_a_table_and_cuts_nothing(width: int) -> None:
    row = ("as calibrated", "0.071", "0.064 to 0.077", "0.071", "0.073")
    wide = Table("", ("layer", "mean", "95 %", "time excluded", "without noise"), [row], frozenset({1, 2, 3, 4}))
    shown = plain_text([wide], width)
    assert max(map(len, shown.splitlines())) <= width
    assert sorted("".join(shown.split())) == sorted("".join(" ".join([*wide.columns, *wide.rows[0]]).split()))


def test_a_table_without_names_has_no_head_and_its_words_hang_beneath_each_other() -> None:
    told = Table("", ("", ""), [("a", "one two three four"), ("", "five")])
    assert [line.rstrip() for line in plain_text([told], 12).splitlines()] == [
        "a  one two",
        "   three",
        "   four",
        "   five",
    ]


def test_a_figure_is_drawn_as_its_data_say() -> None:
    pytest.importorskip("plotly", reason="plotly is not installed (extra report)")
    from casadical.core.reporting.drawing import COLOURS, draw

    picture = draw(drawn(marks=[Rule("y", 5.0), Note("here", 2, 1.0)], shaded=(1, 2)))
    (trace,) = picture.data
    assert (list(trace.x), list(trace.y), trace.line.color) == ([1, 2, 3], [0.1, 1.0, 10.0], COLOURS["red"][0])
    assert (trace.name, picture.layout.title.text) == ("a &lt;b&gt;", "Errors &lt;i&gt;")  # a user's text stays text
    assert (picture.layout.yaxis.type, picture.layout.yaxis.ticktext[0]) == ("log", "1e-09")
    assert [a.text for a in picture.layout.annotations] == ["here"]
    assert picture.layout.annotations[0].y == 0.0  # of a logarithmic axis, as plotly wants it
    assert len(picture.layout.shapes) == 2
    legend = picture.layout.legend
    assert (legend.yref, legend.yanchor, 0 <= legend.y <= 1) == ("container", "bottom", True)  # it is never cut off


def test_rows_are_words_from_the_top_and_intervals_lie_along_them() -> None:
    pytest.importorskip("plotly", reason="plotly is not installed (extra report)")
    from casadical.core.reporting.drawing import draw

    dots = Series("points", [1.0, 2.0], range(2), less=[0.5, 0.1], more=[0.2, 0.3])
    bars = Series("bars", [1.0, 2.0], range(2))
    picture = draw(Figure("n", "t", [dots, bars], rows=("first", "a and\nb")))
    assert (picture.data[1].orientation, picture.data[1].marker.line.width) == ("h", 0)  # a rim would be length
    assert list(picture.layout.yaxis.ticktext) == ["first", "a and<br>b"]
    assert picture.layout.yaxis.range[0] > picture.layout.yaxis.range[1]
    assert (list(picture.data[0].error_x.arrayminus), list(picture.data[0].error_x.array)) == ([0.5, 0.1], [0.2, 0.3])


@pytest.mark.parametrize("count", [1, 2, 3])
def test_figures_of_a_sheet_stand_side_by_side_within_its_margins(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[tuple[float, float]] = []
    monkeypatch.setattr(pdf, "_figure", lambda sheet, figure, left, top, wide, high: places.append((left, wide)))
    sheet = SimpleNamespace(get_y=lambda: 10.0, set_xy=lambda x, y: None)
    pdf._figures(sheet, [drawn()] * count, 1.0)
    edges = np.array([(left, left + wide) for left, wide in places])
    assert edges[0, 0] == pdf.MARGIN_MM
    assert edges[-1, 1] == pytest.approx(pdf.MARGIN_MM + pdf.TEXT_WIDTH_MM)
    np.testing.assert_allclose(edges[1:, 0] - edges[:-1, 1], 6.0)  # mm between two


@pytest.mark.parametrize(("shared", "title", "gap"), [("x", "n", 30), ("", "", 30), ("", "n", 50)])
def test_the_gap_between_panels_holds_the_ticks_where_they_have_some(shared: str, title: str, gap: int) -> None:
    panels = [Panel(k, 1, f"panel {k}", Axis(title)) for k in (1, 2)]
    lines = [Series("line", [1, 2], [1.0, 2.0], panel=k) for k in (0, 1)]
    figure = Figure("n", "t", lines, panels=panels, shared=shared, height=500)
    draw = pytest.importorskip("casadical.core.reporting.drawing").draw
    upper, lower = draw(figure).layout.yaxis.domain, draw(figure).layout.yaxis2.domain
    assert (upper[0] - lower[1]) * (500 - 76 - 100) == pytest.approx(gap)  # less the title and the legend


def test_figures_are_chosen_by_name_or_by_the_first_part_of_it() -> None:
    figures = {name: drawn() for name in ("gap", "where/joints", "where/links", "whereabouts")}
    assert len(figures_named(figures, "where")) == 2
    assert len(figures_named(figures, "gap")) == 1


def test_ticks_of_a_logarithmic_axis_are_round() -> None:
    assert ticks_of_decades(0.1, 5) == [0.1, 0.2, 0.5, 1, 2, 5]
    assert ticks_of_decades(0.02, 30, (1,)) == [0.01, 0.1, 1, 10]


def test_a_length_has_fewer_decimals_the_larger_it_is() -> None:
    assert [mm(x) for x in (-5e-5, 1e-4, 0.01, 0.1)] == ["-0.0500", "0.100", "10.00", "100.0"]
    assert re.fullmatch(r"[125]e-\d+|0\.\d+|\d+(e\+\d+)?", f"{ticks_of_decades()[0]:g}")


def test_brackets_are_printed_and_control_characters_reach_no_terminal(capsys):
    refusal("topic \x1b[31mred\x9b, line\nnext")
    assert capsys.readouterr().err == "casadical: topic \\x1b[31mred\\x9b, line\nnext\n"
    wrapped(False, 80).print("arm [red] of cell [bold]2")
    assert capsys.readouterr().out == "arm [red] of cell [bold]2\n"
    blocks = [Words("\x1b[31mred", "warning"), Table("t", ["\x1bcolumn"], [["\x1bcell"]])]
    assert "\x1b" not in plain_text(blocks)
