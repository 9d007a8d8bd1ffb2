"""Pictures of reports for docs/report.md: python docs/studies/report_pictures.py (a minute)

Makes the two reports of that page by its commands, opens them in Chromium by playwright, and draws the beginning of
some sections, with few colours.
"""

import io
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
PICTURES = {
    "report_calibration": (("calibrate", "problems/hh800"), ("Errors before and after", "In the workspace")),
    "report_diagnosis": (
        ("diagnose", "problems/ur10e", "data/campaigns/practice/ur10e-P09.csv"),
        ("Verdict", "Which causes, and how sure", "Replayed in a simulator"),
    ),
}
WIDTH, COLOURS = 1000, 64
# Of the sections that are kept, the first figure and two tables.
HIDE = """kept => document.querySelectorAll('section').forEach(s => {
    const h = s.querySelector('h2'); if (h && !kept.includes(h.textContent.trim())) s.style.display = 'none';
    s.querySelectorAll('figure').forEach((f, i) => { if (i > 0) f.style.display = 'none'; });
    s.querySelectorAll('.table').forEach((t, i) => { if (i > 1) t.style.display = 'none'; }); })"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as p:
        flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"]
        browser = p.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        for name, (command, sections) in PICTURES.items():
            report = Path(folder) / f"{name}.html"
            run = [sys.executable, "-c", "from casadical.cli import main; main()", *command, "--report", report, "-q"]
            subprocess.run(run, cwd=ROOT, check=True)
            page = browser.new_page(viewport={"width": WIDTH, "height": 1100}, color_scheme="light")
            page.set_default_timeout(120_000)
            page.goto(report.as_uri())
            page.wait_for_selector("html[data-drawn=yes]", state="attached")
            write(IMAGES / f"{name}.png", page, sections)
            page.close()
        browser.close()


def write(path: Path, page: object, sections: Sequence[str]) -> None:
    """A picture of the page's head and some sections."""
    page.evaluate(HIDE, list(sections))  # type: ignore[attr-defined]
    page.wait_for_timeout(1500)  # type: ignore[attr-defined]
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True)))  # type: ignore[attr-defined]
    picture.convert("RGB").quantize(COLOURS).save(path, optimize=True)
    print(f"{path.name}: {picture.width} x {picture.height}, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
