"""Validation of TOML tables with units in the keys.

Messages name file, key, value and what is allowed.
"""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, time
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from casadical.core.basics import MAX_FAULTS_SHOWN, InputError
from casadical.core.reading import unusable


class FaultError(ValueError):
    """A fault of the value at a place in a table: a key, or a path of keys and indices from 0."""

    def __init__(self, place: str | tuple[int | str, ...], text: str) -> None:
        super().__init__(text)
        self.place = (place,) if isinstance(place, str) else place


@dataclass(frozen=True, eq=False)
class Quantity:
    """A physical quantity.

    factors : factor to the SI unit, by the unit suffix of the key, such as "_mm"
    most : largest absolute value that is accepted [SI]
    """

    factors: Mapping[str, float]
    most: float


# Length: unit suffixes of its keys, and its largest value [m].
LENGTH = Quantity({"_mm": 1e-3, "_m": 1.0}, 1e4)
# Angle: unit suffixes of its keys, and its largest value [rad].
ANGLE = Quantity({"_deg": np.pi / 180, "_rad": 1.0, "_mrad": 1e-3}, 1e3)
# Reading of a revolute or prismatic joint: unit suffixes of its keys, and its largest value [rad or
# m].
READING = Quantity({**ANGLE.factors, **LENGTH.factors}, 1e4)


def _whole(value: Any) -> Any:
    """Return a value unchanged, but a boolean or a float as text, so that it is refused.

    A version must be an integer.
    """
    return str(value) if isinstance(value, bool | float) else value  # true and 1.0 are equal to 1, which is allowed


# Pydantic tags for values of two possible forms; error messages omit them.
VALUE_FORMS = ("a text", "a table", "a number", "a list")
# Validator of versions, which are whole numbers.
WHOLE_NUMBER = BeforeValidator(_whole)
# Type of a length with its unit in the key.
Length = Annotated[float, LENGTH]
# Type of an angle with its unit in the key.
Angle = Annotated[float, ANGLE]
# Type of a list of three numbers.
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
# Type of a list of two numbers.
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Schema = TypeVar("Schema", bound=BaseModel)


