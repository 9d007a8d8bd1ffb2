"""Measured poses of one kind as one immutable, checked object in SI units, and their noise model.

The kinds of measurement are in `casadical.measurements.kinds`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.reporting.blocks import Table
from casadical.core.reporting.result import Shown, html
from casadical.measurements.camera_noise import Camera, CameraNoise, View, initial_noise, whitening, without_errors
from casadical.measurements.corners import CameraErrors, Images
from casadical.measurements.kinds.registry import find_kind


@dataclass(frozen=True)
class Noise:
    """Noise of a campaign: that of the instrument, and the repeatability of the joints.

    sigma : standard deviation of a measured coordinate [m]
    repeatability : standard deviation with which a joint repeats its reading [rad or m]
    Raises InputError: a sigma that is not positive, or a negative repeatability.

    Examples
    --------
    >>> casadical.identification.pose_selection.Noise(sigma=2e-5, repeatability=8e-6).sigma
    2e-05
    """

    sigma: float = 2e-5
    repeatability: float = 0.0

    def __post_init__(self) -> None:
        if not (self.sigma > 0 and self.repeatability >= 0):
            raise InputError(
                f"noise of {self.sigma} m and {self.repeatability} rad; allowed: above zero, and zero or more"
            )


# Names of the sets of poses: identification, training of networks, choice among them, report.
SETS = ("identify", "train", "choose", "report")

# Prefixes of the columns that are 1 for poses at which a target was measured, or of a session, else 0.
TARGET_PREFIX = "tool_"
SESSION_PREFIX = "session_"

# Largest difference of each joint's variable [rad or m] with which two poses count as the same.
SAME_READING_TOLERANCE = 1e-6
# Largest difference of each joint's variable [rad or m] between measurements at one pose: of
# several targets, or repeated (acceptance, daily touches).
STANDSTILL_TOLERANCE = 5e-4

# Names of the fields of `Measurements` that hold observations.
FIELDS = ("position", "orientation", "distance", "target", "other", "label")


@dataclass(frozen=True, eq=False)
class Measurements(Shown):
    """Poses of one robot and what was observed at them, all of one kind; SI units.

    q : joint variables, shape (n, joints) [rad or m]: those of the robot file's rows, which are the
        controller's readings unless the file states how it counts
    kind : what was observed: position, pose, distance, pair_distance, contact, or another
        registered kind
    position : measured point in the measuring frame, shape (n, 3) [m]: of kinds position,
        position_covariance and pose
    orientation : of the tool in the measuring frame, shape (n, 3, 3): of kind pose
    distance : shape (n,) [m]: of kinds distance and pair_distance; of kind sphere its radius
    target : given anchor of a distance in the measuring frame, shape (n, 3) [m]; None where it is
        identified
    other : joint variables at the other pose, shape (n, joints) [rad or m]: of kinds pair_distance
        and relative_pose
    label : name of the unknown point, plane, ball, anchor or gauge of each pose, shape (n,)
    extra : further observed arrays by name, each of shape (n, ...), of kinds that need others than
        these
    separations : given distances (label, label, distance [m]) between touched points
    separation_sigma : standard deviation of these distances [m]
    conditions : logged columns by name, each of shape (n,)
    sigma, sigma_angle : standard deviation of a coordinate [m] and of an angle [rad]; None:
        estimated from the fit
    datasheet : largest error of a point that the instrument's data sheet states [m]; None: not
        given
    weight : factor on each pose's squared residual, shape (n,), zero or positive
    row : line of the source at which each pose stands, shape (n,)
    source : file name or description
    unused : columns that nothing reads: those of words, or without a cell
    copies : lines that were dropped because they repeat another one to the last digit
    lost : lines that were dropped because a reading or an observation is missing
    inverted : whether the source has the inverse of each pose: the measuring frame as the tool sees
        it
    camera : where the camera is that saw the poses, "in hand" or "to base"; empty: unknown
    clock_offset : time by which the images were taken after the readings of their rows [s], for
        which the readings q are corrected
    noise : ratios of the noise of a camera's poses in its own axes; None: equal in all axes of the
        measuring frame
    Raises InputError: arrays that do not fit the kind or each other.

    Examples
    --------
    >>> len(poses), poses.residuals
    (40, 120)
    >>> sets = poses.split({"identify": 25, "report": 15}, seed=0)
    >>> {name: len(m) for name, m in sets.items()}
    {'identify': 25, 'report': 15}
    >>> poses.condition_matrix(["payload_kg"], [5.0]).shape
    (40, 1)
    >>> poses.positions_alone().kind
    'position'
    >>> touched = casadical.Measurements(poses.q, "contact", label=np.array(["A", "B"] * 20))
    >>> touched.with_separations([("A", "B", 0.25)]).separations
    (('A', 'B', 0.25),)
    """

    line: ClassVar[str] = " {{ it.source }}: {{ it | length }} poses of {{ it.q.shape[1] }} joints, {{ it.kind }}"

    q: Array
    kind: str
    position: Array | None = None
    orientation: Array | None = None
    distance: Array | None = None
    target: Array | None = None
    other: Array | None = None
    label: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)
    separations: tuple[tuple[str, str, float], ...] = ()
    separation_sigma: float = 2e-5
    conditions: Mapping[str, Array] = field(default_factory=dict)
    sigma: float | None = None
    sigma_angle: float | None = None
    datasheet: float | None = None
    weight: Array = field(default_factory=lambda: np.ones(0))
    row: Array = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    source: str = "table"
    unused: tuple[str, ...] = ()
    copies: tuple[int, ...] = ()
    lost: tuple[int, ...] = ()
    inverted: bool = False
    camera: Camera = ""
    clock_offset: float = 0.0
    noise: CameraNoise | None = None

    def __post_init__(self) -> None:
        for name in ("q", "position", "orientation", "distance", "target", "other", "label", "weight", "row"):
            if not isinstance(value := getattr(self, name), np.ndarray | None):  # lists, columns of a data frame
                try:
                    object.__setattr__(self, name, np.asarray(value, dtype=None if name in ("label", "row") else float))
                except (TypeError, ValueError) as error:
                    raise InputError(f"{self.source}: {name} is no array of numbers: {error}") from None
        n = len(self.q)
        if n == 0:
            raise InputError(f"{self.source}: no poses; at least one row is needed")
        if not len(self.weight):
            object.__setattr__(self, "weight", np.ones(n))
        if not len(self.row):
            object.__setattr__(self, "row", np.arange(n))
        _refuse_malformed(self)

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: ranges of readings, positions and logged columns."""
        columns = [(f"q{k + 1} [rad or m]", column) for k, column in enumerate(self.q.T)]
        if self.position is not None:
            columns += [(f"{axis} [mm]", 1e3 * column) for axis, column in zip("xyz", self.position.T, strict=True)]
        columns += list(self.conditions.items())
        rows = [(name, f"{c.min():.4g}", f"{c.mean():.4g}", f"{c.max():.4g}") for name, c in columns]
        table = Table("Ranges", ("column", "least", "mean", "greatest"), rows, frozenset({1, 2, 3}))
        return html([table], title=repr(self)[1:-1])

    def __len__(self) -> int:
        return len(self.q)

    @property
    def arrays(self) -> dict[str, Array]:
        """Return the observed arrays by name, from fields and `extra`, each of shape (n, ...) [SI].

        With the noise of a camera they include `whitening`, shape (n, 6, 6).
        """
        arrays = {name: getattr(self, name) for name in FIELDS if getattr(self, name) is not None} | dict(self.extra)
        return arrays if self.noise is None else arrays | {"whitening": whitening(self.view, self.noise)}

    @property
    def target_names(self) -> list[str]:
        """Return the names of the measured targets, in the order in which they appear."""
        return [name.removeprefix(TARGET_PREFIX) for name in self.conditions if name.startswith(TARGET_PREFIX)]

    @property
    def session_names(self) -> list[str]:
        """Return the names of the sessions, in the order in which they appear."""
        return [name.removeprefix(SESSION_PREFIX) for name in self.conditions if name.startswith(SESSION_PREFIX)]

    @property
    def view(self) -> View:
        """Return what the camera saw; the poses must have positions and orientations."""
        seen = self.inverse() if self.camera == "in hand" else self
        assert seen.position is not None
        assert seen.orientation is not None
        images = Images(*(self.extra[name] for name in Images._fields)) if "corners" in self.extra else None
        return View(seen.position, seen.orientation, self.camera, images)

    def in_camera_axes(self) -> Measurements:
        """Return measurements with noise in the camera's axes if a camera saw poses; else self."""
        if self.noise or not self.camera or self.kind != "pose":
            return self
        return replace(self, noise=initial_noise(self.view))

    @property
    def residuals(self) -> int:
        """Return the number of scalar residuals of all poses with a weight, and of given separations."""
        return int(np.count_nonzero(self.weight)) * find_kind(self.kind).numbers + len(self.separations)

    def positions_alone(self) -> Measurements:
        """Return the poses as kind position alone. Raises InputError: no positions are measured."""
        none = dict.fromkeys(("orientation", "distance", "target", "other", "label"))
        return replace(self, kind="position", extra={}, separations=(), **none)  # type: ignore[arg-type]

    def inverse(self) -> Measurements:
        """Return the same measurements with each pose inverted: the measuring frame in the tool's.

        They must have positions and orientations; `inverted` is negated, a camera's noise dropped.
        """
        assert self.position is not None
        assert self.orientation is not None
        R = self.orientation.transpose(0, 2, 1)
        p = -np.einsum("nij,nj->ni", R, self.position)
        return replace(self, position=p, orientation=R, inverted=not self.inverted, noise=None)

    @property
    def clock_in_words(self) -> str:
        """Return a sentence on the offset between images and joint readings; empty without one."""
        if not self.clock_offset:
            return ""
        side = "after" if self.clock_offset > 0 else "before"
        return (
            f"Images were taken {1e3 * abs(self.clock_offset):.0f} ms {side} the joint readings of their rows; "
            "readings are interpolated."
        )

    def without_errors(self, errors: CameraErrors, point: Array) -> Measurements:
        """Return the poses as a camera without these errors has them; point : middle of the board, shape (3,) [m]."""
        seen = without_errors(self.view, errors, point)
        images = {} if seen.images is None else seen.images._asdict()
        poses = self.inverse() if self.camera == "in hand" else self
        poses = replace(poses, position=seen.t, orientation=seen.R, extra={**self.extra, **images}, noise=None)
        return poses.inverse() if self.camera == "in hand" else poses

    @property
    def copies_in_words(self) -> str:
        """Return a sentence on rows that were dropped as exact copies of others; empty without any."""
        if not self.copies:
            return ""
        few = ", ".join(map(str, self.copies[:10])) + (" ..." if len(self.copies) > 10 else "")
        many = len(self.copies) > 1
        rows, count = (f"rows {few} repeat", "are") if many else (f"row {few} repeats", "is")
        return (
            f"{self.source}: {rows} another to the last digit and {count} counted once; a true "
            "repeat differs by its noise"
        )

    def __getitem__(self, which: Array | slice | Sequence[int]) -> Measurements:
        """Return the poses chosen by `which`, a mask (n,), a slice or indices, with all they have.

        Separations of points without a pose are dropped.
        """
        index = np.atleast_1d(np.arange(len(self))[which])
        separations = self.separations
        if self.label is not None:
            present = set(self.label[index])
            separations = tuple(s for s in separations if s[0] in present and s[1] in present)
        given = [name for name in ("q", *FIELDS, "weight", "row") if getattr(self, name) is not None]
        return replace(
            self,
            **{name: getattr(self, name)[index] for name in given},
            conditions={name: values[index] for name, values in self.conditions.items()},
            extra={name: values[index] for name, values in self.extra.items()},
            separations=separations,
        )

    def condition_matrix(self, names: Sequence[str], declared: Array) -> Array:
        """Return the k named logged columns, shape (n, k) [each in its own unit].

        declared : values that missing columns take at all poses, shape (k,)
        """
        columns = [self.conditions.get(n, np.full(len(self), declared[k])) for k, n in enumerate(names)]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self), 0))

    def split(self, sizes: Mapping[str, float], seed: int = 0) -> dict[str, Measurements]:
        """Return disjoint sets of poses by name, drawn at random with a seed.

        sizes : of each set: below 1 a share of the poses, from 1 on their number

        Poses at the same joint readings (replicates, several targets at one stop) stay together, so
        that no pose is ever in two sets; a set may hold some more or less than its size for that. A
        pair distance whose ends fall in two sets is omitted; poses of one contact point may fall
        in two.

        Raises InputError: impossible sizes, or a set without poses.
        """
        ends = np.concatenate([self.q] if self.other is None else [self.q, self.other])
        tolerance = STANDSTILL_TOLERANCE if len(self.target_names) > 1 else SAME_READING_TOLERANCE
        reading = same_readings(ends, tolerance)
        near, far = reading[: len(self)], reading[-len(self) :]
        counts = np.array([s * len(self) if s < 1 else s for s in sizes.values()])
        edges = np.cumsum([0.0, *counts]).round().astype(int)
        if not counts.size or counts.min() <= 0 or edges[-1] > len(self):
            wanted = ", ".join(f"{name} {size:g}" for name, size in sizes.items())
            raise InputError(
                f"{self.source}: sets of {wanted} cannot be taken from {len(self)} poses; give "
                "positive sizes (shares below 1, or numbers) that add up to no more than the poses "
                "there are"
            )
        copies = np.bincount(near, minlength=int(reading.max()) + 1)
        order = np.random.default_rng(seed).permutation(len(copies))
        # The place of each reading's first pose in the shuffled order decides on its set.
        first = np.empty(len(copies), dtype=int)
        first[order] = np.cumsum(copies[order]) - copies[order]
        home = np.searchsorted(edges, first, side="right") - 1
        members = {name: (home[near] == k) & (home[far] == k) for k, name in enumerate(sizes)}
        for name, own in members.items():
            if not own.any():
                raise InputError(
                    f"{self.source}: no poses are left for the set {name!r}, {sizes[name]:g} of "
                    f"{len(self)}; give it more in [sets], or measure more"
                )
        return {name: self[own] for name, own in members.items()}

    def with_separations(self, separations: Iterable[tuple[str, str, float]], sigma: float = 2e-5) -> Measurements:
        """Return the poses with given distances between touched points.

        separations : (label, label, distance [m]) of each pair; sigma : standard deviation of a distance
            [m]
        """
        return replace(self, separations=tuple(separations), separation_sigma=sigma)


