"""Loss and trainers against hand numbers, finite differences and scipy."""

import dataclasses
from itertools import islice

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from scipy.optimize._numdiff import approx_derivative

from casadical.compensator import (
    Backprop,
    InvasiveWeeds,
    Iwo,
    IwoSettings,
    IwoThenLm,
    Layout,
    LevenbergMarquardt,
    train,
)
from casadical.compensator.compensator import train_all
from casadical.compensator.network import Loss, Task, forward, random_weights, training_masks
from casadical.compensator.trainers.levenberg_marquardt import descent
from casadical.core.basics import InputError
from problems import small_task

QUICK = {
    "iwo": Iwo(IwoSettings(iterations=150)),
    "iwo-single": Iwo(IwoSettings(iterations=150), precision="single"),
    "backprop": Backprop(steps=120),
    "lm": LevenbergMarquardt(restarts=2, iterations=30, ridges=(0.1, 0.01, 0.001), folds=3, fold_starts=2),
    "iwo-lm": IwoThenLm(
        Iwo(IwoSettings(iterations=25)), LevenbergMarquardt(iterations=20, ridges=(0.1, 0.01), folds=3, fold_starts=1)
    ),
}


def test_loss_by_hand():
    """Errors (1, 2, 2) and (0, 0, 3): E = 3 and 3; with (3, 0, 0) and (0, 3, 3): E = 3 and 6; l1 = 1, l2 = 0.7."""
    errors = np.array([[[1.0, 0], [2, 0], [2, 3]], [[3, 0], [0, 3], [0, 3]]])
    np.testing.assert_allclose(Loss().value(errors), [3 + 0.7 * 3, 4.5 + 0.7 * 6], rtol=1e-15)


def test_loss_slope_against_finite_differences():
    random = np.random.default_rng(0)
    errors = random.normal(size=(2, 3, 7))
    slope, loss = Loss(0.8, 0.3).slope(errors), Loss(0.8, 0.3)
    for index in np.ndindex(errors.shape):
        step = np.zeros_like(errors)
        step[index] = 1e-6
        numeric = (loss.value(errors + step) - loss.value(errors - step))[index[0]] / 2e-6
        assert slope[index] == pytest.approx(numeric, abs=1e-8)


