"""The one serialiser: any result as plain data for JSON, by its fields, their units and what is derived of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import reduce
from pathlib import Path
from typing import Any

# Units that results are written in, as multiples of SI units.
PER_SI_UNIT = {"mm": 1e3, "mm2": 1e6, "um": 1e6, "mrad": 1e3, "urad": 1e6, "deg": 180 / math.pi}


@dataclass(frozen=True)
class Key:
    """How one value of a result is written.

    name : of the key, without the unit that follows it; "" for that of the field
    of : attribute, dotted path of attributes, or a function of the result; "" for the attribute of the same name
    unit : in which an SI value is written, a key of `PER_SI_UNIT`; digits : after the decimal point
    if_known : whether the key is left out where the value is None
    """

    name: str = ""
    of: str | Callable[[Any], Any] = ""
    unit: str = ""
    digits: int | None = None
    if_known: bool = False


def written(name: str = "", unit: str = "", digits: int | None = None) -> dict[str, Key]:
    """Return the metadata of a dataclass field that is written; the arguments are those of `Key`."""
    return {"key": Key(name, "", unit, digits)}


WRITTEN, IN_MM = written(), written(unit="mm")


def plain(value: Any) -> Any:
    """Return a result as dicts, lists, texts and numbers; numbers that are not finite become None.

    A dataclass is written by its marked fields (`written`) and by the keys that its class lists as `derived`; one
    without either is written whole. Arrays and tables become lists, of rows by column; enums their values.
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
    """Return a dataclass by its keys."""
    marked = [(f.name, f.metadata.get("key")) for f in fields(result)]
    derived = tuple(getattr(result, "derived", ()))
    keys = [(name, key) for name, key in marked if key] + [(key.name, key) for key in derived]
    data = {}
    for name, key in keys or [(name, Key()) for name, _ in marked]:
        of = key.of or name
        found = plain(of(result) if callable(of) else reduce(_attribute, of.split("."), result))
        if found is not None or not key.if_known:
            title = f"{key.name or name}_{key.unit}" if key.unit else key.name or name
            data[title] = _in_unit(found, PER_SI_UNIT.get(key.unit, 1), key.digits)
    return data


def _attribute(owner: Any, name: str) -> Any:
    return None if owner is None else getattr(owner, name)


def _in_unit(value: Any, factor: float, digits: int | None) -> Any:
    """Return every number in plain data times a factor, rounded."""
    if isinstance(value, dict):
        return {key: _in_unit(each, factor, digits) for key, each in value.items()}
    if isinstance(value, list):
        return [_in_unit(each, factor, digits) for each in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    value = value if factor == 1 else factor * value
    return value if digits is None else round(value, digits)
