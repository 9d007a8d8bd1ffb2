"""Layout of a compensator network: layer sizes, order of the weight vector, scaling of the inputs.

The weight vector runs layer after layer from the inputs to the outputs, in each layer neuron after
neuron, and for each neuron through its input weights and then its bias. A layer of m neurons on k
inputs is thus the matrix ``[W | b]`` of shape (m, k + 1), row by row. The paper's 6-5-3 network has
5 * 7 + 3 * 6 = 53 weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np

from casadical.core.basics import Array, InputError


@dataclass(frozen=True)
class Layout:
    """Sizes of a network.

    joints : number of joint angles that are its input
    hidden : number of neurons of each hidden layer, first to last (tansig)
    outputs : number of outputs (linear)
    periodic : joints, counted from 0, that enter as (sin q, cos q) instead of as a scaled angle

    Examples
    --------
    >>> layout = casadical.compensator.Layout(joints=6, hidden=(5,))
    >>> layout.count, layout.shapes
    (53, ((5, 7), (3, 6)))
    >>> weights = np.arange(layout.count, dtype=float)
    >>> layers = layout.layers(weights)
    >>> [layer.shape for layer in layers], bool((layout.weights(layers) == weights).all())
    ([(5, 7), (3, 6)], True)
    >>> int(layout.output_biases().sum())
    3
    """

    joints: int = 6
    hidden: tuple[int, ...] = (5,)
    outputs: int = 3
    periodic: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(int(size) for size in self.hidden))
        object.__setattr__(self, "periodic", tuple(sorted(int(joint) for joint in self.periodic)))
        if min((self.joints, self.outputs, *self.hidden)) < 1:
            raise InputError(f"every layer of a network needs at least one neuron, got {self}")
        if len(set(self.periodic)) != len(self.periodic) or not all(
            0 <= joint < self.joints for joint in self.periodic
        ):
            raise InputError(f"periodic names joints 0 to {self.joints - 1}, each once; got {self.periodic}")

    @property
    def features(self) -> int:
        """Return the number of network inputs, without that of the biases: two for a periodic joint."""
        return self.joints + len(self.periodic)

    @cached_property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Return the shape (neurons, inputs + 1) of ``[W | b]`` of every layer, inputs to outputs."""
        sizes = (self.features, *self.hidden, self.outputs)
        return tuple((m, k + 1) for k, m in pairwise(sizes))

    @cached_property
    def count(self) -> int:
        """Return the number of weights, biases included."""
        return sum(m * k for m, k in self.shapes)

    def layers(self, weights: Array) -> list[Array]:
        """Return the weights of each layer, shape (..., m, k + 1), for m neurons on k inputs.

        weights : shape (..., count)
        Raises InputError: another number of weights.
        """
        weights = np.asarray(weights)
        if weights.shape[-1:] != (self.count,):
            raise InputError(f"{self} has {self.count} weights; the array's shape is {weights.shape}")
        spans = pairwise(accumulate((m * k for m, k in self.shapes), initial=0))
        leading = weights.shape[:-1]
        return [
            weights[..., start:stop].reshape(*leading, *shape)
            for (start, stop), shape in zip(spans, self.shapes, strict=True)
        ]

    def weights(self, layers: Sequence[Array]) -> Array:
        """Return the weights, shape (..., count), of given layers.

        layers : shape (..., m, k + 1) each, for m neurons on k inputs
        Raises InputError: layers of other shapes.
        """
        got = [np.shape(layer)[-2:] for layer in layers]
        if got != list(self.shapes):
            raise InputError(f"{self} has layers of shape {list(self.shapes)}; got {got}")
        return np.concatenate([np.asarray(part).reshape(*np.shape(part)[:-2], -1) for part in layers], axis=-1)

    def output_biases(self) -> Array:
        """Return a mask of a weight vector, true for the output layer's biases, shape (count,)."""
        marks = [np.zeros(shape, dtype=bool) for shape in self.shapes]
        marks[-1][:, -1] = True
        return np.concatenate([mark.ravel() for mark in marks])


@dataclass(frozen=True)
class JointBox:
    """Joint ranges by which a network's inputs are scaled and within which it is valid.

    lower : lower end of each joint's range [rad], which is mapped to -1
    upper : upper end of each joint's range [rad], which is mapped to +1; a joint that does not move
        (lower == upper) is mapped to q - lower

    Examples
    --------
    >>> box = casadical.compensator.JointBox((-1.0, -2.0), (1.0, 2.0))
    >>> box.contains(np.array([[0.0, 0.0], [1.5, 0.0]]))
    array([ True, False])
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        lower, upper = (tuple(float(v) for v in bound) for bound in (self.lower, self.upper))
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)
        if len(lower) != len(upper):
            raise InputError(f"a box needs as many lower as upper bounds; got {len(lower)} and {len(upper)}")
        for joint, (low, high) in enumerate(zip(lower, upper, strict=True)):
            if not (np.isfinite(low) and np.isfinite(high) and low <= high):
                raise InputError(f"bounds of joint {joint} must be finite and in order; got {low} and {high} rad")

    @property
    def centre(self) -> Array:
        """Return the middle of every range, shape (joints,) [rad]."""
        return 0.5 * np.add(self.lower, self.upper, dtype=np.float64)

    @property
    def half_width(self) -> Array:
        """Return the half of every range, shape (joints,) [rad]; 1 for a joint that does not move."""
        half = 0.5 * np.subtract(self.upper, self.lower, dtype=np.float64)
        return np.where(half > 0, half, 1.0)

    def contains(self, q: Array) -> Array:
        """Return a mask of those rows of q, (n, joints) [rad], that lie in the box, shape (n,)."""
        within: Array = (q >= self.lower) & (q <= self.upper)
        return np.asarray(within.all(axis=1), dtype=np.bool_)


def box_around(q: Array) -> JointBox:
    """Return the smallest box that contains the joint angles q, shape (n, joints) [rad], n > 0."""
    return JointBox(tuple(q.min(axis=0)), tuple(q.max(axis=0)))


def network_inputs(layout: Layout, box: JointBox, q: Array) -> Array:
    """Return joint angles q, shape (n, joints) [rad], as network inputs, shape (features + 1, n).

    The rows are, joint after joint, the angle scaled from the box to -1..1, or sin and cos of a
    periodic joint. The last row is one: the input of the biases.
    """
    rows: list[Array] = []
    centre, half = box.centre, box.half_width
    for joint in range(layout.joints):
        angle = q[:, joint]
        if joint in layout.periodic:
            rows += [np.sin(angle), np.cos(angle)]
        else:
            rows.append((angle - centre[joint]) / half[joint])
    return np.vstack([*rows, np.ones(len(q))])
