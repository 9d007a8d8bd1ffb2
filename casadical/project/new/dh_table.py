"""Robot files from tables of DH rows: one row for each joint, units in the column names.

Other headings are recognised by `with_our_names`.

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
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from casadical.core.basics import FaultsError, InputError, optional
from casadical.core.reading import foreign, read_text
from casadical.core.transforms import frame, from_rpy, to_rpy
from casadical.measurements.headings import words_of
from casadical.measurements.raw_table import RawTable, read_table
from casadical.measurements.vocabulary import UNITS, WORDS
from casadical.project.faults import each_of
from casadical.project.new.texts import ROBOT_HEAD
from casadical.robot.axes import rows_from_axes

# Columns of a table of DH rows that have the DH parameters.
_ROW_COLUMNS = ["a_mm", "a_m", "alpha_deg", "alpha_rad", "d_mm", "d_m", "theta_deg", "theta_rad"]
# Columns of a table of DH rows that have the joint limits.
_LIMIT_COLUMNS = [f"{side}{unit}" for unit in ("_deg", "_rad", "_mm", "_m") for side in ("lower", "upper")]
# Columns of a table of DH rows that have mass and mass centre of the link.
_BODY_COLUMNS = ["mass_kg", "com_x_mm", "com_y_mm", "com_z_mm"]


def robot_text(path: Path, name: str, convention: str) -> str:
    """Return the commented text of a robot file for a table of DH rows.

    path : table, or YAML of a UR arm's kinematics (see `_ur_text`)
    convention : modified or standard
    Raises InputError that names file, row and column.
    """
    if convention not in ("modified", "standard"):
        raise InputError(f"--convention {convention}: unknown; allowed: modified, standard")
    if path.suffix.lower() in (".yaml", ".yml"):
        return _ur_text(path, name)
    table = read_table(path)

    all_columns = ["joint", *_ROW_COLUMNS, *_LIMIT_COLUMNS, "type", *_BODY_COLUMNS, "compliant", "stiffness_Nm_per_rad"]

    def read() -> str:
        """Return the comments and all [[joint]] tables as text. Raises InputError."""
        frame, said = with_our_names(table, all_columns)
        if not set(frame) & set(_ROW_COLUMNS):
            raise InputError(f"{path.name}: no DH number found; columns are a_mm, alpha_deg, d_mm, theta_deg")
        records = [{str(key): value for key, value in row.items()} for row in frame.to_dict("records")]
        where = [f"{path.name}: row {line}" for line in table.line]
        rows = each_of(partial(_joint_text, *row) for row in zip(records, where, strict=True))
        return "".join(f"# {words}\n" for words in said) + "\n" + "\n".join(rows)

    steps: list[Callable[[], Any]] = [partial(_refuse_non_finite, table), read]
    _, joints = each_of(steps)
    head = ROBOT_HEAD.format(name=name.replace('"', "'"), convention=convention, table=path.name.replace('"', "'"))
    return f"{head}{joints}"


def _ur_text(path: Path, name: str) -> str:
    """Return the text of a robot file for the kinematics YAML of a UR arm, as its ROS driver extracts it.

    Its links are frames at zero readings, each in the one before; the axes that they have are
    written as modified DH rows. The hash becomes a comment.
    """
    yaml = optional("yaml", f"{path.name}: reading YAML needs PyYAML: pip install pyyaml, or write a DH table as CSV")
    with foreign(f"{path.name}: not a readable YAML file", "extract it again with ur_calibration"):
        document = yaml.safe_load(read_text(path))
    links = document.get("kinematics") if isinstance(document, dict) else None
    T, frames = np.eye(4), []
    for link in ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"):
        part = links.get(link) if isinstance(links, dict) else None
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        numbers = [part.get(key) for key in keys] if isinstance(part, dict) else []
        if not numbers or not all(isinstance(v, int | float) and math.isfinite(v) for v in numbers):
            raise InputError(
                f"{path.name}: kinematics: {link}: {part!r}; allowed: numbers {', '.join(keys)} [m, rad], as "
                "ur_calibration writes them; of another arm give --urdf, or its DH rows as CSV"
            )
        T = T @ frame(from_rpy(np.array(numbers[3:])), np.array(numbers[:3]))
        frames.append(T)
    points, directions = [T[:3, 3] for T in frames], [T[:3, 2] for T in frames]
    frame_0, chain, _, _ = rows_from_axes(points, directions, frames[-1])
    units = {"a": "m", "alpha": "rad", "d": "m", "theta": "rad", "beta": "rad"}
    rows = [
        "\n".join(
            f"{key}_{unit} = {getattr(row, key)!r}" for key, unit in units.items() if getattr(row, key) is not None
        )
        for row in chain
    ]
    head = ROBOT_HEAD.format(name=name.replace('"', "'"), convention="modified", table=path.name.replace('"', "'"))
    said = f"# Hash of the controller's calibration: {links['hash']}\n" if links and "hash" in links else ""
    base = f"xyz_m = {frame_0[:3, 3].tolist()}\nrpy_rad = {to_rpy(frame_0[:3, :3]).tolist()}\n"
    text = head.replace("[base] ", f"{said}[base] ", 1).replace('unknown = "pose" ', f'{base}unknown = "pose" ', 1)
    return text + "\n" + "\n\n".join(f"[[joint]]\n{row}" for row in rows) + "\n"


def _refuse_non_finite(table: RawTable) -> None:
    """Refuse cells with nan, NA or inf; an empty cell is allowed. Raises InputError."""
    faults = []
    lost = table.frame.replace([math.inf, -math.inf], math.nan).isna().to_numpy()
    for k, (line, cells) in enumerate(zip(table.line, table.cells, strict=True)):
        for column, (name, cell) in enumerate(zip(table.header, cells, strict=False)):
            if cell.strip() and lost[k, column]:
                faults.append(f"{table.path.name}: row {line}, column {name!r}: {cell!r} is not a finite number")
    if faults:
        raise FaultsError((), faults)


def _joint_text(row: Mapping[str, Any], where: str) -> str:
    """Return the [[joint]] table of one row of the DH table as TOML text."""
    keys = [key for key in (*_ROW_COLUMNS, *_LIMIT_COLUMNS, *_BODY_COLUMNS, "stiffness_Nm_per_rad") if key in row]
    numbers = zip(keys, each_of(partial(_number, row, key, where) for key in keys), strict=True)
    given = {key: value for key, value in numbers if value is not None}
    lines = ["[[joint]]"]
    kind = _word(row, "type")
    if kind:
        lines.append(f'type = "{kind}"')
    lines += [f"{key} = {given[key]!r}" for key in _ROW_COLUMNS if key in given]
    for unit in ("_deg", "_rad", "_mm", "_m"):
        ends = [given.get(f"{side}{unit}") for side in ("lower", "upper")]
        if ends != [None, None]:
            if None in ends:
                raise InputError(f"{where}: lower{unit} and upper{unit} belong together; one is missing")
            lines.append(f"limits{unit} = {ends!r}")
    compliant = _word(row, "compliant")
    # Words of the column `compliant`.
    yes_words = ("yes", "true", "1")
    no_words = ("no", "false", "0")
    if compliant not in ("", *yes_words, *no_words):
        raise InputError(
            f"{where}: compliant = {compliant!r}; allowed: {', '.join(yes_words + no_words)}, or an empty cell"
        )
    if compliant in yes_words:
        lines.append("compliant = true")
    if "stiffness_Nm_per_rad" in given:
        lines.append(f"stiffness_Nm_per_rad = {given['stiffness_Nm_per_rad']!r}")
    if "mass_kg" in given:
        centre = [given.get(key) or 0.0 for key in _BODY_COLUMNS[1:]]
        lines.append(f"body = {{ mass_kg = {given['mass_kg']!r}, com_mm = {centre!r} }}")
    return "\n".join(lines) + "\n"


def _number(row: Mapping[str, Any], key: str, where: str) -> float | None:
    """Return the cell of column `key` as a number; None where it is empty."""
    try:
        value = float(row[key])
    except (TypeError, ValueError):
        raise InputError(f"{where}, column {key!r}: {row[key]!r} is not a number") from None
    return None if math.isnan(value) else value


def _word(row: Mapping[str, Any], key: str) -> str:
    """Return a cell as a lower-case word, "1.0" as "1"; empty where cell or column is missing."""
    value = row.get(key, "")
    return "" if isinstance(value, float) and math.isnan(value) else str(value).strip().lower().removesuffix(".0")


# Names, without unit, of DH columns that are lengths; where one states no unit, another's counts.
_LENGTH_STEMS = ("a", "d")
# Names, without unit, of DH columns that are angles; where one states no unit, another's counts.
_ANGLE_STEMS = ("alpha", "theta", "lower", "upper")


def with_our_names(table: RawTable, allowed: Collection[str]) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Return the table under casadical's names and units, and clauses on recognised columns.

    allowed : casadical's names of all allowed columns
    Raises InputError for a column that is not recognised, or two of one meaning.
    """
    frame = table.frame
    stems = {name: _stem(name) for name in table.header if name not in allowed}
    unknown = [name for name, stem in stems.items() if not stem]
    if unknown:
        several = "is" if len(unknown) == 1 else "are"
        names = ", ".join(map(repr, unknown))
        raise InputError(f"{table.path.name}: column {names} {several} unknown; allowed: {', '.join(allowed)}")
    below = dict(zip(table.header, table.form.units, strict=False))
    units = {name: words_of(name)[1] or below.get(name, "") for name in stems}
    made: dict[str, pd.Series] = {name: frame[name] for name in table.header if name in allowed}
    said = []
    for name, stem in stems.items():
        unit = units[name] or _assumed_unit(frame, stems, units, stem)
        base, factor = UNITS.get(unit, ("", 1.0))
        ours = {"stiffness": "stiffness_Nm_per_rad", "mass": "mass_kg"}.get(stem, stem)
        if stem in _LENGTH_STEMS + _ANGLE_STEMS or stem.startswith("com"):
            ours = f"{stem}_{base or 'mm'}"
        if ours not in allowed:
            raise InputError(f"{table.path.name}: column {name!r}: unit {unit!r} does not fit {stem}")
        if ours in made:
            raise InputError(f"{table.path.name}: column {name!r} is a second column of {ours}; remove one")
        numbers = pd.to_numeric(frame[name], errors="coerce")
        made[ours] = (factor * numbers).where(numbers.notna(), frame[name]) if factor != 1.0 else frame[name]
        said.append(f"{ours} from {name!r}{'' if units[name] or not base else ', unit by the size of the numbers'}")
    return pd.DataFrame(made), tuple(said)