def unmeasured(q: Array, conditions: Mapping[str, Array] | None = None, source: str = "table") -> Measurements:
    """Return poses without measurements, for predictions: kind position, every position zero.

    q : joint variables, shape (n, joints) [rad or m]; conditions : logged columns, (n,) each
    """
    zero = np.zeros((len(q), 3))
    return Measurements(q=q, kind="position", position=zero, conditions=dict(conditions or {}), source=source)


def same_readings(q: Array, within: float = SAME_READING_TOLERANCE) -> Array:
    """Return the number of each pose's group of equal joint variables, shape (n,), from 0.

    Each joint's sorted values are cut into cells at the gaps; poses in the same cells are the same.

    q : joint variables, shape (n, joints) [rad or m]
    within : smaller differences are no gaps [rad or m]; where values are so dense that there are
        no gaps, a cell ends at 20 times this width
    """
    cells = np.empty(q.shape, dtype=int)
    for j, column in enumerate(q.T):
        order = np.argsort(column)
        values = column[order]
        begins = np.diff(values, prepend=values[0]) > within
        first = np.maximum.accumulate(np.where(begins, np.arange(len(values)), 0))
        piece = np.floor((values - values[first]) / (20 * within))
        cells[order, j] = np.cumsum(begins | (np.diff(piece, prepend=0.0) > 0))
    return np.asarray(np.unique(cells, axis=0, return_inverse=True)[1].ravel())


