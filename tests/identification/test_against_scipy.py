"""scipy.optimize.least_squares as the independent oracle: estimates, covariances, bounds, losses, gradients."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares
from scipy.stats import t as student

from casadical import identify
from casadical.identification import least_squares as fit
from casadical.identification.least_squares import LeastSquares
from casadical.identification.residuals import LOSS_KNEE_SQUARE

ARM = arms.six_axis()


def residuals_of(result, m):
    """Position residuals [sigma] over parameter values in solver units, by the robot's own function."""
    start, sigma = result.start, result.problem.sigmas[0][0]
    index = [start.parameters.index_of(n) for n in result.names]
    position = start.position.map(len(m))

    def residuals(x):
        phi = start.parameters.values
        phi[index] = result.problem.scale * x
        return ((position(m.q.T, phi).full().T - m.position) / sigma).ravel()

    return residuals


def scipy_fit(result, m, **options):
    parameters = [result.start.parameters[n] for n in result.names]
    bounds = [[getattr(p, side) / p.scale for p in parameters] for side in ("lower", "upper")]
    x0 = np.clip([p.value / p.scale for p in parameters], np.array(bounds[0]) + 1e-6, np.array(bounds[1]) - 1e-6)
    f = residuals_of(result, m)
    # The model is one of ours; its Jacobian here is scipy's own, by central differences.
    return least_squares(f, x0, bounds=bounds, jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14, **options)


@pytest.fixture(scope="module")
def small():
    """Few free parameters, so that scipy's differences stay quick."""
    built = arms.planted_in(ARM, ["a1", "a2", "theta3", "d4", "beta2", "tool_x"], 1)
    built = replace(built, base=replace(built.base, T=arms.TRACKER))
    return arms.positions(built, arms.readings(built, 40, 2), 3)


FREE = ("base", "a1", "a2", "theta3", "d4", "beta2", "tool_x")


def test_gauss_newton_steps_end_where_ipopt_does(small, monkeypatch):
    """Ipopt, which takes longer to build than a small problem to solve, is for what they do not finish."""
    with monkeypatch.context() as patched:
        patched.setattr(fit, "minimise", None)
        steps = identify(ARM, small, FREE, loss="linear")
    monkeypatch.setattr(fit, "MAX_APPROACH_STEPS", 0)
    ipopt = identify(ARM, small, FREE, loss="linear")
    assert np.abs((steps.estimate - ipopt.estimate) / ipopt.standard_errors).max() < 1e-3
    assert steps.solution.message == ipopt.solution.message


