"""Bounded nonlinear least squares by Ipopt with the Gauss-Newton Hessian, and its caches."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from casadical.core.basics import Array, ConvergenceError
from casadical.core.linear_gaussian.normal_equations import scaled_solution

# Function that is called at each iteration with its number, from 0, and the cost there.
Progress = Callable[[int, float], None]


# Message of an optimum at full accuracy.
OPTIMUM_MESSAGE = "The solver found an optimum."
# Ipopt's status where it stops at its acceptable, not at its required accuracy.
ACCEPTABLE_STATUS = "Solved_To_Acceptable_Level"
# Ipopt's status where `settled` (see `minimise`) stopped a slow search at the optimum.
STOPPED_STATUS = "User_Requested_Stop"
# Ipopt's status -> the message about it.
_MESSAGE_OF_STATUS = {
    "Solve_Succeeded": OPTIMUM_MESSAGE,
    ACCEPTABLE_STATUS: "Ipopt stopped at an acceptable, not a sharp optimum; look at the condition number.",
    STOPPED_STATUS: "Ipopt found an optimum, to a tenth of a standard error of what estimated masses leave open.",
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
    "Search_Direction_Becomes_Too_Small": (
        "Ipopt found an optimum; its last steps were below a millionth of each parameter's scale."
    ),
}


@dataclass(frozen=True, eq=False)
class Solution:
    """The point at which the solver stopped.

    v : scaled variables, shape (size,)
    status : Ipopt's return status, Solve_Succeeded also where Gauss-Newton steps sufficed
    message : the same as a sentence, with a remedy
    history : cost (half of chi-squared, with priors) at each iteration
    """

    v: Array
    status: str
    message: str
    history: tuple[float, ...]


class _Evaluation(ca.Callback):
    """One of the functions that Ipopt calls, computed by numpy in the memory that Ipopt gives.

    inputs, outputs : (name, sparsity) of each, in order
    compute : inputs -> outputs; CasADi takes only those that it requested
    """

    def __init__(
        self,
        name: str,
        inputs: Mapping[str, ca.Sparsity],
        outputs: Mapping[str, ca.Sparsity],
        compute: Callable[..., Sequence[Array | float]],
    ) -> None:
        """Construct the CasADi callback of this name; other arguments are as of the class."""
        ca.Callback.__init__(self)
        self.inputs, self.outputs, self.compute = tuple(inputs.items()), tuple(outputs.items()), compute
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return the number of inputs."""
        return len(self.inputs)

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return len(self.outputs)

    def get_name_in(self, i: int) -> str:
        """Return the name of input i."""
        return self.inputs[i][0]

    def get_name_out(self, i: int) -> str:
        """Return the name of output i."""
        return self.outputs[i][0]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the sparsity of input i."""
        return self.inputs[i][1]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """Return the sparsity of output i."""
        return self.outputs[i][1]

    def has_eval_buffer(self) -> bool:
        """Return that `eval_buffer` exists, so that CasADi makes no copies."""
        return True

    def eval_buffer(self, arg: Sequence[memoryview | None], res: Sequence[memoryview | None]) -> int:
        """Compute the outputs into the memory `res` from the inputs `arg`; return 0 for success."""
        given = [np.frombuffer(a) if a is not None else np.zeros(0) for a in arg]
        for place, value in zip(res, self.compute(*given), strict=False):
            if place is not None:
                np.frombuffer(place)[:] = value
        return 0


class _Solver:
    """Ipopt for problems of one size; it is cached, because building it takes longer than a solve.

    The current problem is set as attributes:
    cost : v -> cost; gradient : v -> gradient and Hessian; scale : typical cost, by which all of
        these are divided
    progress : called at each iteration; settled : v -> whether a slow search is at the optimum
    """

    cost: Callable[[Array], float]
    gradient: Callable[[Array], tuple[Array, Array]]
    scale: float
    progress: Progress | None
    settled: Callable[[Array], bool] | None

    def __init__(self, size: int, most: int, watched: bool) -> None:
        """Build Ipopt for `size` variables and at most `most` iterations.

        watched : whether `settled` may stop it
        """
        vector, upper, none = ca.Sparsity.dense(size, 1), ca.Sparsity.upper(size), ca.Sparsity(0, 0)
        number = ca.Sparsity.dense(1, 1)
        self._lower = np.tril_indices(size)
        self.history: list[float] = []
        given = {"x": vector, "p": none}
        weighed = given | {"lam_f": number, "lam_g": none}
        f = _Evaluation("f", {"x": vector}, {"f": number}, self._cost)
        g = _Evaluation("nlp_grad_f", given, {"f": number, "grad_f_x": vector}, self._gradient)
        h = _Evaluation("nlp_hess_l", weighed, {"hess_gamma_x_x": upper}, self._hessian)
        v = ca.MX.sym("v", size)
        sizes = {"x": vector, "f": number, "lam_x": vector}
        point = {name: sizes.get(name, ca.Sparsity(0, 1)) for name in ca.nlpsol_out()}
        watch = _Evaluation("watch", point, {"stop": number}, self._stop)
        # With a tolerance of 1e-8 instead of 1e-6, Ipopt spends iterations at round-off level in
        # its line search after it has reached the optimum.
        options: dict[str, Any] = {
            "iteration_callback": watch,
            "grad_f": g,
            "hess_lag": h,
            "calc_lam_p": False,
            "no_nlp_grad": True,
            "print_time": False,
            "show_eval_warnings": False,
            "ipopt": {
                "tol": 1e-6,
                "max_iter": most,
                "print_level": 0,
                "sb": "yes",
                "nlp_scaling_method": "none",
                "mu_init": 1e-7,
                # Multipliers of bounds start at mu / distance, not at one: the search then needs no
                # iterations to lower them.
                "bound_mult_init_method": "mu-based",
                "bound_relax_factor": 0.0,
                # The start is near the optimum and may be at bounds, from which it is not moved.
                "bound_push": 1e-8,
                "bound_frac": 1e-8,
                # Steps of a millionth of each scale are not searched: the cost is at round-off
                # there.
                "tiny_step_tol": 1e-6,
                # A step is refined only if its residual is large: the next one corrects it.
                "min_refinement_steps": 0,
                # Robust losses converge linearly, so Ipopt stops where the cost no longer changes.
                "acceptable_tol": 1e-3,
                "acceptable_iter": 3,
                "acceptable_obj_change_tol": 1e-9,
            },
        }
        if not watched:
            del options["iteration_callback"]
        self._keep = f, g, h, watch
        self._solve = ca.nlpsol("identify", "ipopt", {"x": v, "f": f(v)}, options)
        # Fixed buffers for arguments and result avoid CasADi's conversions.
        self._given = {name: np.zeros(size) for name in ("x0", "lbx", "ubx")}
        self._optimum = np.zeros(size)
        self._buffer: Any
        self._buffer, self._run = self._solve.buffer()
        for name, values in self._given.items():
            self._buffer.set_arg(self._solve.index_in(name), values.data)
        self._buffer.set_res(self._solve.index_out("x"), self._optimum.data)

    def solve(self, start: Array, lower: Array, upper: Array) -> tuple[Array, str]:
        """Return the point where Ipopt stopped, shape (size,), and its status.

        start, lower, upper : first point and bounds, shape (size,) each
        """
        for values, of in zip(self._given.values(), (start, lower, upper), strict=True):
            values[:] = of
        self._run()
        return self._optimum.copy(), str(self._solve.stats(1)["return_status"])

    def let_go(self) -> None:
        """Break the circular references to free memory; the solver cannot be used afterwards."""
        del self._run, self._buffer, self._solve, self._keep

    def _stop(self, v: Array, *_: Array) -> Sequence[Array | float]:
        """Return (1.0,) to stop Ipopt at v, if the search is slow and `settled(v)`; else (0.0,)."""
        # Convergence is slow along what only priors determine, such as the scale of estimated masses
        # and compliances: with so small a reduction of the cost the optimum is tested.
        flat = len(self.history) > 10 and self.history[-11] - self.history[-1] < 1e-3
        return (float(flat and self.settled is not None and self.settled(v)),)

    def _cost(self, v: Array) -> Sequence[Array | float]:
        """Return the cost at v divided by `scale`, as Ipopt's objective."""
        return (self.cost(v) / self.scale,)

    def _gradient(self, v: Array, _: Array) -> Sequence[Array | float]:
        """Return cost / scale and gradient / scale, shape (size,), at v, and record the cost."""
        cost, gradient = self.cost(v), self.gradient(v)[0]
        self.history.append(cost)
        if self.progress:
            self.progress(len(self.history) - 1, cost)
        return cost / self.scale, gradient / self.scale

    def _hessian(self, v: Array, _: Array, factor: Array, __: Array) -> Sequence[Array | float]:
        """Return the Hessian's lower triangle at v, flat, times Ipopt's factor over `scale`."""
        return (self.gradient(v)[1][self._lower] * (factor[0] / self.scale),)


