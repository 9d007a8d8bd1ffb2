"""Hand-made CasADi + Ipopt, from what one writes in an afternoon to what one writes after reading the profile.

All four free the 27 parameters written down by hand for this arm. "sx": one SX graph that grows with the poses, exact
Hessian. "map-exact": one position function, `map` over the poses, what `nlpsol` does by default. "map-naive": the
same with J'J of `jacobian(residual)` as Hessian. "map-tuned": cost, gradient and J'J differentiated for one pose and
summed by `map`, variables in millimetres and milliradians; the others are in metres and radians.
"""

import casadi as ca
import numpy as np
from problem import PARALLEL_ROWS, Data, frames_start

NEEDS = {"casadi": "casadi"}
VARIANTS = {
    "casadi-sx": {"style": "sx"},
    "casadi-map-exact": {"style": "map-exact"},
    "casadi-map-naive": {"style": "map-naive"},
    "casadi-map-tuned": {"style": "map-tuned"},
}
IPOPT = {"print_level": 0, "sb": "yes", "tol": 1e-6}


def _transform(R, t):
    return ca.vertcat(ca.horzcat(R, t), ca.DM([[0, 0, 0, 1]]))


def _rotation(axis, angle):
    c, s = ca.cos(angle), ca.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = ca.SX.eye(3)
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -s, s
    return R


def position_function(dh, scale):
    """position:(q[6],phi[27])->(p[3]); phi are deviations from the start, in units of `scale` metres or radians.

    The start itself is a third input: base rotation, base translation and tool point, column after column (15).
    """
    q, phi, start = ca.SX.sym("q", 6), ca.SX.sym("phi", 27), ca.SX.sym("start", 15)
    free = iter(scale * phi[k] for k in range(27))
    shift = ca.vertcat(*(next(free) for _ in range(3)))
    turn = ca.mtimes([_rotation(axis, next(free)) for axis in "zyx"])
    T = _transform(turn @ ca.reshape(start[:9], 3, 3), start[9:12] + shift)
    T = T @ _transform(_rotation("z", q[0]), ca.DM([0, 0, dh[0, 3]]))
    for i in range(1, 6):
        alpha, a, theta, d = dh[i, 0] + next(free), dh[i, 1] + next(free), dh[i, 2], dh[i, 3]
        beta = next(free) if i in PARALLEL_ROWS else 0.0
        theta = theta + next(free) if i < 5 else theta
        d = d + next(free) if i < 5 and i not in PARALLEL_ROWS else d
        T = (
            T
            @ _transform(_rotation("x", alpha), ca.DM([0, 0, 0]))
            @ _transform(_rotation("y", beta), ca.vertcat(a, 0, 0))
        )
        T = (
            T
            @ _transform(_rotation("z", theta + q[i]), ca.DM([0, 0, 0]))
            @ _transform(ca.DM.eye(3), ca.vertcat(0, 0, d))
        )
    tool = start[12:15] + ca.vertcat(*(next(free) for _ in range(3)))
    p = (T @ ca.vertcat(tool, 1))[:3]
    return ca.Function("position", [q, phi, start], [p], ["q", "phi", "start"], ["p"])


def _whole(position, n, style):
    """Ipopt on one expression for all poses; its parameter is (q, p, start) in one column."""
    symbol = ca.SX if style == "sx" else ca.MX
    phi, q, p = symbol.sym("phi", 27), symbol.sym("q", 6, n), symbol.sym("p", 3, n)
    start = symbol.sym("start", 15)
    if style == "sx":
        predicted = ca.horzcat(*(position(q[:, i], phi, start) for i in range(n)))
    else:
        predicted = position.map(n)(q, ca.repmat(phi, 1, n), ca.repmat(start, 1, n))
    residual = ca.vec(predicted - p)
    parameter = ca.vertcat(ca.vec(q), ca.vec(p), start)
    options = {}
    if style == "map-naive":
        J, weight, no_constraint = ca.jacobian(residual, phi), symbol.sym("weight"), symbol.sym("none", 0)
        options["hess_lag"] = ca.Function(
            "hess_lag", [phi, parameter, weight, no_constraint], [ca.triu(weight * J.T @ J)]
        )
    return {"x": phi, "p": parameter, "f": ca.sumsqr(residual) / 2}, options


def _by_pose(position, n, scale):
    """Ipopt on sums over the poses of cost, gradient and J'J, each differentiated for one pose."""
    phi, q, p, start = ca.SX.sym("phi", 27), ca.SX.sym("q", 6), ca.SX.sym("p", 3), ca.SX.sym("start", 15)
    residual = (position(q, phi, start) - p) / scale
    J = ca.jacobian(residual, phi)
    one_pose = {"cost": ca.sumsqr(residual) / 2, "gradient": ca.densify(J.T @ residual), "hessian": ca.triu(J.T @ J)}

    def total(*names):
        f = ca.Function("one_pose", [phi, q, p, start], [one_pose[name] for name in names])
        return f.map("poses", "serial", n, [0, 3], list(range(len(names))))

    x, weight, no_constraint = ca.MX.sym("x", 27), ca.MX.sym("weight"), ca.MX.sym("none", 0)
    parameter = ca.MX.sym("parameter", 9 * n + 15)
    inputs = x, ca.reshape(parameter[: 6 * n], 6, n), ca.reshape(parameter[6 * n : 9 * n], 3, n), parameter[9 * n :]
    hessian = weight * total("hessian")(*inputs)
    options = {
        "grad_f": ca.Function("grad_f", [x, parameter], total("cost", "gradient")(*inputs)),
        "hess_lag": ca.Function("hess_lag", [x, parameter, weight, no_constraint], [hessian]),
    }
    return {"x": x, "p": parameter, "f": total("cost")(*inputs)}, options


def contend(data: Data, clock, style):
    """Predicted positions (m, 3) [m] of the held-out poses."""
    n, scale = len(data.q), 1e-3 if style == "map-tuned" else 1.0
    with clock("build"):
        position = position_function(data.dh, scale)
        nlp, options = _by_pose(position, n, scale) if style == "map-tuned" else _whole(position, n, style)
        solver = ca.nlpsol("fit", "ipopt", nlp, {"print_time": False, "calc_lam_p": False, "ipopt": IPOPT, **options})
    with clock("solve"):
        start = np.concatenate([part.ravel(order="F") for part in frames_start(data)])
        parameter = np.concatenate([data.q.ravel(), data.p.ravel(), start])
        phi = solver(x0=0, p=parameter)["x"]
    if not solver.stats()["success"]:
        raise RuntimeError("Ipopt: " + solver.stats()["return_status"])
    clock.note("parameters", phi.numel())
    clock.note("iterations", solver.stats()["iter_count"])
    return position(data.q_held_out.T, phi, start).full().T
