"""Reports as text: the sentences of a result are in a jinja2 template next to its code.

A line `[kind]` begins a paragraph of that kind (see `Words`), which ends at the next such line;
white space in a paragraph becomes one space. `{{ put(blocks) }}` inserts blocks that are made
elsewhere, such as tables. Values are inserted unchanged, with their spaces and line ends.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from casadical.core.reporting.blocks import Block, Kind, Table, Words, mm
from casadical.core.reporting.figure import Figure

if TYPE_CHECKING:
    from jinja2 import Environment, Template

# Pattern of a tag, which private-use characters of Unicode delimit, and of the text after it.
_TAG_PATTERN = re.compile("\ue000([^\ue001]*)\ue001([^\ue000]*)")
# Translation of values before they are inserted: spaces and line ends to private-use characters.
_PROTECT_WHITESPACE = str.maketrans({" ": "\ue002", "\n": "\ue003", "\ue000": "", "\ue001": ""})
# Translation of rendered text: private-use characters back to spaces and line ends.
_RESTORE_WHITESPACE = str.maketrans({"\ue002": " ", "\ue003": "\n"})


class _Tag(str):
    """A tag, which a template inserts unchanged."""


def tag(kind: str) -> str:
    """Return the tag that begins a paragraph of this kind in a template's text.

    Templates call it where the kind depends on the result.
    """
    return _Tag(f"\ue000{kind}\ue001")


@cache
def _environment(folder: Path) -> Environment:
    """Return the jinja2 environment of a folder's text templates."""
    # Imported late: what shows nothing needs no jinja2, and the simulators' physics write nothing.
    from jinja2 import Environment, FileSystemBytecodeCache, FunctionLoader, StrictUndefined

    from casadical.core.files import private_folder

    def load(name: str) -> str:
        """Return the text of a template file, with tags in place of lines [kind]."""
        source = (folder / name).read_text(encoding="utf-8")
        return re.sub(r"(?m)^\[([A-Za-z]+!?)\]$", lambda found: tag(found[1]), source)

    own = private_folder()
    environment = Environment(
        loader=FunctionLoader(load),
        bytecode_cache=FileSystemBytecodeCache(str(own), "template-%s.jinja") if own else None,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, _Tag) else str(value).translate(_PROTECT_WHITESPACE),
        autoescape=False,
    )
    environment.filters |= {"mm": mm, "f": lambda value, form: format(value, form), "repr": repr}
    environment.globals |= {"tag": tag}
    return environment


@cache
def pages(folder: Path) -> Environment:
    """Return the jinja2 environment of a folder's HTML templates, in which values are escaped."""
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
    """Return the text of the one-line template `line`, rendered with the result as `it`."""
    return _line(line).render(it=result).translate(_RESTORE_WHITESPACE)


@cache
def _line(source: str) -> Template:
    """Return the compiled template of a one-line source."""
    return _environment(Path(__file__).parent).from_string(source)


def sentence(path: Path, result: Any, block: str = "", **more: Any) -> str:
    """Return the text of a template that has no paragraph tags; arguments as of `paragraphs`."""
    return _text(_rendered(path, block, it=result, **more))


def paragraphs(path: Path, result: Any, block: str = "", **more: Any) -> Iterator[tuple[str, str]]:
    """Yield (kind, text) of each paragraph of a rendered template.

    path : file of the template
    result : value of `it` in the template; more : other values that it needs, by name
    block : name of the block that is rendered, in place of the whole template
    """
    yield from ((kind, _text(text)) for kind, text in _TAG_PATTERN.findall(_rendered(path, block, it=result, **more)))


def _rendered(path: Path, block: str, **values: Any) -> str:
    """Return a template file, or one block of it, rendered with values, tags included."""
    template = _environment(path.parent).get_template(path.name)
    context = template.new_context(values)
    return "".join((template.blocks[block] if block else template.root_render_func)(context))


def _text(rendered: str) -> str:
    """Return rendered text with white space reduced to single spaces, but for that of values."""
    return " ".join(rendered.split()).translate(_RESTORE_WHITESPACE)


def template_blocks(path: Path, result: Any, block: str = "", **more: Any) -> list[Block]:
    """Return the blocks of a rendered template: its paragraphs, and those that it inserts."""
    made: list[Block | Sequence[Block]] = []

    def put(blocks: Block | Sequence[Block]) -> str:
        """Return a tag that stands for blocks until the template is rendered."""
        made.append(blocks)
        return tag(f"put {len(made) - 1}")

    blocks: list[Block] = []
    for kind, text in paragraphs(path, result, block, put=put, **more):
        if kind.startswith("put "):
            found = made[int(kind[4:])]
            blocks += [found] if isinstance(found, Words | Table | Figure) else found
        else:
            blocks.append(Words(text, cast(Kind, kind)))
    return blocks