# Cached solvers of the current thread, by size, maximum iterations, and whether they are watched; a
# solver runs in one thread at a time.
_solvers = threading.local()


def minimise(
    cost: Callable[[Array], float],
    gradient: Callable[[Array], tuple[Array, Array]],
    lower: Array,
    upper: Array,
    *,
    scale: float,
    start: Array | None = None,
    progress: Progress | None = None,
    settled: Callable[[Array], bool] | None = None,
) -> Solution:
    """Return the minimum of a sum of squares within bounds, by at most 200 iterations.

    cost : variables v, shape (size,) -> half the sum of squares
    gradient : v -> gradient and Gauss-Newton Hessian J'J, shapes (size,) and (size, size)
    lower, upper : bounds of v, shape (size,)
    scale : typical size of the cost, by which it is divided
    start : first point, shape (size,); None: zero
    progress : called with iteration number and cost
    settled : v -> whether v, at which convergence is slow, is the optimum; None: no such test
    Raises ConvergenceError with a sentence and a remedy if Ipopt does not stop at an optimum.
    """
    # Solvers of up to 100 variables are cached: one of a thousand takes 100 MB, and is built fast.
    cached = len(lower) <= 100
    if not hasattr(_solvers, "of"):
        _solvers.of = lru_cache(maxsize=16)(_Solver)
    ipopt: _Solver = (_solvers.of if cached else _Solver)(len(lower), 200, settled is not None)
    ipopt.cost, ipopt.gradient, ipopt.scale, ipopt.progress, ipopt.history = cost, gradient, scale, progress, []
    ipopt.settled = settled
    try:
        v, status = ipopt.solve(np.zeros(len(lower)) if start is None else start, lower, upper)
    finally:
        if not cached:
            ipopt.let_go()
    message = _MESSAGE_OF_STATUS.get(status, f"Ipopt stopped with {status}; see its documentation for this status.")
    if status not in ("Solve_Succeeded", ACCEPTABLE_STATUS, STOPPED_STATUS, "Search_Direction_Becomes_Too_Small"):
        raise ConvergenceError(f"{message} ({status} after {len(ipopt.history)} iterations)")
    return Solution(v, status, message, tuple(ipopt.history))


