"""How long work says where it stands: a function that is called with a line, and the one that shows nothing."""

from collections.abc import Callable

Show = Callable[[str], None]


def silent(_text: str) -> None:
    """Shows nothing."""
