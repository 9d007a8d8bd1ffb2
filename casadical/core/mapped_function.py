"""CasADi functions called with numpy arrays, without a copy through Python lists, at one point or at many.

At many, what all points share is computed once, the rest point by point.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.compile_cache import MachineCode, compiled

# So many points, evaluated since the start of the process, take as long as to look for a compiled library, and to make
# one. Waiting for that costs at most twice what knowing beforehand would (the ski rental problem).
LOOK_FROM, COMPILE_FROM = 10_000, 500_000
# Points at a time, and fewer where each has many numbers: their Jacobians fit the processor's cache, and to map a
# function over more of them takes longer.
CHUNK, NUMBERS, LEAST = 1024, 400_000, 64
# Numbers of points for which the mapped functions are kept.
SIZES = 64


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


class MappedFunction:
    """Outputs at one point, mapped over some points at a time: graphs do not grow with them.

    Sines, cosines and products of the shared numbers alone, a third of a robot's model, are taken out of the loop, and
    so is what derivatives would compute again. The operations that are left are the same, and so is every bit.

    point : symbols that differ between the points, shape (a,); shared : symbols that do not, shape (b,)
    evaluated : points so far
    """

    def __init__(self, name: str, point: ca.SX, shared: ca.SX, outputs: Sequence[ca.SX]) -> None:
        whole = ca.cse([ca.densify(output) for output in outputs])
        each, symbols, once = ca.extract_parametric(whole, shared, {})
        self._shared = Buffered(ca.Function(name + "_once", [shared], [ca.vertcat(ca.SX(0, 1), *once)]))
        self._each = ca.Function(name, [point, shared, ca.vertcat(ca.SX(0, 1), *symbols)], each)
        outputs_of_each = sum(self._each.nnz_out(k) for k in range(self._each.n_out()))
        self._chunk = min(CHUNK, max(LEAST, NUMBERS // max(outputs_of_each, 1)))
        self._mapped: dict[int, Buffered] = {}
        self.evaluated = self._tried = 0
        self._machine_code: MachineCode | None = None

    @property
    def is_compiled(self) -> bool:
        return self._machine_code is not None

    def __call__(self, points: Array, shared: Array) -> list[Array]:
        """Outputs side by side; points : shape (a, n); shared : shape (b,)."""
        n = points.shape[1]
        self._compile(n)
        (once,) = self._shared(shared)
        if self._machine_code:
            return self._machine_code(points, shared, once)
        if n <= self._chunk:
            return self._over(n)(points, shared, once)
        sizes = [self._each.size_out(k) for k in range(self._each.n_out())]
        whole = [np.empty((rows, columns * n), order="F") for rows, columns in sizes]
        for start in range(0, n, self._chunk):
            some = points[:, start : start + self._chunk]
            parts = self._over(some.shape[1])(some, shared, once)
            for out, part, (_, columns) in zip(whole, parts, sizes, strict=True):
                out[:, columns * start : columns * start + part.shape[1]] = part
        return whole

    def _over(self, n: int) -> Buffered:
        """The function over n points."""
        if n not in self._mapped:
            if len(self._mapped) >= SIZES:
                self._mapped.clear()
            self._mapped[n] = Buffered(self._each.map("points", "serial", n, [1, 2], []))
        return self._mapped[n]

    def _compile(self, n: int) -> None:
        """Go over to machine code where the points evaluated before and these n pay for it."""
        self.evaluated += n
        for make, least in ((False, LOOK_FROM), (True, COMPILE_FROM))[self._tried :]:
            if self._machine_code is None and self.evaluated >= least:
                self.compile(make=make)
                self._tried += 1

    def compile(self, *, make: bool = True) -> None:
        """Go over to machine code if there is a library; make : else one is made."""
        self._machine_code = compiled(self._each, make=make)
