"""Hand-made Gauss-Newton in numpy: the practical limit without compiled code of one's own.

Batched forward kinematics with the poses along the last axis of every array, the analytic Jacobian from axes and
points (rotation: axis x lever; translation: axis), normal equations. It does one thing only: no bounds, no weights,
no statistics, no choice of parameters - the 27 are written down by hand for this arm.
"""

import numpy as np
from problem import N_IDENTIFIABLE, NOMINAL_DH, PARALLEL_ROWS, Data, frames_start, rigid

NEEDS = {"numpy": "numpy"}
VARIANTS = {"numpy-handmade": {}}


def _link(row, beta):
    """Constant part of a row: rotate alpha about x, shift a along x, rotate beta about the new y."""
    (ca, sa), (cb, sb) = (np.cos(row[0]), np.sin(row[0])), (np.cos(beta), np.sin(beta))
    y = np.array([0.0, ca, sa])
    return np.array([[cb, 0, sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb]]), row[1], y


def _positions(model, q, columns=None):
    """Tool positions (3, n); fills `columns` (axis, point or None) of the Jacobian in the order of `_apply`."""
    base, dh, beta, tool = model
    n = len(q)
    frame = np.repeat(base[:3, :3].T.reshape(9, 1), n, axis=1).reshape(3, 3, n)  # frame[j] is axis j, (3, n)
    origin = np.repeat(base[:3, 3:], n, axis=1)
    for i, (row, angle) in enumerate(zip(dh, q.T, strict=True)):
        if i > 0:  # the base frame stands for the first row
            C, a, y = _link(row, beta[i])
            x_old, o_old = frame[0], origin
            origin = o_old + a * x_old
            if columns is not None:
                columns += [(x_old, o_old), (x_old, None)]
                if i in PARALLEL_ROWS:
                    columns += [(y[1] * frame[1] + y[2] * frame[2], origin)]
            frame = (C.T @ frame.reshape(3, 3 * n)).reshape(3, 3, n)
        c, s = np.cos(angle + row[2]), np.sin(angle + row[2])
        origin = origin + row[3] * frame[2]
        frame = np.stack([c * frame[0] + s * frame[1], c * frame[1] - s * frame[0], frame[2]])
        if columns is not None and 0 < i < 5:
            columns += [(frame[2], origin)] if i in PARALLEL_ROWS else [(frame[2], origin), (frame[2], None)]
    if columns is not None:
        columns += [(axis, None) for axis in frame]
    return origin + np.tensordot(tool, frame, 1)


def _jacobian(p, base, columns):
    """Jacobian (27, 3, n): base translation, base rotation about its origin, then `columns`."""
    J = np.zeros((6 + len(columns), *p.shape))
    x, y, z = p - base[:3, 3:]
    J[0, 0] = J[1, 1] = J[2, 2] = 1.0
    J[3, 1], J[3, 2], J[4, 0], J[4, 2], J[5, 0], J[5, 1] = -z, y, z, -x, -y, x
    for column, (axis, point) in zip(J[6:], columns, strict=True):
        if point is None:
            column[:] = axis
            continue
        x, y, z = p - point
        column[0] = axis[1] * z - axis[2] * y
        column[1] = axis[2] * x - axis[0] * z
        column[2] = axis[0] * y - axis[1] * x
    return J


def _apply(model, step):
    """The model after a Gauss-Newton step (27,)."""
    base, dh, beta, tool = model
    turned = rigid(step[3:6], np.zeros(3))[:3, :3] @ base[:3, :3]
    base = np.block([[turned, base[:3, 3:] + step[:3, None]], [np.zeros((1, 3)), 1.0]])
    dh, beta, k = dh.copy(), beta.copy(), 6
    for i in range(1, 6):
        dh[i, :2] += step[k : k + 2]
        k += 2
        if i in PARALLEL_ROWS:
            beta[i] += step[k]
            dh[i, 2] += step[k + 1]
            k += 2
        elif i < 5:
            dh[i, 2:] += step[k : k + 2]
            k += 2
    return base, dh, beta, tool + step[k:]


def _gauss_newton(model, data: Data, steps: int = 20):
    """Fitted model and the number of steps taken."""
    target = np.ascontiguousarray(data.p.T)
    for done in range(1, steps + 1):
        columns = []
        p = _positions(model, data.q, columns)
        J = _jacobian(p, model[0], columns).reshape(-1, p.size)
        residual = (target - p).ravel()
        gradient = J @ residual
        step = np.linalg.solve(J @ J.T, gradient)
        model = _apply(model, step)
        if gradient @ step < 1e-6 * (residual @ residual):  # the step gains a millionth of the cost at most
            return model, done
    raise RuntimeError(f"no convergence in {steps} steps")


def start(data: Data):
    """Model of the nominal arm with base frame and tool point in closed form."""
    R_base, t_base, tool = frames_start(data)
    first = rigid(np.zeros(3), np.array([0, 0, NOMINAL_DH[0, 3]]))
    base = np.block([[R_base, t_base[:, None]], [np.zeros((1, 3)), 1.0]]) @ first
    dh = data.dh.copy()
    dh[0] = 0.0
    return base, dh, np.zeros(6), tool


class Told:
    """The same problem for a solver that is told the 27 parameters: residuals and Jacobian of a step from the start."""

    def __init__(self, data: Data) -> None:
        self.data, self.start, self.evaluations = data, start(data), 0

    def __call__(self, step):
        """Residuals (3n,) [m] and their Jacobian (3n, 27) at a step (27,) from the start."""
        self.evaluations += 1
        model, columns = _apply(self.start, step), []
        p = _positions(model, self.data.q, columns)
        return (p - self.data.p.T).ravel(), _jacobian(p, model[0], columns).reshape(-1, p.size).T

    def predicted(self, clock, step):
        """Predicted positions (m, 3) [m] of the held-out poses, with notes for the table."""
        clock.note("parameters", N_IDENTIFIABLE)
        clock.note("evaluations", self.evaluations)
        return _positions(_apply(self.start, step), self.data.q_held_out).T


def contend(data, clock):
    """Predicted positions (m, 3) [m] of the held-out poses."""
    with clock("solve"):
        model, steps = _gauss_newton(start(data), data)
    clock.note("parameters", N_IDENTIFIABLE)
    clock.note("iterations", steps)
    return _positions(model, data.q_held_out).T
