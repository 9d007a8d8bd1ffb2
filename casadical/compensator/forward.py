"""Forward pass, gradient and Jacobian of a whole colony of networks in batched numpy.

The paper's eq. 10 prints tansig(a) = 2 / (1 + exp(-2a)), without the -1 that makes it odd and bounded by +-1; here it
is 2 / (1 + exp(-2a)) - 1, which is tanh(a).

Shapes: P networks, N samples, O outputs, weights (P, count), inputs (features + 1, N) from `network_inputs`.
"""

from typing import Any

import numpy as np

from casadical.compensator.layout import Layout
from casadical.core.arrays import Array


class Memory:
    """Arrays for the layers' outputs, kept from call to call: fresh memory costs more than the products in it."""

    def __init__(self) -> None:
        self._arrays: dict[tuple[int, bool], Array] = {}

    def __call__(self, level: int, shape: tuple[int, ...], dtype: np.dtype[Any], ones: bool = False) -> Array:
        """An array of this shape, whatever it holds; with `ones` its last rows hold ones, which nobody writes to."""
        held, tail = self._arrays.get((level, ones)), shape[1:]
        if held is None or held.dtype != dtype or held.shape[1:] != tail or len(held) < shape[0]:
            held = self._arrays[level, ones] = (np.ones if ones else np.empty)(shape, dtype)
        return held[: shape[0]]


def forward(layout: Layout, weights: Array, inputs: Array, memory: Memory | None = None) -> Array:
    """Return the outputs of every network for every sample, shape (P, O, N), in the precision of the arguments.

    memory : where the outputs are; the next call with it overwrites them
    """
    first, *rest = layout.layers(weights)
    memory, samples, dtype = memory or Memory(), inputs.shape[1], np.result_type(weights, inputs)
    # The first layer sees the same inputs in every network: one matrix product for the whole colony.
    z = np.matmul(first.reshape(-1, first.shape[-1]), inputs, out=memory(0, (first[..., 0].size, samples), dtype))
    z = z.reshape(len(weights), -1, samples)
    for level, layer in enumerate(rest, 1):
        entering = memory(level, (len(weights), layer.shape[2], samples), dtype, ones=True)
        np.tanh(z, out=entering[:, :-1])
        z = np.matmul(layer, entering, out=memory(level, (*layer.shape[:2], samples), dtype))
    return z


def _activations(layout: Layout, weights: Array, inputs: Array) -> list[Array]:
    """Return what enters every layer, shape (P, k + 1, N) each with its last row one, and then the outputs."""
    count, samples = len(weights), inputs.shape[1]
    enters = [np.broadcast_to(inputs, (count, *inputs.shape))]
    layers = layout.layers(weights)
    for layer in layers[:-1]:
        z = np.ones((count, layer.shape[1] + 1, samples))
        np.tanh(layer @ enters[-1], out=z[:, :-1])
        enters.append(z)
    return [*enters, np.matmul(layers[-1], enters[-1])]


def gradient(layout: Layout, weights: Array, inputs: Array, sensitivity: Array) -> Array:
    """Back-propagate: gradient of a scalar by the weights, shape (P, count).

    sensitivity : array, shape (P, O, N), derivative of the scalar by every output.
    """
    *enters, _ = _activations(layout, weights, inputs)
    layers = layout.layers(weights)
    parts: list[Array] = []
    delta = sensitivity
    for level in reversed(range(len(layers))):
        z = enters[level]
        parts.append(delta @ z.transpose(0, 2, 1))
        if level:
            delta = (layers[level][:, :, :-1].transpose(0, 2, 1) @ delta) * (1.0 - z[:, :-1] ** 2)
    return np.asarray(layout.weights(parts[::-1]), dtype=np.float64)


def outputs_and_jacobian(layout: Layout, weights: Array, inputs: Array) -> tuple[Array, Array]:
    """Return outputs, shape (P, O, N), and their transposed Jacobian by the weights, shape (P, count, O, N)."""
    *enters, outputs = _activations(layout, weights, inputs)
    layers = layout.layers(weights)
    count, size, samples = outputs.shape
    jacobian = np.empty((count, layout.count, size, samples))
    # slope[p, o, m, n]: derivative of output o by what neuron m of the present layer sums up
    slope: Array = np.broadcast_to(np.eye(size)[None, :, :, None], (count, size, size, samples))
    stop = layout.count
    for level in reversed(range(len(layers))):
        m, k = layout.shapes[level]
        z, start = enters[level], stop - m * k
        block = jacobian[:, start:stop].reshape(count, m, k, size, samples)
        np.multiply(slope.transpose(0, 2, 1, 3)[:, :, None], z[:, None, :, None], out=block)
        if level:
            back = np.einsum("pmk,pomn->pokn", layers[level][:, :, :-1], slope)
            slope, stop = back * (1.0 - z[:, None, :-1] ** 2), start
    return outputs, jacobian