def test_losses_are_in_square_millimetres_whatever_the_scale():
    """The same function of the joints, written with two output scales."""
    one, other = small_task(scale_mm=1.0), small_task(scale_mm=0.1)
    weights = random_weights(one.layout, np.random.default_rng(0), 3)
    *hidden, last = one.layout.layers(weights)
    rescaled = one.layout.weights([*hidden, 10 * last])
    np.testing.assert_allclose(one.losses(weights), other.losses(rescaled), rtol=1e-12)
    np.testing.assert_allclose(one.errors_mm(weights[0]), other.errors_mm(rescaled[0]), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize(("precision", "kind"), [("double", np.float64), ("single", np.float32)])
def test_a_colony_is_compared_in_the_precision_that_is_asked(precision, kind, monkeypatch):
    tell, compared = InvasiveWeeds.tell, []
    monkeypatch.setattr(InvasiveWeeds, "tell", lambda own, x: (compared.append(x.dtype), tell(own, x)))
    next(Iwo(IwoSettings(iterations=2), precision=precision).states(small_task(), 0))
    assert compared == [kind]


def test_a_training_without_a_seed_is_that_of_seed_0():
    task, trainer = small_task(), Backprop(steps=3)
    (given,), (default,) = train_all([task], trainer, seed=0), train_all([task], trainer)
    assert (default.weights == given.weights).all()


def scipy_residuals(task, samples, ridge):
    free = ~task.layout.output_biases()

    def residuals(w):
        errors = forward(task.layout, w[None], task.inputs)[0] - task.targets
        return np.concatenate([(errors * np.sqrt(samples)).ravel(), np.sqrt(ridge) * w[free]])

    return residuals


def test_lm_reaches_an_optimum_that_scipy_cannot_improve():
    task = small_task()
    total = task.targets.shape[1]
    random = np.random.default_rng(1)
    weights = random_weights(task.layout, random, 3)
    samples = np.full((3, total), 1 / total)
    samples[1, :6] = 0
    samples[1] /= samples[1].sum()
    ridge = np.array([1e-3, 1e-2, 3e-2])
    *_, batch = islice(descent(task, weights, samples, ridge, relative=1e-14), 301)
    for p in range(3):
        residuals = scipy_residuals(task, samples[p], ridge[p])
        assert batch.cost[p] == pytest.approx(np.sum(residuals(batch.point[p]) ** 2), rel=1e-12)
        found = least_squares(residuals, batch.point[p], jac="3-point", method="lm", xtol=1e-13, ftol=1e-13, gtol=1e-13)
        assert batch.cost[p] <= 2 * found.cost * (1 + 1e-8)
        slope = 2 * found.jac.T @ residuals(batch.point[p])
        assert np.abs(slope).max() < 2e-5  # starts at about 0.1


def test_the_first_step_of_lm_is_damped_by_a_thousandth_of_the_largest_curvature():
    task = small_task()
    weights = random_weights(task.layout, np.random.default_rng(3), 1)
    samples, ridge = np.full((1, task.targets.shape[1]), 1 / task.targets.shape[1]), np.array([0.03])
    residuals = scipy_residuals(task, samples[0], ridge[0])
    J = approx_derivative(residuals, weights[0])
    H = J.T @ J
    expected = weights[0] - np.linalg.solve(H + 1e-3 * np.diag(H).max() * np.eye(len(H)), J.T @ residuals(weights[0]))
    batch = next(descent(task, weights, samples, ridge, relative=0.0))
    np.testing.assert_allclose((batch.point + batch.step)[0], expected, atol=1e-6)


def test_lm_result_does_not_depend_on_its_company():
    task = small_task()
    total = task.targets.shape[1]
    weights = random_weights(task.layout, np.random.default_rng(2), 4)
    samples, ridge = np.full((4, total), 1 / total), np.full(4, 1e-3)
    (*_, together), (*_, alone) = (islice(descent(task, weights[:n], samples[:n], ridge[:n]), 9) for n in (4, 1))
    np.testing.assert_allclose(together.point[0], alone.point[0], rtol=1e-7, atol=1e-9)


def test_huge_ridge_leaves_the_mean_residual():
    task = small_task()
    training = train(task, LevenbergMarquardt(restarts=1, iterations=100, ridges=(1e6,)), seed=0)
    assert training.note == "ridge 1e+06, given"
    outputs = forward(task.layout, training.weights[None], task.inputs)[0]
    np.testing.assert_allclose(outputs, np.tile(task.targets.mean(axis=1)[:, None], task.targets.shape[1]), atol=1e-4)


def test_lm_without_ridge_survives_inputs_that_say_nothing():
    """Two joints that never move leave the normal equations singular."""
    task = small_task()
    inputs = task.inputs.copy()
    inputs[[1, 4]] = 0.0
    training = train(dataclasses.replace(task, inputs=inputs), LevenbergMarquardt(2, 2000, (0.0,)), seed=0)
    assert np.isfinite(training.loss_mm2)


def test_lm_chooses_the_ridge_of_least_held_out_error():
    """On pure noise the strongest ridge must win; on a smooth residual without noise a weak one."""
    trainer = LevenbergMarquardt(restarts=1, iterations=5, ridges=(1.0, 1e-3, 1e-5))
    smooth_task = small_task(poses=60)
    noise = np.random.default_rng(3).normal(size=smooth_task.targets.shape)
    noise_task = dataclasses.replace(smooth_task, targets=noise)
    assert train(noise_task, trainer).note == "ridge 1, chosen by 5-fold cross-validation from 3 candidates"
    assert "ridge 0.001," in train(smooth_task, trainer).note or "ridge 1e-05," in train(smooth_task, trainer).note


def test_iwo_lm_final_part_starts_from_the_iwo_optimum():
    task = small_task()
    lm = LevenbergMarquardt(iterations=1, ridges=(0.0,))
    iwo = train(task, Iwo(IwoSettings(iterations=20)), seed=4)
    both = train(task, IwoThenLm(Iwo(IwoSettings(iterations=20)), lm), seed=4)
    total = task.targets.shape[1]
    _, batch = islice(descent(task, iwo.weights[None], np.full((1, total), 1 / total), np.zeros(1)), 2)
    np.testing.assert_array_equal(both.weights, batch.point[0])


def test_backprop_descends_nearly_to_the_bottom_of_its_basin():
    task = dataclasses.replace(small_task(hidden=(2,)), loss=Loss(1.0, 0.0))
    first, *_, last = Backprop(steps=6000).states(task, 0)
    start, end = (task.losses(state.weights[None])[0] for state in (first, last))
    assert end < 0.5 * start
    scipy_run = minimize(lambda w: task.losses(w[None])[0], last.weights, method="BFGS")
    assert end < 1.5 * scipy_run.fun


@pytest.mark.parametrize("name", QUICK)
def test_every_trainer_lowers_the_loss_and_repeats(name):
    task = small_task()
    first, second = (train(task, QUICK[name], seed=5) for _ in range(2))
    assert first.weights.tobytes() == second.weights.tobytes()
    assert first.loss_mm2 < float(task.losses(np.zeros((1, task.layout.count)))[0])
    assert first.loss_mm2 == float(task.losses(first.weights[None])[0])
    assert first.reasons
    assert train(task, QUICK[name], seed=6).weights.tobytes() != first.weights.tobytes()


def test_folds_hold_every_pose_out_once():
    masks = training_masks(23, 5, seed=1)
    np.testing.assert_array_equal((~masks).sum(axis=0), np.ones(23))
    assert set((~masks).sum(axis=1)) == {4, 5}


@pytest.mark.parametrize(
    "make",
    [
        lambda: LevenbergMarquardt(ridges=(0.1, 0.2)),
        lambda: LevenbergMarquardt(ridges=()),
        lambda: LevenbergMarquardt(folds=1),
        lambda: Iwo(precision="half"),
        lambda: Loss(0.0, 0.0),
        lambda: train(small_task(), QUICK["iwo"], every=0),
    ],
)
def test_wrong_settings_are_refused(make):
    with pytest.raises(InputError):
        make()


def test_starting_weights_keep_the_spread_of_what_comes_in() -> None:
    layout = Layout(joints=6, hidden=(40,), outputs=3)
    drawn = random_weights(layout, np.random.default_rng(0), 4000)
    spread = np.sort(drawn.std(axis=0))
    # 40 neurons of 6 joints and a bias, 3 outputs of 40 neurons and a bias: of variance one over these numbers.
    expected = np.sort([7**-0.5] * 40 * 7 + [41**-0.5] * 3 * 41)
    np.testing.assert_allclose(spread, expected, rtol=0.08)


def test_a_problem_without_an_error_is_left_at_once() -> None:
    task = small_task()
    weights = random_weights(task.layout, np.random.default_rng(0), 1)
    exact = Task(task.layout, task.inputs, forward(task.layout, weights, task.inputs)[0], task.scale_mm, task.loss)
    samples, none = np.full((1, task.targets.shape[1]), 1 / task.targets.shape[1]), np.zeros(1)
    _, batch = descent(exact, weights, samples, none)
    assert batch.cost[0] == 0
    assert not batch.active[0]
    np.testing.assert_array_equal(batch.point, weights)


def test_the_second_trainer_waits_for_the_first() -> None:
    iwo, lm = Iwo(IwoSettings(iterations=3)), LevenbergMarquardt(iterations=2, ridges=(0.0,))
    states, alone = [*IwoThenLm(iwo, lm).states(small_task(), 0)], [*iwo.states(small_task(), 0)]
    first = len(alone) - 1
    assert first >= 2  # generations: the last one starts the second
    assert all((one.weights == other.weights).all() for one, other in zip(states, alone, strict=False))
    second = lm.states(small_task(), 0, starts=alone[-1].weights[None])
    assert [s.steps - len(alone) for s in states[first:]] == [s.steps for s in second]
    assert len(states) < 20
