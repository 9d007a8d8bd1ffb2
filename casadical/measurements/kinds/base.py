"""What a kind of measurement is: how it is read, what its residual is in CasADi, and its error in numbers."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence, Set
from typing import ClassVar

import casadi as ca

from casadical.core.basics import Array
from casadical.core.transforms import Symbolic
from casadical.measurements.columns import Columns

# Observed arrays by name, the first dimension of each over the poses.
Arrays = Mapping[str, Array]
# Tool positions, shape (n, 3) [m], at other readings of the same poses, shape (n, joints).
PositionsAt = Callable[[Array], Array]


class PoseExpression:
    """What a residual may use at one pose, as CasADi expressions in metres and radians.

    model : readings -> (position, orientation), under this pose's conditions
    q : joint readings
    point : shape (3,): departure of the unknown point from its start, where the kind has one

    Its fields: `p`, the measured point of the model, shape (3,), and `R`, its orientation, shape (3, 3); `joints`,
    their number; `observed`, what the residual took of the pose's observed numbers, by name.

    Examples
    --------
    >>> x = ca.SX.sym("q", 2)
    >>> model = lambda q: (ca.vertcat(q, 0), ca.SX.eye(3))
    >>> pose = casadical.measurements.PoseExpression(model, x, ca.SX.sym("point", 3))
    >>> pose.take("position", 3).shape, pose.position_at(2 * x).shape, pose.from_point().shape
    ((3, 1), (3, 1), (3, 1))
    >>> pose.unknown_point().shape, pose.pose_at(2 * x)[1].shape
    ((3, 1), (3, 3))
    >>> sorted(pose.observed)
    ['point', 'position']
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
        """The measured point at other readings, under the same conditions, shape (3,) [m]."""
        return self.pose_at(q)[0]

    def pose_at(self, q: Symbolic) -> tuple[Symbolic, Symbolic]:
        """The measured point and its orientation at other readings, shapes (3,) [m] and (3, 3); else as it is here."""
        p, R = self._model(q)
        return p, R

    def from_point(self) -> Symbolic:
        """The measured point less the unknown point that is identified too, shape (3,) [m]."""
        return self.p - self.unknown_point()

    def unknown_point(self) -> Symbolic:
        """The unknown point that is identified too, for kinds with one, shape (3,) [m]; of a plane see `Plane`."""
        assert self.point is not None
        return self.take("point", 3) + self.point


class MeasurementKind(ABC):
    """A kind of measurement; one instance serves all tables.

    name : as in problem.toml
    columns, unknown : its row of the table in docs/measurements.md
    pattern : of the columns that it reads, which are no conditions; signs : patterns, each of a column of such a table
    fill : columns that a table of poses to be measured leaves empty for it
    arrays : names of the arrays that it needs: fields of `Measurements`, else entries of its `extra`
    lengths, angles : numbers that are observed at a pose [m] and [rad], at least one and at most six together
    places : whether its unknown points are places, between which distances may be known
    touches : whether the tool touches what is measured, so that poses must hold it there
    has_scale : whether it determines the scale: not where robots of one shape and any size fit alike

    Examples
    --------
    >>> from casadical.measurements.kinds.registry import find_kind
    >>> kind = find_kind("position")
    >>> kind.matches({"x_mm", "y_mm", "z_mm"}), kind.numbers
    (True, 3)
    >>> columns = casadical.measurements.Columns.of_frame(table, "made up")
    >>> arrays = kind.read(columns, q)
    >>> model = arrays["position"] + [1e-3, 0, 0]
    >>> kind.errors(arrays, model, lambda q: q)[:2].round(6)
    array([0.001, 0.001])
    >>> kind.at_rest(arrays), kind.point_names(arrays), kind.unit_fault(arrays, model, lambda q: q, reach=0.7)
    (True, (), '')
    >>> contact = find_kind("contact")
    >>> contact.point_starts({"label": np.array(["A", "A"])}, np.array([[0.0, 0, 0], [0.2, 0, 0]])).round(2)
    array([[0.1, 0. , 0. ],
           [0.1, 0. , 0. ]])
    >>> contact.grown(np.array([[1.0, 0, 0]]), np.array([0.5, 0, 0]))
    array([[0.5, 0. , 0. ]])
    >>> x = ca.SX.sym("q", 2)
    >>> kind.residual(casadical.measurements.PoseExpression(lambda q: (ca.vertcat(q, 0), ca.SX.eye(3)), x, None)).shape
    (3, 1)
    """

    name: ClassVar[str]
    columns: ClassVar[str]
    unknown: ClassVar[str] = ""
    pattern: ClassVar[str]
    signs: ClassVar[tuple[str, ...]] = ()
    fill: ClassVar[tuple[str, ...]] = ()
    arrays: ClassVar[tuple[str, ...]]
    lengths: ClassVar[int]
    angles: ClassVar[int] = 0
    places: ClassVar[bool] = True
    touches: ClassVar[bool] = False
    has_scale: ClassVar[bool] = True

    @property
    def numbers(self) -> int:
        """How many numbers are observed at a pose."""
        return self.lengths + self.angles

    def matches(self, names: Set[str]) -> bool:
        """Whether a table with these columns is of this kind where problem.toml does not say: by `signs`, if any."""
        return bool(self.signs) and all(any(re.fullmatch(sign, name) for name in names) for sign in self.signs)

    @abstractmethod
    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """The arrays of a table by name, optional ones too, a row per pose [SI].

        Under `counted` is 0 for rows at which nothing was measured, else 1.

        q : shape (n, joints) [rad or m]: joint readings
        Raises InputError: a column is missing, or holds what cannot be measured.
        """

    @abstractmethod
    def residual(self, pose: PoseExpression) -> Symbolic:
        """Model less measurement at a pose: `lengths` numbers [m], then `angles` numbers [rad]."""

    @abstractmethod
    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Error of each pose that reports tell, shape (n,) [m].

        p : shape (n, 3) [m]: positions of the model; positions_at : the same at other readings, shape (n, joints)
        """

    def at_rest(self, arrays: Arrays) -> bool:
        """Whether something at rest was measured; without it the base's pose is not identifiable.

        By default all but poses that are relative to others.
        """
        return "other" not in arrays

    def point_names(self, arrays: Arrays) -> Sequence[str]:
        """Name of the unknown point that each pose refers to (see `read`); none where the kind has no such points."""
        return ()

    def point_starts(self, arrays: Arrays, p: Array) -> Array:
        """A first estimate of each pose's unknown point, shape (n, 3) [m]; p : positions of the model, alike"""
        raise NotImplementedError(f"kind {self.name!r} names unknown points but does not estimate them")

    def grown(self, points: Array, origin: Array) -> Array:
        """How unknown points, shape (K, 3) [m], move where everything grows about a place, for kinds without scale.

        By their own distance from it, by default; origin : shape (3,) [m]: the place that stays
        """
        return points - origin

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        """What is wrong with the lengths, in words, where they must be in another unit; else nothing.

        p : shape (n, 3) [m]: positions of the nominal model; reach : of the robot [m]
        """
        return ""
