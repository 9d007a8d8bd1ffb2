"""A robot file out of a table of DH rows: one row a joint, units in the column names; see `dh_headings` for others.

| column | meaning |
|---|---|
| `a_mm`, `alpha_deg`, `d_mm`, `theta_deg` (or `_m`, `_rad`) | the row |
| `lower_deg`, `upper_deg` (`_mm` of a prismatic joint) | range of the reading |
| `type` | revolute (default) or prismatic |
| `mass_kg`, `com_x_mm`, `com_y_mm`, `com_z_mm` | body of the link that the joint moves |
| `compliant` | yes: the joint's compliance is identified too |
| `stiffness_Nm_per_rad` | its nominal value |
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from casadical.core.errors import InputError
from casadical.measurements.raw_table import read_table
from casadical.project.new.dh_headings import with_our_names
from casadical.project.new.texts import ROBOT_HEAD

_ROW = [f"{stem}{unit}" for stem, units in (("a", ("_mm", "_m")), ("alpha", ("_deg", "_rad")), ("d", ("_mm", "_m")),
        ("theta", ("_deg", "_rad"))) for unit in units]  # fmt: skip
_ENDS = [f"{side}{unit}" for unit in ("_deg", "_rad", "_mm", "_m") for side in ("lower", "upper")]
_BODY = ["mass_kg", "com_x_mm", "com_y_mm", "com_z_mm"]
_YES, _NO = ("yes", "true", "1"), ("no", "false", "0")
_KNOWN = ["joint", *_ROW, *_ENDS, "type", *_BODY, "compliant", "stiffness_Nm_per_rad"]


def robot_text(path: Path, name: str, convention: str) -> str:
    """The commented text of a robot file. Raises InputError that names file, row and column."""
    if convention not in ("modified", "standard"):
        raise InputError(f"--convention {convention}: not known; allowed: modified, standard")
    table = read_table(path)
    frame, said = with_our_names(table, _KNOWN)
    if not set(frame) & set(_ROW):
        raise InputError(f"{path.name}: no DH number found; columns are a_mm, alpha_deg, d_mm, theta_deg")
    rows = [
        _row({str(key): value for key, value in row.items()}, f"{path.name}: row {line}")
        for line, row in zip(table.line, frame.to_dict("records"), strict=True)
    ]
    head = ROBOT_HEAD.format(name=name.replace('"', "'"), convention=convention, table=path.name.replace('"', "'"))
    understood = "".join(f"# {words}\n" for words in said)
    return head + understood + "\n" + "\n".join(rows)


def _row(row: Mapping[str, Any], where: str) -> str:
    """One [[joint]] table."""
    numbers = {key: _number(row, key, where) for key in (*_ROW, *_ENDS, *_BODY, "stiffness_Nm_per_rad") if key in row}
    given = {key: value for key, value in numbers.items() if value is not None}
    lines = ["[[joint]]"]
    kind = _word(row, "type")
    if kind:
        lines.append(f'type = "{kind}"')
    lines += [f"{key} = {given[key]!r}" for key in _ROW if key in given]
    for unit in ("_deg", "_rad", "_mm", "_m"):
        ends = [given.get(f"{side}{unit}") for side in ("lower", "upper")]
        if ends != [None, None]:
            if None in ends:
                raise InputError(f"{where}: lower{unit} and upper{unit} belong together; one is missing")
            lines.append(f"limits{unit} = {ends!r}")
    compliant = _word(row, "compliant")
    if compliant not in ("", *_YES, *_NO):
        raise InputError(f"{where}: compliant = {compliant!r}; allowed: {', '.join(_YES + _NO)}, or an empty cell")
    if compliant in _YES:
        lines.append("compliant = true")
    if "stiffness_Nm_per_rad" in given:
        lines.append(f"stiffness_Nm_per_rad = {given['stiffness_Nm_per_rad']!r}")
    if "mass_kg" in given:
        centre = [given.get(key) or 0.0 for key in _BODY[1:]]
        lines.append(f"body = {{ mass_kg = {given['mass_kg']!r}, com_mm = {centre!r} }}")
    return "\n".join(lines) + "\n"


def _number(row: Mapping[str, Any], key: str, where: str) -> float | None:
    """A cell as a number; None where it is empty."""
    try:
        value = float(row[key])
    except (TypeError, ValueError):
        raise InputError(f"{where}, column {key!r}: {row[key]!r} is not a number") from None
    if math.isinf(value):
        raise InputError(f"{where}, column {key!r}: {row[key]!r} is not a finite number")
    return None if math.isnan(value) else value


def _word(row: Mapping[str, Any], key: str) -> str:
    value = row.get(key, "")
    return "" if isinstance(value, float) and math.isnan(value) else str(value).strip().lower().removesuffix(".0")
