"""The symbolic model of a robot: chain, loops, gravity torques, compliance and effects in CasADi.

The deflection is added to the joint variables inside the kinematics, not through the linearised J
dtheta of the paper's eq. 5. Torques are those at the pose after one deflection step: the remaining
distance to equilibrium is of third order in the compliance.

A rigid open chain needs no symbolic graph: an elementary rotation about a unit axis w through a
point c moves the tool point p by w x (p - c), an elementary translation along w by w, columns of
the geometric Jacobian (Siciliano et al. 2009, Robotics, section 3.1). They hold for every parameter
of the chain as for its joints, and take a fifth of the operations of automatic differentiation.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from casadical.core.basics import Array
from casadical.core.mapped_function import MappedFunction
from casadical.core.parameters import Parameters
from casadical.core.parts import GRAVITY_COLUMNS, Arm
from casadical.core.transforms import Symbolic, carry, product, rot_x, rot_y, rot_z, small_frame, translate
from casadical.effects import Context, Effect
from casadical.robot import kinematics
from casadical.robot.kinematics import row_elements
from casadical.robot.parameter_list import PLACEMENT_PARAMETERS


@dataclass(frozen=True, eq=False)
class Expressions:
    """Symbols and expressions that all robots of one structure share; see `Model`.

    q, w, phi : symbols of the joint variables (n,), the conditions (k,) and the parameters (P,)
    constants : symbols of numbers that are no parameters and differ between robots of one structure
        (see `constants_of`)
    loaded : symbols of the parameters at which gravity torques are evaluated, shape (P,), separate
        from phi for fixed loads
    p, R, tau, margin : expressions of tool position and orientation in the measuring frame, gravity
        torques, and the margin of each loop (see `Model`)
    functions : cache of what `function` returns
    """

    q: ca.SX
    w: ca.SX
    phi: ca.SX
    constants: ca.SX
    loaded: ca.SX
    p: ca.SX
    R: ca.SX
    tau: ca.SX
    margin: ca.SX
    functions: dict[tuple[str, ...], ca.Function] = field(default_factory=dict)

    def function(self, *outputs: str) -> ca.Function:
        """Return the CasADi function (q, w, phi, constants, loaded) -> outputs, cached.

        Inputs and outputs are the class's fields of these names.

        outputs : names out of p, R, tau and margin
        """
        if outputs not in self.functions:
            inputs = {n: getattr(self, n) for n in ("q", "w", "phi", "constants", "loaded")}
            results = [getattr(self, o) for o in outputs]
            made = ca.Function("model", list(inputs.values()), results, list(inputs), list(outputs))
            self.functions[outputs] = made
        return self.functions[outputs]

    @lru_cache(maxsize=64)  # noqa: B019 - expressions live in a cache themselves
    def mapped(self, *outputs: str) -> MappedFunction:
        """Return the function of many poses: (q, w) of each and shared (phi, constants) -> outputs.

        Gravity torques are those at phi.

        outputs : names out of p, R, tau and margin
        """
        of_pose, shared = ca.vertcat(self.q, self.w), ca.vertcat(self.phi, self.constants)
        results = self.function(*outputs).call([self.q, self.w, self.phi, self.constants, self.phi])
        return MappedFunction("model", of_pose, shared, results)


@dataclass(frozen=True, eq=False)
class Model:
    """The symbolic model of one robot, from which functions are made.

    arm : the robot's parts
    q : joint variables (n,) [rad or m]; w : conditions (k,), the logged columns that it uses; phi :
        parameters (P,) [SI]
    p, R : position (3,) [m] and orientation (3, 3) of the tool frame in the measuring frame
    tau : gravity torques (n,) [N m or N]; margin : of each four-bar (see `kinematics.loop_margin`)
    declared : values of the conditions where nothing was logged, shape (k,)
    constants : numbers that are no parameters, see `constants_of`; structure : of the robot
    """

    arm: Arm
    declared: Array
    constants: Array
    structure: "Structure"

    @cached_property
    def shared(self) -> Expressions:
        """Return the expressions of all robots of this structure, with loads at phi."""
        return expressions(self.structure, False)

    @property
    def q(self) -> ca.SX:
        """Return the symbol of the actuated joint variables, shape (n,) [rad or m]."""
        return self.shared.q

    @property
    def w(self) -> ca.SX:
        """Return the symbol of the conditions (logged columns), shape (k,) [own units]."""
        return self.shared.w

    @property
    def phi(self) -> ca.SX:
        """Return the symbol of the parameters, shape (P,) [SI]."""
        return self.shared.phi

    @cached_property
    def p(self) -> ca.SX:
        """Return the expression of the tool position in the measuring frame, shape (3,) [m]."""
        return self._expression("p")

    @cached_property
    def R(self) -> ca.SX:
        """Return the expression of the tool orientation in the measuring frame, shape (3, 3)."""
        return self._expression("R")

    @cached_property
    def margin(self) -> ca.SX:
        """Return the expression of each four-bar's margin (see `kinematics.loop_margin`), (loops,)."""
        return self._expression("margin")

    def _expression(self, name: str) -> ca.SX:
        """Return the output of this name (p, R, tau or margin) as an expression of q, w and phi."""
        return self.function(name, (name,))(self.q, self.w, self.phi)

    def function(self, name: str, outputs: tuple[str, ...]) -> ca.Function:
        """Return the CasADi function name:(q, w, phi)->outputs.

        Its arguments are joint variables [rad or m], conditions [own units] and parameters [SI].

        name : of the function; outputs : names out of p, R, tau and margin
        """
        whole = self.shared.function(*outputs)
        results = whole.call([self.q, self.w, self.phi, ca.DM(self.constants), self.phi])
        return ca.Function(name, [self.q, self.w, self.phi], results, ["q", "w", "phi"], list(outputs))

    def at_declared(self, name: str, outputs: tuple[str, ...]) -> ca.Function:
        """Return the CasADi function name:(q, phi)->outputs, every condition at its declared value.

        name : of the function; outputs : names out of p, R, tau and margin
        """
        results = self.function(name, outputs).call([self.q, ca.DM(self.declared), self.phi])
        return ca.Function(name, [self.q, self.phi], results, ["q", "phi"], list(outputs))

    def evaluate(self, outputs: tuple[str, ...], q: Array, w: Array, phi: Array) -> list[Array]:
        """Return the outputs at n poses, an array each, whose columns are those of the poses.

        The shapes are (3, n) for p, (3, 3 n) for R, (joints, n) for tau, (loops, n) for margin.

        q : joint variables, shape (n, joints) [rad or m]; w : conditions, shape (n, k)
        phi : parameters, shape (P,) [SI]
        """
        if set(outputs) <= {"p", "R"} and is_rigid(self.structure, phi):
            kinds = tuple(joint.kind for joint in self.arm.joints)
            chain = rigid_chain(kinds, self.structure.parameters.names)
            p, F, _ = chain(q.T, phi, self.constants)
            return [p if name == "p" else F.transpose(1, 2, 0).reshape(3, -1) for name in outputs]
        points, shared = np.concatenate([q, w], axis=1).T, np.concatenate([phi, self.constants])
        return self.shared.mapped(*outputs)(points, shared)


