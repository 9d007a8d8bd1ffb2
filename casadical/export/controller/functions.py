"""The functions of the joints that a correction is made of: a robot's error curves, its tool, how far two are apart.

The error curves are one function that C calls as a table, in the correction of a command and alone: a curve of 60
harmonics is some 600 operations, a table some 30. The model takes the curves' values as parameters, so that everything
else in it (deflections, other effects) follows the readings, as in the robot.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.sx_instructions import SxInstructions
from casadical.core.transforms import Symbolic
from casadical.effects import Effect, JointErrorCurve
from casadical.effects.base import Context
from casadical.export.c.products import NetworkFunction, mapped
from casadical.robot.robot import Robot

# Evaluated at both ends and subtracted.
_ONE: dict[str, Callable[[ca.SX], ca.SX]] = {
    name: getattr(ca, name) for name in ("fabs", "exp", "tanh", "sign", "tan", "atan", "asin", "acos")
} | {"not": ca.logic_not}
_TWO: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    name: getattr(ca, name) for name in ("fmin", "fmax", "lt", "le", "hypot")
} | {"if_else_zero": lambda a, b: ca.if_else(a, b, ca.SX(0))}
_NOTHING = ca.SX(0), ca.SX(0)


def changed(function: ca.Function, values: Sequence[ca.SX], changes: Sequence[ca.SX]) -> list[ca.SX]:
    """How much each output of a function changes when its inputs do; inputs and their changes as column vectors.

    Operations without a formula here are evaluated twice, and their difference may cancel. Raises InputError for an
    operation that the generated C does not have.
    """
    f = function if function.is_a("SXFunction") else function.expand()
    given = zip(values, changes, strict=True)
    pairs = [list(zip(*map(ca.vertsplit, ends), strict=True)) for ends in given]
    ends = SxInstructions.read(f).evaluate(
        pairs, lambda name: partial(_changed, name), lambda number: (ca.SX(number), ca.SX(0)), zero=_NOTHING
    )
    outputs = [ca.SX.zeros(f.size_out(k)) for k in range(f.n_out())]
    for output, results in zip(outputs, ends, strict=True):
        for k, (_, change) in enumerate(results):
            output.nz[k] = change
    return outputs


def _changed(op: str, first: tuple[ca.SX, ca.SX], second: tuple[ca.SX, ca.SX] = _NOTHING) -> tuple[ca.SX, ca.SX]:
    (a, da), (b, db) = first, second
    if op in ("sin", "cos"):
        return _turned(op == "sin", a, da)
    if op == "sqrt":
        root = ca.sqrt(a)
        return root, da if da.is_zero() else da / (root + ca.sqrt(a + da))
    if op == "atan2":
        if da.is_zero() and db.is_zero():
            return ca.atan2(a, b), ca.SX(0)
        return ca.atan2(a, b), ca.atan2(b * da - a * db, b * (b + db) + a * (a + da))
    if op in ("div", "inv"):
        (a, da), (b, db) = (first, second) if op == "div" else ((ca.SX(1), ca.SX(0)), first)
        return a / b, (da - a / b * db) / (b + db)
    if op in _ONE:
        value = _ONE[op](a)
        return value, ca.SX(0) if da.is_zero() else _ONE[op](a + da) - value
    if op in _TWO:
        value = _TWO[op](a, b)
        return value, ca.SX(0) if da.is_zero() and db.is_zero() else _TWO[op](a + da, b + db) - value
    linear = {
        "add": (a + b, da + db),
        "sub": (a - b, da - db),
        "neg": (-a, -da),
        "twice": (2 * a, 2 * da),
        "assign": (a, da),
        "mul": (a * b, da * (b + db) + a * db),
        "sq": (a * a, da * (2 * a + da)),
    }
    if op not in linear:
        raise InputError(f"operation {op} of CasADi has no formula for its change; the generated C does not have it")
    return linear[op]


def _turned(sine: bool, a: ca.SX, da: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Of sine or cosine: with half of the change, which is small, nothing cancels."""
    s, c = ca.sin(a), ca.cos(a)
    half, other = ca.sin(da / 2), ca.cos(da / 2)
    less, turn = -2 * half * half, 2 * half * other
    return (s, s * less + c * turn) if sine else (c, c * less - s * turn)


ROUNDING = 1e-9  # m or rad


@dataclass(frozen=True)
class GivenAngles(Effect):
    """What is added to each joint is a parameter: `z1`, `z2`, .. [rad]."""

    joints: int = 6

    name = "given_angles"

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        return {f"z{joint}": (1.0, "rad") for joint in range(1, self.joints + 1)}

    def joint_angle(self, context: Context) -> Symbolic:
        return ca.vertcat(*[self.value(context, name) for name in self.sizes()])


