"""Base class of a kind of measurement: how it is read, its residual in CasADi, and its error."""

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
# Function that returns positions of the measured point in the measuring frame, shape (n, 3) [m], at
# other joint variables of the same poses, shape (n, joints) [rad or m].
PositionsAt = Callable[[Array], Array]


class PoseExpression:
    """CasADi expressions of which the residual of one pose is built, in metres and radians.

    model : joint variables -> (position, orientation) in the measuring frame, under its conditions
    q : joint variables
    point : deviation of the unknown point from its start, shape (3,) [m], where the kind has one

    Its fields: `p`, the measured point of the model in the measuring frame, shape (3,), and `R`,
    its orientation, shape (3, 3); `joints`, their number; `observed`, the symbols of the pose's
    observed numbers that the residual has taken, by name.

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
        """Return a new symbol for an observed array at this pose, a column of `size` numbers.

        A matrix is given row by row. The name is the array's name in `Arrays`.
        """
        self.observed[name] = ca.SX.sym(name, size)
        return self.observed[name]

    def position_at(self, q: Symbolic) -> Symbolic:
        """Return the measured point at other joints in the measuring frame, shape (3,) [m].

        q : joint variables, shape (joints,) [rad or m]; all else is as at this pose
        """
        return self.pose_at(q)[0]

    def pose_at(self, q: Symbolic) -> tuple[Symbolic, Symbolic]:
        """Return point (3,) [m] and orientation (3, 3) in the measuring frame at other joints.

        q : joint variables, shape (joints,) [rad or m]; all else is as at this pose
        """
        p, R = self._model(q)
        return p, R

    def from_point(self) -> Symbolic:
        """Return the measured point of the model minus the unknown point, shape (3,) [m]."""
        return self.p - self.unknown_point()

    def unknown_point(self) -> Symbolic:
        """Return the unknown point, which is identified too, in the measuring frame, (3,) [m].

        It exists for kinds with one; for a plane it is defined at `Plane`.
        """
        assert self.point is not None
        return self.take("point", 3) + self.point


class MeasurementKind(ABC):
    """A kind of measurement; one instance serves all tables.

    name : as in problem.toml
    columns, unknown : its row of the table in docs/measurements.md
    pattern : of the columns that it reads, which are no conditions
    gives : kind of the measurements that are read; empty: this kind
    signs : patterns, each of a column by which a table of this kind is recognised
    fill : columns that are left empty for it in a table of poses to be measured
    arrays : names of the arrays that it needs: fields of `Measurements`, else entries of its
        `extra`
    lengths, angles : numbers that are observed at a pose [m] and [rad], together one to six
    places : whether its unknown points are places, between which distances may be given
    touches : whether the tool touches what is measured, so that poses must hold it there
    has_scale : whether it determines the scale; if not, similar robots of any size fit equally well

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
    gives: ClassVar[str] = ""
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
        """Number of scalars that are observed at a pose, lengths and angles together."""
        return self.lengths + self.angles

    def matches(self, names: Set[str]) -> bool:
        """Return whether a table with these columns is of this kind, by `signs`, if it has any.

        It is asked where problem.toml does not declare the kind.
        """
        return bool(self.signs) and all(any(re.fullmatch(sign, name) for name in names) for sign in self.signs)

    @abstractmethod
    def read(self, columns: Columns, q: Array) -> dict[str, Array]:
        """Return the arrays of a table by name, optional ones too, one row per pose [SI].

        An entry `counted` may be 0 for rows at which nothing was measured, else 1.

        q : joint variables, shape (n, joints) [rad or m]
        Raises InputError: a column is missing, or holds what cannot be measured.
        """

    def of(self, arrays: Arrays) -> "MeasurementKind":
        """Return the kind with the residual that some observed arrays ask for; by default itself."""
        return self

    @abstractmethod
    def residual(self, pose: PoseExpression) -> Symbolic:
        """Return model minus measurement at a pose: `lengths` numbers [m], then `angles` [rad]."""

    @abstractmethod
    def errors(self, arrays: Arrays, p: Array, positions_at: PositionsAt) -> Array:
        """Return the error of each pose as reports quote it, shape (n,) [m], zero or positive.

        arrays : observed arrays of the n poses
        p : positions of the model in the measuring frame, shape (n, 3) [m]
        positions_at : function that returns them at other joint variables, shape (n, joints)
        """

    def at_rest(self, arrays: Arrays) -> bool:
        """Return whether something fixed was measured, so that the base is identifiable.

        By default this is true of all but poses that are relative to others.
        """
        return "other" not in arrays

    def point_names(self, arrays: Arrays) -> Sequence[str]:
        """Return the name of each pose's unknown point, n of them; empty for kinds without any."""
        return ()

    def point_starts(self, arrays: Arrays, p: Array) -> Array:
        """Return an initial estimate of each pose's unknown point, shape (n, 3) [m].

        It is in the measuring frame; poses of one point get equal rows.

        p : positions of the model in the measuring frame, shape (n, 3) [m]
        """
        raise NotImplementedError(f"kind {self.name!r} names unknown points but does not estimate them")

    def grown(self, points: Array, origin: Array) -> Array:
        """Return the derivative of unknown points by a common scale of all lengths, (K, 3) [m].

        All is scaled about `origin`, for kinds that do not determine the scale. By default the
        derivative is each point's vector from the origin.

        points : unknown points, shape (K, 3) [m]; origin : fixed point, shape (3,) [m]
        """
        return points - origin

    def unit_fault(self, arrays: Arrays, p: Array, positions_at: PositionsAt, reach: float) -> str:
        """Return a sentence if the measured lengths must be in another unit, else an empty text.

        p : positions of the nominal model in the measuring frame, shape (n, 3) [m]
        positions_at : function that returns them at other joints; reach : of the robot [m]
        """
        return ""
