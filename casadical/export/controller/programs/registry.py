"""Languages of robot programs."""

from pathlib import Path

from casadical.core.basics import InputError
from casadical.export.controller.programs.csv_table import CsvTable
from casadical.export.controller.programs.fanuc import Fanuc
from casadical.export.controller.programs.krl import Krl
from casadical.export.controller.programs.language import ProgramLanguage
from casadical.export.controller.programs.rapid import Rapid
from casadical.export.controller.programs.urscript import UrScript


def known_program_languages() -> dict[str, type[ProgramLanguage]]:
    """Return the languages by name."""
    return {kind.name: kind for kind in (Krl, Rapid, UrScript, Fanuc, CsvTable)}


def language_named(word: str) -> ProgramLanguage:
    """The language of a word in its name, or of a suffix. Raises InputError that lists the names."""
    known = known_program_languages()
    for kind in known.values():
        if word.lower() in kind.__name__.lower() or f".{word.lower()}" in kind.suffixes:
            return kind()
    raise InputError(f"{word!r}: no such language of programs; allowed: {', '.join(k.name for k in known.values())}")


def language_of(path: Path) -> ProgramLanguage:
    """The language of a file, by its suffix. Raises InputError that lists the suffixes."""
    known = known_program_languages()
    for language in known.values():
        if path.suffix.lower() in language.suffixes:
            return language()
    listed = ", ".join(f"{'/'.join(kind.suffixes)} ({kind.name})" for kind in known.values())
    raise InputError(f"{path}: programs with the suffix {path.suffix!r} cannot be read; allowed: {listed}")
