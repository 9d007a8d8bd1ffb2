"""Kinematics of rigid open chains at many poses in numpy, with the Jacobian by their structure.

An elementary rotation about a unit axis w through a point c moves the tool point p by w x (p - c),
an elementary translation along w by w: columns of the geometric Jacobian (Siciliano et al. 2009,
Robotics, section 3.1). They hold for every parameter of the chain as for its joints, and take a
fifth of the operations of automatic differentiation; no symbolic graph is built.
"""

import math
from functools import lru_cache

import numpy as np

from casadical.core.basics import Array
from casadical.robot.kinematics import row_elements
from casadical.robot.parameter_list import PLACEMENT_PARAMETERS


class RigidChain:
    """The chain of an arm without loops, effects and deflections, and with one measured point.

    kinds : of its joints; names : of all its parameters, in their order
    chosen : indices of the parameters of the Jacobian
    """

    def __init__(self, kinds: tuple[str, ...], names: tuple[str, ...], chosen: tuple[int, ...] = ()) -> None:
        """List the elementary transforms in parts; all but the last two end with a joint's own."""
        base, tool = (
            [(k > 2, k % 3, name) for k, name in enumerate(PLACEMENT_PARAMETERS[which])] for which in ("base", "tool")
        )
        parts, after = [], [e for e in base if e[2] in names]
        for i, kind in enumerate(kinds, 1):
            row, at = row_elements(kind, i, names)
            parts.append([*after, *row[: at + 1]])
            after = row[at + 1 :]
        parts += [[*after, *tool[:3]], [e for e in tool[3:] if e[2] in names]]
        index = {name: k for k, name in enumerate(names)}
        column = {names[k]: j for j, k in enumerate(chosen)}
        self.names, self.chosen = names, chosen
        # Of each element: whether it rotates, its axis, and the indices of its parameter and of its
        # column of the Jacobian, -1 for none.
        self._parts = [[(*e[:2], index.get(e[2], -1), column.get(e[2], -1)) for e in part] for part in parts]
        moving = [(rotates, j) for part in self._parts[:-1] for rotates, _, _, j in part if j >= 0]
        order = [j for wanted in (True, False) for rotates, j in moving if rotates is wanted]
        self._rotations, self._moving = sum(rotates for rotates, _ in moving), len(moving)
        # Places of the columns among those of rotations, then translations, then one of zeros.
        places = [order.index(j) if j in order else -1 for j in range(len(chosen))]
        self._places = np.array(places, dtype=int)

    def __call__(
        self,
        q: Array,
        phi: Array,
        constants: Array,
        scale: Array | None = None,
        weight: Array | float = 1.0,
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
        m = self._rotations if factors else 0
        axes, points = np.empty((self._moving if factors else 0, 3, n)), np.empty((m, 3, n))
        *parts, turned = self._parts
        angles = q + np.array([[values[part[-1][2]]] for part in parts[:-1]])
        cosines, sines = np.cos(angles), np.sin(angles)
        F, p, rotations, shifts = np.eye(3)[:, :, None], np.zeros((3, 1)), 0, m
        # Axes and origin relative to F and p, to which the elements since the last joint lead.
        R, t = [nominal[k : k + 3] for k in (0, 3, 6)], nominal[9:12]
        for joint, part in enumerate(parts):
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
        J = moved[self._places] if factors else moved[:0]
        return p, (np.array(R) @ F.reshape(3, -1)).reshape(3, 3, -1), J


# A function of the arguments of `RigidChain` that returns one, cached: many robots share it.
rigid_chain = lru_cache(maxsize=64)(RigidChain)


def _turned(R: list[list[float]], axis: int, angle: float) -> list[list[float]]:
    """Return the three axes of a frame after a rotation about one of them by an angle [rad]."""
    if not angle:
        return R
    c, s, i, j = math.cos(angle), math.sin(angle), (axis + 1) % 3, (axis + 2) % 3
    (x, y, z), (u, v, w), turned = R[i], R[j], [*R]
    turned[i] = [c * x + s * u, c * y + s * v, c * z + s * w]
    turned[j] = [c * u - s * x, c * v - s * y, c * w - s * z]
    return turned
