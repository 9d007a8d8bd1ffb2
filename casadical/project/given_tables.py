"""Tables that a command names: by which of a problem's own they are understood, and a problem made of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from casadical.core.errors import InputError, shown
from casadical.core.schema import check
from casadical.measurements.raw_table import RawTable
from casadical.measurements.table_parts import read_columns
from casadical.project.problem_file import DataTable, ProblemFile, problem_file


def file_of(source: Path, tables: Sequence[str | Path]) -> ProblemFile:
    """The file of a problem folder; of a robot file, or with other tables than its own, as if it said so.

    Raises InputError.
    """
    if not tables:
        return problem_file(source)
    if source.is_file():
        file = ProblemFile(casadical=1, title="", robot=str(source.resolve()))
    else:
        file = problem_file(source)
        file = file.model_copy(update={"robot": file.of_campaigns, "title": "", "paper": None})
    own = tables_of(source)
    found = [fitting(source, read_columns(t), own).model_copy(update={"file": str(Path(t).resolve())}) for t in tables]
    return file.model_copy(update={"measurements": found, "data": None})


def own_tables(source: Path) -> list[Path]:
    """Files of the tables of a problem folder. Raises InputError where it names none, and of a robot file."""
    if source.is_file():
        raise InputError(f"{shown(source)}: a robot file has no measurements; give their tables after it")
    if not (source / "problem.toml").exists():
        raise InputError(f"{shown(source)}: no problem.toml is in it, which would name tables; give them after it")
    found = [source / table.file for table in problem_file(source).measurements]
    if not found:
        raise InputError(f"{shown(source / 'problem.toml')}: no [[measurements]]; give tables after the folder")
    return found


def tables_of(folder: Path) -> Sequence[DataTable]:
    """How the tables of a problem are to be understood, or those that a robot file was calibrated from."""
    if (folder / "problem.toml").exists():
        return problem_file(folder).measurements
    try:
        listed = json.loads((folder.parent / "result.json").read_text(encoding="utf-8"))["tables"]
        return [check(DataTable, table, "result.json") for table in listed]
    except (OSError, ValueError, KeyError, TypeError, InputError):
        return []


def fitting(folder: Path, raw: RawTable, tables: Sequence[DataTable]) -> DataTable:
    """How a problem's tables say that this one is to be understood; a copy of one of them is that one."""
    for data in tables:
        own = folder / data.file
        if own.resolve() == raw.path.resolve() or (own.is_file() and own.read_bytes() == raw.path.read_bytes()):
            return data
    for data in tables:
        found = data.named_in(raw.header)
        if found.columns or found.point_from:
            return found
    return DataTable(file=raw.path.name)