def test_estimate_and_covariance(small):
    result = identify(ARM, small, FREE)
    oracle = scipy_fit(result, small)
    mine = result.estimate / result.problem.scale
    assert np.abs(mine - oracle.x).max() < 1e-5 * np.abs(result.standard_errors / result.problem.scale).min() * 1e3
    freedom = oracle.fun.size - oracle.x.size
    expected = 2 * oracle.cost / freedom * np.linalg.inv(oracle.jac.T @ oracle.jac)
    scaled = result.covariance / np.outer(result.problem.scale, result.problem.scale)
    assert np.allclose(scaled, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    assert result.degrees_of_freedom == freedom
    table = result.parameters.set_index("name").loc[list(result.names)]
    half = student.ppf(0.975, freedom) * table["std_error"]
    assert np.allclose(table["high"] - table["value"], half, rtol=1e-5)


def test_active_bound_is_kept_and_reported(small):
    width = ARM.widths["geometry"]
    narrow = replace(ARM, widths={**ARM.widths, "geometry": replace(width, length_bound=3e-4, angle_bound=3e-4)})
    result = identify(narrow, small, FREE)
    oracle = scipy_fit(result, small)
    assert result.at_bounds
    assert set(result.at_bounds) == {n for n, side in zip(result.names, oracle.active_mask, strict=True) if side}
    assert np.allclose(result.estimate / result.problem.scale, oracle.x, rtol=0, atol=1e-4)
    assert result.is_optimal()
    assert len(result.solution.history) <= 4  # an interior point that creeps along bounds takes more
    assert all(n in result.verdict for n in result.at_bounds)
    table = result.parameters.set_index("name")
    assert (table.loc[list(result.at_bounds), "status"] == "at bound").all()
    assert table.loc[list(result.at_bounds), "std_error"].isna().all()
    free = [n for n in result.names if n not in result.at_bounds]
    assert table.loc[free, "std_error"].notna().all()


@pytest.mark.parametrize("loss", ["huber", "soft_l1"])
def test_robust_losses_minimise_what_scipy_says(small, loss):
    """scipy's rho acts on each residual, ours on each pose: compare where a pose has one residual."""
    robot = replace(ARM, base=arms.Placement(arms.TRACKER), tool=arms.Placement(ARM.tool.T))
    built = arms.planted_in(robot, ["a1", "a2", "theta3", "d4"], 1)
    q = arms.readings(built, 60, 5)
    m = arms.distances(built, q, np.zeros(3), 6, known=True)
    wrong = m.distance.copy()
    wrong[::10] += 4e-5 * np.arange(1, 7)  # up to twelve sigma
    problem = LeastSquares(
        robot, (replace(m, distance=wrong),), ("a1", "a2", "theta3", "d4"), loss, False, ((arms.NOISE, 1.0),)
    )
    solution = problem.solve()

    position = robot.position.map(len(m))

    def residuals(x):
        phi = robot.parameters.values
        phi[[robot.parameters.index_of(n) for n in problem.names]] += problem.scale * x
        return (np.linalg.norm(position(m.q.T, phi).full(), axis=0) - wrong) / arms.NOISE

    oracle = least_squares(
        residuals,
        np.zeros(4),
        jac="3-point",
        loss=loss,
        f_scale=np.sqrt(LOSS_KNEE_SQUARE[1]),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-12,
    )
    assert np.allclose(solution.v, oracle.x, rtol=0, atol=1e-4)
    assert solution.history[-1] == pytest.approx(oracle.cost, rel=1e-6)
    plain = least_squares(residuals, np.zeros(4), jac="3-point")
    assert np.abs(plain.x - oracle.x).max() > 1e-2  # the outliers do pull without the loss


def problem_of(kind: str, loss: str) -> LeastSquares:
    """Twelve poses, with priors, weights and separations."""
    robot = replace(ARM, base=arms.Placement(np.eye(4)))
    built = arms.planted(robot, 1)
    q = arms.readings(robot, 12, 2)
    label = np.array(list("AABBBCCCAABC"), dtype=object)
    m = {
        "position": lambda: arms.positions(built, q, 3),
        "pose": lambda: arms.poses(built, q, 3),
        "distance": lambda: arms.distances(built, q, np.array([1.0, 0.5, 0.2]), 3),
        "pair": lambda: arms.pair_distances(built, q, arms.readings(robot, 12, 4), 3),
        "contact": lambda: replace(arms.bare(q), kind="contact", position=None, label=label).with_separations(
            [("A", "B", 0.4), ("B", "C", 0.5)], 1e-3
        ),
    }[kind]()
    m = replace(m, weight=np.linspace(0.5, 2, 12))
    names = ("a1", "alpha2", "beta2", "theta3", "d4", "tool_x")
    return LeastSquares(robot, (m,), names, loss, True, ((1e-3, 1e-2),))


every_kind = pytest.mark.parametrize("kind", ["position", "pose", "distance", "pair", "contact"])


@pytest.mark.parametrize("loss", ["linear", "huber", "soft_l1"])
@every_kind
def test_gradient_is_that_of_the_cost(kind, loss):
    """Central differences of the solver's own cost, far from the optimum."""
    problem = problem_of(kind, loss)
    v = np.random.default_rng(5).normal(size=problem.size)

    steps = np.eye(problem.size) * 1e-5
    numeric = np.array([(problem.cost(v + h) - problem.cost(v - h)) / 2e-5 for h in steps])
    g, H = problem.gradient(v)
    assert np.allclose(g, numeric, rtol=1e-5, atol=1e-6 * np.abs(numeric).max())
    assert np.abs(approx_fprime(v, problem.cost, 1e-6) - g).max() < 1e-2 * np.abs(g).max()
    assert np.linalg.eigvalsh(H).min() > -1e-9 * np.abs(H).max()


@every_kind
def test_a_search_along_a_step_evaluates_no_derivatives_and_has_the_same_costs(kind, monkeypatch):
    """Where the point before was not stepped to, its gradient never asked for, the next has its cost alone."""
    there, here = problem_of(kind, "huber"), problem_of(kind, "huber")
    first, *others = np.random.default_rng(6).normal(size=(4, there.size))
    expected = [replace(there).cost(v) for v in (*others, first)]
    kernel, derivatives = here.blocks[0].kernel, []
    both, alone = kernel.residual, kernel.value
    monkeypatch.setattr(kernel, "residual", lambda *given: derivatives.append(True) or both(*given))
    monkeypatch.setattr(kernel, "value", lambda *given: derivatives.append(False) or alone(*given))
    here.cost(first)
    assert derivatives == [True]
    assert [here.cost(v) for v in others] == expected[:-1]
    assert derivatives == [True, *[False] * len(others)]
    assert here.gradient(others[-1])[0] == pytest.approx(there.gradient(others[-1])[0], rel=1e-14)
    derivatives.clear()
    assert here.cost(first) == expected[-1]  # after a gradient both are wanted again
    assert derivatives == [True]
