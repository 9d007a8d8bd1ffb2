"""Settings of an effect: fields in which it is not linear, with their grid, and as plain data."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, fields
from itertools import product
from typing import Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from casadical.core.basics import InputError

_STRICT = ConfigDict(strict=True, allow_inf_nan=False)
# Of a setting that counts, and of combinations of settings on their grids.
MOST_WHOLE = 10_000
# In place of a grid: the joints whose motors can move the effect's own one (see `Arm.near`).
NEAR = "near"


def setting(
    default: Any,
    grid: Sequence[Any] | str = (),
    *,
    steps: bool = False,
    signed: bool = False,
    given: bool = False,
    joint: bool = False,
    whole: bool = False,
    tried: Sequence[float] = (),
) -> Any:
    """A field of an effect in which it is not linear.

    default : value where none is given
    grid : values of the candidates; between them the diagnosis refines a setting of type float, by factors; "near": the
        joints right before and behind the effect's own one
    steps : whether it is refined by steps, shares of the grid's first value, rather than by factors
    signed : whether it may be below zero
    given : whether only a user can know it (a gear ratio): it is not refined
    joint : whether it is the number of a joint
    whole : whether whole numbers are more probable than others
    tried : values that are tried once a cause is found, beside whole numbers, before it is named

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Ripple(casadical.Effect):
    ...     waves: float = casadical.effects.setting(80.0, grid=(80.0, 100.0, 120.0))
    ...     name = "ripple"
    ...     acts_at = "joints"
    >>> [effect.waves for effect in Ripple.candidates(robot)]
    [80.0, 100.0, 120.0, 80.0, 100.0, 120.0]
    """
    how = {"steps": steps, "signed": signed, "given": given, "joint": joint, "whole": whole, "tried": tuple(tried)}
    return field(default=default, metadata={"grid": grid if grid == NEAR else tuple(grid), **how})


def grid_points(kind: type, near: Sequence[int] = ()) -> Iterator[dict[str, Any]]:
    """All combinations of the settings that have a grid, by name; near : joints that stand for the grid `NEAR`."""
    grids = {f.name: f.metadata["grid"] for f in fields(kind) if f.metadata.get("grid")}
    grids = {name: near if grid == NEAR else grid for name, grid in grids.items()}
    return (dict(zip(grids, point, strict=True)) for point in product(*grids.values()))


def settings_of(effect: Any) -> dict[str, Any]:
    """Settings by name, as plain data."""
    return {f.name: getattr(effect, f.name) for f in fields(effect) if f.name != "joint"}


def checked_settings(kind: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as an effect's class takes them, of plain data. Raises InputError for one that is none, or no number."""
    hints = get_type_hints(kind)
    names = [f.name for f in fields(kind) if f.name != "joint"]
    checked = {}
    for key, value in given.items():
        if key not in names:
            raise InputError(f"settings.{key}: no setting of {kind.name}; allowed: {', '.join(names) or 'none'}")
        try:
            checked[key] = TypeAdapter(hints[key], config=_STRICT).validate_json(json.dumps(value, default=str))
        except ValidationError as error:
            wrong = error.errors()[0]["msg"].replace("Input should be", "must be")
            raise InputError(f"settings.{key} = {value!r}: {wrong}") from None
        if any(not 0 <= n <= MOST_WHOLE for n in _whole_numbers(checked[key])):
            raise InputError(f"settings.{key} = {value!r}: allowed: whole numbers from 0 to {MOST_WHOLE}")
    return checked


def _whole_numbers(value: Any) -> Iterator[int]:
    if isinstance(value, tuple | list):
        yield from (number for each in value for number in _whole_numbers(each))
    elif isinstance(value, int):
        yield int(value)
