"""Damped least-squares steps that correct a joint command (chord method), as CasADi SX functions.

They are written once, for all target languages. With J the Jacobian at the commanded joints and L D
L^T = J J^T + lambda^2 I, factored once, each step solves L D L^T y = r for the residual r and moves
the joints by J^T y. After the last step the model is evaluated again, so that the status is based
on the remaining error itself and not on an estimate; the step that follows from this evaluation
costs next to nothing and is taken too if the last one reduced the error to a third or less.

Where the joints cannot reach every orientation, the position has priority: P = I - J^T (J J^T +
lambda^2 I)^-1 J projects joint motions onto those that keep the position, and a second
least-squares problem corrects the orientation as far as these reach (task priority; Nakamura,
Hanafusa and Yoshikawa 1987). The orientation's error is then the rotation that the next step would
still make.
"""

import casadi
from casadi import SX

from casadical.export.c.products import Command

# Length that converts an orientation error [rad] to the scale of a position error [m].
ORIENTATION_LENGTH_M = 0.3


def prepare(command: Command) -> casadi.Function:
    """Return the CasADi function that prepares a correction: q[n] -> prepared, one vector.

    It has the nominal pose, the factored Jacobian (see `_Step.factored`), the weakness (large near
    a singular pose), and the calibrated pose; q : commanded joints [rad or m].
    """
    q = SX.sym("q", len(command.lower))
    step = _step(command)
    function = command.jacobian_of if command.jacobian_of is not None else command.calibrated
    at = q if command.jacobian_at is None else _flat(command.jacobian_at, q)
    # The mean of both robots' Jacobians is close to the trapezoidal rule along the step and has
    # half the error of a single one.
    mean = 0.5 * (_slope(command, function, at) + _slope(command, command.nominal, q))
    factors, weakness = step.factored(mean)
    out = [_flat(command.nominal, q), factors, weakness, _flat(command.calibrated, q)]
    return casadi.Function("prepare", [q], [casadi.densify(casadi.vertcat(*out))], ["q"], ["prepared"])


def prepared_size(command: Command) -> int:
    """Return the number of entries of `prepare`'s output before the calibrated pose."""
    return pose_size(command) + _step(command).size + 1


def advance(command: Command) -> casadi.Function:
    """Return the CasADi function of one step: (prepared, calibrated pose) -> moved[n + 1].

    `moved` is the joint step, shape (n,) [rad or m], and as its last entry the squared error before
    it [m^2]; `prepared` is the output of `prepare` before its calibrated pose.
    """
    size, step = pose_size(command), _step(command)
    prepared, now = SX.sym("prepared", prepared_size(command)), SX.sym("now", size)
    target, factors, _ = casadi.vertsplit(prepared, [0, size, size + step.size, size + step.size + 1])
    moved, error = step.solved(factors, residual(target, now))
    return casadi.Function("advance", [prepared, now], [casadi.vertcat(moved, error)], ["prepared", "now"], ["moved"])


def residual_size(command: Command) -> int:
    """Return the number of residuals: 3 for positions, 6 for poses."""
    return 3 if command.calibrated.numel_out(0) == 3 and command.calibrated.n_out() == 1 else 6


def pose_size(command: Command) -> int:
    """Return the size of a pose vector: 3 for positions, 12 with the rotation's columns."""
    return 3 if residual_size(command) == 3 else 12


def _step(command: Command) -> "_Step":
    """Return the form of the least-squares step that suits a command.

    Where the joints cannot reach all six directions of a pose, it corrects the position first.
    """
    n, damping, (position, orientation) = len(command.lower), command.limits.damping**2, command.freedom
    if residual_size(command) == 6 and position + orientation < 6:
        return _PositionFirst(n, 6, damping, position, orientation)
    return _Step(n, residual_size(command), damping, position)