def _stem(heading: str) -> str:
    """Return casadical's column name, without its unit, for a heading; empty if unknown."""
    words = set(words_of(heading)[0])
    # Stems in the order in which headings are compared with them: a "mass centre" is no mass, and a
    # "twist angle" is no joint angle.
    heading_stems = ("com", "stiffness", "compliant", "lower", "upper", "mass", "type", "alpha", "d", "theta", "a")
    for stem in heading_stems:
        if words & WORDS[f"dh_{stem}"]:
            if stem != "com":
                return stem
            axis = words & {"x", "y", "z"}
            return f"com_{axis.pop()}" if len(axis) == 1 else ""
    return "joint" if words & (WORDS["joint"] | WORDS["dh_joint"]) else ""


def _assumed_unit(frame: pd.DataFrame, stems: dict[str, str], units: dict[str, str], stem: str) -> str:
    """Return the unit (mm, m, deg, rad) of a column that states none; empty if it needs none.

    It is that of another column of the same quantity, else it follows from their size.
    """
    # Lengths without a unit are in millimetres if their median is above 10, else in metres;
    # angles are in degrees if one is above a full turn, else in radians.
    for like, ours, least in (
        (_LENGTH_STEMS, ("mm", "m"), 10.0),
        (_ANGLE_STEMS, ("deg", "rad"), 2 * np.pi + 0.01),
    ):
        if stem in like:
            names = [name for name, other in stems.items() if other in like]
            if stated := [units[name] for name in names if units[name]]:
                return stated[0]
            numbers = frame[names].apply(pd.to_numeric, errors="coerce").abs().to_numpy(dtype=float)
            sizes = numbers[numbers > 0]
            # Of lengths the median decides, as one may be in another unit; of angles the greatest.
            size = 0.0 if not len(sizes) else np.median(sizes) if ours[0] == "mm" else np.nanmax(sizes)
            return ours[0] if size > least else ours[1]
    return ""
