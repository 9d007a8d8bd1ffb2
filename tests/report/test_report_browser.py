"""Reports in a real browser: drawn, hovered over, on a phone, in the dark, on paper, and never on the network."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import Opened, chromium

KINDS = ["calibration", "diagnosis"]


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(params=KINDS)
def file(request) -> Path:
    path: Path = request.getfixturevalue(f"{request.param}_file")
    return path


@pytest.mark.parametrize("width", [1280, 390])
def test_every_figure_is_drawn_and_nothing_overflows_or_leaves_the_file(browser, file, width) -> None:
    opened = Opened(browser, file, width=width)
    figures = opened.js("document.querySelectorAll('figure[data-name]').length")
    drawn = opened.js(
        """[...document.querySelectorAll('figure[data-name]')].filter(f => {
            const plot = f.querySelector('.plot'), box = plot.querySelector('.main-svg').getBoundingClientRect();
            const marks = plot.querySelectorAll('.scatterlayer .trace path, .barlayer path, .gl-container canvas');
            return box.width > 0.9 * plot.clientWidth && box.width < plot.clientWidth + 1 && marks.length > 0;
        }).length"""
    )
    assert figures >= 12
    assert drawn == figures
    assert opened.js("document.documentElement.scrollWidth") == width
    assert opened.faults == []
    assert opened.network == []


def test_no_words_of_a_figure_lie_outside_of_it(browser, file) -> None:
    opened = Opened(browser, file, width=390, height=844)
    outside = opened.js(
        """[...document.querySelectorAll('.plot')].flatMap(plot => {
            const box = plot.getBoundingClientRect();
            return [...plot.querySelectorAll('.xtick text, .ytick text, .gtitle, .xtitle, .ytitle, .legendtext')]
                .filter(t => { const r = t.getBoundingClientRect();
                    const wide = r.left < box.left - 1 || r.right > box.right + 1;
                    return r.width && (wide || r.bottom > box.bottom + 1); })
                .map(t => t.textContent);
        })"""
    )
    assert outside == []


def test_ticks_of_an_axis_do_not_overlap(browser, file) -> None:
    opened = Opened(browser, file, width=390, height=844)
    overlapping = opened.js(
        """[...document.querySelectorAll('.plot')].flatMap(plot => ['.xtick text', '.ytick text'].flatMap(kind => {
            const boxes = [...plot.querySelectorAll(kind)].map(t => [t.textContent, t.getBoundingClientRect()]);
            return boxes.flatMap(([a, p], i) => boxes.slice(i + 1).filter(([b, q]) =>
                p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 4 && q.top < p.bottom - 4)
                .map(([b]) => `${a} | ${b}`));
        }))"""
    )
    assert overlapping == []


def hover(opened: Opened, name: str) -> str:
    """The tooltip that the mouse finds over a mark of a plane figure."""
    mark = opened.page.locator(f"figure[data-name='{name}'] .points path, figure[data-name='{name}'] .point path")
    mark.nth(1 if mark.count() > 1 else 0).scroll_into_view_if_needed()
    box = mark.nth(1 if mark.count() > 1 else 0).bounding_box()
    opened.page.mouse.move(box["x"] + box["width"] / 2 - 3, box["y"] + box["height"] / 2 - 3)
    opened.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, steps=4)
    tip = opened.page.locator(f"figure[data-name='{name}'] .hoverlayer text").first
    tip.wait_for(timeout=5000)
    return str(opened.page.locator(f"figure[data-name='{name}'] .hoverlayer").inner_text())


def test_tooltips_tell_the_pose_its_error_and_the_interval(browser, calibration_file, diagnosis_file) -> None:
    opened = Opened(browser, calibration_file)
    errors = hover(opened, "errors/report")
    assert "pose " in errors
    assert "SKCM" in errors
    assert "mm" in errors
    assert "95 %" in hover(opened, "parameters/lengths")
    assert "95 %" in hover(opened, "where/regions")
    opened = Opened(browser, diagnosis_file)
    assert "backlash@5" in hover(opened, "causes/1")


def test_the_workspace_turns_and_its_vectors_answer_the_mouse(browser, calibration_file) -> None:
    opened = Opened(browser, calibration_file)
    scene = opened.page.locator("figure[data-name='workspace'] .gl-container")
    scene.scroll_into_view_if_needed()
    box = scene.bounding_box()
    eye = "document.querySelector(\"figure[data-name='workspace'] .plot\")._fullLayout.scene._scene.getCamera().eye.x"
    before = opened.js(eye)
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    opened.page.mouse.move(*middle)
    opened.page.mouse.down()
    opened.page.mouse.move(middle[0] + 80, middle[1], steps=5)
    opened.page.mouse.up()
    opened.page.wait_for_timeout(300)
    assert abs(opened.js(eye) - before) > 0.05
    # Where the first tip stands on the screen, no library tells: the mouse searches for it.
    opened.js(
        """(() => { window.tips = []; document.querySelector("figure[data-name='workspace'] .plot")
            .on('plotly_hover', e => window.tips.push(e.points[0].customdata)); })()"""
    )
    for y in range(int(box["y"] + 0.25 * box["height"]), int(box["y"] + 0.75 * box["height"]), 9):
        opened.page.mouse.move(box["x"] + 0.25 * box["width"], y)
        opened.page.mouse.move(box["x"] + 0.75 * box["width"], y, steps=40)
        if opened.js("window.tips.length"):
            break
    tips = opened.js("window.tips")
    assert tips
    row, size, dx, dy, dz = tips[0][:5]
    assert size == pytest.approx((dx**2 + dy**2 + dz**2) ** 0.5, abs=1e-4)
    assert row == int(row)


def test_the_dark_page_is_dark_and_so_are_its_figures(browser, file) -> None:
    light, dark = (Opened(browser, file, scheme=scheme) for scheme in ("light", "dark"))
    for opened, limit in ((light, lambda v: v > 200), (dark, lambda v: v < 60)):
        grounds = opened.js(
            """[getComputedStyle(document.body).backgroundColor,
                ...[...document.querySelectorAll('.plot .main-svg:first-child')]
                    .map(s => getComputedStyle(s).backgroundColor)]
               .map(c => Number(c.match(/\\d+/)[0]))"""
        )
        assert len(grounds) > 10
        assert all(limit(v) for v in grounds)


def test_it_prints_with_a_white_picture_of_every_figure(browser, file, tmp_path) -> None:
    opened = Opened(browser, file, scheme="dark")
    opened.page.emulate_media(media="print")
    pictures = opened.js(
        """[...document.querySelectorAll('img.print')].map(i => [i.naturalWidth, i.clientWidth,
            getComputedStyle(i).display, i.src.includes(encodeURIComponent('#171c23'))])"""
    )
    assert len(pictures) == opened.js("document.querySelectorAll('figure[data-name]').length")
    assert all(
        natural > 0 and shown > 0 and display == "block" and not dark for natural, shown, display, dark in pictures
    )
    pdf = opened.page.pdf(path=tmp_path / "report.pdf", format="A4")
    assert pdf.startswith(b"%PDF")
    assert len(pdf) > 50_000
