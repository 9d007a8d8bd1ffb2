"""A store of rows, one a robot: a folder of parquet files that is only added to, so that nothing is lost midway."""

from __future__ import annotations

import io
import os
import uuid
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from casadical.core.basics import InputError, optional, shown
from casadical.core.file_locks import Lock
from casadical.core.files import write_together
from casadical.core.reading import read_bytes
from casadical.fleet.one_robot import NOTHING

VERSION = 1
# Key of the version in the metadata of every file.
KEY = b"casadical_fleet"
# Columns that files of this version may lack.
ADDED = ("left_free",)
_NEEDED = "a fleet needs dask, distributed and pyarrow; install them: pip install 'casadical[fleet]'"


@contextmanager
def opened(folder: Path) -> Iterator[None]:
    """A store that this process alone writes to. Raises InputError: another one does, no folder, another version."""
    optional("pyarrow", _NEEDED)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{shown(folder)}: is a file; a store is a folder: give another name with --store")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with Lock(folder) as lock:
            if not lock.taken():
                raise InputError(f"{shown(folder)}: another casadical is writing to this store; wait for it")
            if not os.access(folder, os.W_OK):
                raise InputError(
                    f"{shown(folder)}: this store cannot be written to; change its permissions or its place"
                )
            foreign = [p.name for p in folder.iterdir() if not p.name.startswith((".", "part-"))]
            if foreign:
                raise InputError(
                    f"{shown(folder)}: holds {shown(min(foreign))}, which is no part of a store; a store is a folder "
                    "of its own: give another name with --store"
                )
            yield
    except OSError as error:
        raise InputError(f"{shown(folder)}: cannot be used as a store: {error.strerror or error}") from None


def add(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Add rows as one more file, which appears completely or not at all. Raises InputError."""
    if not rows:
        return
    arrow, parquet = optional("pyarrow", _NEEDED), optional("pyarrow.parquet", _NEEDED)
    columns = {name: [row.get(name, empty) for row in rows] for name, empty in NOTHING.items()}
    table = arrow.table({name: arrow.array(values, _type(NOTHING[name])) for name, values in columns.items()})
    blob = io.BytesIO()
    parquet.write_table(table.replace_schema_metadata({KEY: str(VERSION).encode()}), blob, compression="zstd")
    number = 1 + max((int(p.name[5:11]) for p in parts(folder)), default=0)
    try:
        write_together({folder / f"part-{number:06d}-{uuid.uuid4().hex[:8]}.parquet": blob.getvalue()})
    except InputError as error:
        raise InputError(
            f"{error} of {len(rows)} robots; those written before are kept: run the command again"
        ) from None


def _type(empty: Any) -> Any:
    arrow = optional("pyarrow", _NEEDED)
    if isinstance(empty, list):
        return arrow.list_(
            arrow.string() if empty is NOTHING["names"] or empty is NOTHING["identified"] else arrow.float64()
        )
    return {str: arrow.string(), int: arrow.int64(), float: arrow.float64()}[type(empty)]


def parts(folder: Path) -> list[Path]:
    return sorted(folder.glob("part-" + 6 * "[0-9]" + "-*.parquet"))


def rows(folder: Path, columns: Sequence[str] | None = None, damaged: list[str] | None = None) -> pd.DataFrame:
    """The last row of every robot. Raises InputError for files of another version.

    damaged : files that cannot be read are named here and passed over; where it is not given they raise InputError, too
    """
    tables = [table.to_pandas() for path in parts(folder) if (table := _read(path, columns, damaged)) is not None]
    empty = pd.DataFrame({name: [] for name in columns or NOTHING})
    whole = pd.concat(tables, ignore_index=True) if tables else empty
    return whole.drop_duplicates("robot", keep="last", ignore_index=True)


def each(folder: Path, robots: Collection[str], columns: Sequence[str] | None = None) -> Iterator[dict[str, Any]]:
    """The last row of some robots, one by one: of the store, one file at a time is in memory."""
    left = set(robots)
    for path in reversed(parts(folder)):
        names = _read(path, ["robot"], [])
        if names is None or left.isdisjoint(names["robot"].to_pylist()):
            continue
        table = _read(path, columns, [])
        last = {name: k for k, name in enumerate(names["robot"].to_pylist()) if name in left}
        left -= last.keys()
        yield from records(table.take(list(last.values())).to_pandas())


def records(robots: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(k): v for k, v in r.items()} for r in robots.to_dict("records")]


def _read(path: Path, columns: Sequence[str] | None, damaged: list[str] | None) -> Any:
    """Table of a file, without columns that were added after it was written; None where it cannot be read.

    damaged : then said there. Raises InputError.
    """
    parquet = optional("pyarrow.parquet", _NEEDED)
    blob = io.BytesIO(read_bytes(path))
    try:
        schema = parquet.read_schema(blob)
        _refuse_other(path, (schema.metadata or {}).get(KEY, b"").decode(errors="replace"))
        _refuse_malformed(schema)
        table = parquet.read_table(blob, columns=[n for n in schema.names if columns is None or n in columns])
        if lost := [name for name in table.column_names if table[name].null_count]:
            raise ValueError(f"a cell of column {lost[0]!r} is empty")
        return table
    except (OSError, ValueError, ArithmeticError) as error:
        if isinstance(error, InputError):
            raise
        why = f"{shown(path)}: is no part of a store: {str(error).splitlines()[0].rstrip('.')}"
        if damaged is None:
            raise InputError(why) from None
        damaged.append(f"{why}; the robots in it are computed again; remove it")
        return None


def _refuse_malformed(schema: Any) -> None:
    """Raises ValueError where columns of a file are not those of a row."""
    for name, empty in NOTHING.items():
        if name not in schema.names and name not in ADDED:
            raise ValueError(f"column {name!r} is missing")
        if name in schema.names and schema.field(name).type != _type(empty):
            raise ValueError(f"column {name!r} is of type {schema.field(name).type}, not {_type(empty)}")


def _refuse_other(path: Path, version: str) -> None:
    """Raises InputError for a file of a store that this casadical cannot read."""
    if version != str(VERSION):
        raise InputError(
            f"{shown(path)}: a store of version {version or 'unknown'}; this casadical reads version {VERSION}: "
            "give another --store, or use the casadical that wrote it. Nothing was changed"
        )
