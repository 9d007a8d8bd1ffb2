"""Pages as one HTML file that needs nothing else: words, tables and figures in sections, plotly.js inlined once."""

import hashlib
import json
import math
import platform
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from casadical.core.basics import InputError, optional
from casadical.core.telling.blocks import Page
from casadical.core.telling.drawing import COLOURS, DARK, NEEDED, draw
from casadical.core.telling.template import pages as pages_of

TEMPLATES = Path(__file__).parent / "templates"


def require() -> None:
    """Refuse at once what would fail in the end. Raises InputError where a library of the extra is not installed."""
    optional("plotly.graph_objects", NEEDED)


def html_of(pages: Sequence[Page], command: Sequence[str] = ()) -> str:
    """The whole file as text; command : as it was typed

    Raises InputError where plotly is not installed, or a file of a page is gone.
    """
    text: str = (
        pages_of(TEMPLATES)
        .get_template("page.html")
        .render(
            figure=lambda figure: safe_json(json.loads(draw(figure).to_json())),
            title=pages[0].kind,
            parts=pages,
            provenance=provenance_of([path for page in pages for path in page.files], command),
            colours=COLOURS,
            dark=safe_json(DARK),
            style=_text("page.css"),
            script=_text("page.js"),
            plotly=_plotly(),
        )
    )
    return text.encode(errors="backslashreplace").decode()  # names of files may not be UTF-8


def safe_json(value: Any) -> str:
    """JSON for a script element, in which no tag can open or close; numbers that are not finite become null."""
    text = json.dumps(_finite(value), separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@cache
def _text(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    # Nothing in the library may end the element that it stands in.
    whole: str = optional("plotly.offline", NEEDED).get_plotlyjs()
    return whole.replace("</script", "<\\/script")


@dataclass(frozen=True)
class Provenance:
    """files : (path, SHA-256) of what was read; versions : (name, version); command : as typed; date : UTC."""

    files: tuple[tuple[str, str], ...]
    versions: tuple[tuple[str, str], ...]
    command: str
    date: str


def provenance_of(files: Iterable[Path], command: Sequence[str] = (), now: datetime | None = None) -> Provenance:
    """Of files, read now; now : instead of the clock. Raises InputError where a file cannot be read."""
    return Provenance(
        files=tuple((str(path), sha256(path)) for path in dict.fromkeys(files)),
        versions=(
            *((name, _version(name)) for name in ("casadical", "casadi", "numpy", "pandas", "plotly")),
            ("Python", platform.python_version()),
            ("platform", f"{platform.system()} {platform.machine()}"),
        ),
        command=shlex.join(command),
        date=(now or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC"),
    )


def sha256(path: Path) -> str:
    """Of a file's bytes. Raises InputError."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
