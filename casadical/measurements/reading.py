"""Measurements from CSV files and pandas tables."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from casadical.core.arm import GRAVITY
from casadical.core.arrays import Array
from casadical.core.errors import InputError
from casadical.measurements.column_map import Source
from casadical.measurements.columns import Columns
from casadical.measurements.headings import understand
from casadical.measurements.kinds.registry import find_kind, kind_of, kinds
from casadical.measurements.measurements import FIELDS, Measurements
from casadical.measurements.raw_table import RawTable
from casadical.measurements.table_parts import read_columns

_POSITIONS = {f"{c}{u}" for c in "xyz" for u in ("_mm", "_m")}


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
    """Measurements from a table in a file (see `casadical.measurements.raw_table`).

    Parameters
    ----------
    path : str | Path
        table, as text in any usual form or .xlsx
    joints : int | Sequence[str]
        number of joints, or the kind of each ("revolute", "prismatic")
    kind : str, optional
        what was observed; by default what the columns say
    columns : Mapping[str, str | Source], optional
        our name -> name in the file, where the file's headers differ from ours and do not tell it themselves
    point_from : Sequence[str], default ()
        columns that together name the touched point, of kind contact
    sigma_mm : float, optional
        one sigma of a measured coordinate [mm]; None: estimated from the fit
    sigma_deg : float, optional
        one sigma of a measured angle [deg]; None: estimated from the fit

    Returns
    -------
    Measurements
        poses with their readings, observations and logged columns

    Raises
    ------
    InputError
        a table that cannot be used; it names the file, row and column where something is wrong

    Examples
    --------
    >>> poses = casadical.read_measurements("data/planar/planar.csv", 2)
    >>> poses.kind, poses.position.shape
    ('position', (40, 3))
    """
    table = named_columns(read_columns(path), joints, columns or {}, point_from)
    return from_columns(table, joints, kind, sigma_mm=sigma_mm, sigma_deg=sigma_deg)


def named_columns(
    raw: RawTable, joints: int | Sequence[str], columns: Mapping[str, str | Source], point_from: Sequence[str] = ()
) -> Columns:
    """The columns of a file under our names: as `columns` says, and what it leaves open as the headings say.

    Raises InputError where the headings leave a question.
    """
    kinds = ["revolute"] * joints if isinstance(joints, int) else list(joints)
    found = understand(raw, kinds, columns)
    for question in found.questions:
        first = next(iter(question.choices.values()))
        line = ", ".join(f'{ours} = "{source.name}"' for ours, source in first.items())
        raise InputError(
            f"{raw.path}: {question.text} Allowed: {'; '.join(question.choices)}. "
            f"Say it in problem.toml, for example columns = {{ {line} }}"
        )
    return Columns.of_file(raw).mapped({**found.sources, **columns}, point_from)


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
    """Measurements from a pandas table; arguments and errors as of `read_measurements`.

    Parameters
    ----------
    table : DataFrame
        with the columns of docs/measurements.md
    joints : int | Sequence[str]
        as of `read_measurements`
    kind : str, optional
        as of `read_measurements`
    columns : Mapping[str, str], optional
        as of `read_measurements`
    sigma_mm, sigma_deg : float, optional
        as of `read_measurements`
    source : str, default "table"
        what messages call the table

    Returns
    -------
    Measurements
        poses with their readings, observations and logged columns

    Raises
    ------
    InputError
        the table names no usable poses; row and column are named

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
    """Measurements from columns under our names; arguments and errors (Raises InputError) as of `read_measurements`."""
    source, each = columns.source, ["revolute"] * joints if isinstance(joints, int) else list(joints)
    if not each or set(each) - {"revolute", "prismatic"}:
        raise InputError(f"{source}: joints {joints!r}; allowed: their number, or 'revolute' or 'prismatic' for each")
    observed = find_kind(kind, source) if kind else kind_of(columns)
    q = columns.joints(each)
    arrays = observed.read(columns, q)
    counted = arrays.pop("counted", np.ones(len(q)))
    patterns = [k.pattern for k in kinds().values()]
    conditions = with_gravity(columns.conditions(patterns), columns) | columns.tools() | columns.sessions()
    found = Measurements(
        q=q,
        kind=observed.name,
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
    return _without_copies(found)


def with_gravity(conditions: dict[str, Array], columns: Columns) -> dict[str, Array]:
    """Logged columns, and the direction of gravity in the base frame where two tilts were logged.

    A base that is level, turned by tilt_x about its x axis, then by tilt_y about the new y axis. Raises InputError for
    an accelerometer that reads nothing.
    """
    tilts = [f"tilt_{c}_{unit}" for unit in ("deg", "rad") for c in "xy"]
    given = [name for name in tilts if name in conditions]
    if len(given) == 2 and not {*GRAVITY} & conditions.keys():
        x, y = (conditions[n] * (np.pi / 180 if n.endswith("deg") else 1.0) for n in sorted(given))
        down = (np.cos(x) * np.sin(y), -np.sin(x), -np.cos(x) * np.cos(y))
        return conditions | dict(zip(GRAVITY, down, strict=True))
    if {*GRAVITY} <= conditions.keys():
        still = np.linalg.norm([conditions[name] for name in GRAVITY], axis=0) == 0
        if still.any():
            raise InputError(f"{columns.at(int(np.argmax(still)))}: {', '.join(GRAVITY)} are all zero; gravity is not")
    return conditions


def readings_alone(columns: Columns, joints: int | Sequence[str]) -> Measurements:
    """Poses that are planned but not measured: readings and conditions, every position zero. Raises InputError."""
    table = columns.table.drop(columns=[name for name in columns.table if name in _POSITIONS])
    return from_columns(replace(columns, table=table.assign(x_m=0.0, y_m=0.0, z_m=0.0)), joints, "position")


def _without_copies(found: Measurements) -> Measurements:
    """A row copied whole is no second measurement: it is counted once."""
    seen = [found.q]
    for name, values in found.arrays.items():
        numbers = np.unique(values.astype(str), return_inverse=True)[1] if name == "label" else values
        seen.append(numbers.reshape(len(found), -1).astype(float))
    _, first = np.unique(np.concatenate(seen, axis=1), axis=0, return_index=True)
    copied = np.ones(len(found), dtype=bool)
    copied[first] = False
    return replace(found[~copied], copies=tuple(found.row[copied].tolist())) if copied.any() else found