class _Step:
    """Damped least-squares step of m residuals and n joints.

    damping : lambda^2 [m^2/rad^2]
    reached : number of directions, of 3, in which the joints move the tool
    """

    def __init__(self, n: int, m: int, damping: float, reached: int) -> None:
        self.n, self.m, self.damping, self.reached = n, m, damping, reached

    @property
    def size(self) -> int:
        """Return the length of `factored`'s vector: J, L below its diagonal, inverted pivots."""
        return self.m * self.n + _factor_size(self.m)

    def factored(self, J: SX) -> tuple[SX, SX]:
        """Return a Jacobian J, (m, n), and its factors as one vector, and the weakness [rad^2/m^2].

        The weakness is the trace of (J J^T + lambda^2 I)^-1 without unreachable directions: about 1
        / (smallest singular value)^2 near a singular pose.
        """
        L, inverse = self._factors(J)
        lost = 3 - self.reached
        weakness = _weakness(L, inverse)
        return casadi.vertcat(casadi.vec(J), _packed(L, inverse)), weakness - lost / self.damping if lost else weakness

    def _factors(self, J: SX) -> tuple[SX, SX]:
        """Return the factors of J J^T + lambda^2 I, see `_factored`."""
        return _factored(casadi.mtimes(J, J.T) + self.damping * SX.eye(J.shape[0]), self.damping / 2)

    def solved(self, factors: SX, r: SX) -> tuple[SX, SX]:
        """Return the joint step (n,) for a residual r (m,) [m], and its squared norm [m^2].

        Unless the tool moves in all directions, it is that of the reachable part, J times the step.
        """
        J = casadi.reshape(factors[: self.m * self.n], self.m, self.n)
        moved = casadi.mtimes(J.T, _solved(*_factors_of(factors[self.m * self.n :], self.m), r))
        return moved, casadi.sumsqr(r if self.reached == 3 else casadi.mtimes(J, moved))


class _PositionFirst(_Step):
    """Least-squares step that corrects the position, then the orientation.

    turned : number of directions about which the joints can rotate the tool at a fixed position
    """

    def __init__(self, n: int, m: int, damping: float, reached: int, turned: int) -> None:
        super().__init__(n, m, damping, reached)
        self.turned = turned

    @property
    def size(self) -> int:
        """Return the length of `factored`'s vector: J, two factors of 3 rows, and P (J_o P)^T."""
        return (self.m + 3) * self.n + 2 * _factor_size(3)

    def factored(self, J: SX) -> tuple[SX, SX]:
        """Return J with the factors of the position and orientation problems, and the weakness.

        J and the factors are one vector of `size` numbers. The weakness is the sum of those of
        position and orientation, without unreachable directions [rad^2/m^2].

        J : Jacobian of position and scaled orientation by the joints, shape (6, n)
        """
        Jp, Jo = J[:3, :], J[3:, :]
        L, inverse = self._factors(Jp)
        G = self._projected(Jp, L, inverse, Jo.T).T
        M, inverse_o = self._factors(G)
        back = self._projected(Jp, L, inverse, G.T)
        lost = 6 - self.reached - self.turned
        weakness = _weakness(L, inverse) + _weakness(M, inverse_o) - lost / self.damping
        return casadi.vertcat(casadi.vec(J), _packed(L, inverse), _packed(M, inverse_o), casadi.vec(back)), weakness

    def solved(self, factors: SX, r: SX) -> tuple[SX, SX]:
        """Return the joint step, (n,) [rad or m], and the squared norm of r's reachable part [m^2].

        factors : vector of `factored` at these joints
        r : residual of position and, times a length, of orientation, shape (6,) [m]
        """
        n, m, f = self.n, self.m, _factor_size(3)
        parts = casadi.vertsplit(factors, [0, m * n, m * n + f, m * n + 2 * f, (m + 3) * n + 2 * f])
        J = casadi.reshape(parts[0], m, n)
        (L, inverse), (M, inverse_o) = _factors_of(parts[1], 3), _factors_of(parts[2], 3)
        first = casadi.mtimes(J[:3, :].T, _solved(L, inverse, r[:3]))
        rest = r[3:] - casadi.mtimes(J[3:, :], first)
        moved = first + casadi.mtimes(casadi.reshape(parts[3], n, 3), _solved(M, inverse_o, rest))
        position_error = r[:3] if self.reached == 3 else casadi.mtimes(J[:3, :], moved)
        return moved, casadi.sumsqr(casadi.vertcat(position_error, casadi.mtimes(J[3:, :], moved)))

    @staticmethod
    def _projected(Jp: SX, L: SX, inverse: SX, v: SX) -> SX:
        """Return P v, shape (n, 3): joint motions v projected onto those that keep the position.

        Jp : Jacobian of the position, (3, n); L, inverse : its factors, see `_factored`
        """
        y = casadi.horzcat(*[_solved(L, inverse, casadi.mtimes(Jp, v[:, k])) for k in range(v.shape[1])])
        return v - casadi.mtimes(Jp.T, y)


