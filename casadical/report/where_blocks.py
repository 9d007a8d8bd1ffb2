"""Figures of where the gap lies, each with how to read it; both reports show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from casadical.report.page import Drawing

if TYPE_CHECKING:
    import plotly.graph_objects as go


def where_drawings(figures: Mapping[str, go.Figure]) -> Iterator[Drawing]:
    """Figures of where the gap lies, each with how to read it."""
    captions = {
        "joints": "Share of the gap that smooth errors of each joint would account for; all sum to 100 %.",
        "links": "The same for links, loop, base and tool frame.",
        "directions": "Each frame's three directions sum to 100 %, noise included; evenly spread would be 33 % each.",
        "regions": "Poses in thirds of each joint's readings, of the distance from joint 1 and of the height.",
    }
    for name, figure in figures.items():
        yield Drawing(f"where/{name}", figure, captions.get(name, ""))
