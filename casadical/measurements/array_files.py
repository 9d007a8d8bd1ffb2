"""Tables in files of arrays and records (.npy, .npz, .mat, .json, .yaml, .samples), and lists in one cell."""

import io
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError, optional
from casadical.core.reading import foreign
from casadical.measurements.vocabulary import WORDS

# Files that hold arrays or records, by the end of their name.
ARRAY_FILES = (".npy", ".npz", ".mat", ".json", ".yaml", ".yml", ".samples")


def table_of_arrays(path: Path, data: bytes) -> tuple[pd.DataFrame, str]:
    """Return the table in a file of arrays or records, and a sentence on what it was made of.

    Arrays with equally many rows stand side by side, their columns named for the array: x, y and z
    of three columns, indices of matrices. A single array without a name has columns without
    headings, "column 1" and so on.

    path : its end names the form; data : content of the file
    Raises InputError: it is not readable, or holds no table.
    """
    ending = path.suffix.lower()
    with foreign(f"{path}: not a readable {ending} file", "save the table as CSV"):
        if ending in (".npy", ".npz"):
            content: Any = np.load(io.BytesIO(data), allow_pickle=False)
            content = content if isinstance(content, np.ndarray) else dict(content)
        elif ending == ".mat":
            from scipy.io import loadmat

            try:
                content = loadmat(io.BytesIO(data), squeeze_me=True, struct_as_record=True)
            except NotImplementedError:
                raise InputError(f"{path}: a .mat file of version 7.3; save it with -v7, or as CSV") from None
        elif ending == ".json":
            content = json.loads(data)
        else:
            yaml = optional("yaml", f"{path}: reading YAML needs PyYAML: pip install pyyaml, or save the table as CSV")
            content = yaml.safe_load(data)
    with foreign(f"{path}: holds no table", "save the poses as CSV, one row each"):
        arrays = {**_arrays(content)}
    counts = {size for a in arrays.values() for size in a.shape if size > 3}
    if not arrays or not counts:
        names = [str(k) for k in content if not str(k).startswith("__")] if isinstance(content, Mapping) else []
        held = ", ".join(names)[:200] or type(content).__name__
        raise InputError(f"{path}: holds no table: {held}; save the poses as CSV, one row each")
    arrays, handeye = _without_flange(path, arrays)
    n = max(counts, key=lambda size: (sum(size in a.shape for a in arrays.values()), size))
    columns: dict[str, Array] = {}
    for name, array in arrays.items():
        if n in array.shape:
            columns |= _columns(name, np.moveaxis(array, array.shape.index(n), 0))
    table = pd.DataFrame(columns)
    used = ", ".join(f"{k or 'array'} ({' x '.join(map(str, a.shape))})" for k, a in arrays.items() if n in a.shape)
    return table, f"{path.name}: {n} rows of {used}.{handeye}"


def _without_flange(path: Path, arrays: Mapping[str, Array]) -> tuple[dict[str, Array], str]:
    """Return arrays without the flange's poses of easy_handeye2's samples, and what is said of them.

    The controller computed them, they were not measured. Raises InputError without joint readings.
    """
    parts = {name: name.removeprefix("samples.").split(".")[0] for name in arrays}
    if not {"robot", "optical"} <= {*parts.values()}:
        return {**arrays}, ""
    if {*parts.values()} == {"robot", "optical"}:
        raise InputError(
            f"{path}: samples of easy_handeye2 have poses of the flange (robot) and of the target (optical), no joint "
            "readings. The errors of an arm act through its joints, and a pose of the flange has several postures: "
            "add the readings of /joint_states to each sample (joints: [...]), or write a CSV with a row for each: "
            "j1, j2, ..., x, y, z, qx, qy, qz, qw (of optical)"
        )
    said = " Samples of easy_handeye2: poses of the flange (robot) are computed by the controller, and not used."
    return {name: array for name, array in arrays.items() if parts[name] != "robot"}, said


