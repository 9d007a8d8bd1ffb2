"""Bounded nonlinear least squares by Ipopt with the Gauss-Newton Hessian."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import ConvergenceError

Progress = Callable[[int, float], None]

# At 1e-8 Ipopt reaches the optimum and then spends iterations at round-off level in its line search.
TOLERANCE = 1e-6
MAX_ITERATIONS = 200

_SENTENCES = {
    "Solve_Succeeded": "Ipopt found an optimum.",
    "Solved_To_Acceptable_Level": "Ipopt stopped at an acceptable, not a sharp optimum; look at the condition number.",
    "Maximum_Iterations_Exceeded": (
        "Ipopt ran out of iterations; the start may be far off (check units, joint signs and zero offsets), "
        "or parameters nearly confounded: free fewer of them, or use priors."
    ),
    "Infeasible_Problem_Detected": "Ipopt found no point inside the bounds; check the bounds in the robot file.",
    "Invalid_Number_Detected": (
        "The model gave NaN during the search: a four-bar opened. Narrow the bounds of the loop's bars, "
        "or leave out poses near its folded positions."
    ),
    "Restoration_Failed": "Ipopt could not make progress; check units and outliers, or use loss='soft_l1'.",
    "Search_Direction_Becomes_Too_Small": "Ipopt stalled at round-off; the data may be noise-free: see is_optimal().",
}


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver stopped.

    v : shape (size,), scaled variables; status : that of Ipopt; message : the same in a sentence, with a remedy
    history : cost at each iteration
    """

    v: Array
    status: str
    message: str
    history: tuple[float, ...]


class _Watch(ca.Callback):
    """Ipopt's iteration callback: keeps the cost and reports it."""

    def __init__(self, size: int, scale: float, progress: Progress | None) -> None:
        ca.Callback.__init__(self)
        self.size, self.scale, self.progress = size, scale, progress
        self.history: list[float] = []
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        shapes = {"x": self.size, "f": 1, "lam_x": self.size}
        return ca.Sparsity.dense(shapes.get(ca.nlpsol_out(i), 0))

    def eval(self, arg: Sequence[ca.DM]) -> list[ca.DM]:
        self.history.append(float(arg[1]) * self.scale)
        if self.progress:
            self.progress(len(self.history) - 1, self.history[-1])
        return [ca.DM(0)]


def minimise(
    v: ca.MX,
    cost: ca.MX,
    gradient: tuple[ca.MX, ca.MX],
    hessian: ca.MX,
    lower: Array,
    upper: Array,
    *,
    scale: float,
    progress: Progress | None = None,
) -> Solution:
    """Minimise a sum of squares from v = 0 within bounds.

    gradient : the cost once more, as it comes with the gradient, and the gradient; hessian : upper triangle of J'J
    scale : typical size of the cost, by which it is divided

    Raises ConvergenceError with a sentence and a remedy if Ipopt does not stop at an optimum.
    """
    p, lam_f, lam_g = ca.MX.sym("p", 0), ca.MX.sym("lam_f"), ca.MX.sym("lam_g", 0)
    grad = ca.Function("nlp_grad_f", [v, p], [part / scale for part in gradient], ["x", "p"], ["f", "grad_f_x"])
    hess = ca.Function(
        "nlp_hess_l",
        [v, p, lam_f, lam_g],
        [lam_f * hessian / scale],
        ["x", "p", "lam_f", "lam_g"],
        ["hess_gamma_x_x"],
    )
    watch = _Watch(v.numel(), scale, progress)
    options: dict[str, Any] = {
        "grad_f": grad,
        "hess_lag": hess,
        "calc_lam_p": False,
        "no_nlp_grad": True,
        "print_time": False,
        "show_eval_warnings": False,
        "iteration_callback": watch,
        "ipopt": {
            "tol": TOLERANCE,
            "max_iter": MAX_ITERATIONS,
            "print_level": 0,
            "sb": "yes",
            "nlp_scaling_method": "none",
            "mu_init": 1e-7,
            "bound_relax_factor": 0.0,
            # Robust losses converge linearly: stop where the cost no longer changes.
            "acceptable_tol": 1e-3,
            "acceptable_iter": 3,
            "acceptable_obj_change_tol": 1e-9,
        },
    }
    problem: dict[str, Any] = {"x": v, "f": cost / scale}
    solver = ca.nlpsol("identify", "ipopt", problem, options)
    found = solver(x0=np.zeros(v.numel()), lbx=lower, ubx=upper)
    status = str(solver.stats()["return_status"])
    message = _SENTENCES.get(status, f"Ipopt stopped with {status}; see its documentation for this status.")
    if status not in ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Search_Direction_Becomes_Too_Small"):
        raise ConvergenceError(f"{message} ({status} after {len(watch.history)} iterations)")
    return Solution(found["x"].full().ravel(), status, message, tuple(watch.history))
