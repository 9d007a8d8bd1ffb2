"""Marks of tests: what only the slow part runs, and what needs MuJoCo, which no module imports to say so."""

from importlib.util import find_spec
from typing import Any

import pytest

MUJOCO = pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo is not installed (extra mujoco)")


def slow(*cases: Any) -> list[Any]:
    """Return cases for `parametrize` that are marked slow; a tuple has the values of several names."""
    return [pytest.param(*(c if isinstance(c, tuple) else (c,)), marks=pytest.mark.slow) for c in cases]