def bounded_step(g: Array, H: Array, lower: Array, upper: Array, at_bounds: Array, moves: Array | None = None) -> Array:
    """Return the step that minimises a quadratic cost within bounds, shape (size,).

    The active set method fixes variables at bounds that they would violate and releases those that
    the cost draws back (Portugal, Judice and Vicente 1994). The best step within bounds after 60
    updates at most is returned, zero where none lowers the cost.

    g, H : gradient (size,) and Hessian (size, size) of the cost
    lower, upper : bounds of the step, shape (size,)
    at_bounds : mask of the variables at a bound; moves : mask of those that may move, all by
        default
    """
    step, free = np.zeros(len(g)), np.ones(len(g), dtype=bool) if moves is None else moves
    fixed = np.where(-lower < upper, g >= 0, g <= 0) & at_bounds & free
    best, least, own = step, 0.0, free
    # The active set is updated at most 60 times, at first by all violations at once.
    for turn in range(60):
        free = own & ~fixed
        step = np.where(free, 0.0, step)
        some = H if free.all() else H[np.ix_(free, free)]
        step[free] = -scaled_solution(some, (g + H @ step)[free])
        inside = np.clip(step, lower, upper)
        if (cost := float((g + 0.5 * H @ inside) @ inside)) < least:
            best, least = inside, cost
        beyond, slope = free & (inside != step), g + H @ step
        drawn = fixed & np.where(inside - lower < upper - inside, slope < 0, slope > 0)
        wrong = beyond | drawn
        if not wrong.any():
            break
        if turn > 8:  # with one change at a time the method cannot cycle (Murty 1974)
            wrong &= np.arange(len(g)) == wrong.argmax()
        step, fixed = np.where(fixed | beyond & wrong, inside, 0.0), fixed ^ wrong
    return best


