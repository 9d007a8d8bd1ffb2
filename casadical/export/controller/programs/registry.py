"""Languages of programs: ours, a line each, and those of installed packages (entry points of `GROUP`)."""

from pathlib import Path

from casadical.core.basics import InputError
from casadical.core.plugins import members
from casadical.export.controller.programs.language import ProgramLanguage

GROUP = "casadical.program_languages"
LANGUAGES = (
    "casadical.export.controller.programs.krl:Krl",
    "casadical.export.controller.programs.rapid:Rapid",
    "casadical.export.controller.programs.urscript:UrScript",
    "casadical.export.controller.programs.fanuc:Fanuc",
    "casadical.export.controller.programs.csv_table:CsvTable",
)


def known_program_languages() -> dict[str, type[ProgramLanguage]]:
    """Languages of this package, then those of plug-ins, by name. Raises InputError for a faulty plug-in."""
    return members(GROUP, ProgramLanguage, LANGUAGES)  # type: ignore[type-abstract]


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
