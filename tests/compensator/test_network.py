"""The network against a hand-computed one, finite differences, CasADi and a second formula."""

import casadi
import numpy as np
import pytest

from casadical.compensator import JointBox, Layout, Network
from casadical.compensator.layout import network_inputs
from casadical.compensator.network import forward, gradient, outputs_and_jacobian
from casadical.core.basics import InputError

LAYOUTS = [
    Layout(),
    Layout(hidden=(4, 3)),
    Layout(joints=2, hidden=(3,), outputs=1),
    Layout(joints=7, hidden=(5,), periodic=(0, 6)),
    Layout(joints=3, hidden=(3, 2, 4), outputs=6, periodic=(1,)),
]


def make(layout: Layout, seed: int = 0, count: int = 4, samples: int = 9):
    rng = np.random.default_rng(seed)
    box = JointBox(tuple(rng.uniform(-3, -1, layout.joints)), tuple(rng.uniform(0.5, 2, layout.joints)))
    q = rng.uniform(-3, 2, (samples, layout.joints))
    return box, q, rng.normal(0, 0.7, (count, layout.count))


def tansig(a):
    return 2.0 / (1.0 + np.exp(-2.0 * a)) - 1.0


def test_hand_computed_network():
    """1-1-1 network on q in [0, 4]: q = 3 scales to 0.5; a = 2 * 0.5 + 0 = 1; y = 3 tansig(1) + 0.25, times 2 mm."""
    net = Network(Layout(1, (1,), 1), JointBox((0.0,), (4.0,)), np.array([2.0, 0.0, 3.0, 0.25]), output_scale_mm=2.0)
    assert net.output_mm(np.array([3.0])) == pytest.approx([2 * (3 * 0.7615941559557649 + 0.25)], rel=1e-15)


def test_map_puts_each_neurons_bias_after_its_weights():
    first, last = Layout(2, (2,), 1).layers(np.arange(9.0))
    np.testing.assert_array_equal(first, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(last, [[6, 7, 8]])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_batched_forward_equals_one_network_one_sample_at_a_time(layout):
    box, q, weights = make(layout)
    batch = forward(layout, weights, network_inputs(layout, box, q))
    for p, w in enumerate(weights):
        for n, angles in enumerate(q):
            z = []
            for j, angle in enumerate(angles):
                low, high = box.lower[j], box.upper[j]
                z += [np.sin(angle), np.cos(angle)] if j in layout.periodic else [2 * (angle - low) / (high - low) - 1]
            layers = layout.layers(w)
            for layer in layers[:-1]:
                z = tansig(layer[:, :-1] @ np.array(z) + layer[:, -1])
            expected = layers[-1][:, :-1] @ np.array(z) + layers[-1][:, -1]
            np.testing.assert_allclose(batch[p, :, n], expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_jacobian_and_gradient_against_finite_differences(layout):
    box, q, weights = make(layout, seed=1, count=3)
    inputs = network_inputs(layout, box, q)
    outputs, jacobian = outputs_and_jacobian(layout, weights, inputs)
    np.testing.assert_allclose(outputs, forward(layout, weights, inputs), rtol=1e-12, atol=1e-13)
    step, numeric = 1e-6, np.empty_like(jacobian)
    for i in range(layout.count):
        shift = np.zeros(layout.count)
        shift[i] = step
        up, down = forward(layout, weights + shift, inputs), forward(layout, weights - shift, inputs)
        numeric[:, i] = (up - down) / (2 * step)
    np.testing.assert_allclose(jacobian, numeric, atol=2e-9)
    sensitivity = np.random.default_rng(2).normal(size=outputs.shape)
    expected = np.einsum("piok,pok->pi", jacobian, sensitivity)
    np.testing.assert_allclose(gradient(layout, weights, inputs, sensitivity), expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_casadi_function_agrees_to_round_off_and_differentiates(layout):
    box, q, weights = make(layout, seed=3, count=1, samples=20)
    net = Network(layout, box, weights[0], output_scale_mm=0.37)
    function = net.function()
    assert function.name() == "network"
    assert (function.name_in(), function.name_out()) == (["q"], ["dp"])
    assert function.size1_in(0) == layout.joints
    got = np.array([np.asarray(function(angles)).ravel() for angles in q])
    np.testing.assert_allclose(got, net.output_mm(q), rtol=1e-13, atol=1e-14)
    slope = np.asarray(function.jacobian()(q[0], casadi.DM.zeros(layout.outputs)))
    steps = 1e-6 * np.eye(layout.joints)
    numeric = np.array([(net.output_mm(q[0] + s) - net.output_mm(q[0] - s)) / 2e-6 for s in steps]).T
    np.testing.assert_allclose(slope, numeric, atol=2e-8)


def test_a_joint_that_does_not_move_does_no_harm():
    net = Network(Layout(1, (1,), 1), JointBox((0.5,), (0.5,)), np.array([1.0, 0.0, 1.0, 0.0]))
    assert net.output_mm(np.array([[0.5]])) == 0.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Layout(hidden=(0,)), "at least one neuron"),
        (lambda: Layout(periodic=(6,)), "joints 0 to 5"),
        (lambda: Layout().layers(np.zeros(52)), "53 weights"),
        (lambda: JointBox((0.0,), (np.nan,)), "joint 0"),
        (lambda: JointBox((1.0,), (0.0,)), "in order"),
        (lambda: Network(Layout(), JointBox((0,) * 6, (1,) * 6), np.full(53, np.nan)), "not finite"),
        (lambda: Network(Layout(), JointBox((0,) * 5, (1,) * 5), np.zeros(53)), "5 joints"),
        (
            lambda: Network(Layout(), JointBox((0,) * 6, (1,) * 6), np.zeros(53)).output_mm(np.zeros((3, 5))),
            r"\(n, 6\)",
        ),
        (
            lambda: Network(Layout(), JointBox((0,) * 6, (1,) * 6), np.zeros(53)).output_mm(np.full(6, np.inf)),
            "not finite",
        ),
    ],
)
def test_wrong_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()


@pytest.mark.parametrize("more", [-1, 1])
def test_another_number_of_weights_is_refused(more: int) -> None:
    layout = Layout(2)
    with pytest.raises(InputError, match=f"has {layout.count} weights"):
        layout.layers(np.zeros((3, layout.count + more)))
