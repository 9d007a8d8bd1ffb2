"""Measured poses: a table with units in its column names goes in, one immutable, checked object in SI comes out.

Joint readings `q1_deg` (or `q1_rad`; `q1_mm`, `q1_m` of a prismatic joint) and one kind of observation:

| kind | columns |
|---|---|
| position | `x_mm, y_mm, z_mm` (or `_m`) |
| pose | those and `rx_deg, ry_deg, rz_deg` (intrinsic x-y-z; or `_rad`), `R00..R22`, or `qw, qx, qy, qz` |
| distance | `distance_mm` to a point: known `to_x_mm, to_y_mm, to_z_mm`, or unknown (identified too) |
| pair_distance | `distance_mm` to the tool's position at another pose, `other_pose` |
| contact | `point`: poses with the same label hold the tool at the same, unknown point |

Everything else that the model needs (`payload_kg`, `temperature_degC`, `approach1`, ...) is kept by its name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from .errors import InputError
from .transforms import Array, from_rpy
from .wellformed import refuse_malformed

Kind = Literal["position", "pose", "distance", "pair_distance", "contact"]

KINDS: tuple[Kind, ...] = ("position", "pose", "distance", "pair_distance", "contact")
SETS = ("identify", "train", "choose", "report")

# Readings closer than this [rad or m] in every joint count as the same pose.
SAME_READING = 1e-6

_TO_SI = {"_mm": 1e-3, "_m": 1.0, "_deg": np.pi / 180, "_rad": 1.0}


@dataclass(frozen=True, eq=False)
class Measurements:
    """Poses of one robot and what was observed at them, all of one kind; SI units.

    q : joint readings, shape (n, joints) [rad or m]
    kind : what was observed (see the module's table)
    position : shape (n, 3) [m], of kinds position and pose
    orientation : shape (n, 3, 3), of kind pose
    distance : shape (n,) [m], of kinds distance and pair_distance
    target : shape (n, 3) [m], the known far end of a distance; None where it is to be identified
    other : shape (n, joints), readings at the other end of a pair distance
    label : shape (n,), which unknown point is touched, of kind contact
    separations : for kind contact, (label, label, distance [m]) between touched points that are known
    separation_sigma : how well they are known [m]
    conditions : logged columns by name, each of shape (n,)
    sigma, sigma_angle : standard deviation of one coordinate [m] and angle [rad]; None: estimated from the fit
    weight : shape (n,), factor on each pose's residual
    row : shape (n,), line of the source at which each pose stands, for messages
    source : file name or description
    """

    q: Array
    kind: Kind
    position: Array | None = None
    orientation: Array | None = None
    distance: Array | None = None
    target: Array | None = None
    other: Array | None = None
    label: Array | None = None
    separations: tuple[tuple[str, str, float], ...] = ()
    separation_sigma: float = 2e-5
    conditions: Mapping[str, Array] = field(default_factory=dict)
    sigma: float | None = None
    sigma_angle: float | None = None
    weight: Array = field(default_factory=lambda: np.ones(0))
    row: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    source: str = "table"

    def __post_init__(self) -> None:
        n = len(self.q)
        if n == 0:
            raise InputError(f"{self.source}: no poses; at least one row is needed")
        if not len(self.weight):
            object.__setattr__(self, "weight", np.ones(n))
        if not len(self.row):
            object.__setattr__(self, "row", np.arange(n))
        refuse_malformed(self)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def residuals(self) -> int:
        """How many numbers were observed, poses of weight zero left aside."""
        return int(np.count_nonzero(self.weight)) * {"position": 3, "pose": 6, "contact": 3}.get(self.kind, 1) + len(
            self.separations
        )

    def __getitem__(self, which: Array | slice | Sequence[int]) -> Measurements:
        """The poses chosen by mask, slice or indices."""
        index = np.atleast_1d(np.arange(len(self))[which])
        arrays = {
            name: None if getattr(self, name) is None else getattr(self, name)[index]
            for name in ("q", "position", "orientation", "distance", "target", "other", "label", "weight", "row")
        }
        kept = self.separations
        if arrays["label"] is not None:
            present = set(arrays["label"])
            kept = tuple(s for s in kept if s[0] in present and s[1] in present)
        conditions = {name: values[index] for name, values in self.conditions.items()}
        return replace(self, **arrays, conditions=conditions, separations=kept)  # type: ignore[arg-type]

    def condition_matrix(self, names: Sequence[str], declared: Array) -> Array:
        """Logged columns, shape (n, len(names)), SI; a column that was not logged takes its declared value."""
        columns = [self.conditions.get(n, np.full(len(self), declared[k])) for k, n in enumerate(names)]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self), 0))

    def split(self, sizes: Mapping[str, float], seed: int = 0) -> dict[str, Measurements]:
        """Disjoint, seeded, named sets; a size below 1 is a share, from 1 on a number of poses.

        Poses at the same joint readings (replicates) stay together, so that no pose is ever in two sets; a set may hold
        some more or less than its size for that. A pair distance whose ends fall in two sets is left out; poses of one
        contact point may fall in two. Raises InputError for sizes that cannot be had.
        """
        ends = np.concatenate([self.q] if self.other is None else [self.q, self.other])
        reading = same_readings(ends)
        near, far = reading[: len(self)], reading[-len(self) :]
        counts = np.array([s * len(self) if s < 1 else s for s in sizes.values()])
        edges = np.cumsum([0.0, *counts]).round().astype(int)
        if not counts.size or counts.min() <= 0 or edges[-1] > len(self):
            raise InputError(
                f"{self.source}: sets of {dict(sizes)} cannot be taken from {len(self)} poses; give positive sizes "
                "(shares below 1, or numbers) that add up to no more than the poses there are"
            )
        copies = np.bincount(near, minlength=int(reading.max()) + 1)
        order = np.random.default_rng(seed).permutation(len(copies))
        # The place of each reading's first pose in the shuffled row decides on its set.
        first = np.empty(len(copies), dtype=int)
        first[order] = np.cumsum(copies[order]) - copies[order]
        home = np.searchsorted(edges, first, side="right") - 1
        return {name: self[(home[near] == k) & (home[far] == k)] for k, name in enumerate(sizes)}

    def with_separations(self, known: Iterable[tuple[str, str, float]], sigma: float = 2e-5) -> Measurements:
        """Contact poses with known distances (label, label, distance [m]) between touched points, sigma [m] each."""
        return replace(self, separations=tuple(known), separation_sigma=sigma)


def same_readings(q: Array) -> Array:
    """A number for each distinct reading, shape (n,): joint by joint, a new cell begins behind each gap."""
    cells = np.empty(q.shape, dtype=int)
    for j, column in enumerate(q.T):
        order = np.argsort(column)
        cells[order, j] = np.cumsum(np.diff(column[order], prepend=column[order[0]]) > SAME_READING)
    return np.asarray(np.unique(cells, axis=0, return_inverse=True)[1].ravel())


def read_measurements(
    path: str | Path,
    joints: int | Sequence[str],
    kind: Kind | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    sigma_mm: float | None = None,
    sigma_deg: float | None = None,
) -> Measurements:
    """Measurements from a CSV file.

    joints : number of joints, or the kind of each ("revolute", "prismatic")
    kind : what was observed; by default what the columns say
    columns : new name -> name in the file, where the file's headers differ from ours

    Raises InputError that names the file, row and column where something is wrong.
    """
    path, table = _csv(path)
    return from_table(table, joints, kind, columns=columns, sigma_mm=sigma_mm, sigma_deg=sigma_deg, source=path.name)


def read_readings(path: str | Path, joints: int | Sequence[str]) -> Measurements:
    """Poses that are planned but not measured, from a CSV file: readings and conditions, every position zero.

    Raises InputError as `read_measurements` does.
    """
    path, table = _csv(path)
    table = table.drop(columns=[c for c in table if str(c).strip() in _POSITIONS])
    return from_table(table.assign(x_m=0.0, y_m=0.0, z_m=0.0), joints, "position", source=path.name)


_POSITIONS = {f"{c}{u}" for c in "xyz" for u in ("_mm", "_m")}


def _csv(path: str | Path) -> tuple[Path, pd.DataFrame]:
    path = Path(path)
    try:
        table = pd.read_csv(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a readable CSV table: {str(error).strip()}") from None
    if table.shape[1] == 1 and (";" in str(table.columns[0]) or "\t" in str(table.columns[0])):
        raise InputError(f"{path}: its columns are parted by ';' or tabs; allowed: commas, with decimal points")
    return path, table


def from_table(
    table: pd.DataFrame,
    joints: int | Sequence[str],
    kind: Kind | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    sigma_mm: float | None = None,
    sigma_deg: float | None = None,
    source: str = "table",
) -> Measurements:
    """Measurements from a pandas table; arguments and errors (Raises InputError) as of `read_measurements`."""
    reader = _Reader(_renamed(_tidy(table, source), columns or {}, source), source)
    kinds = ["revolute"] * joints if isinstance(joints, int) else list(joints)
    if not kinds or set(kinds) - {"revolute", "prismatic"}:
        raise InputError(f"{source}: joints {joints!r}; allowed: their number, or 'revolute' or 'prismatic' for each")
    kind = kind or reader.guess_kind()
    if kind not in KINDS:
        raise InputError(f"{source}: kind {kind!r} is not known; allowed: {', '.join(KINDS)}")
    q = reader.joints(kinds)
    observed = _OBSERVED[kind](reader, q)
    found = Measurements(
        q=q,
        kind=kind,
        conditions=reader.conditions(),
        sigma=None if sigma_mm is None else sigma_mm * 1e-3,
        sigma_angle=None if sigma_deg is None else float(np.deg2rad(sigma_deg)),
        weight=reader.column("weight") if "weight" in reader.table else np.ones(len(q)),
        row=np.arange(len(q)) + 2,
        source=source,
        **observed,  # type: ignore[arg-type]
    )
    _refuse_repeats(found)
    return found


def _tidy(table: pd.DataFrame, source: str) -> pd.DataFrame:
    """Headers without blanks around them, wholly empty columns left out. Raises InputError: no rows, names twice."""
    table = table.rename(columns=lambda name: str(name).strip())
    twice = sorted(set(table.columns[table.columns.duplicated()]))
    # pandas reads a second x_mm as x_mm.1
    twice += [c[:-2] for c in table.columns if c.endswith(".1") and c[:-2] in table]
    if twice:
        raise InputError(f"{source}: column {twice[0]!r} is there twice; keep one")
    if not len(table):
        raise InputError(f"{source}: a header but no rows; at least one pose is needed")
    return table.dropna(axis="columns", how="all")


def _renamed(table: pd.DataFrame, columns: Mapping[str, str], source: str) -> pd.DataFrame:
    for ours, theirs in columns.items():
        if theirs not in table:
            raise InputError(f"{source}: column {theirs!r}, named for {ours!r}, is missing; there are {list(table)}")
    # A header that keeps its own name elsewhere in the map is copied, not moved.
    copies = {ours: table[theirs] for ours, theirs in columns.items()}
    return table.drop(columns=[c for c in columns if c in table and columns[c] != c]).assign(**copies)


# Columns that are readings or observations; every other one is a condition.
_OWN = re.compile(
    r"q\d+_(deg|rad|mm|m)|q[wxyz]|(to_)?[xyz]_mm?|r[xyz]_(deg|rad)|R[012]{2}|distance_mm?|weight|point|set"
)


class _Reader:
    """Columns of one table, converted to SI, with errors that say where."""

    def __init__(self, table: pd.DataFrame, source: str) -> None:
        self.table = table
        self.source = source

    def guess_kind(self) -> Kind:
        has = set(self.table)
        if has & {"x_mm", "x_m"}:
            turned = has & {"rx_deg", "rx_rad", "R00", "qw"}
            return "pose" if turned else "position"
        if has & {"distance_mm", "distance_m"}:
            return "pair_distance" if "other_pose" in has else "distance"
        if "point" in has:
            return "contact"
        raise InputError(
            f"{self.source}: no observation found; need x_mm, y_mm, z_mm (or _m), distance_mm or point; "
            f"there are {', '.join(map(str, self.table))}"
        )

    def column(self, name: str) -> Array:
        if name not in self.table:
            raise InputError(f"{self.source}: column {name!r} is missing; there are {', '.join(map(str, self.table))}")
        values = pd.to_numeric(self.table[name], errors="coerce").to_numpy(dtype=float)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            text = self.table[name].iloc[int(bad[0])]
            raise InputError(
                f"{self.source}: row {bad[0] + 2}, column {name!r}: {text!r} is not a finite number "
                f"({bad.size} such in this column); correct or delete the row"
            )
        return values

    def si(self, stem: str, units: Sequence[str]) -> Array:
        """Column `stem` under one of the allowed unit suffixes, in SI."""
        present = [u for u in units if f"{stem}{u}" in self.table]
        if len(present) > 1:
            both = " and ".join(f"{stem}{u}" for u in present)
            raise InputError(f"{self.source}: columns {both} say the same; keep one")
        if not present:
            wanted = " or ".join(f"{stem}{u}" for u in units)
            raise InputError(f"{self.source}: column {wanted} is missing; there are {', '.join(map(str, self.table))}")
        return self.column(stem + present[0]) * _TO_SI[present[0]]

    def joints(self, kinds: Sequence[str]) -> Array:
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
            turns = f"{self.source}: row {row + 2}, column "
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
        has = set(self.table)
        if "R00" in has:
            R = np.stack([self.column(f"R{i}{j}") for i in range(3) for j in range(3)], axis=1).reshape(-1, 3, 3)
        elif "qw" in has:
            quaternion = np.stack([self.column(c) for c in ("qw", "qx", "qy", "qz")], axis=1)
            length = np.linalg.norm(quaternion, axis=1)
            if np.abs(length - 1).max() > 1e-2:
                row = int(np.abs(length - 1).argmax())
                raise InputError(
                    f"{self.source}: row {row + 2}, columns 'qw' to 'qz': length {length[row]:.4g}; "
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
                f"{self.source}: row {row + 2}, columns 'R00' to 'R22': no rotation (R R' differs from one by "
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


def _position(reader: _Reader, _q: Array) -> dict[str, Array | None]:
    return {"position": reader.vector("")}


def _pose(reader: _Reader, _q: Array) -> dict[str, Array | None]:
    return {"position": reader.vector(""), "orientation": reader.orientation()}


def _distance(reader: _Reader, _q: Array) -> dict[str, Array | None]:
    known = any(str(c).startswith("to_x") for c in reader.table)
    return {"distance": _positive_distance(reader), "target": reader.vector("to_") if known else None}


def _pair_distance(reader: _Reader, q: Array) -> dict[str, Array | None]:
    pose, other = reader.column("pose"), reader.column("other_pose")
    where = {float(p): k for k, p in enumerate(pose)}
    if len(where) < len(pose):
        row = next(k for k, p in enumerate(pose) if where[float(p)] != k)
        raise InputError(
            f"{reader.source}: row {row + 2}, column 'pose': {pose[row]:g} occurs again in row "
            f"{where[float(pose[row])] + 2}; allowed: each pose's own number"
        )
    if (pose == other).any():
        row = int(np.argmax(pose == other))
        raise InputError(f"{reader.source}: row {row + 2}, column 'other_pose': {other[row]:g} is that pose itself")
    missing = [k for k, o in enumerate(other) if float(o) not in where]
    if missing:
        raise InputError(
            f"{reader.source}: row {missing[0] + 2}, column 'other_pose': {other[missing[0]]:g} is no pose of this "
            "table; allowed: the numbers in column 'pose'"
        )
    return {"distance": _positive_distance(reader), "other": q[[where[float(o)] for o in other]]}


def _positive_distance(reader: _Reader) -> Array:
    distance = reader.si("distance", ("_mm", "_m"))
    if (distance <= 0).any():
        row = int(np.argmax(distance <= 0))
        raise InputError(
            f"{reader.source}: row {row + 2}, column 'distance': {1e3 * distance[row]:.4g} mm; a distance must be "
            "positive (poses at one point are kind 'contact')"
        )
    return distance


def _contact(reader: _Reader, _q: Array) -> dict[str, Array | None]:
    if "point" not in reader.table:
        raise InputError(f"{reader.source}: column 'point' is missing; it says which point each pose touches")
    empty = reader.table["point"].isna().to_numpy()
    if empty.any():
        raise InputError(f"{reader.source}: row {int(np.argmax(empty)) + 2}, column 'point' is empty; name the point")
    label = reader.table["point"].astype(str).to_numpy(dtype=object)
    names, counts = np.unique(label.astype(str), return_counts=True)
    if counts.max() < 2:
        raise InputError(
            f"{reader.source}: column 'point': no point is touched twice ({len(names)} labels); "
            "poses at one point must have one label"
        )
    return {"label": label}


_OBSERVED: dict[Kind, Callable[[_Reader, Array], dict[str, Array | None]]] = {
    "position": _position,
    "pose": _pose,
    "distance": _distance,
    "pair_distance": _pair_distance,
    "contact": _contact,
}


def _refuse_repeats(found: Measurements) -> None:
    """A row copied whole is no second measurement."""
    seen = [found.q]
    for part in (found.position, found.distance, found.other):
        if part is not None:
            seen.append(part.reshape(len(found), -1))
    if found.label is not None:
        seen.append(np.unique(found.label.astype(str), return_inverse=True)[1].reshape(-1, 1).astype(float))
    stacked = np.concatenate(seen, axis=1)
    _, first, inverse = np.unique(stacked, axis=0, return_index=True, return_inverse=True)
    origin = first[inverse.ravel()]
    copies = np.flatnonzero(origin != np.arange(len(found)))
    if copies.size:
        k = int(copies[0])
        raise InputError(
            f"{found.source}: row {found.row[k]} repeats row {found.row[origin[k]]} to the last digit, readings "
            f"and observation alike ({copies.size} such rows); a true repeat differs by its noise: delete copies"
        )
