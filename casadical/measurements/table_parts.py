"""A table of any size, some rows at a time: as text it takes twenty times the memory of its numbers.

Numbers that are greater than memory stand in unnamed files, which the system maps, in the folder for temporary files
(that of TMPDIR, where it is set): it brings the parts that are looked at into memory, and drops them where memory is
needed for something else.
"""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import chain, repeat
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError, optional
from casadical.core.reading import MOST_BYTES, MOST_COUNT, foreign, regular
from casadical.measurements.measurements import FIELDS, Measurements
from casadical.measurements.raw_table import (
    RawTable,
    read_table,
    records_in,
    refuse_many,
    refuse_repeated_names,
    table_of,
)
from casadical.measurements.table_form import Form, Record, commented, marked_encoding, separator_of

_CONDITION = "condition "
_FIELDS = ("q", "weight", "row", *FIELDS)


def joined(parts: Iterator[Measurements]) -> Measurements | None:
    """The poses of all parts, one after another; None where a part has other columns than the first, or names points.

    Parts are of one kind, without separations, and copies are those of the first.
    """
    first, rows, whole = next(parts), 0, dict[str, Array]()
    with ExitStack() as stack:
        files = {name: stack.enter_context(tempfile.TemporaryFile()) for name in _arrays(first)}
        for part in chain([first], parts):
            arrays = _arrays(part)
            if arrays.keys() != files.keys() or set(part.unused) != set(first.unused) or part.label is not None:
                return None
            for name, values in arrays.items():
                files[name].write(np.ascontiguousarray(values).tobytes())
            rows += len(part)
        for name, values in arrays.items():
            files[name].flush()
            whole[name] = np.asarray(np.memmap(files[name], values.dtype, "r", shape=(rows, *values.shape[1:])))
    conditions = {name.removeprefix(_CONDITION): v for name, v in whole.items() if name.startswith(_CONDITION)}
    extra = {name: v for name, v in whole.items() if name not in _FIELDS and not name.startswith(_CONDITION)}
    own = {name: values for name, values in whole.items() if name in _FIELDS}
    return replace(first, conditions=conditions, extra=extra, **own)  # type: ignore[arg-type]


def _arrays(m: Measurements) -> dict[str, Array]:
    """Every array by a name of its own."""
    conditions = {_CONDITION + name: values for name, values in m.conditions.items()}
    return {"q": m.q, "weight": m.weight, "row": m.row, **m.arrays, **conditions}


@dataclass(frozen=True)
class Portion:
    """How much of a table is read at a time; a text of fewer characters is read at once.

    characters : of a text; rows : of Parquet, and of measurements that are moved within temporary files
    """

    characters: int = 4_000_000
    rows: int = 65_536


USUAL = Portion()
# Characters from which separator and decimal sign are told.
SAMPLE = 100_000


def table_parts(path: str | Path, portion: Portion = USUAL) -> Iterator[RawTable]:
    """As `read_table`, some rows at a time, all under the headings of the first ones; Parquet, too (needs pyarrow).

    A table with quoted cells, in an encoding of one country, in a workbook or gzipped is read at once.
    Raises InputError as `read_table` does.
    """
    path = Path(path)
    if path.suffix.lower() == ".parquet":
        yield from _parquet(path, portion.rows)
    elif not path.is_file() or path.stat().st_size <= portion.characters or not (encoding := _encoding(path, portion)):
        yield read_table(path)
    else:
        yield from _text(path, encoding, portion.characters)


def read_columns(path: str | Path, portion: Portion = USUAL) -> RawTable:
    """As `read_table`, a large table some rows at a time. Raises InputError also for too many numbers for memory."""
    parts: list[RawTable] = []
    for part in table_parts(path, portion):
        parts.append(part)
        refuse_many(Path(path), sum(one.frame.size for one in parts))
    first, *more = parts
    if not more:
        return first
    frame = pd.concat([part.frame for part in parts], ignore_index=True)
    return replace(first, cells=(), frame=frame, line=np.concatenate([part.line for part in parts]))


def _encoding(path: Path, portion: Portion) -> str:
    """Of a text that can be read in parts; empty where it cannot."""
    with path.open("rb") as file:
        head = file.read(1000)
    encoding = marked_encoding(head)
    if head.startswith((b"PK\x03\x04", b"\x1f\x8b")):
        return ""
    ends: set[str] = set()
    try:
        with path.open(encoding=encoding, newline="\n") as text:
            while some := text.read(portion.characters):
                if '"' in some or "\0" in some:
                    return ""
                ends |= {end for end in "\r\n" if end in some}
    except UnicodeDecodeError:
        return ""
    return "" if ends == {"\r"} else encoding  # lines are found by their newlines


