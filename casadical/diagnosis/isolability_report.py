"""What a design can tell, as tables to read."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from .isolability import Isolability

SHOWN_RIVALS = 3


def as_json(found: Isolability, campaign: str) -> dict[str, Any]:
    """The same as plain data; a share that is nothing, and a size that is never found, are left out."""
    rows = {str(k): {c: _plain(v) for c, v in row.items()} for k, row in found.effects.iterrows()}
    alike = {k: {r: round(v, 4) for r, v in found.rivals(k, 0.1).items()} for k in rows}
    return {"campaign": campaign, "effects": rows, "alike": alike, "missing": found.missing}


def _plain(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None


def report(found: Isolability, title: str) -> RenderableType:
    """A row per effect: size, what the base absorbs, what stays visible, and its rivals."""
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for column in ("effect", "size mm", "absorbed", "visible mm", "over noise", "found from"):
        table.add_column(column, justify="left" if column == "effect" else "right", no_wrap=True)
    table.add_column("looks like")
    for label, row in found.effects.iterrows():
        table.add_row(
            str(label),
            f"{row['size_mm']:.3f}",
            f"{100 * row['absorbed']:.0f} %",
            f"{row['visible_mm']:.4f}",
            f"{row['visible_to_noise']:.2f}",
            _factor(row["findable_from"]),
            ", ".join(f"{k} {v:.2f}" for k, v in list(found.rivals(str(label)).items())[:SHOWN_RIVALS]),
        )
    return Group(Text(title, style="bold underline"), table, *_footnotes(found))


def _factor(value: float) -> str:
    """A multiple of the realistic size."""
    return f"{value:.2g} x" if np.isfinite(value) and value < 100 else "never"


def _footnotes(found: Isolability) -> list[Text]:
    lines = [
        "size: rms at a realistic size; absorbed: its share that the base model takes over;",
        "found from: the multiple of that size which is found 9 times in 10;",
        "looks like: causes that reproduce this share of what is visible",
    ]
    if found.missing:
        columns = sorted({c for lacking in found.missing.values() for c in lacking})
        lines.append(f"not logged: {', '.join(columns)}; nothing can be said about {', '.join(sorted(found.missing))}")
    return [Text(line) for line in lines]
