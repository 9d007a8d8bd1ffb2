"""Reports as text: a template of jinja2 beside the code of a result holds its sentences.

A line `[kind]` begins a paragraph of that kind (see `Words`), which ends at the next such line; a blank or a new line
in a paragraph is a space. `{{ put(blocks) }}` stands for blocks that are made elsewhere, such as tables. Values are put
in as they are, with the spaces and line ends that they have.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casadical.core.telling.blocks import Block, Table, Words, mm
from casadical.core.telling.figure import Figure

if TYPE_CHECKING:
    from jinja2 import Template

_BEGINS = re.compile(r"^\[(title|text|note|warning|error|verdict)\]$", re.MULTILINE)
# Characters for private use stand for the ends of a tag, and for spaces and line ends of values.
_TAG = re.compile("\ue000([a-z]+) ?(\\d*)\ue001([^\ue000]*)")
_KEPT = str.maketrans({" ": "\ue002", "\n": "\ue003", "\ue000": "", "\ue001": ""})
_GIVEN_BACK = str.maketrans({"\ue002": " ", "\ue003": "\n"})


class _Tag(str):
    """A tag that stays as it is where a template puts it in."""


@cache
def _template(path: Path) -> Template:
    from jinja2 import Environment, StrictUndefined  # late: showing nothing, physics need none

    environment = Environment(
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, _Tag) else str(value).translate(_KEPT),
        autoescape=False,
    )
    environment.filters |= {"mm": mm, "f": lambda value, form: format(value, form)}
    source = path.read_text(encoding="utf-8")
    return environment.from_string(_BEGINS.sub(lambda tag: f"\ue000{tag[1]}\ue001", source))


def told(path: Path, result: Any, **more: Any) -> list[Block]:
    """Return the blocks of a template; result : `it` of the template; more : other values that it needs."""
    made: list[Block | Sequence[Block]] = []

    def put(blocks: Block | Sequence[Block]) -> _Tag:
        made.append(blocks)
        return _Tag(f"\ue000put {len(made) - 1}\ue001")

    blocks: list[Block] = []
    for kind, number, text in _TAG.findall(_template(path).render(it=result, put=put, **more)):
        if kind == "put":
            found = made[int(number)]
            blocks += [found] if isinstance(found, Words | Table | Figure) else found
        else:
            blocks.append(Words(" ".join(text.split()).translate(_GIVEN_BACK), kind))
    return blocks