def constants_of(arm: Arm, torque_scale: Array) -> Array:
    """Return the constants of the expressions: nominal frames and torque scales, shape (24 + n,).

    The frames are T_M0 (base in the measuring frame) and T_nE (tool in the flange frame), their
    upper three rows column by column [m].

    torque_scale : peak gravity torques, shape (n,) [N m or N], which only effects use
    """
    return np.concatenate([*(T[:3].ravel(order="F") for T in (arm.base.T, arm.tool.T)), torque_scale])


@dataclass(frozen=True, eq=False)
class Structure:
    """The parts of which a model is composed.

    Structures of robots with the same parts are equal, even if the robots differ in numbers that
    enter as parameters or constants.

    arm, parameters, effects : of a robot with this structure
    conditions : names of the logged columns that it uses
    """

    arm: Arm
    parameters: Parameters
    effects: tuple[Effect, ...]
    conditions: tuple[str, ...]

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Return the data that decide on the symbolic model, as a hashable tuple."""
        arm = self.arm
        joints = tuple(
            (j.kind, j.beta is None, j.b is None, j.compliance is None, j.body and (j.body.mass, *j.body.com))
            for j in arm.joints
        )
        sides = tuple(sorted(kinematics.assembly_sides(arm).items()))
        loops = tuple((loop.driven, loop.carrier, loop.offset) for loop in arm.loops)
        payload = arm.payload and (arm.payload.mass, *arm.payload.com)
        gravity = (*arm.gravity, arm.gravity_frame)
        return (
            joints,
            sides,
            loops,
            payload,
            gravity,
            arm.base.unknown,
            arm.tool.unknown,
            self.conditions,
            self.parameters.names,
            self.effects,
        )

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Structure) and self.key == other.key


def is_rigid(structure: Structure, phi: Array, chosen: Iterable[int] = ()) -> bool:
    """Return whether a robot is a `rigid_chain`: no loops, targets, effects or deflections.

    phi : values of its parameters, shape (P,) [SI]
    chosen : indices of parameters that may change; with a compliance among them it is False
    """
    arm = structure.arm
    if arm.loops or arm.targets or structure.effects:
        return False
    soft = {k for k, p in enumerate(structure.parameters) if p.group == "compliance"}
    return not (soft.intersection(chosen) or phi[[*soft]].any())


@lru_cache(maxsize=64)
def expressions(structure: Structure, fixed_loads: bool) -> Expressions:
    """Return the expressions of a structure, composed once for all robots that share it.

    fixed_loads : whether gravity torques are at the separate symbols `loaded`, for the nominal
        geometry, not at phi. Strictly, a longer last link also carries its load farther out; the
        masses are too uncertain to distinguish the link from the tool by that.
    """
    arm, effects, names = structure.arm, structure.effects, structure.parameters.names
    q = ca.SX.sym("q", arm.n)
    w = ca.SX.sym("w", len(structure.conditions))
    phi = ca.SX.sym("phi", len(names))
    loaded = ca.SX.sym("loaded", len(names))
    constants = ca.SX.sym("constants", 24 + arm.n)
    last_row = ca.DM([[0, 0, 0, 1]])
    base, tool = (ca.vertcat(ca.reshape(constants[k : k + 12], 3, 4), last_row) for k in (0, 12))
    values: dict[str, Symbolic] = dict(zip(names, ca.vertsplit(phi), strict=True))
    conditions = dict(zip(structure.conditions, ca.vertsplit(w) if structure.conditions else [], strict=True))

    at = dict(zip(names, ca.vertsplit(loaded), strict=True)) if fixed_loads else values
    unloaded = replace(rigid_context(arm, constants[24:], q, conditions, at, base), values=values)
    tau = kinematics.gravity_torques(unloaded, sum(e.energy(unloaded) for e in effects))
    context = replace(unloaded, torque=tau)
    factors = [base_frame(arm, values, base), *_to_tool(arm, effects, tool, context)]
    T_ME, point = product(factors), carry(factors, ca.SX.zeros(3))
    for effect in effects:
        point = effect.measurement(point, context)
    margin = ca.vertcat(*kinematics.loop_margins(arm, ca.vertsplit(q), values)) if arm.loops else ca.SX.zeros(0)
    return Expressions(q, w, phi, constants, loaded, ca.SX(point), ca.SX(T_ME[:3, :3]), ca.SX(tau), ca.SX(margin))


def rigid_context(
    arm: Arm,
    torque_scale: Symbolic,
    q: Symbolic,
    conditions: Mapping[str, Symbolic],
    values: Mapping[str, Symbolic],
    base: Symbolic,
) -> Context:
    """Return the context of effects with link frames of rigid joints, without torques.

    torque_scale : peak gravity torque of each joint, shape (n,) [N m or N]
    q : joint variables; conditions : logged column -> symbol; values : parameter -> symbol [SI]
    base : nominal T_M0, shape (4, 4) [m]
    """
    gravity = gravity_in_base(arm, base_frame(arm, values, base), conditions)
    rigid = kinematics.link_frames(arm, ca.vertsplit(q), values)
    return Context(arm, torque_scale, q, conditions, values, rigid, gravity)


def gravity_in_base(arm: Arm, T_M0: Symbolic, conditions: Mapping[str, Symbolic]) -> Symbolic:
    """Return gravity in the robot's base frame, shape (3,) [m/s^2].

    Logged gravity is in the base frame; only its direction is used, with the declared magnitude.

    T_M0 : base frame in the measuring frame, shape (4, 4) [m], for gravity declared in the latter
    """
    gravity = ca.DM(arm.gravity)
    if arm.gravity_frame == "logged":
        down = ca.vertcat(*(conditions[name] for name in GRAVITY_COLUMNS))
        return ca.norm_2(gravity) * down / ca.norm_2(down)
    return T_M0[:3, :3].T @ gravity if arm.gravity_frame == "measuring" else gravity


def base_frame(arm: Arm, values: kinematics.Values, T: Symbolic) -> Symbolic:
    """Return T_M0, the robot's base frame in the measuring frame, shape (4, 4) [m].

    values : parameter -> value [SI], of which those of the base are used, if it is unknown
    T : nominal T_M0, shape (4, 4) [m]
    """
    if arm.base.unknown == "none":
        return T
    return T @ small_frame(*(values.get(name, 0.0) for name in PLACEMENT_PARAMETERS["base"]))


def _to_tool(arm: Arm, effects: tuple[Effect, ...], nominal: Symbolic, context: Context) -> list[Symbolic]:
    """Return the transforms whose product is T_0E, the tool frame in the robot's base frame.

    They are those of effects at the base, of each row, whose variable has deflections and effects
    added, with effects at its link, of effects at the tool, and of the tool itself.

    nominal : constant part of the tool frame in the flange frame, shape (4, 4) [m]
    """
    values = context.values
    moved = context.q + kinematics.deflections(arm, context.torque, values)
    for effect in effects:
        moved = moved + effect.joint_angle(context)
    factors = [effect.base(context) for effect in effects]
    for i, row in enumerate(kinematics.chain_factors(arm, ca.vertsplit(moved), values), 1):
        factors += [*row, *(effect.link(i, context) for effect in effects)]
    return [*factors, *(effect.tool(context) for effect in effects), *_tool(arm, nominal, values, context.conditions)]


def _tool(arm: Arm, nominal: Symbolic, values: kinematics.Values, conditions: Mapping[str, Symbolic]) -> list[Symbolic]:
    """Return the transforms whose product is the tool frame in the flange frame.

    Its origin is the measured point; of several it is the one that the pose's logged columns name.

    nominal : of the first tool in the flange frame, shape (4, 4) [m]
    """
    first = [values.get(f"tool_{c}", nominal[k, 3]) for k, c in enumerate("xyz")]
    x, y, z = (
        v + sum(conditions[t.column] * (values[t.parameters[k]] - v) for t in arm.targets) for k, v in enumerate(first)
    )
    turn = ca.horzcat(nominal[:, :3], ca.DM([0, 0, 0, 1]))
    turns = [
        make(values[f"tool_{c}"]) for make, c in ((rot_x, "rx"), (rot_y, "ry"), (rot_z, "rz")) if f"tool_{c}" in values
    ]
    return [translate(x, y, z), turn, *turns]


@lru_cache(maxsize=64)
def rigid_chain(
    kinds: tuple[str, ...], names: tuple[str, ...], chosen: tuple[int, ...] = ()
) -> Callable[..., tuple[Array, Array, Array]]:
    """Return the function `chain` of an arm without loops, effects, deflections and further targets.

    It is cached, because many robots share it.

    kinds : of its joints; names : of all its parameters, in their order
    chosen : indices of the parameters of the Jacobian
    """
    base, tool = (
        [(k > 2, k % 3, name) for k, name in enumerate(PLACEMENT_PARAMETERS[which])] for which in ("base", "tool")
    )
    # Elementary transforms in parts, of which all but the last two end with a joint's own.
    parts, after = [], [e for e in base if e[2] in names]
    for i, kind in enumerate(kinds, 1):
        row, at = row_elements(kind, i, names)
        parts.append([*after, *row[: at + 1]])
        after = row[at + 1 :]
    parts += [[*after, *tool[:3]], [e for e in tool[3:] if e[2] in names]]
    index = {name: k for k, name in enumerate(names)}
    column = {names[k]: j for j, k in enumerate(chosen)}
    # Of each element: whether it rotates, its axis, and the indices of its parameter and of its
    # column of the Jacobian, -1 for none.
    elements = [[(*e[:2], index.get(e[2], -1), column.get(e[2], -1)) for e in part] for part in parts]
    moving = [(rotates, j) for part in elements[:-1] for rotates, _, _, j in part if j >= 0]
    order = [j for wanted in (True, False) for rotates, j in moving if rotates is wanted]
    rotating, movable = sum(rotates for rotates, _ in moving), len(moving)
    # Places of the columns among those of rotations, then translations, then one of zeros.
    places = np.array([order.index(j) if j in order else -1 for j in range(len(chosen))], dtype=int)

    def chain(
        q: Array, phi: Array, constants: Array, scale: Array | None = None, weight: Array | float = 1.0
    ) -> tuple[Array, Array, Array]:
        """Return positions (3, n) [m], axes of the tool frame (3, 3, n), and the Jacobian.

        Of the axes the first index is that of the axis, the second of its coordinate in the
        measuring frame. The Jacobian of the position by the chosen parameters, shape (chosen, n, 3)
        [m per SI unit, times the factors], is empty, (0, n, 3), without `scale`.

        q : joint variables, shape (joints, n) [rad or m]; phi : parameters, shape (P,) [SI]
        constants : of the model (see `constants_of`)
        scale, weight : factors of each parameter, (chosen,), and pose, (n,), on the Jacobian
        """
        n, values, nominal = q.shape[1], phi.tolist(), constants.tolist()
        factors: list[float] = [] if scale is None else scale.tolist()
        m = rotating if factors else 0
        axes, points = np.empty((movable if factors else 0, 3, n)), np.empty((m, 3, n))
        *moving_parts, turned = elements
        angles = q + np.array([[values[part[-1][2]]] for part in moving_parts[:-1]])
        cosines, sines = np.cos(angles), np.sin(angles)
        F, p, rotations, shifts = np.eye(3)[:, :, None], np.zeros((3, 1)), 0, m
        # Axes and origin relative to F and p, to which the elements since the last joint lead.
        R, t = [nominal[k : k + 3] for k in (0, 3, 6)], nominal[9:12]
        for joint, part in enumerate(moving_parts):
            about, through, along = list[list[float]](), list[list[float]](), list[list[float]]()
            for place, (rotates, axis, k, column) in enumerate(part, 1):
                x, y, z = R[axis]
                if column >= 0 and factors:
                    f = factors[column]
                    (about if rotates else along).append([f * x, f * y, f * z])
                    if rotates:
                        through.append(t)
                if joint < len(q) and place == len(part):
                    break
                value = values[k] if k >= 0 else nominal[21 + axis]
                if rotates:
                    R = _turned(R, axis, value)
                else:
                    t = [t[0] + value * x, t[1] + value * y, t[2] + value * z]
            a, b = len(about), len(along)
            rows = np.array([*about, *through, *along, *R, t])
            world = (rows @ F.reshape(3, -1)).reshape(len(rows), 3, -1)
            axes[rotations : rotations + a] = world[:a]
            axes[shifts : shifts + b] = world[2 * a : 2 * a + b]
            points[rotations : rotations + a] = world[a : 2 * a] + p
            rotations, shifts, F, p = rotations + a, shifts + b, world[-4:-1], p + world[-1]
            if joint == len(q):
                break
            if rotates:
                c, s, i, j = cosines[joint], sines[joint], (axis + 1) % 3, (axis + 2) % 3
                before, F = F, np.empty((3, 3, n))
                F[axis], F[i] = before[axis], c * before[i] + s * before[j]
                F[j] = c * before[j] - s * before[i]
            else:
                p = p + angles[joint] * F[axis]
            R, t = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 0.0]
        R = [nominal[k : k + 3] for k in (12, 15, 18)]
        for _, axis, k, _ in turned:
            R = _turned(R, axis, values[k])
        moved = np.zeros((len(axes) + 1, n, 3))
        axes *= weight
        (x, y, z), (u, v, w) = axes[:m].transpose(1, 0, 2), (p - points).transpose(1, 0, 2)
        for k, (a, b, c, d) in enumerate(((y, w, z, v), (z, u, x, w), (x, v, y, u))):
            np.subtract(a * b, c * d, out=moved[:m, :, k])
        moved[m:-1] = axes[m:].transpose(0, 2, 1)
        J = moved[places] if factors else moved[:0]
        return p, (np.array(R) @ F.reshape(3, -1)).reshape(3, 3, -1), J

    return chain


def _turned(R: list[list[float]], axis: int, angle: float) -> list[list[float]]:
    """Return the three axes of a frame after a rotation about one of them by an angle [rad]."""
    if not angle:
        return R
    c, s, i, j = math.cos(angle), math.sin(angle), (axis + 1) % 3, (axis + 2) % 3
    (x, y, z), (u, v, w), turned = R[i], R[j], [*R]
    turned[i] = [c * x + s * u, c * y + s * v, c * z + s * w]
    turned[j] = [c * u - s * x, c * v - s * y, c * w - s * z]
    return turned
