"""Reports in a real browser: drawn, hovered over, on a phone, in the dark, on paper, and never on the network."""

import pytest
from browser import Opened, chromium

pytestmark = pytest.mark.slow
WIDE, PHONE = 1280, 390
CALIBRATION, DIAGNOSIS = ("calibration", WIDE), ("diagnosis", WIDE)
PHONES = (("calibration", PHONE), ("diagnosis", PHONE))
LEAST = {"calibration": 12, "diagnosis": 12, "logs": 3}
FIGURE = "figure[data-name='{}']"


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def page(request, browser):
    """A kind of report at a width: opened once for all its tests, which pytest runs one after the other."""
    kind, width = request.param
    opened = Opened(browser, request.getfixturevalue(f"{kind}_file"), width)
    opened.kind = kind
    yield opened
    opened.close()


def on(*pages: tuple[str, int]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("page", pages, indirect=True, ids="{0[0]}-{0[1]}".format)


@on(CALIBRATION, DIAGNOSIS, ("logs", WIDE), *PHONES, ("logs", PHONE))
def test_every_figure_is_drawn_and_nothing_overflows_or_leaves_the_file(page) -> None:
    figures = page.js("document.querySelectorAll('figure[data-name]').length")
    drawn = page.js(
        """[...document.querySelectorAll('figure[data-name]')].filter(f => {
            const plot = f.querySelector('.plot'), box = plot.querySelector('.main-svg').getBoundingClientRect();
            const marks = plot.querySelectorAll(
                '.scatterlayer .trace path, .barlayer path, .heatmaplayer image, .gl-container canvas');
            return box.width > 0.9 * plot.clientWidth && box.width < plot.clientWidth + 1 && marks.length > 0;
        }).length"""
    )
    assert figures >= LEAST[page.kind]
    assert drawn == figures
    assert page.js("document.documentElement.scrollWidth") == page.width
    assert page.faults == []
    assert page.network == []


@on(*PHONES)
def test_on_a_phone_no_words_of_a_figure_are_cut_or_lie_on_others(page) -> None:
    outside = page.js(
        """[...document.querySelectorAll('.plot')].flatMap(plot => {
            const box = plot.getBoundingClientRect();
            const words = '.xtick text, .ytick text, .gtitle, .xtitle, .ytitle, .legendtext, .bartext, '
                + '.annotation-text';
            return [...plot.querySelectorAll(words)]
                .filter(t => { const r = t.getBoundingClientRect();
                    const wide = r.left < box.left - 1 || r.right > box.right + 1;
                    return r.width && (wide || r.bottom > box.bottom + 1); })
                .map(t => t.textContent);
        })"""
    )
    assert outside == []
    overlapping = page.js(
        """[...document.querySelectorAll('.plot')].flatMap(plot => ['.xtick text', '.ytick text'].flatMap(kind => {
            const boxes = [...plot.querySelectorAll(kind)].map(t => [t.textContent, t.getBoundingClientRect()]);
            return boxes.flatMap(([a, p], i) => boxes.slice(i + 1).filter(([b, q]) =>
                p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 4 && q.top < p.bottom - 4)
                .map(([b]) => `${a} | ${b}`));
        }))"""
    )
    assert overlapping == []


def hover(page: Opened, name: str) -> str:
    """The tooltip that a real mouse finds over a mark of a plane figure."""
    figure = page.page.locator(FIGURE.format(name))
    mark = figure.locator(".points path, .point path").nth(1)
    mark.scroll_into_view_if_needed()
    box = mark.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x - 4, y)
    page.page.mouse.move(x, y, steps=4)
    figure.locator(".hoverlayer text").first.wait_for(timeout=10_000)
    return str(figure.locator(".hoverlayer").text_content())


@on(CALIBRATION)
def test_tooltips_tell_the_pose_its_error_and_the_interval(page) -> None:
    errors = hover(page, "errors/report")
    assert "row " in errors
    assert "before" in errors
    assert "mm" in errors
    assert "95 %" in hover(page, "parameters/lengths")
    assert "95 %" in hover(page, "where/regions")


GROUNDS = """[getComputedStyle(document.body).backgroundColor,
    ...[...document.querySelectorAll('.plot .main-svg:first-child')].map(s => getComputedStyle(s).backgroundColor)]
    .map(c => Number(c.match(/\\d+/)[0]))"""


@on(CALIBRATION, DIAGNOSIS)
def test_in_the_dark_the_page_and_its_figures_turn_dark(page) -> None:
    assert min(page.js(GROUNDS)) > 200
    page.page.emulate_media(color_scheme="dark")
    page.until(f"() => Math.max(...{GROUNDS}) < 60")
    assert len(page.js(GROUNDS)) > 12
    page.page.emulate_media(color_scheme="light")
    page.until(f"() => Math.min(...{GROUNDS}) > 200")
