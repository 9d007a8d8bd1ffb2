"""Errors of a robot model against measurements, and the statistics that summarise them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key
from casadical.core.reporting.result import Shown
from casadical.measurements.kinds.base import PositionsAt
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


@dataclass(frozen=True)
class Accuracy(Shown):
    """Statistics of the errors at the poses of one or several sets [m].

    n : number of poses
    mean, max, std, rms, p95 : mean, maximum, sample standard deviation, root mean square, 95th
        percentile [m]
    turn : the same of the angles between measured and computed orientations [rad]; None where no
        orientations were measured
    """

    line: ClassVar[str] = (
        " of {{ it.n }} poses: mean {{ it.mean | mm }} mm, 95 % below {{ it.p95 | mm }} mm, max {{ it.max | mm }} mm"
    )

    n: int = field(metadata=WRITTEN)
    mean: float = field(metadata=IN_MM)
    max: float = field(metadata=IN_MM)
    std: float = field(metadata=IN_MM)
    rms: float = field(metadata=IN_MM)
    p95: float = field(metadata=IN_MM)
    turn: Accuracy | None = None

    derived: ClassVar[tuple[Key, ...]] = (Key("orientation", lambda a: a.turn and a.turn.in_degrees, omit_none=True),)

    @property
    def in_degrees(self) -> dict[str, float]:
        """Return the statistics of angles, JSON key ("mean_deg", "max_deg", ...) -> value [deg].

        The fields must be angles [rad], as those of `turn`.
        """
        return {f"{name}_deg": float(np.rad2deg(getattr(self, name))) for name in ("mean", "max", "std", "rms", "p95")}


def accuracy_of(robot: Robot, sets: Sequence[Measurements]) -> Accuracy:
    """Return the statistics of a robot's errors over all poses of some sets (see `errors`) [m].

    Those of orientations are in `turn` [rad].
    """
    turns = [turn for m in sets if (turn := turn_errors(robot, m)) is not None]
    found = summarise(np.concatenate([errors(robot, m) for m in sets]))
    return replace(found, turn=summarise(np.concatenate(turns))) if turns else found


def turn_errors(robot: Robot, m: Measurements) -> Array | None:
    """Return the angle between measured and computed orientation at each pose, shape (n,) [rad].

    None where no orientations were measured.
    """
    if m.orientation is None:
        return None
    # The chord between two rotations, of small angles too.
    chord = np.linalg.norm(predicted(robot, m)[1] - m.orientation, axis=(1, 2)) / np.sqrt(8)
    return np.asarray(2 * np.arcsin(np.minimum(chord, 1.0)))


def summarise(errors: Array) -> Accuracy:
    """Return the statistics of errors, shape (n,) [m]; the standard deviation divides by n - 1.

    It is 0 for one error. Errors in rad give statistics in rad.
    """
    return Accuracy(
        n=len(errors),
        mean=float(errors.mean()),
        max=float(errors.max()),
        std=float(errors.std(ddof=1)) if len(errors) > 1 else 0.0,
        rms=float(np.sqrt(np.mean(errors**2))),
        p95=float(np.quantile(errors, 0.95)),
    )


def predicted(robot: Robot, m: Measurements, values: Mapping[str, float] | None = None) -> tuple[Array, Array]:
    """Return tool positions (n, 3) [m] and orientations (n, 3, 3) in the measuring frame, by model.

    m : poses and their conditions; those not logged are as the robot declares them
    values : parameter name -> value [SI], used in place of the robot's own

    Examples
    --------
    >>> p, R = casadical.identification.predicted(found.robot, poses)
    >>> p.shape, R.shape
    ((40, 3), (40, 3, 3))
    """
    phi = robot.parameters.values
    for name, value in (values or {}).items():
        phi[robot.parameters.index_of(name)] = value
    w = m.condition_matrix(robot.conditions, robot.declared)
    p, R = robot.model.evaluate(("p", "R"), m.q, w, phi)
    return p.T, R.reshape(3, len(m), 3).transpose(1, 0, 2)


def residual_mm(robot: Robot, m: Measurements) -> Array:
    """Return the position residuals, measured minus computed, (n, 3) [mm], in the measuring frame.

    Source: paper, eq. 9.

    m : poses with their observations
    Raises InputError: where the measurements do not say where the point is.

    Examples
    --------
    >>> casadical.identification.residual_mm(found.robot, poses)[0].round(3)
    array([-0.011,  0.01 , -0.003])
    """
    if m.position is None:
        raise InputError(f"measurements of the kind {m.kind} do not say where the point is; positions and poses do")
    return np.asarray(1e3 * (m.position - predicted(robot, m)[0]))


def errors(robot: Robot, m: Measurements) -> Array:
    """Return the error of a robot's model at each pose, shape (n,) [m], zero or positive.

    Position and pose: the distance between measured and computed point. Distances and readings of a
    dial: the absolute difference. Contact: the distance from the mean of all poses at the same
    point, or from the best plane or sphere of the label. See `MeasurementKind.errors`.

    m : poses with their observations

    Examples
    --------
    >>> 1e3 * casadical.identification.errors(robot, poses)[:3].round(6)  # mm
    array([0.899, 1.901, 0.816])
    """
    return find_kind(m.kind).errors(m.arrays, predicted(robot, m)[0], positions_at(robot, m))


def positions_at(robot: Robot, m: Measurements) -> PositionsAt:
    """Return the function from joint variables (n, joints) to the robot's positions (n, 3) [m].

    Positions are those of the measured point in the measuring frame, at the conditions (payload,
    temperature and others) of the n poses m.
    """
    return lambda q: predicted(robot, replace(m, q=q))[0]