def _flat(function: casadi.Function, q: SX) -> SX:
    """Return all outputs of a function at joints q as one column, matrices column by column."""
    return casadi.vertcat(*[casadi.vec(out) for out in function.call([q])])


def residual(target: SX, now: SX) -> SX:
    """Return the residual of a target: position error [m], then for poses the scaled rotation [m].

    It has 3 or 6 entries. The rotation vector is the one from `now` to `target` (small angles),
    times `ORIENTATION_LENGTH_M`.

    target, now : position [m] and, for poses, the columns of the rotation matrix, 3 or 12 entries,
        both in one frame
    """
    if target.numel() == 3:
        return target - now
    columns = (slice(3 + 3 * k, 6 + 3 * k) for k in range(3))
    turn = sum((casadi.cross(now[i], target[i]) for i in columns), SX.zeros(3))
    return casadi.vertcat(target[:3] - now[:3], 0.5 * ORIENTATION_LENGTH_M * turn)


def _slope(command: Command, function: casadi.Function, at: SX) -> SX:
    """Return the Jacobian of minus the residual, (m, n), by the joints of a pose function.

    It is taken at joints `at`, shape (n,), and is that of the pose in the residual's scale.
    """
    x, fixed = SX.sym("x", len(command.lower)), SX.sym("fixed", pose_size(command))
    now = _flat(function, x)
    slope = casadi.jacobian(-residual(fixed, now), x)
    return casadi.Function("slope", [x, fixed], [slope])(at, _flat(function, at))


def _factored(A: SX, floor: float) -> tuple[SX, SX]:
    """Return unit lower triangular L and inverted pivots of A = L D L^T, (m, m) and (m,)."""
    m = A.shape[0]
    L, d, inverse = SX.eye(m), SX.zeros(m), SX.zeros(m)
    for j in range(m):
        scaled = [L[j, k] * d[k] for k in range(j)]
        d[j] = casadi.fmax(A[j, j] - sum((L[j, k] * scaled[k] for k in range(j)), SX(0)), floor)
        inverse[j] = 1 / d[j]
        for i in range(j + 1, m):
            L[i, j] = (A[i, j] - sum((L[i, k] * scaled[k] for k in range(j)), SX(0))) * inverse[j]
    return L, inverse


def _weakness(L: SX, inverse: SX) -> SX:
    """Return the trace of A^-1 for A = L D L^T, an upper bound of 1 / (smallest eigenvalue of A).

    L : unit lower triangular, shape (m, m); inverse : 1 / diagonal of D, shape (m,)
    """
    m = L.shape[0]
    columns = [_forward_solve(L, SX.eye(m)[:, j]) for j in range(m)]
    return sum((c[i] * c[i] * inverse[i] for j, c in enumerate(columns) for i in range(j, m)), SX(0))


def _forward_solve(L: SX, b: SX) -> SX:
    """Return the solution y of L y = b, shape (m,), with L unit lower triangular, shape (m, m)."""
    y = SX(b)
    for i in range(b.numel()):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
    return y


def _solved(L: SX, inverse: SX, r: SX) -> SX:
    """Return the solution y of L D L^T y = r, shape (m,).

    L : unit lower triangular, shape (m, m); inverse : 1 / diagonal of D, shape (m,)
    """
    y = _forward_solve(L, r) * inverse
    m = L.shape[0]
    for i in reversed(range(m)):
        for k in range(i + 1, m):
            y[i] -= L[k, i] * y[k]
    return y


def _below(m: int) -> list[tuple[int, int]]:
    """Return the places (row, column) of an m x m matrix below its diagonal, column by column."""
    return [(i, j) for j in range(m) for i in range(j + 1, m)]


def _factor_size(m: int) -> int:
    """Return the length of `_packed`'s vector for m rows, m (m + 1) / 2."""
    return m * (m - 1) // 2 + m


def _packed(L: SX, inverse: SX) -> SX:
    """Return the entries of L below its diagonal, then the inverted pivots 1 / D, as one vector."""
    return casadi.vertcat(*[L[i, j] for i, j in _below(L.shape[0])], inverse)


def _factors_of(packed: SX, m: int) -> tuple[SX, SX]:
    """Return L, (m, m), and the inverted pivots 1 / D, (m,), from a vector of `_packed`."""
    L = SX.eye(m)
    for value, (i, j) in zip(casadi.vertsplit(packed)[: len(_below(m))], _below(m), strict=True):
        L[i, j] = value
    return L, packed[len(_below(m)) :]
