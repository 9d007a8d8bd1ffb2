"""Settings of an effect: its nonlinear fields, their grids, and their conversion to plain data."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, fields
from itertools import product
from typing import Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from casadical.core.basics import InputError

# Largest value of an integer setting, and largest number of combinations of settings on grids.
MAX_SETTING_COUNT = 10_000
# Value of `grid` that stands for the joints next to the effect's own one (see `Arm.near`).
NEAR_JOINTS = "near"


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
    """Return a dataclass field for a setting, in which an effect is not linear.

    default : value where none is given
    grid : values of the candidates of a diagnosis, which refines a setting of type float by factors
        from the best one; "near": up to two joints before and two behind the effect's own one
    steps : whether it is refined by fractions of the grid's first spacing rather than by factors
    signed : whether a refined value may be below zero
    given : whether only a user can know it (a gear ratio), so that it is not refined
    joint : whether it is the number of a joint, 1-based
    whole : whether integers are more probable than other values; at most one setting of an effect
    tried : values that are evaluated once the cause is found, with integers of the `whole` setting

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
    return field(default=default, metadata={"grid": grid if grid == NEAR_JOINTS else tuple(grid), **how})


def grid_points(kind: type, near: Sequence[int] = ()) -> Iterator[dict[str, Any]]:
    """Return an iterator of dicts of settings by name, one for every combination of grid values.

    kind : class of an effect; settings without a grid are not in the dicts; without grids: one {}
    near : numbers of joints that replace the grid `NEAR_JOINTS`
    """
    grids = {f.name: f.metadata["grid"] for f in fields(kind) if f.metadata.get("grid")}
    grids = {name: near if grid == NEAR_JOINTS else grid for name, grid in grids.items()}
    return (dict(zip(grids, point, strict=True)) for point in product(*grids.values()))


def settings_of(effect: Any) -> dict[str, Any]:
    """Return the values of all fields of an effect but `joint`, by name."""
    return {f.name: getattr(effect, f.name) for f in fields(effect) if f.name != "joint"}


def checked_settings(kind: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return validated values of an effect's settings, by name, from plain data.

    kind : class of the effect; given : values by name, lists in place of tuples
    Raises InputError for an unknown setting, a value of the wrong type, and an integer below 0 or
    above `MAX_SETTING_COUNT`.
    """
    hints = get_type_hints(kind)
    names = [f.name for f in fields(kind) if f.name != "joint"]
    checked = {}
    for key, value in given.items():
        if key not in names:
            raise InputError(f"settings.{key}: no setting of {kind.name}; allowed: {', '.join(names) or 'none'}")
        try:
            checked[key] = TypeAdapter(hints[key], config=ConfigDict(strict=True, allow_inf_nan=False)).validate_json(
                json.dumps(value, default=str)
            )
        except ValidationError as error:
            wrong = error.errors()[0]["msg"].replace("Input should be", "must be")
            raise InputError(f"settings.{key} = {value!r}: {wrong}") from None
        if any(not 0 <= n <= MAX_SETTING_COUNT for n in _whole_numbers(checked[key])):
            raise InputError(f"settings.{key} = {value!r}: allowed: whole numbers from 0 to {MAX_SETTING_COUNT}")
    return checked


def _whole_numbers(value: Any) -> Iterator[int]:
    """Yield every integer in a value, which may be nested lists or tuples."""
    if isinstance(value, tuple | list):
        yield from (number for each in value for number in _whole_numbers(each))
    elif isinstance(value, int):
        yield int(value)
