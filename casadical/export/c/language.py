"""A language of a controller: it turns tapes into files. Each is one file, and one line in `registry.py`."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

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
    >>> from casadical.export.c.language import Label
    >>> from casadical.export.c.tape_program import TapeProgram
    >>> Count().files(TapeProgram(None, "double", {}, ()), Label("arm"))
    {'arm.txt': '0'}
    """

    name: ClassVar[str]

    @abstractmethod
    def files(self, program: TapeProgram, label: Label) -> Mapping[str, str | bytes]:
        """Contents by file name, relative to the export's folder; the same ones for the same arguments."""