class TomlTable(BaseModel):
    """Base of schemas of TOML tables; a `Quantity` has its unit in the key, and SI in the field."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _units(cls, data: Any) -> Any:
        """Return the table with fields in SI in place of keys with units."""
        if not isinstance(data, dict):
            return data
        fields: dict[str, Any] = {}
        for key, value in data.items():
            name, factor = cls.field_of(key)
            if name in fields:
                raise FaultError(key, f"{name} is given twice, with different units; keep one")
            fields[name] = value if factor is None else _to_si(value, factor)
            quantity = _quantity(cls.model_fields[name].metadata) if factor is not None else None
            if factor is not None and quantity is not None and _size(fields[name]) > quantity.most:
                raise FaultError(key, f"allowed: at most {quantity.most / factor:.6g}")
        return fields

    @classmethod
    def field_of(cls, key: str) -> tuple[str, float | None]:
        """Return the name of the field of a key, such as a for a_mm, and the key's factor to SI.

        The factor is None for fields without a unit; an unknown key is returned unchanged.

        Raises FaultError for a key without its unit.
        """
        for name, field in cls.model_fields.items():
            quantity = _quantity(field.metadata)
            if quantity is None:
                continue
            if key == name:
                raise FaultError(key, f"write its unit too: {' or '.join(name + u for u in quantity.factors)}")
            for unit, factor in quantity.factors.items():
                if key == name + unit:
                    return name, factor
        return key, None

    @classmethod
    def keys(cls) -> list[str]:
        """Return the key of every field as it is written in a file, with the first of its units."""
        quantities = {f.alias or name: _quantity(f.metadata) for name, f in cls.model_fields.items()}
        return [name + next(iter(q.factors)) if q else name for name, q in quantities.items()]


def _quantity(metadata: list[Any]) -> Quantity | None:
    """Return the `Quantity` in the metadata of a pydantic field; None without one."""
    return next((m for m in metadata if isinstance(m, Quantity)), None)


def _to_si(value: Any, factor: float) -> Any:
    """Return a number, or the numbers of nested lists, times a factor; other values unchanged."""
    if isinstance(value, list):
        return [_to_si(v, factor) for v in value]
    return value * factor if isinstance(value, int | float) and not isinstance(value, bool) else value


def _size(value: Any) -> float:
    """Return the largest absolute value in a number or nested lists; 0 for other types."""
    if isinstance(value, list):
        return max(map(_size, value), default=0.0)
    return abs(value) if isinstance(value, int | float) and not isinstance(value, bool) else 0.0


def check(schema: type[Schema], data: Mapping[str, Any], source: str) -> Schema:
    """Return data validated against a schema, as an instance of it.

    source : name of the data in messages, such as a path
    Raises InputError that lists the faults by key, at most `MAX_FAULTS_SHOWN`.
    """
    if wrong := list(unusable(data)):
        raise _faults([f"{place}: {fault}" for place, fault in wrong[:MAX_FAULTS_SHOWN]], len(wrong), source)
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        faults = [_fault(schema, data, e) for e in error.errors()[:MAX_FAULTS_SHOWN]]
        raise _faults(faults, error.error_count(), source) from None


def _faults(listed: Sequence[str], count: int, source: str) -> InputError:
    """Return the InputError that lists faults of a source."""
    more = [f"and {count - len(listed)} more"] if count > len(listed) else []
    return InputError("\n  ".join([f"{source}: {count} fault{'s' if count > 1 else ''}", *listed, *more]))


def _fault(schema: type[BaseModel], data: Mapping[str, Any], error: Any) -> str:
    """Return a fault as text: the key as written in the file, its value, and what is allowed."""
    cause = error.get("ctx", {}).get("error")
    loc = tuple(part for part in error["loc"] if part not in VALUE_FORMS)
    place = (*loc, *(cause.place if isinstance(cause, FaultError) else ()))
    if loc[-1:] == ("[key]",):
        return f"{_as_written(schema, data, loc[:-2])[0]}: a key {loc[-2]!r}: {_text(error)}"
    key, value = _as_written(schema, data, place)
    if error["type"] == "extra_forbidden":
        table = _table(schema, loc[:-1])
        own = [field.alias or name for name, field in table.model_fields.items()]
        keys = table.keys() if issubclass(table, TomlTable) else own
        near = difflib.get_close_matches(str(loc[-1]), keys, 1, 0.6)
        hint = f" (is {near[0]} meant?)" if near else ""
        return f"{key} = {_short(value)}: unknown key{hint}; allowed here: {', '.join(keys)}"
    if error["type"] == "missing":
        return f"{key}: is missing{'; write casadical = 1, the version of the file' if key == 'casadical' else ''}"
    given = f" = {_short(value)}" if not isinstance(value, Mapping) else ""
    return f"{key}{given}: {_text(error)}"


def _text(error: Any) -> str:
    """Return the message of one of pydantic's errors in the wording of casadical."""
    if error["type"] in ("model_type", "dict_type"):
        return "must be a table"
    if error["type"] == "string_too_short":
        return "must not be empty"
    limits = {"most": "max_length", "least": "min_length"}
    if error["type"] in ("too_long", "too_short"):
        wanted = next(f"at {w} {error['ctx'][k]}" for w, k in limits.items() if k in error["ctx"])
        return f"must have {wanted} entries, not {error['ctx']['actual_length']}"
    return str(error["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")


def _short(value: Any) -> str:
    """Return a value as TOML writes it (true, 2020-01-01), cut to at most 60 characters."""
    text = str(value) if isinstance(value, date | time) else repr(value)
    text = {"True": "true", "False": "false", "None": "null"}.get(text, text)
    return text if len(text) < 60 else f"{text[:57]}..."


def _as_written(schema: type[BaseModel], data: Any, location: tuple[int | str, ...]) -> tuple[str, Any]:
    """Return the key and the value in the file for a place in the schema.

    The key has its unit and the keys of the tables around it, such as joint[2].a_mm.

    location : path of fields and indices from 0
    """
    words: list[str] = []
    for depth, part in enumerate(location):
        if isinstance(part, int):
            words.append(f"[{part + 1}]")
            data = data[part] if isinstance(data, list) and part < len(data) else None
            continue
        table = _table(schema, location[:depth])
        key = part
        if isinstance(data, Mapping) and part not in data and issubclass(table, TomlTable):
            keys = dict(zip(table.model_fields, table.keys(), strict=True))
            key = next((k for k in data if table.field_of(k)[0] == part), keys.get(part, part))
        words.append(f".{key}")
        data = data.get(key) if isinstance(data, Mapping) else None
    return "".join(words).lstrip(".") or "file", data


def _table(schema: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel]:
    """Return the schema of the table at a location in `schema`, a path of fields and indices."""
    for part in location:
        if isinstance(part, str) and part in schema.model_fields:
            schema = next(_models(schema.model_fields[part].annotation), schema)
    return schema


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the pydantic schemas in a type annotation, the outermost first."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in getattr(annotation, "__args__", ()):
        yield from _models(inner)