def _arrays(content: Any, name: str = "") -> Mapping[str, Array]:
    """Return all arrays in nested mappings, records and structs, by their names joined by dots."""
    if isinstance(content, np.ndarray) and content.dtype.names:
        if content.ndim == 0:
            return _arrays({field: content[field].item() for field in content.dtype.names}, name)
        fields = {field: _stacked(content[field]) for field in content.dtype.names}
        return {key: value for field in fields for key, value in _arrays(fields[field], f"{name}.{field}").items()}
    if isinstance(content, Mapping) and {"columns", "data"} <= {*content}:  # as pandas splits a table
        return _arrays([dict(zip(content["columns"], row, strict=False)) for row in content["data"]], name)
    if isinstance(content, Mapping):
        inner = {str(key): value for key, value in content.items() if not str(key).startswith("__")}
        single = len(inner) == 1 and not name
        return {
            key: value
            for own, part in inner.items()
            for key, value in _arrays(
                part, "" if single and isinstance(part, list) else f"{name}.{own}".strip(".")
            ).items()
        }
    if isinstance(content, list) and content and all(isinstance(row, Mapping) for row in content):
        frame = pd.json_normalize(content)
        return {
            key: value for own in frame for key, value in _arrays([*frame[own]], f"{name}.{own}".strip(".")).items()
        }
    array = content if isinstance(content, np.ndarray) else _stacked(content)
    whole = isinstance(array, np.ndarray) and array.ndim and array.size and array.dtype.kind in "fiuUO"
    return {name: array} if whole else {}


def _stacked(cells: Any) -> Any:
    """Return cells that are numbers, words or lists of one size as one array; else unchanged."""
    try:
        array = np.array([*cells] if not isinstance(cells, str) else cells)
    except (TypeError, ValueError):
        return cells
    return array if array.dtype.kind in "fiuU" else cells


def _columns(name: str, array: Array) -> dict[str, Array]:
    """Return the columns of an array, rows first, by their headings."""
    flat = array.reshape(len(array), -1)
    if array.ndim == 1:
        return {name or "column 1": array}
    headings = headings_of(name, array.shape[1:]) if name else [f"column {k}" for k in range(1, flat.shape[1] + 1)]
    return dict(zip(headings, flat.T, strict=True))


def headings_of(name: str, shape: tuple[int, ...]) -> list[str]:
    """Return headings of the entries of a list or matrix of this shape: angles, _x or [i,j]."""
    words = {*re.findall(r"[^\W\d_]+", name.casefold())}
    if shape == (3,) and words & {"rpy", "ypr"}:
        angles = ("roll", "pitch", "yaw")
        return [f"{name} {angle}" for angle in (angles if "rpy" in words else angles[::-1])]
    if shape == (3,) and not words & (WORDS["log_position"] - {"position", "pos", "positions"}):
        return [f"{name}_{c}" for c in "xyz"]
    return [f"{name}[{','.join(map(str, k))}]" for k in np.ndindex(shape)]


def expanded(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose columns of lists of one size, in half of the cells, are split.

    Lists are in brackets, as ROS and numpy write them, or three or more numbers with blanks or
    semicolons between them.
    """
    parts: list[pd.DataFrame] = []
    for name in frame:
        column = frame[name]
        lists = [_list(cell) for cell in column] if column.dtype.kind not in "fiub" else []
        sizes = {x.shape for x in lists if x is not None}
        if len(sizes) != 1 or sum(x is not None for x in lists) < 0.5 * len(lists) or sizes == {(1,)}:
            parts.append(column.to_frame())
            continue
        shape = sizes.pop()
        rows = [np.full(shape, np.nan) if x is None else x for x in lists]
        flat = pd.DataFrame([row.ravel() for row in rows], columns=headings_of(str(name), shape), index=frame.index)
        for own in flat:
            numbers = pd.to_numeric(flat[own], errors="coerce")
            parts.append((flat[own] if numbers.isna().all() else numbers).to_frame())
    return pd.concat(parts, axis=1) if len(parts) else frame


def _list(cell: Any) -> Array | None:
    """Return the list or matrix in a cell as an array of numbers or words; None if it is none."""
    if isinstance(cell, list | tuple | np.ndarray):
        array = _stacked(cell)
        return array if isinstance(array, np.ndarray) and array.ndim else None
    text = re.sub(r"np\.\w+\(([^()]*)\)", r"\1", str(cell).strip())  # as numpy 2 writes a number
    text = re.sub(r"^array\((?:'\w',)?(.*)\)$", r"\1", text, flags=re.DOTALL).strip()
    bracketed = re.fullmatch(r"[\[({].*[\])}]", text, re.DOTALL)
    tokens = [t.strip("'\"") for t in re.split(r"[\[\](){},;\s]+", text) if t]
    numbers = [_number(t) for t in tokens]
    if not tokens or (not bracketed and (len(tokens) < 3 or None in numbers)):
        return None
    array = np.array(tokens if None in numbers else numbers)
    rows = len(re.findall(r"[\[(][^\[\](){}]+[\])]", text))
    nested = bracketed and rows > 1 and len(array) % rows == 0
    return array.reshape(rows, -1) if nested else array


def _number(text: str) -> float | None:
    """Return the number that a text writes, None for other texts."""
    try:
        return float(text)
    except ValueError:
        return None
