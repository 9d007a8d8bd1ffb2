"""The libraries of the extra `report`, imported when they are first needed."""

import importlib
from types import ModuleType
from typing import Any

from casadical.core.errors import InputError

_HOW = "a report needs the extra `report`: pip install 'casadical[report]'"


def plotly() -> Any:
    """The module plotly.graph_objects. Raises InputError where plotly is not installed."""
    return _module("plotly.graph_objects")


def plotly_js() -> str:
    """The whole of plotly.js, as plotly's wheel carries it, to stand in a page."""
    return str(_module("plotly.offline").get_plotlyjs())


def jinja() -> Any:
    """The module jinja2. Raises InputError where it is not installed."""
    return _module("jinja2")


def _module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise InputError(f"{error.name} is not installed; {_HOW}") from None


def require() -> None:
    """Refuse at once what would fail in the end. Raises InputError where a library of the extra is not installed."""
    plotly()
    jinja()