def _text(path: Path, encoding: str, characters: int) -> Iterator[RawTable]:
    with path.open(encoding=encoding, newline="\n") as file:
        separator = separator_of(file.read(SAMPLE))
        file.seek(0)
        first: RawTable | None = None
        lines = 0
        above: list[Record] = []
        while some := file.read(characters) + file.readline():
            records = [(lines + line, cells) for line, cells in records_in(path, some, separator)]
            more = not all(commented(cells) for _, cells in records)
            if first is None and more:
                first = table_of(path, [*above, *records], encoding.removesuffix("-sig"), separator)
                yield first
            elif first is not None and more:
                yield _under(first, records, lines + 1)
            else:  # comments alone; above the table the last ones may hold its headings
                above = [*above, *records][-MOST_COUNT:]
            lines += some.count("\n") + some.count("\r") - some.count("\r\n")
    if first is None:
        table_of(path, above, encoding, separator)  # which refuses it


def _under(first: RawTable, records: list[tuple[int, list[str]]], line: int) -> RawTable:
    """Further records under the headings of the first ones. Raises InputError where they have others."""
    form = first.form
    head = [(form.header_line, list(first.header))] if form.header_line else []
    part = table_of(first.path, [*head, *records], form.encoding, form.separator, form.decimal)
    if part.header != first.header:
        raise InputError(
            f"{first.path}: other columns from row {line} on: {', '.join(part.header)}; "
            f"before: {', '.join(first.header)}; give one file to each"
        )
    return part


def _parquet(path: Path, rows: int) -> Iterator[RawTable]:
    """Its rows count as in a text, from 2 on. Raises InputError for whatever Arrow or pandas raise."""
    parquet = optional("pyarrow.parquet", f"{path}: reading Parquet needs pyarrow: pip install 'casadical[fleet]'")
    line = 2
    regular(path)  # Arrow waits for a pipe
    with (
        foreign(f"{path}: not a readable table", "write it again"),
        parquet.ParquetFile(path, memory_map=True, pre_buffer=False) as file,
    ):
        header = tuple(str(name).strip() for name in file.schema_arrow.names)
        refuse_repeated_names(header, str(path))
        about = file.metadata
        if any(about.schema.column(k).max_repetition_level for k in range(about.num_columns)):  # of lists
            refuse_many(path, values_of(path))
        for _, batch in zip(_bounded_texts(path, file, rows), file.iter_batches(rows), strict=False):
            batch.validate(full=True)  # else pandas finds texts that are none where they are looked at
            frame = batch.to_pandas(ignore_metadata=True)
            if tuple(str(name).strip() for name in frame) != header:
                raise ValueError(f"row {line} has other columns than the header")
            lines = range(line, line + len(frame))
            line += len(frame)
            if len(frame):
                yield RawTable(path, header, (), frame.set_axis(header, axis=1), lines, Form("parquet"))
    if line == 2:
        raise InputError(f"{path}: no rows; at least one is needed")


def values_of(source: Path | IO[bytes]) -> int:
    """How many values a Parquet file holds, those of lists counted one by one; raises what Arrow does.

    They are decoded without being kept, which raises an error where the metadata of a column are damaged: to ask for
    these ends the process then.
    """
    with import_module("pyarrow.parquet").ParquetFile(source, memory_map=True, pre_buffer=False) as file:
        file.scan_contents()
        groups, columns = map(file.metadata.row_group, range(file.num_row_groups)), range(file.metadata.num_columns)
        return sum(group.column(k).num_values for group in groups for k in columns)


def _bounded_texts(path: Path, file: Any, rows: int) -> Iterator[None]:
    """Once before each part is read, whose texts a file may hold once for all rows. Raises InputError for too many."""
    parquet, compute = import_module("pyarrow.parquet"), import_module("pyarrow.compute")
    schema = file.metadata.schema
    leaves = map(schema.column, range(len(schema)))
    texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY" and not leaf.max_repetition_level]
    size = 0
    with parquet.ParquetFile(path, memory_map=True, pre_buffer=False, read_dictionary=texts) as coded:
        for batch in coded.iter_batches(rows, columns=texts) if texts else repeat(()):
            for column in batch:
                lengths = compute.binary_length(column.dictionary)
                size += compute.sum(lengths.take(column.indices)).as_py() or 0
            if size > MOST_BYTES:
                raise InputError(f"{path}: its texts have more than {MOST_BYTES} bytes; leave columns of texts out")
            yield
