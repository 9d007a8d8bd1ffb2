"""A report as one HTML file that needs nothing else: words, tables and figures in sections, plotly.js inlined once."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from casadical.core.blocks import Table, Words
from casadical.report.optional_imports import jinja, plotly_js
from casadical.report.provenance import Provenance
from casadical.report.style import COLOURS, DARK, Figure

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure with the words beneath it."""

    name: str
    figure: Figure
    caption: str = ""


Block = Words | Table | Drawing


@dataclass(frozen=True, eq=False)
class Section:
    """One question of the reader and what answers it; an empty one is left out."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Tile:
    """A main figure, shown large at the top of a part."""

    label: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True, eq=False)
class Part:
    """One problem or campaign; badge : what must not be overlooked, as "synthetic data"."""

    title: str
    subtitle: str
    sections: Sequence[Section]
    tiles: Sequence[Tile] = ()
    badges: Sequence[str] = field(default=())


def report_html(title: str, parts: Sequence[Part], provenance: Provenance) -> str:
    """The whole file as text. Raises InputError where plotly or jinja2 is not installed."""
    environment = jinja().Environment(
        loader=jinja().FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja().StrictUndefined,
    )
    environment.tests |= {kind.__name__.lower(): _is(kind) for kind in (Words, Table, Drawing)}
    environment.filters["figure"] = figure_json
    text: str = environment.get_template("page.html").render(
        title=title,
        parts=parts,
        provenance=provenance,
        colours=COLOURS,
        dark=safe_json(DARK),
        style=_text("page.css"),
        script=_text("page.js"),
        plotly=_plotly(),
    )
    return text.encode(errors="backslashreplace").decode()  # names of files may not be UTF-8


def figure_json(figure: Figure) -> str:
    """A figure as JSON that may stand inside of a script element."""
    return safe_json(json.loads(figure.to_json()))


def safe_json(value: Any) -> str:
    """JSON in which no tag can open or close; numbers that are not finite become null."""
    text = json.dumps(_finite(value), separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _is(kind: type) -> Any:
    return lambda block: isinstance(block, kind)


@cache
def _text(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    # Nothing in the library may end the element that it stands in.
    return plotly_js().replace("</script", "<\\/script")
