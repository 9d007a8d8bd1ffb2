"""Measurements that are greater than memory: their numbers stand in unnamed files, which the system maps.

The files are in the folder for temporary files (that of TMPDIR, where it is set). The system brings the parts that are
looked at into memory and drops them where memory is needed for something else.
"""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from typing import IO

import numpy as np

from casadical.core.arrays import Array
from casadical.measurements.measurements import FIELDS, Measurements

_CONDITION = "condition "
_FIELDS = ("q", "weight", "row", *FIELDS)


def joined(parts: Iterator[Measurements]) -> Measurements | None:
    """The poses of all parts, one after another; None where a part has other columns than the first, or names points.

    Parts are of one kind, without separations, and copies are those of the first.
    """
    first = next(parts)
    with ExitStack() as files:
        stores = {name: _Stored(files.enter_context(tempfile.TemporaryFile())) for name in _arrays(first)}
        for part in chain([first], parts):
            arrays = _arrays(part)
            if arrays.keys() != stores.keys() or set(part.unused) != set(first.unused) or part.label is not None:
                return None
            for name, values in arrays.items():
                stores[name].append(values)
        whole = {name: store.mapped() for name, store in stores.items()}
    conditions = {name.removeprefix(_CONDITION): v for name, v in whole.items() if name.startswith(_CONDITION)}
    extra = {name: v for name, v in whole.items() if name not in _FIELDS and not name.startswith(_CONDITION)}
    own = {name: values for name, values in whole.items() if name in _FIELDS}
    return replace(first, conditions=conditions, extra=extra, **own)  # type: ignore[arg-type]


def _arrays(m: Measurements) -> dict[str, Array]:
    """Every array by a name of its own."""
    conditions = {_CONDITION + name: values for name, values in m.conditions.items()}
    return {"q": m.q, "weight": m.weight, "row": m.row, **m.arrays, **conditions}


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
