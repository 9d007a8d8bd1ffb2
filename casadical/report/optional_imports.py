"""The libraries of the extra `report`, imported when they are first needed."""

from typing import Any

from casadical.core.errors import optional

_HOW = "a report needs plotly and jinja2, and one of them is not installed: pip install 'casadical[report]'"


def plotly() -> Any:
    """The module plotly.graph_objects. Raises InputError where plotly is not installed."""
    return optional("plotly.graph_objects", _HOW)


def plotly_js() -> str:
    """The whole of plotly.js, as plotly's wheel carries it, to stand in a page."""
    return str(optional("plotly.offline", _HOW).get_plotlyjs())


def jinja() -> Any:
    """The module jinja2. Raises InputError where it is not installed."""
    return optional("jinja2", _HOW)


def require() -> None:
    """Refuse at once what would fail in the end. Raises InputError where a library of the extra is not installed."""
    plotly()
    jinja()
