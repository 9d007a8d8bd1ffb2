"""The one name for arrays in annotations; shape, unit and type of the numbers stand in the docstrings."""

from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]