def without_poses(sets: Sequence[Measurements], out: Iterable[tuple[int, int]]) -> tuple[Measurements, ...]:
    """Return the sets without some poses, in the same order.

    out : (set, pose) indices of the poses to be removed, from 0
    """
    excluded = set(out)
    return tuple(m[[i for i in range(len(m)) if (k, i) not in excluded]] for k, m in enumerate(sets))


def _refuse_malformed(m: Measurements) -> None:
    """Check shapes and values of all arrays. Raises InputError that names source and entry."""
    if m.q.ndim != 2:
        raise InputError(f"{m.source}: q has shape {m.q.shape}; it must be (poses, joints)")
    arrays = m.arrays
    for name in find_kind(m.kind, m.source).arrays:
        if name not in arrays:
            raise InputError(f"{m.source}: kind {m.kind!r} needs {name}")
    entries = {"position": (3,), "orientation": (3, 3), "target": (3,), "other": m.q.shape[1:]}
    entries |= {name: value.shape[1:] for name, value in arrays.items() if name not in FIELDS}
    shaped = [(name, value, entries.get(name, ())) for name, value in arrays.items()]
    shaped += [(name, value, ()) for name, value in (*m.conditions.items(), ("weight", m.weight), ("row", m.row))]
    for name, value, entry in shaped:
        if value.shape != (len(m), *entry):
            wanted = (len(m), *entry)
            raise InputError(f"{m.source}: {name} has shape {value.shape}; for {len(m)} poses it is {wanted}")
    for name, value in [("q", m.q), *arrays.items(), *m.conditions.items()]:
        if not np.issubdtype(value.dtype, np.number):
            continue  # names of points
        with np.errstate(over="ignore", invalid="ignore"):
            if np.isfinite(value.sum()):
                continue
        bad = ~np.isfinite(value.reshape(len(m), -1)).all(axis=1)
        if bad.any():
            k = int(np.argmax(bad))
            raise InputError(f"{m.source}: row {m.row[k]}: {name} is {value[k]}; only finite numbers are allowed")
    for name in ("sigma", "sigma_angle", "separation_sigma", "datasheet"):
        size = getattr(m, name)
        if size is not None and not 0 < size < np.inf:
            raise InputError(f"{m.source}: {name} is {size:.6g}; how large errors are must be positive and finite")
    if not (m.weight.min() >= 0 and m.weight.max() < np.inf):
        bad = ~(np.isfinite(m.weight) & (m.weight >= 0))
        k = int(np.argmax(bad))
        raise InputError(
            f"{m.source}: row {m.row[k]}, column 'weight': {m.weight[k]:.6g}; a weight must be zero or more and finite"
        )
    if not m.weight.any():
        raise InputError(
            f"{m.source}: no pose counts: column 'weight' is zero in every row, or a way has no pose before it"
        )
    present = set() if m.label is None else {str(name) for name in m.label}
    if m.separations and not find_kind(m.kind).places:
        first, second, _ = m.separations[0]
        raise InputError(
            f"{m.source}: separation {first!r} - {second!r}: kind {m.kind!r} has no points whose "
            "distance could be known; allowed: touched points, centres of balls, far ends of "
            "distances"
        )
    for first, second, length in m.separations:
        unknown = sorted({first, second} - present)
        if unknown:
            raise InputError(
                f"{m.source}: separation {first!r} - {second!r}: no pose touches {unknown[0]!r}; "
                f"there are {', '.join(sorted(present)) or 'no touched points (kind contact only)'}"
            )
        if first == second or not 0 < length < np.inf:
            raise InputError(
                f"{m.source}: separation {first!r} - {second!r}: {1e3 * length:.6g} mm; "
                "it must be a positive distance between two different points"
            )
