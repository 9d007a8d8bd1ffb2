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

import numpy as np

from casadical.core.errors import InputError
from casadical.core.transforms import Array
from casadical.measurements.kinds import Kind
from casadical.measurements.validation import refuse_malformed

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
