"""Lazy loading of a package's public names, listed in its stub (Scientific Python's SPEC 1)."""

from importlib import import_module

TYPE_CHECKING = False  # as in typing, whose import costs more than all of this
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def attach(package: str, file: str) -> "tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]":
    """Return `__getattr__`, `__dir__` and `__all__` of a package that loads its names when used.

    package, file : `__name__` and `__file__` of the package
    The stub next to it, `__init__.pyi`, which type checkers and editors read too, has a line
    `from MODULE import NAME as NAME` for each public name and is the only list of them. A name must
    not be that of a module in the package: once that is imported, Python finds the module first.
    Subpackages and modules of the package are loaded on first use, too.
    """
    with open(f"{file}i", encoding="utf-8") as stub:
        lines = [line.split() for line in stub if line.startswith("from ")]
    home = {name: module for _, module, _, name, *_ in lines}

    def find(name: str) -> "Any":
        """Return a public name or submodule of the package."""
        if name in home:
            return getattr(import_module(home[name]), name)
        beneath = f"{package}.{name}"
        try:
            return import_module(beneath)
        except ModuleNotFoundError as missing:
            if missing.name != beneath:
                raise
        raise AttributeError(f"module {package!r} has no attribute {name!r}; there are {', '.join(home)}")

    return find, lambda: sorted(home), list(home)
