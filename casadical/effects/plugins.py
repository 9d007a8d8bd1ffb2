"""Every effect by its name: those of the registry and of installed plug-ins.

A plug-in is a class in another package, under the entry point group `casadical.effects`:

    [project.entry-points."casadical.effects"]
    soft_stop = "my_package:SoftStop"
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from casadical.core.errors import InputError
from casadical.effects import registry
from casadical.effects.base import Effect

GROUP = "casadical.effects"


@cache
def known_effects() -> Mapping[str, type[Effect]]:
    """Every effect of the package and of installed plug-ins, by name. Raises InputError for a faulty plug-in."""
    found = {kind.name: kind for kind in vars(registry).values() if isinstance(kind, type) and issubclass(kind, Effect)}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        kind = _loaded(point)
        if found.setdefault(kind.name, kind) is not kind:
            raise InputError(f"{_origin(point)}: there is an effect {kind.name!r} already; rename it, or uninstall one")
    return found


def find_effect(name: str, own: Iterable[type[Effect]] = ()) -> type[Effect]:
    """The effect of a name. own : classes that count besides. Raises InputError that lists those that exist."""
    known = {**known_effects(), **{kind.name: kind for kind in own}}
    if name not in known:
        raise InputError(
            f"no effect {name!r} is installed; there are {', '.join(sorted(known))}. One of your own is registered by "
            f"the entry point group {GROUP!r} of the package that holds it"
        )
    return known[name]


def signature_of(name: str) -> str:
    """What the data show of an effect, in words; empty for a name that is none."""
    return known_effects()[name].signature if name in known_effects() else ""


def _loaded(point: EntryPoint) -> type[Effect]:
    """The class behind an entry point."""
    try:
        kind = point.load()
    except Exception as error:  # whatever a stranger's module raises
        raise InputError(f"{_origin(point)}: cannot be loaded ({error!r}); repair or uninstall it") from error
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise InputError(f"{_origin(point)}: is {kind!r}; it must be a subclass of casadical.effects.Effect")
    if kind.name != point.name:
        raise InputError(f"{_origin(point)}: its class is named {kind.name!r}; both need the same name")
    return kind


def _origin(point: EntryPoint) -> str:
    package = f" of {point.dist.name}" if point.dist else ""
    return f"plug-in {point.name} = {point.value!r}{package}"
