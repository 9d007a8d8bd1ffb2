"""Cases of a test that only the slow part runs."""

from typing import Any

import pytest


def slow(*cases: Any) -> list[Any]:
    """Return cases for `parametrize` that are marked slow; a tuple has the values of several names."""
    return [pytest.param(*(c if isinstance(c, tuple) else (c,)), marks=pytest.mark.slow) for c in cases]
