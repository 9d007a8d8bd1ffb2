"""CasADi functions called with numpy arrays, without a copy through Python lists."""

from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array


class Buffered:
    """A function with dense inputs and outputs, to be called many times; its memory is kept from call to call."""

    def __init__(self, f: ca.Function) -> None:
        self.name = f.name()
        self._inputs = [f.size_in(k) for k in range(f.n_in())]
        self._outputs = [f.size_out(k) for k in range(f.n_out())]
        self._function, self._idle = f, list[Any]()

    def __call__(self, *arguments: Array) -> list[Array]:
        """Its outputs, each of its own shape.

        An argument of fewer columns than the input is repeated side by side, as CasADi does. Raises ValueError for
        shapes that do not fit.
        """
        try:  # a buffer serves one call at a time: another thread takes another one
            buffer, trigger = self._idle.pop()
        except IndexError:
            buffer, trigger = self._function.buffer()
        held: list[Any] = []
        for k, (argument, (rows, columns)) in enumerate(zip(arguments, self._inputs, strict=True)):
            values = np.asarray(argument, dtype=float)
            values = values.reshape(rows, -1, order="F") if rows * columns else np.zeros((0, 0))
            if values.size and values.shape[1] != columns:
                values = np.tile(values, columns // values.shape[1])
            if values.size != rows * columns:
                raise ValueError(f"{self.name}: input {k} has shape {np.shape(argument)}, expected {(rows, columns)}")
            held.append(np.asfortranarray(values))
            if values.size:
                buffer.set_arg(k, _view(held[-1]))
        results = [np.empty(size, order="F") for size in self._outputs]
        for k, r in enumerate(results):
            if r.size:
                buffer.set_res(k, _view(r))
        trigger()
        self._idle.append((buffer, trigger))
        return results


def call(f: ca.Function, *arguments: Array) -> list[Array]:
    """Outputs of a function that is called once; see `Buffered`."""
    return Buffered(f)(*arguments)


def _view(values: Array) -> Any:
    """The memory of a column-major array."""
    return memoryview(values.reshape(-1, order="F"))  # type: ignore[arg-type]
