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

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from casadical.core.errors import InputError
from casadical.core.transforms import Array
from casadical.measurements.columns import Columns
from casadical.measurements.kinds import KINDS, OBSERVED, Kind, guess_kind
from casadical.measurements.validation import refuse_malformed

__all__ = ["SETS", "Kind", "Measurements", "from_table", "read_measurements", "read_readings", "same_readings"]

SETS = ("identify", "train", "choose", "report")

# Readings closer than this [rad or m] in every joint count as the same pose.
SAME_READING = 1e-6


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
    given = Columns(_renamed(_tidy(table, source), columns or {}, source), source)
    kinds = ["revolute"] * joints if isinstance(joints, int) else list(joints)
    if not kinds or set(kinds) - {"revolute", "prismatic"}:
        raise InputError(f"{source}: joints {joints!r}; allowed: their number, or 'revolute' or 'prismatic' for each")
    kind = kind or guess_kind(given)
    if kind not in KINDS:
        raise InputError(f"{source}: kind {kind!r} is not known; allowed: {', '.join(KINDS)}")
    q = given.joints(kinds)
    observed = OBSERVED[kind](given, q)
    found = Measurements(
        q=q,
        kind=kind,
        conditions=given.conditions(),
        sigma=None if sigma_mm is None else sigma_mm * 1e-3,
        sigma_angle=None if sigma_deg is None else float(np.deg2rad(sigma_deg)),
        weight=given.column("weight") if "weight" in given.table else np.ones(len(q)),
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
