"""Reports in a real browser: drawn, hovered over, on a phone, in the dark, on paper, and never on the network."""

import pytest
from browser import Opened, chromium

pytestmark = pytest.mark.slow
WIDE, PHONE = 1280, 390
CALIBRATION, DIAGNOSIS = ("calibration", WIDE), ("diagnosis", WIDE)
PHONES = (("calibration", PHONE), ("diagnosis", PHONE))
LEAST = {"calibration": 12, "diagnosis": 12, "logs": 5}
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


@on(PHONES[0])
def test_on_a_phone_the_tables_of_errors_show_all_their_columns(page) -> None:
    cut = page.js(
        """[...document.querySelectorAll('#p1s2 .table')].filter(t => t.textContent.includes('95 %'))
            .map(t => t.querySelector('.scroll')).map(s => [s.scrollWidth, s.clientWidth])"""
    )
    assert cut
    assert all(whole <= seen for whole, seen in cut), cut


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


@on(DIAGNOSIS)
def test_tooltips_tell_the_cause(page) -> None:
    assert "backlash" in hover(page, "causes/1")


@on(CALIBRATION)
def test_the_workspace_turns_and_its_vectors_answer_the_mouse(page) -> None:
    scene = page.page.locator(f"{FIGURE.format('workspace')} .gl-container canvas").first
    scene.scroll_into_view_if_needed()
    box = scene.bounding_box()
    plot = f'document.querySelector("{FIGURE.format("workspace")} .plot")'
    before = page.js(f"{plot}._fullLayout.scene._scene.getCamera().eye.x")
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 80, y, steps=8)
    page.page.mouse.up()
    page.until(f"() => Math.abs({plot}._fullLayout.scene._scene.getCamera().eye.x - {before}) > 0.05")
    # Where a tip stands on the screen, no library tells: the mouse searches for it.
    page.js(f"(() => {{ window.tips = []; {plot}.on('plotly_hover', e => tips.push(e.points[0].customdata)); }})()")
    for share in (0.5, 0.4, 0.6, 0.45, 0.55, 0.35, 0.3):
        page.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + share * box["height"])
        page.page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + share * box["height"], steps=60)
        if page.js("tips.length"):
            break
    tips = page.js("tips")
    assert tips
    row, size, dx, dy, dz = tips[0][:5]
    assert size == pytest.approx((dx**2 + dy**2 + dz**2) ** 0.5, abs=1e-4)
    assert row == int(row)


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


@on(CALIBRATION, DIAGNOSIS)
def test_it_prints_with_a_white_picture_of_every_figure(page, tmp_path) -> None:
    page.until("() => document.documentElement.dataset.ready === 'yes'")
    page.page.emulate_media(media="print", color_scheme="dark")
    pictures = page.js(
        """[...document.querySelectorAll('img.print')].map(i => [i.naturalWidth, i.clientWidth,
            getComputedStyle(i).display, i.src.includes(encodeURIComponent('#171c23'))])"""
    )
    page.page.emulate_media(media="screen", color_scheme="light")
    assert len(pictures) == page.js("document.querySelectorAll('figure[data-name]').length")
    assert all(natural and shown and display == "block" and not dark for natural, shown, display, dark in pictures)
    pdf = page.page.pdf(path=tmp_path / "report.pdf", format="A4")
    assert pdf.startswith(b"%PDF")
    assert len(pdf) > 50_000
