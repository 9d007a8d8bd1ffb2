"""The one serialiser: results as plain data for JSON, by their fields, units and derived values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

# Factor from the SI unit to each output unit.
PER_SI_UNIT = {"mm": 1e3, "mm2": 1e6, "um": 1e6, "mrad": 1e3, "urad": 1e6, "deg": 180 / math.pi}


@dataclass(frozen=True)
class Key:
    """How one value of a result is written to JSON.

    name : JSON key, without the unit that is appended to it; "" for the name of the field
    of : attribute, dotted path of attributes, or function of the result that gives the value; ""
        for the attribute of the same name
    unit : unit into which an SI value is converted, a key of `PER_SI_UNIT`; "": none
    digits : number of digits after the decimal point; None: not rounded
    omit_none : whether the key is omitted where the value is None
    """

    name: str = ""
    of: str | Callable[[Any], Any] = ""
    unit: str = ""
    digits: int | None = None
    omit_none: bool = False


def written(name: str = "", unit: str = "", digits: int | None = None) -> dict[str, Key]:
    """Return the metadata of a dataclass field that is written to JSON; arguments as of `Key`."""
    return {"key": Key(name, "", unit, digits)}


# Metadata of a dataclass field that is written to JSON unchanged.
WRITTEN = written()
# Metadata of a dataclass field, a length [m], that is written to JSON in mm.
IN_MM = written(unit="mm")


def plain(value: Any) -> Any:
    """Return a result as dicts, lists, texts and numbers; numbers that are not finite become None.

    A dataclass is written by its marked fields (`written`) and by the keys that its class lists as
    `derived`; one without either is written with all its fields. Arrays become nested lists, a
    table a list of its rows as dicts by column, an enum member its value.

    Raises TypeError for other types.
    """
    if isinstance(value, Enum):
        return plain(value.value)
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):  # an array or a number of numpy, which the help of commands does not load
        return plain(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if is_dataclass(value):
        return _by_keys(value)
    if hasattr(value, "model_dump"):  # a table of a file, by pydantic
        return plain(value.model_dump())
    if hasattr(value, "to_dict"):  # a table of pandas
        return [plain(row) for row in value.to_dict("records")]
    if isinstance(value, Iterable):
        return [plain(each) for each in value]
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def _by_keys(result: Any) -> dict[str, Any]:
    """Return a dataclass as a dict, plain data by key.

    It has the fields whose metadata has a `Key` and the keys that `derived` adds; all fields if
    there are none of either.
    """
    marked = [(f.name, f.metadata.get("key")) for f in fields(result)]
    derived = tuple(getattr(result, "derived", ()))
    keys = [(name, key) for name, key in marked if key] + [(key.name, key) for key in derived]
    data = {}
    for name, key in keys or [(name, Key()) for name, _ in marked]:
        of, found = key.of or name, result
        if callable(of):
            found = of(result)
        else:  # an attribute of None is None
            for attribute in of.split("."):
                found = None if found is None else getattr(found, attribute)
        found = plain(found)
        if found is not None or not key.omit_none:
            title = f"{key.name or name}_{key.unit}" if key.unit else key.name or name
            data[title] = _in_unit(found, PER_SI_UNIT.get(key.unit, 1), key.digits)
    return data


def _in_unit(value: Any, factor: float, digits: int | None) -> Any:
    """Return plain data with every number multiplied by a factor and rounded.

    digits : number of digits after the decimal point; None: not rounded
    """
    if isinstance(value, dict):
        return {key: _in_unit(each, factor, digits) for key, each in value.items()}
    if isinstance(value, list):
        return [_in_unit(each, factor, digits) for each in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    value = value if factor == 1 else factor * value
    return value if digits is None else round(value, digits)
