"""A CasADi expression at many points: what all points share is computed once, the rest point by point."""

from collections.abc import Sequence
from functools import cached_property, lru_cache

import casadi as ca

from casadical.core.arrays import Array
from casadical.core.casadi_buffers import Buffered
from casadical.core.compile_cache import compiled


class MappedFunction:
    """Outputs at one point, mapped over some points at a time: graphs do not grow with them.

    Sines, cosines and products of the shared numbers alone, a third of a robot's model, are taken out of the loop, and
    so is what derivatives would compute again. The operations that are left are the same, and so is every bit.

    point : symbols that differ between the points, shape (a,); shared : symbols that do not, shape (b,)
    """

    def __init__(self, name: str, point: ca.SX, shared: ca.SX, outputs: Sequence[ca.SX]) -> None:
        whole = ca.cse([ca.densify(output) for output in outputs])
        each, symbols, once = ca.extract_parametric(whole, shared, {})
        self._once = Buffered(ca.Function(name + "_once", [shared], [ca.vertcat(ca.SX(0, 1), *once)]))
        self._each = ca.Function(name, [point, shared, ca.vertcat(ca.SX(0, 1), *symbols)], each)
        self._mapped = lru_cache(maxsize=64)(self._over)

    def __call__(self, points: Array, shared: Array, machine_code: bool = False) -> list[Array]:
        """Outputs side by side; points : shape (a, n); shared : shape (b,); machine_code : through the C compiler."""
        (once,) = self._once(shared)
        return self._mapped(points.shape[1], machine_code)(points, shared, once)

    def _over(self, n: int, machine_code: bool) -> Buffered:
        f = self._machine_code if machine_code else self._each
        return Buffered(f.map("points", "serial", n, [1, 2], []))

    @cached_property
    def _machine_code(self) -> ca.Function:
        """Where there is a C compiler."""
        return compiled(self._each)
