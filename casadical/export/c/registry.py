"""Languages of a controller."""

from collections.abc import Iterable

from casadical.core.basics import InputError
from casadical.export.c.c_language import C99
from casadical.export.c.language import Label, Language
from casadical.export.c.structured_text import StructuredText
from casadical.export.c.tape_program import TapeProgram


def known_languages() -> dict[str, type[Language]]:
    """Return the languages by name."""
    return {kind.name: kind for kind in (C99, StructuredText)}


def written_in(program: TapeProgram, label: Label, names: Iterable[str] | None) -> dict[str, bytes]:
    """Contents of all files by name; `names` as of `write_c`. Raises InputError."""
    known = known_languages()
    contents: dict[str, bytes] = {}
    for name in dict.fromkeys(("c", *(known if names is None else names))):
        if name not in known:
            raise InputError(f"language {name!r} is not known; allowed: {', '.join(known)}")
        for file, content in known[name]().files(program, label).items():
            if file in (*contents, "manifest.json"):
                raise InputError(f"language {name!r} writes {file}, which is another one's; leave one of them out")
            contents[file] = content.encode() if isinstance(content, str) else content
    return contents
