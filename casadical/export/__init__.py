"""CasADi functions to guarded, deterministic C99 without a mathematical library; knows no robot.

from casadical.export import Network, write_c
export = write_c(Network(function, lower, upper), "out", name="arm", real="float")
"""

from importlib import import_module
from typing import Any

# Public name -> module that defines it.
_HOME: dict[str, str] = {
    "Command": "casadical.export.c.products",
    "Export": "casadical.export.c.write",
    "Kernel": "casadical.export.c.kernel",
    "Limits": "casadical.export.c.products",
    "Network": "casadical.export.c.products",
    "Status": "casadical.export.c.reference",
    "load": "casadical.export.c.kernel",
    "write_c": "casadical.export.c.write",
}

__all__ = ["Command", "Export", "Kernel", "Limits", "Network", "Status", "load", "write_c"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'casadical.export' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