def joint_curves(robot: Robot) -> ca.Function | None:
    """joint_curves:(q[n] rad)->(dq[n] rad), which another function calls as a whole; None where the robot has no curve.

    A joint whose coefficients are zero has the constant 0. Raises InputError for a coefficient that is not finite.
    """
    curves = [e for e in robot.effects if isinstance(e, JointErrorCurve)]
    if not curves:
        return None
    values = {p.name: p.value for p in robot.parameters}
    for name in (f"{e.label}.{short}" for e in curves for short in e.sizes()):
        if not np.isfinite(values[name]):
            raise InputError(f"{robot.name}: {name} = {values[name]}; a coefficient of a curve must be a finite number")
    q = ca.SX.sym("q", robot.n)
    context = Context(robot, np.zeros(robot.n), q, {}, values, (), None)
    moved = sum((e.joint_angle(context) for e in curves), ca.SX.zeros(robot.n))
    return ca.Function("joint_curves", [q], [ca.densify(moved)], {"never_inline": True})


def without_curves(robot: Robot) -> Robot:
    return robot.with_only(e for e in robot.effects if not isinstance(e, JointErrorCurve))


def pose_of(robot: Robot, q: ca.SX) -> list[ca.SX]:
    """p[3] [m] and R[3x3] of the tool at the readings q; the error curves are a call of `joint_curves`."""
    curves = joint_curves(robot)
    values = robot.parameters.values
    if curves is None:
        return list(robot.pose.call([q, ca.DM(values)]))
    given = GivenAngles(None, robot.n)
    model = without_curves(robot).with_effect(given)
    names = [f"{given.label}.{name}" for name in given.sizes()]
    phi = ca.SX(model.parameters.values)
    phi[[model.parameters.index_of(name) for name in names]] = curves(q)
    return list(model.pose.call([q, phi]))


def tool_function(
    robot: Robot, name: str, orientation: bool, turn: Array | None = None, network: NetworkFunction | None = None
) -> ca.Function:
    """NAME:(q[n] rad or m)->(p[3] m) or (p[3] m, R[3x3]).

    turn : rotation from the measuring frame, in which the network learned, into the robot's, shape (3, 3); None: none
    """
    q = ca.SX.sym("q", robot.n)
    p, R = pose_of(robot, q)
    if network is not None:
        p = p + 1e-3 * ca.mtimes(ca.DM(np.eye(3) if turn is None else turn), network.function(q))
    return ca.Function(name, [q], [p, R] if orientation else [p], ["q"], ["p", "R"] if orientation else ["p"])


def bent_function(robot: Robot) -> ca.Function:
    """bent:(q[n])->(joints with their deflections [rad or m])."""
    q = ca.SX.sym("q", robot.n)
    soft = ca.DM([j.compliance or 0.0 for j in robot.joints])
    return ca.Function("bent", [q], [q + soft * robot.torque(q, ca.DM(robot.parameters.values))], ["q"], ["bent"])


def difference_function(
    real: Robot, nominal: Robot, orientation: bool, turn: Array, network: NetworkFunction | None
) -> ca.Function:
    """difference:(q[n], dq[n])->(dp[3] m) or (dp, dR[3x3]): the real robot at q + dq less the nominal one at q.

    Nothing cancels (see `changed`): one model, whose parameters and joints change from nominal to real.
    turn, network : as of `tool_function`. Raises InputError where the real robot's model cannot be the nominal one's.
    """
    q, dq = ca.SX.sym("q", real.n), ca.SX.sym("dq", real.n)
    curves = joint_curves(real)
    given = GivenAngles(None, real.n)
    model = real if curves is None else without_curves(real).with_effect(given)
    nominal_values = {p.name: p.value for p in nominal.parameters}
    before = np.array([nominal_values.get(name, 0.0) for name in model.parameters.names])
    _refuse_other(model, before, nominal)
    change = ca.SX(model.parameters.values - before)
    if curves is not None:
        change[[model.parameters.index_of(f"{given.label}.{name}") for name in given.sizes()]] = curves(q + dq)
    dp, dR = changed(model.pose, [q, ca.SX(before)], [dq, change])
    if network is not None:
        dp = dp + 1e-3 * ca.mtimes(ca.DM(turn), network.function(q + dq))
    out = [ca.densify(part) for part in ([dp, dR] if orientation else [dp])]
    return ca.Function("difference", [q, dq], out, ["q", "dq"], ["dp", "dR"][: len(out)])


def _refuse_other(model: Robot, before: Array, nominal: Robot) -> None:
    """Raises InputError where the model with nominal parameters is not the nominal robot."""
    q = ca.SX.sym("q", model.n)
    poses = np.random.default_rng(0).uniform(*nominal.limits, (50, model.n))
    mine, theirs = (
        mapped(ca.Function("pose", [q], pose), poses)
        for pose in (list(model.pose.call([q, ca.DM(before)])), pose_of(nominal, q))
    )
    off = abs(mine - theirs)[np.isfinite(theirs).all(axis=1)]
    if not np.all(off < ROUNDING):
        raise InputError(
            f"{model.name}: its model does not become that of {nominal.name} by its parameters (off by "
            f"{1e3 * np.max(off):.3g} mm), which --precise needs: leave it out, or give --tool shared"
        )
