"""CasADi functions called with numpy arrays, without a copy through lists, at one point or at many.

For many points, expressions of the shared inputs are computed once, the others for each point.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.compile_cache import MachineCode, compiled

# Number of points that one mapped function has evaluated before a library compiled earlier is
# looked up in the cache. Evaluating them takes about as long as the lookup, so that waiting costs
# at most twice the optimum (the ski rental problem).
LIBRARY_LOOKUP_POINTS = 500
# Number of points that one mapped function has evaluated before a library is compiled for it.
# Evaluating them takes about as long as the compilation, whatever the function: CasADi takes 2.6 ns
# per instruction and point, gcc half a millisecond per instruction. One solve of a few hundred or
# thousand poses stays below.
COMPILATION_POINTS = 200_000
# Largest number of points that are evaluated at a time; mapping over more of them takes longer.
MAX_CHUNK_POINTS = 1024
# Largest number of output numbers that are computed at a time (but see MIN_CHUNK_POINTS): Jacobians
# then fit the processor's cache.
MAX_CHUNK_NUMBERS = 400_000
# Smallest number of points that are evaluated at a time, even if they have more than
# MAX_CHUNK_NUMBERS output numbers.
MIN_CHUNK_POINTS = 64


class Buffered:
    """A CasADi function of dense inputs and outputs that is called many times with arrays.

    CasADi's work memory is reused in the next call; the returned arrays are new.
    """

    def __init__(self, f: ca.Function) -> None:
        self.name = f.name()
        self._inputs = [f.size_in(k) for k in range(f.n_in())]
        self._outputs = [f.size_out(k) for k in range(f.n_out())]
        self._function, self._idle = f, list[Any]()

    def __call__(self, *arguments: Array) -> list[Array]:
        """Return the outputs, each of two axes in its own shape, for one argument per input.

        An argument with fewer columns than the input is repeated side by side, as by CasADi.

        Raises ValueError for another number of arguments, or of values of one.
        """
        try:  # a buffer serves one call at a time: another thread takes another one
            buffer, trigger = self._idle.pop()
        except IndexError:
            buffer, trigger = self._function.buffer()
        arrays: list[Any] = []
        for k, (argument, (rows, columns)) in enumerate(zip(arguments, self._inputs, strict=True)):
            values = np.asarray(argument, dtype=float)
            values = values.reshape(rows, -1, order="F") if rows * columns else np.zeros((0, 0))
            if values.size and values.shape[1] != columns:
                values = np.tile(values, columns // values.shape[1])
            if values.size != rows * columns:
                raise ValueError(f"{self.name}: input {k} has shape {np.shape(argument)}, expected {(rows, columns)}")
            arrays.append(np.asfortranarray(values))
            if values.size:
                buffer.set_arg(k, _view(arrays[-1]))
        results = [np.empty(size, order="F") for size in self._outputs]
        for k, r in enumerate(results):
            if r.size:
                buffer.set_res(k, _view(r))
        trigger()
        self._idle.append((buffer, trigger))
        return results


def call(f: ca.Function, *arguments: Array) -> list[Array]:
    """Return the outputs of a CasADi function that is called once, as arrays; see `Buffered`."""
    return Buffered(f)(*arguments)


def _view(values: Array) -> Any:
    """Return a flat view of the memory of a column-major array."""
    return memoryview(values.reshape(-1, order="F"))  # type: ignore[arg-type]


class MappedFunction:
    """A function of one point that is evaluated at many points in chunks.

    The graph does not grow with the number of points. Expressions of the shared inputs only, a
    third of a robot's model, are computed once a call, common subexpressions once a point. The
    other operations are unchanged, and so is every bit of CasADi's results.

    name : name of the CasADi function
    point : symbols whose values differ between the points, shape (a,)
    shared : symbols whose values are the same for all points, shape (b,)
    outputs : expressions of both
    evaluated : number of points evaluated so far
    """

    def __init__(self, name: str, point: ca.SX, shared: ca.SX, outputs: Sequence[ca.SX]) -> None:
        whole = ca.cse([ca.densify(output) for output in outputs])
        each, symbols, once = ca.extract_parametric(whole, shared, {})
        self._shared = Buffered(ca.Function(name + "_once", [shared], [ca.vertcat(ca.SX(0, 1), *once)]))
        self._each = ca.Function(name, [point, shared, ca.vertcat(ca.SX(0, 1), *symbols)], each)
        outputs_of_each = sum(self._each.nnz_out(k) for k in range(self._each.n_out()))
        self._chunk = min(MAX_CHUNK_POINTS, max(MIN_CHUNK_POINTS, MAX_CHUNK_NUMBERS // max(outputs_of_each, 1)))
        self._mapped: dict[int, Buffered] = {}
        self.evaluated = self._tried = 0
        self._machine_code: MachineCode | None = None

    @property
    def is_compiled(self) -> bool:
        """Return whether a compiled library evaluates the function, not CasADi."""
        return self._machine_code is not None

    def __call__(self, points: Array, shared: Array) -> list[Array]:
        """Return the outputs at n points side by side, shape (rows, columns n) each.

        points : shape (a, n); shared : shape (b,)
        """
        n = points.shape[1]
        self.evaluated += n
        # Machine code is used once the points that were evaluated pay for it.
        for make, threshold in ((False, LIBRARY_LOOKUP_POINTS), (True, COMPILATION_POINTS))[self._tried :]:
            if self._machine_code is None and self.evaluated >= threshold:
                self.compile(make=make)
                self._tried += 1
        (once,) = self._shared(shared)
        if self._machine_code:
            return self._machine_code(points, shared, once)
        if n <= self._chunk:
            return self._over(n)(points, shared, once)
        sizes = [self._each.size_out(k) for k in range(self._each.n_out())]
        outputs = [np.empty((rows, columns * n), order="F") for rows, columns in sizes]
        for start in range(0, n, self._chunk):
            some = points[:, start : start + self._chunk]
            parts = self._over(some.shape[1])(some, shared, once)
            for out, part, (_, columns) in zip(outputs, parts, sizes, strict=True):
                out[:, columns * start : columns * start + part.shape[1]] = part
        return outputs

    def _over(self, n: int) -> Buffered:
        """Return the CasADi function mapped over n points, from the cache if it is there."""
        if n not in self._mapped:
            # A function of n points is cached for each of at most 64 values of n; at the next one
            # the cache is emptied.
            if len(self._mapped) >= 64:
                self._mapped.clear()
            self._mapped[n] = Buffered(self._each.map("points", "serial", n, [1, 2], []))
        return self._mapped[n]

    def compile(self, *, make: bool = True) -> None:
        """Switch to a compiled library, if one is in the cache or can be built.

        make : whether it is built if the cache has none
        """
        self._machine_code = compiled(self._each, make=make)
