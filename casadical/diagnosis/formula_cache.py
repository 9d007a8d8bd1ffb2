"""Formulas of the effects on the robots of one structure, kept in the user's cache: composing them takes a second."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.core.file_locks import private_folder
from casadical.core.files import write_whole
from casadical.core.reading import MOST_JSON, read_text
from casadical.core.sx_instructions import Instruction, SxInstructions
from casadical.diagnosis.seams import Seams
from casadical.effects import Effect

PACKAGE = Path(__file__).parents[1]
# Rooms on whose code a formula depends.
ROOMS = ("core", "effects", "robot", "diagnosis")


@dataclass(frozen=True, eq=False)
class Formula:
    """The seam variables' derivative by one effect's parameters, its settings left open.

    conditions : of the formula's input w, in order; rows, columns : seam and parameter of each nonzero
    """

    function: SxInstructions
    conditions: tuple[str, ...]
    rows: Array
    columns: Array

    def as_data(self) -> list[Any]:
        """Plain data."""
        f = self.function
        return [
            [f.name, f.instructions, f.places, f.nonzeros],
            self.conditions,
            self.rows.tolist(),
            self.columns.tolist(),
        ]

    @classmethod
    def from_data(cls, data: list[Any]) -> Formula:
        """What `as_data` gave."""
        (name, steps, places, nonzeros), conditions, rows, columns = data
        function = SxInstructions(name, tuple(Instruction(*step) for step in steps), places, tuple(nonzeros))
        return cls(function, tuple(conditions), np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64))


class KeptFormulas:
    """Formulas of one structure, read from one file and written to it; None is kept, too.

    The file's name holds the hash of the structure and of the code that composes formulas, so that it is never stale.
    """

    def __init__(self, s: Seams) -> None:
        self._arm = s.exact.arm
        name = hashlib.sha256(f"{ca.CasadiMeta.version()} {code_hash()} {s.key}".encode()).hexdigest()[:32]
        folder = private_folder()
        self.path = None if folder is None else folder / f"formulas-{name}.json"
        self._known: dict[str, Any] = {}
        self._new = False
        if self.path is not None:
            with suppress(OSError, ValueError):
                digest, _, text = read_text(self.path, MOST_JSON).partition("\n")
                if digest == hashlib.sha256(text.encode()).hexdigest():  # else it was damaged, and is made again
                    self._known = json.loads(text)

    def keeps(self, template: Effect) -> bool:
        """Whether formulas of an effect are kept: of those on a list, of the package's own code, with usual sizes."""
        own = all(kind.__module__.startswith("casadical.") for kind in type(template).__mro__[:-1])
        return (
            own and bool(template.on_list) and (not template.parts or template in type(template).candidates(self._arm))
        )

    def __contains__(self, key: tuple[Effect, tuple[str, ...]]) -> bool:
        return repr(key) in self._known

    def __getitem__(self, key: tuple[Effect, tuple[str, ...]]) -> Formula | None:
        data = self._known[repr(key)]
        return None if data is None else Formula.from_data(data)

    def add(self, template: Effect, settings: tuple[str, ...], formula: Formula | None) -> None:
        """Keep one more."""
        self._known[repr((template, settings))] = None if formula is None else formula.as_data()
        self._new = True

    def write(self) -> None:
        """Write the file if there are new ones; it appears whole or not at all."""
        if not self._new or self.path is None:
            return
        self._new = False
        text = json.dumps(self._known)
        with suppress(InputError):
            write_whole(self.path, f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


@lru_cache(maxsize=16)
def kept_formulas(s: Seams) -> KeptFormulas:
    """Formulas of one structure."""
    return KeptFormulas(s)


@lru_cache(maxsize=1)
def code_hash() -> str:
    """Hash of the code that composes formulas."""
    files = sorted(path for room in ROOMS for kind in ("*.py", "*.toml") for path in (PACKAGE / room).rglob(kind))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
