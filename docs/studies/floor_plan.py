"""The floor plan as a picture: the rooms on their floors, and a matrix of which room imports which."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from html import escape
from itertools import pairwise
from pathlib import Path

from imports_of_package import House

ROOT = Path(__file__).parents[2]

# What a room is for, as short as a box in the picture wants it.
PURPOSE = {
    "cli": "commands, exit codes",
    "report": "HTML reports, figures",
    "fleet": "changes, many campaigns, many robots",
    "project": "problem folders, Calibration",
    "blind_check": "diagnosis judged by simulators",
    "export": "C, MJCF, corrected programs",
    "diagnosis": "causes of the remaining error",
    "identification": "parameters; which poses to measure",
    "measurements": "tables of measured poses",
    "robot": "model of an arm, its files",
    "effects": "physics beyond the base model",
    "compensator": "a network for the remaining error",
    "core": "errors, types, frames, files",
}
INK, SOFT, FAINT, PAPER, WALL = "#23262b", "#5c6068", "#e7e3da", "#fdfcf9", "#8a8272"
DOWN, UP = "#0f766e", "#c2410c"
FLOOR, WIDTH, CELL = 56, 660, 34


def floors() -> list[list[str]]:
    """Rooms by floor, the top one first, as the import contract has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = next(c for c in settings["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    return [[room.strip(" ()") for room in re.split(r"[:|]", layer)] for layer in contract["layers"]]


def picture(house: House) -> str:
    """The house in section, floor above floor, and below it which room imports which."""
    storeys = floors()
    order = [room for storey in storeys for room in storey]
    left, top = 24, 108
    grid = top + FLOOR * len(storeys) + 160
    width, height = WIDTH + 2 * left, grid + CELL * len(order) + 66
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="Helvetica, Arial, sans-serif" role="img" aria-label="Floor plan of the package casadical">',
        f'<rect width="{width}" height="{height}" fill="{PAPER}"/>',
        *_section(storeys, left, top),
        *_matrix(house, order, left + 170, grid),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _section(storeys: list[list[str]], left: int, top: int) -> Iterator[str]:
    right, bottom = left + WIDTH, top + FLOOR * len(storeys)
    ridge = (left + right) / 2
    yield f'<path d="M{left - 14} {top} L{ridge} 30 L{right + 14} {top} Z" fill="{FAINT}" stroke="{WALL}"/>'
    yield _text(ridge, top - 34, "casadical", 17, INK, "middle", "bold")
    yield _text(ridge, top - 16, "the public names", 11.5, SOFT, "middle")
    for k, storey in enumerate(storeys):
        y = top + FLOOR * k
        edges = [left + WIDTH * i / len(storey) for i in range(len(storey) + 1)]
        for room, (a, b) in zip(storey, pairwise(edges), strict=True):
            yield (
                f'<rect x="{a:.1f}" y="{y}" width="{b - a:.1f}" height="{FLOOR}" fill="white" stroke="{WALL}" '
                'stroke-width="1"/>'
            )
            yield _text((a + b) / 2, y + 26, room, 14.5, INK, "middle", "bold")
            yield _text((a + b) / 2, y + 43, PURPOSE[room], 11, SOFT, "middle")
        yield f'<path d="M{left} {y} H{right}" stroke="{WALL}" stroke-width="2.5"/>'
    yield f'<rect x="{left - 8}" y="{bottom}" width="{WIDTH + 16}" height="9" fill="{WALL}"/>'
    yield _text(
        left, bottom + 34, "A room imports from the floors below; from its own where the contract says so.", 11.5
    )


def _matrix(house: House, order: list[str], left: float, top: int) -> Iterator[str]:
    """A dot where the room of the row imports the room of the column."""
    size = CELL * len(order)
    for k, room in enumerate(order):
        middle = CELL * (k + 0.5)
        yield f'<path d="M{left} {top + CELL * k} h{size} M{left + CELL * k} {top} v{size}" stroke="{FAINT}"/>'
        yield _text(left - 10, top + middle + 4, room, 12, INK, "end")
        x, y = left + middle + 4, top - 10
        yield (
            f'<text x="{x}" y="{y}" font-size="12" fill="{INK}" transform="rotate(-60 {x} {y})">{escape(room)}</text>'
        )
        yield f'<rect x="{left + CELL * k}" y="{top + CELL * k}" width="{CELL}" height="{CELL}" fill="{FAINT}"/>'
    yield f'<rect x="{left}" y="{top}" width="{size}" height="{size}" fill="none" stroke="{WALL}"/>'
    for a, b in sorted(house.arrows):
        i, j = order.index(a), order.index(b)
        x, y = left + CELL * (j + 0.5), top + CELL * (i + 0.5)
        colour = DOWN if _allowed(a, b) else UP
        yield f'<circle cx="{x}" cy="{y}" r="6" fill="{colour}"><title>{a} to {b}</title></circle>'
    yield _text(left, top + size + 26, "A dot: the room of the row imports the room of the column.", 11.5)
    yield _text(left, top + size + 43, "Orange: against the contract.", 11.5)


def _allowed(a: str, b: str) -> bool:
    level = {room: k for k, storey in enumerate(floors()) for room in storey}
    return level[a] <= level[b]


def _text(
    x: float, y: float, text: str, size: float, colour: str = SOFT, anchor: str = "start", weight: str = "normal"
) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" fill="{colour}" text-anchor="{anchor}" '
        f'font-weight="{weight}">{escape(text)}</text>'
    )
