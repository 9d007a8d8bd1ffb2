"""Readers of measured poses: `Measurements` from table files and pandas tables."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.parts import GRAVITY_COLUMNS
from casadical.measurements.arrangement import long
from casadical.measurements.columns import FULL_TURN_RAD, MAX_TURNS, Columns, Source, columns_used
from casadical.measurements.kinds.registry import find_kind, kind_of, kinds
from casadical.measurements.measurements import FIELDS, Measurements
from casadical.measurements.proposals import Understanding, understand
from casadical.measurements.raw_table import RawTable, read_table


def read_measurements(
    path: str | Path,
    joints: int | Sequence[str],
    kind: str | None = None,
    *,
    columns: Mapping[str, str | Source] | None = None,
    point_from: Sequence[str] = (),
    sigma_mm: float | None = None,
    sigma_deg: float | None = None,
) -> Measurements:
    """Return the measurements in a table file (see `casadical.measurements.raw_table`).

    path : table, as text in any usual form, .xlsx (needs openpyxl) or .parquet (needs pyarrow)
    joints : number of joints, or the kind of each ("revolute", "prismatic")
    kind : what was observed; by default the kind that the columns show
    columns : our name -> name in the file, for headings whose meaning is not recognised
    point_from : columns that together name the touched point, of kind contact
    sigma_mm, sigma_deg : standard deviation of a measured coordinate [mm] and angle [deg]; None:
        estimated from the fit
    Raises InputError: a table that cannot be used; it names the file, row and column where
    something is wrong.

    Examples
    --------
    >>> poses = casadical.read_measurements("data/planar/planar.csv", 2)
    >>> poses.kind, poses.position.shape
    ('position', (40, 3))
    """
    sources = {ours: Source(given) if isinstance(given, str) else given for ours, given in (columns or {}).items()}
    raw = long(read_table(path, keep_text=False), [name for name, _ in columns_used(sources)])
    meaning = understand(raw, _kinds(joints, raw.path.name), sources, kind=kind).in_usual_order
    refuse_open(raw, meaning)
    named = Columns.of_file(raw).mapped({**meaning.sources, **sources}, point_from)
    return from_columns(named, joints, kind, sigma_mm=sigma_mm, sigma_deg=sigma_deg)


def refuse_open(raw: RawTable, meaning: Understanding) -> None:
    """Check that the meaning of a table's headings leaves no question.

    Raises InputError with the first question, and what to write in problem.toml.
    """
    for question in meaning.questions:
        first = next(iter(question.choices.values()))
        line = ", ".join(f'{c.ours} = "{c.source.name}"' for c in first)
        raise InputError(
            f"{raw.path}: {question.text} Allowed: {'; '.join(question.choices)}. "
            f"Say it in problem.toml, for example columns = {{ {line} }}"
        )


def from_table(
    table: pd.DataFrame,
    joints: int | Sequence[str],
    kind: str | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    sigma_mm: float | None = None,
    sigma_deg: float | None = None,
    source: str = "table",
) -> Measurements:
    """Return the measurements in a pandas table; arguments and errors as of `read_measurements`.

    table : with the columns of docs/measurements.md, or others that `columns` names: other headings
        are not interpreted; source : what messages call it

    Examples
    --------
    >>> casadical.from_table(table, 2, "position", sigma_mm=0.02)
    <Measurements table: 60 poses of 2 joints, position>
    """
    given = Columns.of_frame(table, source).mapped(columns or {})
    return from_columns(given, joints, kind, sigma_mm=sigma_mm, sigma_deg=sigma_deg)


def from_columns(
    columns: Columns,
    joints: int | Sequence[str],
    kind: str | None = None,
    *,
    sigma_mm: float | None = None,
    sigma_deg: float | None = None,
) -> Measurements:
    """Return the measurements in columns under casadical's names, without exact copies of rows.

    Other arguments are as of `read_measurements`.
    Raises InputError: columns that cannot be used, or no row.
    """
    source, each = columns.source, _kinds(joints, columns.source)
    observed = find_kind(kind, source) if kind else kind_of(columns)
    patterns = [k.pattern for k in kinds().values()]
    columns.refuse_faults(each, "|".join(patterns))
    q = columns.joints(each)
    if not len(q):
        raise InputError(f"{source}: no row is left; at least one pose is needed")
    _refuse_other_unit(q, each, columns, columns.row)
    arrays = observed.read(columns, q)
    counted = arrays.pop("counted", np.ones(len(q)))
    conditions = with_gravity(columns.conditions(patterns), columns) | columns.tools() | columns.sessions()
    m = Measurements(
        q=q,
        kind=observed.gives or observed.name,
        conditions=conditions,
        unused=columns.unused(conditions, patterns),
        sigma=None if sigma_mm is None else sigma_mm * 1e-3,
        sigma_angle=None if sigma_deg is None else float(np.deg2rad(sigma_deg)),
        weight=counted * columns.column("weight") if "weight" in columns.table else counted,
        row=columns.row,
        source=source,
        extra={name: values for name, values in arrays.items() if name not in FIELDS},
        **{name: values for name, values in arrays.items() if name in FIELDS},  # type: ignore[arg-type]
    )
    # The measurements without rows that repeat an earlier one to the last digit.
    hashes = _hashes(_numbers(m))
    alike = np.flatnonzero(pd.Series(hashes).duplicated(keep=False))
    if not len(alike):
        return m
    some = np.concatenate([values[alike].astype(float) for values in _numbers(m)], axis=1)
    copied = np.setdiff1d(alike, alike[np.unique(some, axis=0, return_index=True)[1]])
    if not len(copied):
        return m
    return replace(m[np.setdiff1d(np.arange(len(m)), copied)], copies=tuple(m.row[copied].tolist()))


def _kinds(joints: int | Sequence[str], source: str) -> list[str]:
    """Return the kind of each joint, revolute or prismatic. Raises InputError."""
    kinds = ["revolute"] * joints if isinstance(joints, int) else list(joints)
    if not kinds or set(kinds) - {"revolute", "prismatic"}:
        raise InputError(f"{source}: joints {joints!r}; allowed: their number, or 'revolute' or 'prismatic' for each")
    return kinds


def _refuse_other_unit(q: Array, kinds: Sequence[str], columns: Columns, row: Array) -> None:
    """Check that revolute readings are in the unit of their columns' names. Raises InputError.

    q : readings, shape (n, joints) [rad or m]; kinds : of the joints; row : line of each pose
    """
    source, names = columns.source, columns.table
    turning = [i for i, kind in enumerate(kinds) if kind == "revolute"]
    if not turning:
        return
    ends = np.array([[column.min(), column.max()] for column in (q[:, i] for i in turning)])
    if np.abs(ends).max() > MAX_TURNS * 2 * np.pi:
        k, i = divmod(int(np.argmax(np.abs(q[:, turning]))), len(turning))
        name, largest = f"q{turning[i] + 1}", q[k, turning[i]]
        unit, said = ("rad", largest) if f"{name}_rad" in names else ("deg", np.rad2deg(largest))
        remedy = f"at most {MAX_TURNS} are allowed: correct the reading"
        if unit == "rad":
            remedy = f"are the columns in degrees? name them {name}_deg"
        turns = abs(largest) / (2 * np.pi)
        raise InputError(
            f"{source}: row {row[k]}, column '{name}_{unit}': {said:.6g} {unit} is {turns:.1f} turns; {remedy}"
        )
    widest = float(np.rad2deg(np.ptp(ends, axis=1).max()))
    if all(f"q{i + 1}_deg" in names for i in turning) and len(q) >= 10 and widest < FULL_TURN_RAD:
        remedy = "are the columns in radians? name them q1_rad, ..." if widest else "measure poses that differ"
        raise InputError(f"{source}: no joint moves by more than {widest:.2f} deg over {len(q)} poses; {remedy}")


def with_gravity(conditions: dict[str, Array], columns: Columns) -> dict[str, Array]:
    """Return logged columns, completed by the direction of gravity if two tilts were logged.

    The direction, in the base frame, is added under GRAVITY_COLUMNS: the base, level at first, is
    rotated by tilt_x about its x axis, then by tilt_y about the new y axis.
    Raises InputError: an accelerometer whose three values are zero.
    """
    tilts = [f"tilt_{c}_{unit}" for unit in ("deg", "rad") for c in "xy"]
    given = [name for name in tilts if name in conditions]
    if len(given) == 2 and not {*GRAVITY_COLUMNS} & conditions.keys():
        x, y = (conditions[n] * (np.pi / 180 if n.endswith("deg") else 1.0) for n in sorted(given))
        down = (np.cos(x) * np.sin(y), -np.sin(x), -np.cos(x) * np.cos(y))
        return conditions | dict(zip(GRAVITY_COLUMNS, down, strict=True))
    if {*GRAVITY_COLUMNS} <= conditions.keys():
        still = np.linalg.norm([conditions[name] for name in GRAVITY_COLUMNS], axis=0) == 0
        if still.any():
            raise InputError(
                f"{columns.at(int(np.argmax(still)))}: {', '.join(GRAVITY_COLUMNS)} are all zero; gravity is not"
            )
    return conditions


def readings_alone(columns: Columns, joints: int | Sequence[str]) -> Measurements:
    """Return planned poses, not measured yet, as kind position with every position zero.

    Joint variables and conditions are those of the columns. Raises InputError as `from_columns`.
    """
    positions = [f"{c}{unit}" for c in "xyz" for unit in ("_mm", "_m")]
    table = columns.table.drop(columns=positions, errors="ignore")
    return from_columns(replace(columns, table=table.assign(x_m=0.0, y_m=0.0, z_m=0.0)), joints, "position")


def _numbers(m: Measurements) -> list[Array]:
    """Return joint variables and observed arrays as numbers, (n, k) each; names as hashes."""
    names = {
        name: pd.util.hash_array(v.astype(str).astype(object)) >> 11
        for name, v in m.arrays.items()
        if v.dtype.kind not in "fiub"
    }
    return [m.q, *(names.get(name, values).reshape(len(m), -1) for name, values in m.arrays.items())]


def refuse_shared_rows(sets: Sequence[Measurements]) -> None:
    """Check that no tables of a kind share half of the smaller one's rows. Raises InputError."""
    rows = [np.unique(_hashes(_numbers(m))) for m in sets] if len(sets) > 1 else []
    if not rows or len(np.unique(np.concatenate(rows))) == sum(map(len, rows)):
        return
    seen: list[tuple[tuple[object, ...], Array, Measurements]] = []
    for m, hashes in zip(sets, rows, strict=True):
        alike = (m.kind, *m.arrays, m.q.shape[1])
        for shape, others, other in seen:
            shared = np.isin(hashes, others).sum() if shape == alike else 0
            # If half of the rows of the smaller table are shared, it is a copy; fewer may be
            # chance.
            if shared >= 0.5 * min(len(hashes), len(others)):
                raise InputError(
                    f"{m.source}: {shared} of its {len(hashes)} poses are in {other.source}, too; "
                    "a pose counts once: take one of the two tables out"
                )
        seen.append((alike, hashes, m))


def _hashes(numbers: Sequence[Array]) -> Array:
    """Return a hash (uint64) of each row over all arrays, shape (n,), equal for equal rows.

    numbers : arrays of shape (n, k)
    """
    hashes = np.zeros(len(numbers[0]), dtype=np.uint64)
    for column in (column for values in numbers for column in values.T):
        hashes = hashes * np.uint64(1_000_003) ^ pd.util.hash_array(column + 0.0)  # -0.0 is 0.0
    return hashes
