"""Every effect by its name: those of the registry and of installed plug-ins.

A plug-in is a class in another package, under the entry point group `casadical.effects`:

    [project.entry-points."casadical.effects"]
    soft_stop = "my_package:SoftStop"
"""

from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from casadical.core.basics import InputError
from casadical.effects import registry
from casadical.effects.base import Effect
from casadical.effects.definition import DefinedEffect, Definition, effect_classes

GROUP = "casadical.effects"


@cache
def known_effects() -> Mapping[str, type[Effect]]:
    """Return every effect by name: those of the package, then those of installed plug-ins, by name.

    Raises InputError that names the entry point where one cannot be loaded, is no effect, or has a name
    that is taken.
    """
    own: list[type[Effect]] = [kind for kind in vars(registry).values() if isinstance(kind, type)]
    classes = {kind.name: kind for kind in own}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        origin = f"plug-in {point.name} = {point.value!r}" + (f" of {point.dist.name}" if point.dist else "")
        kind = _loaded(point, origin)
        if point.name != kind.name:
            raise InputError(f"{origin}: its class is named {kind.name!r}; both need the same name")
        if kind.name in classes:
            raise InputError(f"{origin}: there is a {kind.name!r} already; rename it, or uninstall one")
        classes[kind.name] = kind
    return classes


def _loaded(point: EntryPoint, origin: str) -> type[Effect]:
    try:
        kind = point.load()
    except Exception as error:  # whatever another package's module raises
        raise InputError(f"{origin}: cannot be loaded ({error!r}); repair or uninstall it") from error
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise InputError(f"{origin}: is {kind!r}; it must be a subclass of {Effect.__module__}.{Effect.__name__}")
    return kind


def find_effect(name: str, own: Iterable[type[Effect]] = ()) -> type[Effect]:
    """The effect of a name.

    name : as in the table of docs/diagnosis.md
    own : classes that count besides
    Raises InputError: no such effect; those that there are.
    """
    known = {**known_effects(), **{kind.name: kind for kind in own}}
    if name not in known:
        raise InputError(
            f"no effect {name!r} is installed; there are {', '.join(sorted(known))}. One of your own is registered by "
            f"the entry point group {GROUP!r} of the package that holds it"
        )
    return known[name]


def new_effects(definitions: Iterable[Definition]) -> tuple[type[Effect], ...]:
    """Effects that a file defines. Raises InputError for a faulty one, and for a name that there is already."""
    kinds = effect_classes(definitions)
    for k, kind in enumerate(kinds, 1):
        if kind.name in known_effects() or kind.name in [other.name for other in kinds[: k - 1]]:
            raise InputError(f"definition[{k}].name: there is an effect {kind.name!r} already; give it another name")
    return kinds


def defined_in_files(effects: Iterable[Effect]) -> list[Definition]:
    """Definitions, each once, of effects that are not installed: a file with such an effect holds them, too."""
    kinds = dict.fromkeys(type(e) for e in effects if isinstance(e, DefinedEffect) and e.name not in known_effects())
    return [kind.definition for kind in kinds]


def signature_of(name: str) -> str:
    """What the data show of an effect, in words; empty for a name that is none."""
    return known_effects()[name].signature if name in known_effects() else ""
