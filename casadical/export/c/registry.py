"""Languages of a controller: ours, a line each, and those of installed packages (entry points of `GROUP`)."""

from collections.abc import Iterable

from casadical.core.basics import InputError
from casadical.core.plugins import members
from casadical.export.c.language import Label, Language
from casadical.export.c.tape_program import TapeProgram

GROUP = "casadical.controller_languages"
LANGUAGES = (
    "casadical.export.c.c_language:C99",
    "casadical.export.c.structured_text:StructuredText",
)


def known_languages() -> dict[str, type[Language]]:
    """Languages of this package, then those of installed plug-ins, by name. Raises InputError for a faulty plug-in."""
    return members(GROUP, Language, LANGUAGES)  # type: ignore[type-abstract]


def written_in(program: TapeProgram, label: Label, names: Iterable[str] | None) -> dict[str, bytes]:
    """Contents of all files by name; `names` as of `write_c`. Raises InputError."""
    known = known_languages()
    own = list(known)[: len(LANGUAGES)]
    contents: dict[str, bytes] = {}
    for name in dict.fromkeys(("c", *(own if names is None else names))):
        if name not in known:
            raise InputError(f"language {name!r} is not known; allowed: {', '.join(known)}")
        for file, content in known[name]().files(program, label).items():
            if file in (*contents, "manifest.json"):
                raise InputError(f"language {name!r} writes {file}, which is another one's; leave one of them out")
            contents[file] = content.encode() if isinstance(content, str) else content
    return contents
