"""Results as plain data: fields by their keys and units, what is derived, and what has no form."""

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import pytest

from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key, plain, written
from casadical.core.reporting.template import template_blocks


class Colour(StrEnum):
    RED = "red"


@dataclass
class Whole:
    row: int
    at: Path


@dataclass
class Marked:
    derived: ClassVar[tuple[Key, ...]] = (
        Key("count", lambda marked: len(marked.rows)),
        Key("first", "rows.row"),
        Key("angle", "turn", "deg", 1),
        Key("gone", "nothing", omit_none=True),
        Key("none", "nothing"),
    )

    name: str = field(metadata=WRITTEN)
    length: float = field(metadata=IN_MM)
    spans: dict[str, Any] = field(metadata=written("width", "urad", 2))
    rows: Any
    turn: float = np.pi
    nothing: Any = None


def test_a_result_is_written_by_marked_fields_and_derived_keys() -> None:
    marked = Marked("arm", 0.5, {"a": (1e-6, np.float64(2.3456e-6)), "b": True, "c": "x"}, [1, 2])
    marked.rows = type("Rows", (), {"row": 7, "__len__": lambda _: 2})()
    assert plain(marked) == {
        "name": "arm",
        "length_mm": 500.0,
        "width_urad": {"a": [1.0, 2.35], "b": True, "c": "x"},
        "count": 2,
        "first": 7,
        "angle_deg": 180.0,
        "none": None,
    }


def test_values_become_plain() -> None:
    table = pd.DataFrame({"x": [1.0, np.nan], "y": ["a", "b"]})
    values = [Colour.RED, np.arange(2), np.bool_(True), float("inf"), Whole(3, Path("a/b")), table, {1: (None, "t")}]
    assert plain(values) == [
        "red",
        [0, 1],
        True,
        None,
        {"row": 3, "at": "a/b"},
        [{"x": 1.0, "y": "a"}, {"x": None, "y": "b"}],
        {"1": [None, "t"]},
    ]
    with pytest.raises(TypeError, match="object has no form in JSON"):
        plain(object())


def test_a_template_gives_paragraphs_and_blocks_and_keeps_values_as_they_are(tmp_path) -> None:
    path = tmp_path / "report.j2"
    path.write_text(
        "[verdict]\nOf {{ it.name }}\n  all.\n{% if more %}\n[note]\n{{ it.length | mm }} mm\n{% endif %}\n"
        "{{ put(table) }}\n{{ put([table]) }}\n[text]\n"
    )
    name, table = "a  [note]\n[text] {{ b }} \ue000note\ue001", Table("t", ("a",), [])
    blocks = template_blocks(path, Marked(name, 0.002, {}, []), more=True, table=table)
    shown = Words("Of a  [note]\n[text] {{ b }} note all.", "verdict")
    assert blocks == [shown, Words("2.000 mm", "note"), table, table, Words("")]
