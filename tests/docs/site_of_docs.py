"""The docs built once a run, in a copy, tutorials and all; and what is in the pages."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cached_property
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted(path.name for path in (ROOT / "docs" / "tutorials").glob("tutorial_*.py"))


@dataclass(frozen=True)
class Site:
    """A build: where, how it ended, and of each tutorial what went wrong."""

    folder: Path
    returncode: int
    log: str
    tutorials: dict[str, str]

    @cached_property
    def pages(self) -> dict[Path, Page]:
        """Every page."""
        found = {}
        for path in sorted(self.folder.rglob("*.html")):
            found[path] = Page()
            found[path].feed(path.read_text(encoding="utf-8"))
        return found


def built(folder: Path) -> Site:
    """The documented command, on a copy of docs/ beside the files that the pages link to and the tutorials read."""
    shutil.copytree(ROOT / "docs", folder / "docs", ignore=shutil.ignore_patterns("gallery", "api", "__pycache__"))
    for name in ("data", "problems", "casadical", "tests"):
        (folder / name).symlink_to(ROOT / name)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", "build/docs"]
    environment = {**os.environ, "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    return Site(folder / "build" / "docs", done.returncode, done.stdout + done.stderr, _tutorials(folder))


def _tutorials(folder: Path) -> dict[str, str]:
    report = folder / "build" / "docs" / "gallery-junit.xml"
    if not report.exists():
        return {}
    found = {}
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        wrong = " ".join(child.get("message") or child.tag for child in case)
        found[Path(case.get("file", "")).name] = wrong
    return found


@dataclass
class Page(HTMLParser):
    """Links, anchors and loaded files of one page."""

    links: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)
    loaded: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.anchors |= {values[key] or "" for key in ("id", "name") if key in values}
        if tag == "a" and values.get("href"):
            self.links.append(values["href"] or "")
        for key in ("src", "href"):
            if tag in ("script", "img", "link", "iframe") and values.get(key) and values.get("rel") != "canonical":
                self.loaded.append(values[key] or "")
