"""Columns of a table by name, converted to SI; what is missing, no number or in the wrong unit is refused."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from casadical.core.errors import InputError
from casadical.core.transforms import Array, from_rpy
from casadical.measurements.raw_table import RawTable, refuse_repeated_names

_TO_SI = {"_mm": 1e-3, "_m": 1.0, "_deg": np.pi / 180, "_rad": 1.0}
# Columns that are readings or observations; every other one is a condition.
_OWN = re.compile(
    r"q\d+_(deg|rad|mm|m)|q[wxyz]|(to_)?[xyz]_mm?|r[xyz]_(deg|rad)|R[012]{2}|distance_mm?|weight|point|set"
)


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of one table, converted to SI; every error (InputError) says where.

    table : headers without blanks around them, wholly empty columns left out
    source : file name or description; row : shape (n,), line of the file at which each row stands
    """

    table: pd.DataFrame
    source: str
    row: Array

    @staticmethod
    def of_file(raw: RawTable) -> Columns:
        """Columns of a file. Raises InputError."""
        return _columns(raw.frame(), raw.path.name, np.array(raw.line))

    @staticmethod
    def of_frame(table: pd.DataFrame, source: str) -> Columns:
        """Columns of a pandas table; its rows count as in a file, from 2 on. Raises InputError."""
        return _columns(table, source, np.arange(len(table)) + 2)

    def mapped(self, columns: Mapping[str, str], point_from: Sequence[str] = ()) -> Columns:
        """With our names where the table's headers differ.

        columns : our name -> name in the table; point_from : columns whose words, joined by "/", name the touched point
        Raises InputError where a named column is missing.
        """
        named = [(theirs, f"named for {ours!r}") for ours, theirs in columns.items()]
        for theirs, where in [*named, *((name, "named in point_from") for name in point_from)]:
            if theirs not in self.table:
                raise InputError(f"{self.source}: column {theirs!r}, {where}, is missing; there are {self.names}")
        # A header that keeps its own name elsewhere in the map is copied, not moved.
        made = {ours: self.table[theirs] for ours, theirs in columns.items()}
        if point_from:
            made["point"] = self.table[list(point_from)].astype(str).agg("/".join, axis=1)
        moved = [name for name, theirs in columns.items() if name in self.table and theirs != name]
        return replace(self, table=self.table.drop(columns=moved).assign(**made))

    @property
    def names(self) -> str:
        """All of them, for messages."""
        return ", ".join(map(str, self.table))

    def at(self, k: int) -> str:
        """Source and row of the table's k-th row, for messages."""
        return f"{self.source}: row {self.row[k]}"

    def column(self, name: str) -> Array:
        """A column's numbers, shape (k,). Raises InputError where it is missing or not finite."""
        if name not in self.table:
            raise InputError(f"{self.source}: column {name!r} is missing; there are {self.names}")
        values = pd.to_numeric(self.table[name], errors="coerce").to_numpy(dtype=float)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            text = self.table[name].iloc[int(bad[0])]
            raise InputError(
                f"{self.at(bad[0])}, column {name!r}: {text!r} is not a finite number "
                f"({bad.size} such in this column); correct or delete the row"
            )
        return values

    def si(self, stem: str, units: Sequence[str]) -> Array:
        """Column `stem` in one of the allowed units, shape (k,) [SI]. Raises InputError for none or several."""
        present = [u for u in units if f"{stem}{u}" in self.table]
        if len(present) > 1:
            both = " and ".join(f"{stem}{u}" for u in present)
            raise InputError(f"{self.source}: columns {both} say the same; keep one")
        if not present:
            wanted = " or ".join(f"{stem}{u}" for u in units)
            raise InputError(f"{self.source}: column {wanted} is missing; there are {self.names}")
        return self.column(stem + present[0]) * _TO_SI[present[0]]

    def joints(self, kinds: Sequence[str]) -> Array:
        """Joint readings, shape (k, n) [rad or m]. Raises InputError for missing columns, others or wrong units."""
        columns = []
        for i, kind in enumerate(kinds, 1):
            units = ("_deg", "_rad") if kind == "revolute" else ("_mm", "_m")
            columns.append(self.si(f"q{i}", units))
        extra = [c for c in self.table if str(c).startswith(f"q{len(kinds) + 1}_")]
        if extra:
            raise InputError(f"{self.source}: column {extra[0]!r}: this robot has only {len(kinds)} joints")
        q = np.stack(columns, axis=1)
        self._angle_units(q, kinds)
        return q

    def _angle_units(self, q: Array, kinds: Sequence[str]) -> None:
        turning = [i for i, k in enumerate(kinds) if k == "revolute"]
        if not turning or not len(q):
            return
        largest = float(np.abs(q[:, turning]).max())
        names = [f"q{i + 1}" for i in turning]
        if largest > 8 * np.pi:
            i = turning[int(np.argmax(np.abs(q[:, turning]).max(axis=0)))]
            row = int(np.argmax(np.abs(q[:, i])))
            turns = f"{self.at(row)}, column "
            if f"q{i + 1}_rad" in self.table:
                turns += f"'q{i + 1}_rad': {q[row, i]:.6g} rad is {largest / (2 * np.pi):.1f} turns; "
                raise InputError(turns + f"are the columns in degrees? name them q{i + 1}_deg")
            turns += f"'q{i + 1}_deg': {np.rad2deg(q[row, i]):.6g} deg is {largest / (2 * np.pi):.1f} turns; "
            raise InputError(turns + "at most 4 are allowed: correct the reading")
        degrees = all(f"{n}_deg" in self.table for n in names)
        if degrees and len(q) >= 10 and np.ptp(q[:, turning], axis=0).max() < np.deg2rad(6.3):
            raise InputError(
                f"{self.source}: no joint moves by more than {np.rad2deg(np.ptp(q[:, turning], axis=0).max()):.2f} deg "
                f"over {len(q)} poses; are the columns in radians? name them q1_rad, ..."
            )

    def vector(self, prefix: str, units: Sequence[str] = ("_mm", "_m")) -> Array:
        return np.stack([self.si(f"{prefix}{c}", units) for c in "xyz"], axis=1)

    def orientation(self) -> Array:
        """Rotation matrices, shape (k, 3, 3), from whichever columns there are. Raises InputError for no rotation."""
        has = set(self.table)
        if "R00" in has:
            R = np.stack([self.column(f"R{i}{j}") for i in range(3) for j in range(3)], axis=1).reshape(-1, 3, 3)
        elif "qw" in has:
            quaternion = np.stack([self.column(c) for c in ("qw", "qx", "qy", "qz")], axis=1)
            length = np.linalg.norm(quaternion, axis=1)
            if np.abs(length - 1).max() > 1e-2:
                row = int(np.abs(length - 1).argmax())
                raise InputError(
                    f"{self.at(row)}, columns 'qw' to 'qz': length {length[row]:.4g}; "
                    "allowed: unit quaternions (w first), within 1 %"
                )
            R = _from_quaternion(quaternion)
        else:
            angles = self.vector("r", ("_deg", "_rad"))
            R = np.stack([from_rpy(np.array([a, 0, 0])) @ _from_yz(b, c) for a, b, c in angles])
        off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(R) < 0)
        if off.max() > 1e-3:
            row = int(off.argmax())
            raise InputError(
                f"{self.at(row)}, columns 'R00' to 'R22': no rotation (R R' differs from one by "
                f"{off[row]:.3g}, mirrored ones by more than one); allowed: orthonormal matrices, right-handed"
            )
        return R

    def conditions(self) -> dict[str, Array]:
        """Every other numeric column, by its own name; a column of words (remarks, operators) is left out."""
        found = {}
        for name in map(str, self.table):
            if _OWN.fullmatch(name):
                continue
            numeric = pd.to_numeric(self.table[name], errors="coerce").notna()
            if numeric.mean() >= 0.5:  # some words among numbers are mistakes: `column` says where
                found[name] = self.column(name)
        return found


def _columns(table: pd.DataFrame, source: str, row: Array) -> Columns:
    table = table.rename(columns=lambda name: str(name).strip())
    refuse_repeated_names(table.columns, source)
    if not len(table):
        raise InputError(f"{source}: a header but no rows; at least one row is needed")
    return Columns(table.dropna(axis="columns", how="all"), source, row)


def _from_yz(b: float, c: float) -> Array:
    """Ry(b) Rz(c)."""
    return from_rpy(np.array([0, b, 0])) @ from_rpy(np.array([0, 0, c]))


def _from_quaternion(q: Array) -> Array:
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
