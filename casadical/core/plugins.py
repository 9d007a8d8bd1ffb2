"""Classes that other installed packages add to one of our families, by entry points."""

from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from casadical.core.basics import InputError

T = TypeVar("T")


def members(group: str, base: type[T], own: Iterable[str | type[T]]) -> dict[str, type[T]]:
    """Classes of a family by name: our own ones first, in their order, then those of installed packages, by name.

    group : of the entry points of other packages, each `name = "module:Class"`
    base : what each class must be derived from; its attribute `name` must be the entry point's
    own : the classes of this package, or "module:Class" of each

    Raises InputError that names the entry point where one cannot be loaded, is no such class, or has a name that is
    taken.
    """
    classes: dict[str, type[T]] = {}
    plugged_in = sorted(entry_points(group=group), key=lambda point: point.name)
    ours = (k if isinstance(k, str) else f"{k.__module__}:{k.__qualname__}" for k in own)
    for point in [*(EntryPoint("", value, group) for value in ours), *plugged_in]:
        member = _loaded(point, base)
        name = str(getattr(member, "name", member))
        if point.name and name != point.name:
            raise InputError(f"{_origin(point)}: its class is named {name!r}; both need the same name")
        if name in classes:
            raise InputError(f"{_origin(point)}: there is a {name!r} already; rename it, or uninstall one")
        classes[name] = member
    return classes


def _loaded(point: EntryPoint, base: type[T]) -> type[T]:
    try:
        member = point.load()
    except Exception as error:  # whatever another package's module raises
        raise InputError(f"{_origin(point)}: cannot be loaded ({error!r}); repair or uninstall it") from error
    if not (isinstance(member, type) and issubclass(member, base)):
        raise InputError(f"{_origin(point)}: is {member!r}; it must be a subclass of {base.__module__}.{base.__name__}")
    return member


def _origin(point: EntryPoint) -> str:
    return f"plug-in {point.name} = {point.value!r}" + (f" of {point.dist.name}" if point.dist else "")
