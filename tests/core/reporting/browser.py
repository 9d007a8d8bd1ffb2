"""A page opened in the real Chromium of this machine, watched for errors and for requests."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser; the test is skipped, aloud, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no report was opened")
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: no report was opened")
    with playwright.sync_playwright() as p:
        # Scenes are drawn by a program that stands for a graphics card; the page itself costs less without it.
        flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing"]
        flags += ["--no-sandbox", "--disable-dev-shm-usage"]
        browser = p.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


class Opened:
    """A page and what happened while it was open."""

    def __init__(self, browser: Any, path: Path, width: int) -> None:
        self.width, self.kind = width, ""
        phone = width < 600
        size = {"width": width, "height": 844 if phone else 900}
        context = browser.new_context(viewport=size, color_scheme="light", has_touch=phone, is_mobile=phone)
        self.page = context.new_page()
        self.faults: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda m: self.faults.append(m.text) if m.type == "error" else None)
        self.page.on("pageerror", lambda e: self.faults.append(str(e)))
        self.page.on("request", lambda r: self.requests.append(r.url))
        # A busy machine draws slowly.
        self.page.set_default_timeout(120_000)
        self.page.goto(path.as_uri(), wait_until="commit")
        self.page.wait_for_selector("html[data-drawn=yes]", state="attached")

    def close(self) -> None:
        """An open page draws its scene again and again, which takes half a processor."""
        self.page.context.close()

    @property
    def network(self) -> list[str]:
        """Requests that left the file."""
        return [u for u in self.requests if not u.startswith(("file:", "data:", "blob:"))]

    def until(self, expression: str) -> None:
        """Wait for what the page will do in a moment."""
        self.page.wait_for_function(expression)

    def js(self, expression: str) -> Any:
        return self.page.evaluate(expression)
