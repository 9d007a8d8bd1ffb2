"""The headings of a DH table in five languages, with their units, as the names that casadical has for them."""

from collections.abc import Collection

import numpy as np
import pandas as pd

from casadical.core.errors import InputError
from casadical.measurements.headings import words_of
from casadical.measurements.raw_table import RawTable
from casadical.measurements.vocabulary import UNITS, WORDS

# In the order in which they are recognised: a "mass centre" is no mass, a "twist angle" no angle of the joint.
_STEMS = ("com", "stiffness", "compliant", "lower", "upper", "mass", "type", "alpha", "d", "theta", "a")
_LENGTHS, _ANGLES = ("a", "d"), ("alpha", "theta", "lower", "upper")
# Without units: lengths of a robot in metres and angles in radians are below these.
METRES, RADIANS = 10.0, 2 * np.pi + 0.01


def with_our_names(table: RawTable, known: Collection[str]) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """The table with our names, lengths and angles in the units that these say; what was understood, in words.

    known : our names. Raises InputError for a heading that means nothing here, or the same as another.
    """
    frame = table.frame()
    stems = {name: _stem(name) for name in table.header if name not in known}
    unknown = [name for name, stem in stems.items() if not stem]
    if unknown:
        raise InputError(f"{table.path.name}: column {unknown[0]!r} is not known; allowed: {', '.join(known)}")
    below = dict(zip(table.header, table.form.units, strict=False))
    units = {name: words_of(name)[1] or below.get(name, "") for name in stems}
    made: dict[str, pd.Series] = {name: frame[name] for name in table.header if name in known}
    said = []
    for name, stem in stems.items():
        unit = units[name] or _usual(frame, stems, units, stem)
        base, factor = UNITS.get(unit, ("", 1.0))
        ours = {"stiffness": "stiffness_Nm_per_rad", "mass": "mass_kg"}.get(stem, stem)
        if stem in _LENGTHS + _ANGLES or stem.startswith("com"):
            ours = f"{stem}_{base or 'mm'}"
        if ours not in known:
            raise InputError(f"{table.path.name}: column {name!r}: unit {unit!r} does not fit {stem}")
        if ours in made:
            raise InputError(f"{table.path.name}: column {name!r} is a second column of {ours}; remove one")
        numbers = pd.to_numeric(frame[name], errors="coerce")
        made[ours] = (factor * numbers).where(numbers.notna(), frame[name]) if factor != 1.0 else frame[name]
        said.append(f"{ours} from {name!r}{'' if units[name] or not base else ', unit by the size of the numbers'}")
    return pd.DataFrame(made), tuple(said)


def _stem(heading: str) -> str:
    """Our name without a unit; empty for a heading that means nothing here."""
    words = set(words_of(heading)[0])
    for stem in _STEMS:
        if words & WORDS[f"dh_{stem}"]:
            if stem != "com":
                return stem
            axis = words & {"x", "y", "z"}
            return f"com_{axis.pop()}" if len(axis) == 1 else ""
    return "joint" if words & (WORDS["joint"] | WORDS["dh_joint"]) else ""


def _usual(frame: pd.DataFrame, stems: dict[str, str], units: dict[str, str], stem: str) -> str:
    """The unit of a column that states none: that of its like, else as the size of all numbers of its kind says."""
    for like, ours, least in ((_LENGTHS, ("mm", "m"), METRES), (_ANGLES, ("deg", "rad"), RADIANS)):
        if stem in like:
            names = [name for name, other in stems.items() if other in like]
            if stated := [units[name] for name in names if units[name]]:
                return stated[0]
            numbers = frame[names].apply(pd.to_numeric, errors="coerce").abs().to_numpy(dtype=float)
            sizes = numbers[numbers > 0]
            # One length in another unit must not decide for all; of angles the greatest does.
            size = 0.0 if not len(sizes) else np.median(sizes) if ours[0] == "mm" else np.nanmax(sizes)
            return ours[0] if size > least else ours[1]
    return ""
