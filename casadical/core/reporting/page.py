"""Pages as one self-contained HTML file: words, tables and figures, plotly.js included."""

import hashlib
import json
import math
import platform
import shlex
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from casadical.core.basics import InputError, optional
from casadical.core.reporting.blocks import Page
from casadical.core.reporting.drawing import COLOURS, DARK_BY_LIGHT, MISSING_PLOTLY, draw
from casadical.core.reporting.template import pages as pages_of

# Folder of the templates, style and script of HTML pages.
TEMPLATES = Path(__file__).parent / "templates"


def require() -> None:
    """Check that HTML reports can be made. Raises InputError where plotly is not installed."""
    optional("plotly.graph_objects", MISSING_PLOTLY)


def html_of(pages: Sequence[Page], command: Sequence[str] = ()) -> str:
    """Return pages as the text of one self-contained HTML file.

    command : words of the command line that made it
    Raises InputError where plotly is not installed, or a file of a page cannot be read.
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
            dark=safe_json(DARK_BY_LIGHT),
            style=_text("page.css"),
            script=_text("page.js"),
            # No text of the library may close the script element that contains it.
            plotly=optional("plotly.offline", MISSING_PLOTLY).get_plotlyjs().replace("</script", "<\\/script"),
        )
    )
    return text.encode(errors="backslashreplace").decode()  # names of files may not be UTF-8


def safe_json(value: Any) -> str:
    """Return plain data as JSON text for an HTML script element, without <, > and &.

    Numbers that are not finite become null.
    """
    text = json.dumps(_finite(value), separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _finite(value: Any) -> Any:
    """Return plain data with None in place of numbers that are not finite."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@cache
def _text(name: str) -> str:
    """Return the text of a file in `TEMPLATES`."""
    return (TEMPLATES / name).read_text(encoding="utf-8")


def provenance_of(files: Iterable[Path], command: Sequence[str] = (), now: datetime | None = None) -> dict[str, Any]:
    """Return the provenance of a report made from files, which are read and hashed here.

    The keys are `files` (SHA-256 by path), `versions` (of each library, of Python and of the
    platform, by name), `command` (quoted for a shell) and `date` (date and time, UTC).

    command : words of the command line
    now : date and time, UTC; None: those of the clock
    Raises InputError where a file cannot be read.
    """
    libraries = ("casadical", "casadi", "numpy", "pandas", "plotly")
    system = {
        "Python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
    }
    return {
        "files": {str(path): sha256(path) for path in files},
        "versions": {name: _version(name) for name in libraries} | system,
        "command": shlex.join(command),
        "date": (now or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC"),
    }


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits. Raises InputError if unreadable."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _version(name: str) -> str:
    """Return the version of an installed distribution, or "unknown"."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
