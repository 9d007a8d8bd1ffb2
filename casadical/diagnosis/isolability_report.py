"""What a design can tell, as a table to read."""

import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from casadical.diagnosis.isolability import Isolability
from casadical.diagnosis.statements import columns_to_log, gathered_by_columns

SHOWN_RIVALS = 3
WIDTH = 112
HEAD = (
    f"{'effect':<24} {'size mm':>8} {'absorbed':>9} {'visible mm':>11} {'to noise':>9} {'found from':>11}   looks like"
)
NOTES = (
    "size: rms at a realistic size; absorbed: the share that the base model takes up; visible: what is left of it, and "
    "a coordinate of that in units of the noise; found from: the multiple of the realistic size that is found 9 times "
    "in 10; looks like: causes that reproduce this share of what is visible."
)


def as_json(found: Isolability, campaign: str) -> dict[str, Any]:
    """The same as plain data; a share that is nothing, and a size that is never found, are left out."""
    rows = {str(k): {c: _plain(v) for c, v in row.items()} for k, row in found.effects.iterrows()}
    alike = {k: {r: round(v, 4) for r, v in found.rivals(k, 0.1).items()} for k in rows}
    return {"campaign": campaign, "effects": rows, "alike": alike, "missing": found.missing}


def _plain(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None


def report(found: Isolability, title: str) -> RenderableType:
    """A row per effect: size, what the base absorbs, what stays visible, and its rivals; to be printed unwrapped."""
    page = Text(f"{title}\n", style="bold underline", no_wrap=True)
    page.append(Text("\n".join([HEAD, *_rows(found), *_footnotes(found)]), style="not bold not underline"))
    return page


def _rows(found: Isolability) -> Iterator[str]:
    for label, row in found.effects.iterrows():
        absorbed = f"{100 * row['absorbed']:.0f} %"
        figures = (
            f"{label!s:<24} {row['size_mm']:>8.3f} {absorbed:>9} {row['visible_mm']:>11.4f} "
            f"{row['visible_to_noise']:>9.2f} {_factor(row['findable_from']):>11}   "
        )
        rivals = [f"{k} {v:.2f}" for k, v in list(found.rivals(str(label)).items())[:SHOWN_RIVALS]]
        yield f"{figures}{rivals[0] if rivals else ''}".rstrip()
        yield from (" " * len(figures) + rival for rival in rivals[1:])


def _factor(value: float) -> str:
    """A multiple of the realistic size."""
    return f"{value:.2g} x" if np.isfinite(value) and value < 100 else "never"


def _footnotes(found: Isolability) -> Iterator[str]:
    yield from textwrap.wrap(NOTES, WIDTH)
    for columns, effects in gathered_by_columns(columns_to_log(found.missing, ())).items():
        yield from textwrap.wrap(f"not logged: {columns}; it would show {effects}", WIDTH, break_on_hyphens=False)
