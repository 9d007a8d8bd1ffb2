"""What a language of a controller is, and which there are: our own, and those of packages (entry points of `GROUP`)."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from casadical.core.errors import InputError
from casadical.core.plugins import members
from casadical.export.c.tape_program import TapeProgram

# Of functions and files, so that it is safe in paths, too.
NAME = "^[a-z][a-z0-9_]{0,23}$"


@dataclass(frozen=True)
class Label:
    """What the files say about themselves: a C identifier, hashes of the model and of the data it came from."""

    name: str
    model_sha256: str = "not given"
    data_sha256: str = "not given"


class Language(ABC):
    """A language that a controller takes. Derive from it, without arguments of the constructor.

    name : by which `casadical export c --language` knows it

    Examples
    --------
    >>> class Count(casadical.export.Language):
    ...     name = "count"
    ...
    ...     def files(self, program, label):
    ...         return {f"{label.name}.txt": str(len(program.tapes))}
    >>> from casadical.export.c.registry import Label
    >>> from casadical.export.c.tape_program import TapeProgram
    >>> Count().files(TapeProgram(None, "double", {}, ()), Label("arm"))
    {'arm.txt': '0'}
    """

    name: ClassVar[str]

    @abstractmethod
    def files(self, program: TapeProgram, label: Label) -> Mapping[str, str | bytes]:
        """Contents by file name, relative to the export's folder; the same ones for the same arguments."""


GROUP = "casadical.controller_languages"
LANGUAGES = (
    "casadical.export.c.c_language:C99",
    "casadical.export.c.fmu:Fmu",
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
