"""CasADi functions called with numpy arrays, without a copy through Python lists."""

from typing import Any

import casadi as ca
import numpy as np

from casadical.core.arrays import Array


def call(f: ca.Function, *arguments: Array) -> list[Array]:
    """Outputs of a function with dense inputs and outputs, each of its own shape.

    An argument of fewer columns than the input is repeated side by side, as CasADi does. Raises ValueError for shapes
    that do not fit.
    """
    buffer, trigger = f.buffer()
    held: list[Any] = []
    for k, argument in enumerate(arguments):
        rows, columns = f.size_in(k)
        values = np.asarray(argument, dtype=float).reshape(rows, -1, order="F") if rows * columns else np.zeros((0, 0))
        if values.size and values.shape[1] != columns:
            values = np.tile(values, columns // values.shape[1])
        if values.size != rows * columns:
            raise ValueError(f"{f.name()}: input {k} has shape {np.shape(argument)}, expected {(rows, columns)}")
        held.append(np.asfortranarray(values))
        if held[-1].size:
            buffer.set_arg(k, _view(held[-1]))  # type: ignore[call-arg]
    results = [np.zeros(f.size_out(k), order="F") for k in range(f.n_out())]
    for k, r in enumerate(results):
        if r.size:
            buffer.set_res(k, _view(r))  # type: ignore[call-arg]
    trigger()
    return results


def _view(values: Array) -> Any:
    """The memory of a column-major array."""
    return memoryview(values.reshape(-1, order="F"))  # type: ignore[arg-type]
