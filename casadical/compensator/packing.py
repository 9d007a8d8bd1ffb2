"""Arrays as JSON values without loss of a bit."""

from base64 import b64decode, b64encode
from typing import Any

import numpy as np

from casadical.core.arrays import Array


def pack(array: Array) -> dict[str, Any]:
    """Return an array as its shape and its little-endian doubles in base64."""
    return {"shape": list(array.shape), "base64": b64encode(array.astype("<f8").tobytes()).decode("ascii")}


def unpack(value: dict[str, Any]) -> Array:
    """Return the array that `pack` packed."""
    flat = np.frombuffer(b64decode(value["base64"], validate=True), dtype="<f8")
    return flat.astype(np.float64).reshape(value["shape"])