# Type of a result that is computed once and cached.
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over all residuals at one point, without priors.

    cost : half the sum of squares through the loss; gradient : of the cost, shape (size,)
    information : J'WJ with the loss weights W, shape (size, size)
    square : sum of the squared residuals, without the loss [sigma^2]
    residuals : of every set, shape (n, m) [sigma]; None if they are too many to be cached
    triangle : triangular factor of J, without the loss, (size, size) or fewer rows; None: not asked
    """

    cost: float
    gradient: Array
    information: Array
    square: float
    residuals: list[Array] | None
    triangle: Array | None = None

    def for_variables(self, columns: Sequence[int]) -> "Sums":
        """Return the sums for some of the variables, the others fixed, without the triangle.

        columns : indices of these variables
        """
        at = np.array(columns, dtype=int)
        return Sums(self.cost, self.gradient[at], self.information[np.ix_(at, at)], self.square, self.residuals)


class LastValueCache:
    """Cache of the value of one function at the last point at which it was evaluated.

    point : this point, shape (size,), None before the first; answer : the value there
    """

    point: Array | None = None
    answer: Any = None

    def holds(self, v: Array) -> bool:
        """Return whether the cached point is v, to the bit."""
        return self.point is not None and self.point.tobytes() == v.tobytes()

    @property
    def at_zero(self) -> Any:
        """The cached value if its point is the origin (all variables zero); else None."""
        return None if self.point is None or self.point.any() else self.answer

    def __call__(self, v: Array, compute: Callable[[Array], Any]) -> Any:
        """Return the function's value at v, from the cache or by `compute(v)`, which it caches."""
        return self.answer if self.holds(v) else self.keep(v, compute(v))

    def keep(self, v: Array, answer: Any) -> Any:
        """Store a value at v that was computed elsewhere, and return it."""
        self.point, self.answer = v.copy(), answer
        return answer


class ProblemCache:
    """Cache of what a problem has computed: constants by name, and values at the last point."""

    def __init__(self) -> None:
        """Start with an empty cache."""
        self.made: dict[str, Any] = {}
        caches = (LastValueCache() for _ in range(5))
        self.sums, self.parts, self.gradient, self.cost, self.redundancies = caches

    def once(self, name: str, compute: Callable[[], T]) -> T:
        """Return the cached value of this name; the first time it is computed by `compute()`."""
        if name not in self.made:
            self.made[name] = compute()
        answer: T = self.made[name]
        return answer
