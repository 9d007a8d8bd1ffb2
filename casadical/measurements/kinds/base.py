"""What a kind of measurement is: how it is read, what its residual is in CasADi, and its error in numbers."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence, Set
from typing import ClassVar

import casadi as ca

from casadical.core.arrays import Array
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns

# Observed arrays by name, the first dimension of each over the poses.
Arrays = Mapping[str, Array]
# Tool positions, shape (n, 3) [m], at other readings of the same poses, shape (n, joints).
PositionsAt = Callable[[Array], Array]


class PoseExpression:
    """What a residual may use at one pose, as CasADi expressions in metres and radians.

    p : measured point of the model, shape (3,); R : its orientation, shape (3, 3); joints : number of joints
    point : departure of the unknown point from its start, shape (3,), where the kind has one
    observed : what the residual took of the pose's observed numbers, by name
    """

    def __init__(self, model: Callable[[Symbolic], Symbolic], q: Symbolic, point: Symbolic | None) -> None:
        self._model = model
        self.p, self.R = model(q)
        self.joints = int(q.numel())
        self.point = point
        self.observed: dict[str, Symbolic] = {}

    def take(self, name: str, size: int) -> Symbolic:
        """An observed array at this pose, as a column of numbers, a matrix row by row."""
        self.observed[name] = ca.SX.sym(name, size)
        return self.observed[name]

    def position_at(self, q: Symbolic) -> Symbolic:
        """The measured point at other readings, under the same conditions."""
        return self._model(q)[0]

    def from_point(self) -> Symbolic:
        """The measured point less the unknown point that is identified too, for kinds with one."""
        assert self.point is not None
        return self.p - self.take("point", 3) - self.point


class MeasurementKind(ABC):
    """A kind of measurement; one instance serves all tables.

    name : as in problem.toml; columns, unknown : its row of the table in docs/measurements.md
    pattern : of the columns that it reads, which are no conditions
    arrays : names of the arrays that it needs: fields of `Measurements`, else entries of its `extra`
    lengths, angles : numbers that are observed at a pose [m] and [rad], at least one and at most six together
    has_scale : whether it determines the scale: not where robots of one shape and any size fit alike
    """

    name: ClassVar[str]
    columns: ClassVar[str]
    unknown: ClassVar[str] = ""
    pattern: ClassVar[str]
    arrays: ClassVar[tuple[str, ...]]
    lengths: ClassVar[int]
    angles: ClassVar[int] = 0
    has_scale: ClassVar[bool] = True

    @property
    def numbers(self) -> int:
        """How many numbers are observed at a pose."""
        return self.lengths + self.angles

    @abstractmethod
    def matches(self, names: Set[str]) -> bool:
        """Whether a table with these columns is of this kind, where problem.toml does not say."""

    @abstractmethod
    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """The arrays of a table [SI], optional ones too; q : readings, shape (n, joints). Raises InputError."""

    @abstractmethod
    def residual(self, pose: PoseExpression) -> Symbolic:
        """Model less measurement at a pose: `lengths` numbers [m], then `angles` numbers [rad]."""

    @abstractmethod
    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Error that is reported of each pose, shape (n,) [m]; p : positions of the model, shape (n, 3) [m]."""

    def at_rest(self, arrays: Arrays) -> bool:
        """Whether something at rest was measured (see `read`); without it the base's pose is not identifiable."""
        return True

    def point_names(self, arrays: Arrays) -> Sequence[str]:
        """Name of the unknown point that each pose refers to (see `read`); none where the kind has no such points."""
        return ()

    def point_starts(self, arrays: Arrays, p: Array) -> Array:
        """A first estimate of each pose's unknown point, shape (n, 3) [m]; p : positions of the model, same shape."""
        raise NotImplementedError(f"kind {self.name!r} names unknown points but does not estimate them")

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        """What is wrong with the lengths, in words, where they must be in another unit; else nothing.

        p : positions of the nominal model, shape (n, 3) [m]; reach : of the robot [m]
        """
        return ""
