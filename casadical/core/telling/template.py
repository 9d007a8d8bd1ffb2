"""Reports as text: a template of jinja2 beside the code of a result holds its sentences.

A line `[kind]` begins a paragraph of that kind (see `Words`), which ends at the next such line; a blank or a new line
in a paragraph is a space. `{{ put(blocks) }}` stands for blocks that are made elsewhere, such as tables. Values are put
in as they are, with the spaces and line ends that they have.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from casadical.core.telling.blocks import Block, Kind, Table, Words, mm
from casadical.core.telling.figure import Figure

if TYPE_CHECKING:
    from jinja2 import Environment, Template

# Characters for private use stand for the ends of a tag, and for spaces and line ends of values.
_TAG = re.compile("\ue000([^\ue001]*)\ue001([^\ue000]*)")
_KEPT = str.maketrans({" ": "\ue002", "\n": "\ue003", "\ue000": "", "\ue001": ""})
_GIVEN_BACK = str.maketrans({"\ue002": " ", "\ue003": "\n"})


class _Tag(str):
    """A tag that stays as it is where a template puts it in."""


def tag(kind: str) -> str:
    """Return what begins a paragraph of a kind in a template, where the kind depends on the result."""
    return _Tag(f"\ue000{kind}\ue001")


@cache
def _environment(folder: Path) -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined  # late: showing nothing, physics need none

    def load(name: str) -> str:
        source = (folder / name).read_text(encoding="utf-8")
        return re.sub(r"(?m)^\[([A-Za-z]+!?)\]$", lambda found: tag(found[1]), source)

    environment = Environment(
        loader=FunctionLoader(load),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, _Tag) else str(value).translate(_KEPT),
        autoescape=False,
    )
    environment.filters |= {"mm": mm, "f": lambda value, form: format(value, form), "repr": repr}
    environment.globals |= {"tag": tag}
    return environment


@cache
def pages(folder: Path) -> Environment:
    """Return the environment of templates of HTML in a folder, in which values are escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    kinds = {"words": Words, "table": Table}
    environment.tests |= {name: lambda block, kind=kind: isinstance(block, kind) for name, kind in kinds.items()}
    environment.filters["mm"] = mm
    return environment


def filled(line: str, result: Any) -> str:
    """Return a template of one line, `it` being the result."""
    return _line(line).render(it=result).translate(_GIVEN_BACK)


@cache
def _line(source: str) -> Template:
    return _environment(Path(__file__).parent).from_string(source)


def sentence(path: Path, result: Any, block: str = "", **more: Any) -> str:
    """Return the text of a template without paragraphs; the arguments are those of `paragraphs`."""
    return _text(_rendered(path, block, it=result, **more))


def paragraphs(path: Path, result: Any, block: str = "", **more: Any) -> Iterator[tuple[str, str]]:
    """Yield kind and text of each paragraph.

    result : `it` of the template; more : other values that it needs
    block : of the template, in place of all of it
    """
    yield from ((kind, _text(text)) for kind, text in _TAG.findall(_rendered(path, block, it=result, **more)))


def _rendered(path: Path, block: str, **known: Any) -> str:
    template = _environment(path.parent).get_template(path.name)
    context = template.new_context(known)
    return "".join((template.blocks[block] if block else template.root_render_func)(context))


def _text(rendered: str) -> str:
    return " ".join(rendered.split()).translate(_GIVEN_BACK)


def told(path: Path, result: Any, block: str = "", **more: Any) -> list[Block]:
    """Return the blocks of a template; the arguments are those of `paragraphs`."""
    made: list[Block | Sequence[Block]] = []

    def put(blocks: Block | Sequence[Block]) -> str:
        made.append(blocks)
        return tag(f"put {len(made) - 1}")

    told: list[Block] = []
    for kind, text in paragraphs(path, result, block, put=put, **more):
        if kind.startswith("put "):
            found = made[int(kind[4:])]
            told += [found] if isinstance(found, Words | Table | Figure) else found
        else:
            told.append(Words(text, cast(Kind, kind)))
    return told
