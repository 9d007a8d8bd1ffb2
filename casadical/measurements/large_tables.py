"""Tables that are greater than memory: read some rows at a time, their numbers kept in files that the system maps.

The numbers stand in unnamed files in the folder for temporary files. The system brings the parts that are looked at
into memory and drops them where memory is needed for something else; what is left of a pose is evaluated and forgotten.
"""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd

from casadical.core.arrays import Array
from casadical.core.errors import InputError, optional
from casadical.measurements.columns import Columns
from casadical.measurements.measurements import FIELDS, Measurements
from casadical.measurements.reading import from_columns

# Rows that are read at a time.
ROWS = 65_536


def read_large(
    path: str | Path,
    joints: int | Sequence[str],
    kind: str | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    sigma_mm: float | None = None,
    sigma_deg: float | None = None,
    rows: int = ROWS,
) -> Measurements:
    """Measurements from a CSV or Parquet file of any length, read and checked some rows at a time.

    Their arrays stand in unnamed temporary files (in the folder that TMPDIR names, where it is set) and are not in
    memory. Copied rows are found within the rows that are read at a time.

    Parameters
    ----------
    path : str | Path
        CSV with commas and headings as in docs/measurements.md, or .parquet (needs pyarrow)
    joints : int | Sequence[str]
        as of `read_measurements`
    kind : str, optional
        as of `read_measurements`
    columns : Mapping[str, str], optional
        our name -> name in the file
    sigma_mm, sigma_deg : float, optional
        as of `read_measurements`
    rows : int, default 65536
        how many are read at a time

    Returns
    -------
    Measurements
        poses as of `read_measurements`

    Raises
    ------
    InputError
        no such file, not a table, or rows that cannot be used; the row is named

    Examples
    --------
    >>> poses = casadical.read_large("data/planar/planar.csv", 2, rows=16)
    >>> poses
    <Measurements data/planar/planar.csv: 40 poses of 2 joints, position>
    """
    path = Path(path)
    parts: dict[str, _Stored] = {}
    first: Measurements | None = None
    copies: tuple[int, ...] = ()
    with ExitStack() as files:
        for start, frame in _frames(path, rows):
            given = Columns.of_frame(frame, str(path))
            given = replace(given, row=given.row + start).mapped(columns or {})
            some = from_columns(given, joints, kind, sigma_mm=sigma_mm, sigma_deg=sigma_deg)
            found = _arrays(some)
            if first is None:
                first = some
                parts = {name: _Stored(files.enter_context(tempfile.TemporaryFile())) for name in found}
            if found.keys() != parts.keys():
                raise InputError(
                    f"{path}: the rows from {start + 2} on hold {', '.join(sorted(found))}; those before hold "
                    f"{', '.join(sorted(parts))}; give one file to each"
                )
            for name, values in found.items():
                parts[name].append(values)
            copies += some.copies
        whole = {name: part.mapped() for name, part in parts.items()}
    if first is None:
        raise InputError(f"{path}: no rows; at least one is needed")
    own: dict[str, Any] = {name: values for name, values in whole.items() if name in _OWN}
    return Measurements(
        kind=first.kind,
        conditions={name.removeprefix(_CONDITION): v for name, v in whole.items() if name.startswith(_CONDITION)},
        extra={name: v for name, v in whole.items() if name not in _OWN and not name.startswith(_CONDITION)},
        sigma=first.sigma,
        sigma_angle=first.sigma_angle,
        unused=first.unused,
        source=str(path),
        copies=copies,
        **own,
    )


_CONDITION = "condition "
_OWN = ("q", "weight", "row", *FIELDS)


def _arrays(m: Measurements) -> dict[str, Array]:
    """Every array of measurements by a name of its own. Raises InputError for names of points."""
    if m.label is not None:
        raise InputError(f"{m.source}: kind {m.kind}: points are compared with others; use read_measurements")
    conditions = {_CONDITION + name: values for name, values in m.conditions.items()}
    return {"q": m.q, "weight": m.weight, "row": m.row, **m.arrays, **conditions}


def _frames(path: Path, rows: int) -> Iterator[tuple[int, pd.DataFrame]]:
    """Some rows at a time, and how many were before them. Raises InputError."""
    start = 0
    try:
        for frame in _parquet(path, rows) if path.suffix.lower() == ".parquet" else _csv(path, rows):
            if len(frame):
                yield start, frame
            start += len(frame)
    except InputError:
        raise
    except (OSError, ValueError) as error:  # pandas' and Arrow's errors are such
        raise InputError(f"{path}: not a readable table: {getattr(error, 'strerror', None) or error}") from None


def _csv(path: Path, rows: int) -> Iterator[pd.DataFrame]:
    with pd.read_csv(path, chunksize=rows, skipinitialspace=True) as frames:
        yield from (frame.reset_index(drop=True) for frame in frames)


def _parquet(path: Path, rows: int) -> Iterator[pd.DataFrame]:
    parquet = optional("pyarrow.parquet", f"{path}: reading Parquet needs pyarrow: pip install 'casadical[fleet]'")
    with parquet.ParquetFile(path, memory_map=True, pre_buffer=False) as file:
        yield from (batch.to_pandas() for batch in file.iter_batches(rows))


class _Stored:
    """An array of numbers that grows in a file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._rows, self._entry, self._dtype = 0, tuple[int, ...](), np.dtype(float)

    def append(self, values: Array) -> None:
        """More rows at its end."""
        self._rows, self._entry, self._dtype = self._rows + len(values), values.shape[1:], values.dtype
        self._file.write(np.ascontiguousarray(values).tobytes())

    def mapped(self) -> Array:
        """The whole of it, not in memory; the file may be closed."""
        self._file.flush()
        return np.asarray(np.memmap(self._file, self._dtype, "r", shape=(self._rows, *self._entry)))
