"""What can be exported as C: a network, joint error curves, or the correction of joint commands."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import casadi
import numpy as np

from casadical.core.basics import Array, InputError


@dataclass(frozen=True)
class Limits:
    """Limits of a joint-command correction, and thresholds of the statuses that it reports.

    delta_rad : largest correction of a joint [rad or m]
    step_rad : largest change of a joint in one least-squares step [rad or m]
    rate_rad_s : rate at which a correction may change [rad/s or m/s]
    cycle_s : cycle time of the controller [s]
    ramp_s : time in which the correction is switched on or off [s]
    damping : lambda of the damped least squares [m/rad]
    singular_m_per_rad : a pose whose weakest direction moves the tool by less than about this is
        reported as singular [m/rad]
    tolerance_mm : a larger remaining error is reported as not converged [mm]
    Raises InputError: a limit not positive and finite, a cycle outside of 0.01 ms to 1 s, a ramp of
    less than one cycle or more than 100,000 (in float a gain of smaller steps goes wrong), or a
    rate that in a cycle changes a joint by less than 1e-6 rad or by more than the largest
    correction.
    """

    delta_rad: float = 0.15
    step_rad: float = 0.1
    rate_rad_s: float = 0.5
    cycle_s: float = 0.004
    ramp_s: float = 1.0
    damping: float = 0.01
    singular_m_per_rad: float = 0.07
    tolerance_mm: float = 0.02

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"limit {name} is {value}; it must be a positive number")
        if not 1e-5 <= self.cycle_s <= 1:
            raise InputError(f"a cycle of {1e3 * self.cycle_s:g} ms; allowed: 0.01 to 1000 ms")
        if not 1 <= self.ramp_s / self.cycle_s * (1 + 1e-9) <= 100_001:
            raise InputError(
                f"a ramp of {self.ramp_s:g} s; with a cycle of {1e3 * self.cycle_s:g} ms allowed: "
                f"{self.cycle_s:g} to {1e5 * self.cycle_s:g} s"
            )
        if not 1e-6 <= self.rate_rad_s * self.cycle_s <= self.delta_rad:
            raise InputError(
                f"a rate of {self.rate_rad_s:g} rad/s; with a cycle of {1e3 * self.cycle_s:g} ms "
                f"allowed: {1e-6 / self.cycle_s:g} to {self.delta_rad / self.cycle_s:g} rad/s (a "
                f"correction is at most {self.delta_rad:g} rad)"
            )

    @property
    def numbers(self) -> dict[str, float]:
        """Return the limits as the C compares with them, by name.

        They are delta, step and change per cycle [rad or m], ramp (gain per cycle, at most 1),
        tolerance2 (squared tolerance [m^2]) and weakness (largest value of a pose that is not
        singular [rad^2/m^2], see `prepare`).
        """
        return {
            "delta": self.delta_rad,
            "step": self.step_rad,
            "change": self.rate_rad_s * self.cycle_s,
            "ramp": min(self.cycle_s / self.ramp_s, 1.0),
            "tolerance2": (1e-3 * self.tolerance_mm) ** 2,
            "weakness": 1.0 / (self.singular_m_per_rad**2 + self.damping**2),
        }


@dataclass(frozen=True)
class NetworkFunction:
    """A network q[n] [rad or m] -> dp[m] [mm] with the joint ranges in which it was trained.

    function : CasADi function of the variables of the robot's rows; dp is added to positions
    lower, upper : lower and upper ends of these ranges, shape (n,) [rad or m]
    units : "rad" or "m" of each joint; empty: all rad
    key, out, unit, title : names of the exported function and of its result, the result's unit, and
        a title in words
    Raises InputError: a function of other shapes, or ranges or units that are not allowed.
    """

    function: casadi.Function
    lower: Array
    upper: Array
    units: tuple[str, ...] = ()

    key: ClassVar[str] = "network"
    out: ClassVar[str] = "dp_mm"
    unit: ClassVar[str] = "mm"
    title: ClassVar[str] = "compensation network"

    def __post_init__(self) -> None:
        _checked_box(self)
        _checked_signature(self.function, len(self.lower), None)


@dataclass(frozen=True)
class CurveFunction(NetworkFunction):
    """The joints' error curves, q[n] -> dq[n]: a joint's true angle is its reading plus dq [rad].

    Raises InputError: as of `NetworkFunction`.
    """

    key: ClassVar[str] = "curves"
    out: ClassVar[str] = "dq"
    unit: ClassVar[str] = "rad"
    title: ClassVar[str] = "error curves of the joints"

    def __post_init__(self) -> None:
        _checked_box(self)
        _checked_signature(self.function, len(self.lower), (len(self.lower),))


@dataclass(frozen=True)
class Command:
    """The correction of joint commands, which moves the real tool to the nominal tool's position.

    nominal, calibrated : q[n] -> p[3] [m], or q[n] -> (p[3], R[3x3]) for position and orientation,
        both in the robot's own base frame; the calibrated one is the whole model of the real robot
        (closed loops, compliance, network)
    lower, upper : lower and upper ends of the box of joint readings that are corrected, shape (n,)
        [rad or m]; `command_of` takes the robot's limits, not the range that was measured
    jacobian_of : function like ``calibrated``, the mean of whose Jacobian and the nominal one the
        steps take; None: ``calibrated`` itself. A chain without compliance and network is cheaper
    jacobian_at : joints at which this Jacobian is taken, as a function of q; None: q
    network : a network that is exported as a function of its own besides the correction; None: none
    limits : limits of the correction, and thresholds of its statuses
    steps : number of least-squares steps, 1 to 10. The robot is evaluated again after them:
        NOT_CONVERGED means that the error there exceeds the tolerance, or the next step its limit.
        One more step follows where the last one reduced the error to a third or less
    units : "rad" or "m" of each joint's reading; default: all rad
    freedom : number of directions in which the joints move the tool, and number about which they
        rotate it at a fixed position. Where a pose has fewer than six in all, the position has
        priority, and the orientation is corrected as far as the joints allow
    notes : sentences for the reader of the header
    Raises InputError: functions of other shapes, or a box, units or steps that are not allowed.
    """

    nominal: casadi.Function
    calibrated: casadi.Function
    lower: Array
    upper: Array
    jacobian_of: casadi.Function | None = None
    jacobian_at: casadi.Function | None = None
    network: NetworkFunction | None = None
    limits: Limits = field(default_factory=Limits)
    steps: int = 2
    units: tuple[str, ...] = ()
    freedom: tuple[int, int] = (3, 3)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _checked_box(self)
        if not 1 <= self.steps <= 10:
            raise InputError(f"{self.steps} least-squares steps; 1 to 10 are allowed")
        n = len(self.lower)
        size = _checked_signature(self.calibrated, n, (3, 12))
        for function, given in ((self.nominal, size), (self.jacobian_of, size), (self.jacobian_at, n)):
            if function is not None:
                _checked_signature(function, n, (given,))
        if self.network is not None and len(self.network.lower) != n:
            raise InputError(f"the network has {len(self.network.lower)} joints and the robot {n}; both must be equal")


# Type of what can be exported as C.
Product = NetworkFunction | Command


def _checked_box(product: Any) -> None:
    """Check box and units of a product, and replace them by float arrays and a complete tuple."""
    lower, upper = (np.array(b, float).ravel() for b in (product.lower, product.upper))
    if lower.shape != upper.shape or len(lower) == 0:
        raise InputError(f"the box has {len(lower)} lower and {len(upper)} upper bounds; give one of each per joint")
    if not (np.isfinite(lower) & np.isfinite(upper) & (lower < upper) & (abs(lower) < 100) & (abs(upper) < 100)).all():
        raise InputError(f"the box {lower} to {upper} must be finite, below 100 rad or m, and not empty")
    units = product.units or ("rad",) * len(lower)
    if len(units) != len(lower) or set(units) - {"rad", "m"}:
        raise InputError(f"units {units}; give rad or m for each of the {len(lower)} joints")
    object.__setattr__(product, "lower", lower)
    object.__setattr__(product, "upper", upper)
    object.__setattr__(product, "units", units)


def _checked_signature(function: casadi.Function, n: int, sizes: tuple[int, ...] | None) -> int:
    """Return a function's number of outputs after checking its numbers of inputs and outputs.

    sizes : numbers of outputs that are allowed; None: any but 0
    """
    n_in = sum(function.numel_in(i) for i in range(function.n_in()))
    n_out = sum(function.numel_out(i) for i in range(function.n_out()))
    if n_in != n or (sizes is not None and n_out not in sizes) or n_out == 0:
        allowed = "some" if sizes is None else " or ".join(map(str, sizes))
        raise InputError(
            f"function {function!s} takes {n_in} numbers and gives {n_out}; expected {n} joint "
            f"angles and {allowed} outputs; fix parameters with a wrapper such as "
            "casadi.Function('p', [q], [f(q, values)])"
        )
    return int(n_out)


def mapped(function: casadi.Function, q: Array) -> Array:
    """Return a CasADi function's outputs at k rows of joints, shape (k, outputs).

    Outputs that are matrices are appended column by column.

    q : joints as the function takes them, shape (k, n) [rad or m]
    """
    out = function.map(len(q)).call([casadi.DM(q.T)])
    columns = [np.array(o).reshape(o.shape[0], -1, len(q), order="F") for o in out]
    return np.hstack([c.transpose(2, 1, 0).reshape(len(q), -1) for c in columns])
