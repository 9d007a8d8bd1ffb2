"""Every effect by its name: those of the registry and of installed plug-ins.

A plug-in is a class in another package, under the entry point group `casadical.effects`:

    [project.entry-points."casadical.effects"]
    soft_stop = "my_package:SoftStop"
"""

from collections.abc import Iterable, Mapping
from functools import cache

from casadical.core.errors import InputError
from casadical.core.plugins import members
from casadical.effects import registry
from casadical.effects.base import Effect

GROUP = "casadical.effects"


@cache
def known_effects() -> Mapping[str, type[Effect]]:
    """Every effect of the package and of installed plug-ins, by name. Raises InputError for a faulty plug-in."""
    return members(GROUP, Effect, (kind for kind in vars(registry).values() if isinstance(kind, type)))


def find_effect(name: str, own: Iterable[type[Effect]] = ()) -> type[Effect]:
    """The effect of a name.

    Parameters
    ----------
    name : str
        as in the table of docs/diagnosis.md
    own : Iterable[type[Effect]], default ()
        classes that count besides

    Returns
    -------
    type[Effect]
        its class

    Raises
    ------
    InputError
        no such effect; those that there are

    Examples
    --------
    >>> casadical.effects.find_effect("backlash")(5).label
    'backlash@5'
    """
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
