"""Lookup of effects by name: those of the package and those of installed plug-ins.

A plug-in is a class in another package, under the entry point group `casadical.effects`:

    [project.entry-points."casadical.effects"]
    soft_stop = "my_package:SoftStop"
"""

from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import entry_points

from casadical.core.basics import InputError
from casadical.effects import registry
from casadical.effects.base import Effect
from casadical.effects.definition import DefinedEffect, Definition, effect_classes

# Name of the entry point group under which other packages register effects.
ENTRY_POINT_GROUP = "casadical.effects"


@cache
def effects_by_name() -> Mapping[str, type[Effect]]:
    """Return the class of every effect by its name: the package's, then those of plug-ins.

    Raises InputError that names the entry point of a plug-in that cannot be loaded, is no subclass
    of `Effect`, or has a name that is taken or differs from that of its class.
    """
    own: list[type[Effect]] = [kind for kind in vars(registry).values() if isinstance(kind, type)]
    classes = {kind.name: kind for kind in own}
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        origin = f"plug-in {point.name} = {point.value!r}" + (f" of {point.dist.name}" if point.dist else "")
        try:
            kind = point.load()
        except Exception as error:  # whatever another package's module raises
            raise InputError(f"{origin}: cannot be loaded ({error!r}); repair or uninstall it") from error
        if not (isinstance(kind, type) and issubclass(kind, Effect)):
            raise InputError(f"{origin}: is {kind!r}; it must be a subclass of {Effect.__module__}.{Effect.__name__}")
        if point.name != kind.name:
            raise InputError(f"{origin}: its class is named {kind.name!r}; both need the same name")
        if kind.name in classes:
            raise InputError(f"{origin}: there is a {kind.name!r} already; rename it, or uninstall one")
        classes[kind.name] = kind
    return classes


def find_effect(name: str, own: Iterable[type[Effect]] = ()) -> type[Effect]:
    """Return the class of the effect of a name.

    name : as in the table of docs/effects.md
    own : additional classes to search; they replace installed ones of the same name
    Raises InputError, with the names of all effects, for an unknown name.
    """
    kinds = {**effects_by_name(), **{kind.name: kind for kind in own}}
    if name not in kinds:
        raise InputError(
            f"no effect {name!r} is installed; there are {', '.join(sorted(kinds))}. One of your own is registered by "
            f"the entry point group {ENTRY_POINT_GROUP!r} of the package that holds it"
        )
    return kinds[name]


def new_effects(definitions: Iterable[Definition]) -> tuple[type[Effect], ...]:
    """Return the effect class of each definition in a file, in order.

    Raises InputError for a faulty definition, and for the name of another effect or one that occurs
    twice.
    """
    kinds = effect_classes(definitions)
    for k, kind in enumerate(kinds, 1):
        if kind.name in effects_by_name() or kind.name in [other.name for other in kinds[: k - 1]]:
            raise InputError(f"definition[{k}].name: there is an effect {kind.name!r} already; give it another name")
    return kinds


def defined_in_files(effects: Iterable[Effect]) -> list[Definition]:
    """Return the definitions, each once, of those effects that a file defined.

    They are not installed, so that a file with such an effect must contain its definition, too.
    """
    kinds = dict.fromkeys(type(e) for e in effects if isinstance(e, DefinedEffect) and e.name not in effects_by_name())
    return [kind.definition for kind in kinds]


def signature_of(name: str) -> str:
    """Return the sentence on how the effect of a name appears in data; "" for an unknown name."""
    return effects_by_name()[name].signature if name in effects_by_name() else ""
