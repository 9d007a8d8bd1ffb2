"""Compensator network: joint angles [rad] -> position correction [mm] (paper, eq. 10).

It is computed in NumPy and in CasADi.

The equation prints tansig(a) = 2 / (1 + exp(-2a)), without the -1 that makes it odd and bounded by
+-1; here it is 2 / (1 + exp(-2a)) - 1, which is tanh(a). A whole colony of networks is computed at
once. Shapes: P networks, N samples, O outputs, weights (P, count), inputs (features + 1, N) from
`network_inputs`.

The training task is defined here too: scaled inputs and targets, folds of them, and the paper's
loss (eqs. 12 and 14).
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from casadical.compensator.layout import JointBox, Layout, network_inputs
from casadical.core.basics import Array, InputError

if TYPE_CHECKING:
    import casadi


# Memory for the layers' outputs, by the index of the layer and whether the array is its input. It
# is reused by the next call, because allocating costs more than the matrix products.
OutputBuffers = dict[tuple[int, bool], Array]


def _reused(
    buffers: OutputBuffers, level: int, shape: tuple[int, ...], dtype: np.dtype[Any], ones: bool = False
) -> Array:
    """Return an array of this shape, whose memory the next call for the same layer reuses.

    level : index of the layer
    ones : whether the array is an input of the layer and begins as ones; its last row, the input of
        the biases, is never written to and stays one. Else its content is undefined.
    """
    buffer, tail = buffers.get((level, ones)), shape[1:]
    if buffer is None or buffer.dtype != dtype or buffer.shape[1:] != tail or len(buffer) < shape[0]:
        buffer = buffers[level, ones] = (np.ones if ones else np.empty)(shape, dtype)
    return buffer[: shape[0]]


def forward(layout: Layout, weights: Array, inputs: Array, buffers: OutputBuffers | None = None) -> Array:
    """Return the outputs of every network for every sample, shape (P, O, N).

    They are in units of the output layer and have the precision of the arguments.

    weights : shape (P, count); inputs : as of `network_inputs`, shape (features + 1, N)
    buffers : memory for the outputs; the next call with it overwrites them
    """
    first, *rest = layout.layers(weights)
    buffers = {} if buffers is None else buffers
    samples, dtype = inputs.shape[1], np.result_type(weights, inputs)
    # The first layer sees the same inputs in every network: one matrix product for the colony.
    out = _reused(buffers, 0, (first[..., 0].size, samples), dtype)
    z = np.matmul(first.reshape(-1, first.shape[-1]), inputs, out=out)
    z = z.reshape(len(weights), -1, samples)
    for level, layer in enumerate(rest, 1):
        size = (len(weights), layer.shape[2], samples)
        entering = _reused(buffers, level, size, dtype, ones=True)
        np.tanh(z, out=entering[:, :-1])
        out = _reused(buffers, level, (*layer.shape[:2], samples), dtype)
        z = np.matmul(layer, entering, out=out)
    return z


def _activations(layout: Layout, weights: Array, inputs: Array) -> list[Array]:
    """Return the input of every layer, shape (P, k + 1, N), and then the outputs, (P, O, N).

    The last row of an input is one.

    weights : shape (P, count); inputs : shape (features + 1, N)
    """
    count, samples = len(weights), inputs.shape[1]
    enters = [np.broadcast_to(inputs, (count, *inputs.shape))]
    layers = layout.layers(weights)
    for layer in layers[:-1]:
        z = np.ones((count, layer.shape[1] + 1, samples))
        np.tanh(layer @ enters[-1], out=z[:, :-1])
        enters.append(z)
    return [*enters, np.matmul(layers[-1], enters[-1])]


def gradient(layout: Layout, weights: Array, inputs: Array, sensitivity: Array) -> Array:
    """Return the gradient of a function of the outputs by the weights, shape (P, count).

    It is computed by back-propagation.

    weights : shape (P, count); inputs : shape (features + 1, N)
    sensitivity : gradient of the function by the outputs, shape (P, O, N)
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
    """Return the outputs, (P, O, N), and their Jacobian by the weights, (P, count, O, N).

    weights : shape (P, count); inputs : shape (features + 1, N)
    """
    *enters, outputs = _activations(layout, weights, inputs)
    layers = layout.layers(weights)
    count, size, samples = outputs.shape
    jacobian = np.empty((count, layout.count, size, samples))
    # slope[p, o, m, n]: derivative of output o by the weighted sum of this layer's neuron m.
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


@dataclass(frozen=True, eq=False)
class Network:
    """A trained network.

    layout : layer sizes
    box : joint ranges by which the inputs are scaled [rad]
    weights : in the order that `casadical.compensator.layout` defines, shape (layout.count,)
    output_scale_mm : millimetres of one unit of the output layer; 1 in the paper

    Examples
    --------
    >>> layout = casadical.compensator.Layout(joints=2, outputs=3)
    >>> box = casadical.compensator.JointBox((-3.0, -3.0), (3.0, 3.0))
    >>> network = casadical.compensator.Network(layout, box, np.zeros(layout.count))
    >>> network.output_mm(q[:4]).shape
    (4, 3)
    >>> print(network.function())
    network:(q[2])->(dp[3]) SXFunction
    """

    layout: Layout
    box: JointBox
    weights: Array = field(repr=False)
    output_scale_mm: float = 1.0

    def __post_init__(self) -> None:
        weights = np.array(self.weights, dtype=np.float64)
        if weights.shape != (self.layout.count,):
            raise InputError(f"{self.layout} has {self.layout.count} weights; the array's shape is {weights.shape}")
        if not np.all(np.isfinite(weights)):
            raise InputError("the network has weights that are not finite: it was not trained to an end")
        if len(self.box.lower) != self.layout.joints:
            raise InputError(f"the box has {len(self.box.lower)} joints, the layout {self.layout.joints}")
        if not (np.isfinite(self.output_scale_mm) and self.output_scale_mm > 0):
            raise InputError(f"output_scale_mm must be positive and finite; got {self.output_scale_mm}")
        weights.setflags(write=False)
        object.__setattr__(self, "weights", weights)

    def output_mm(self, q: Array) -> Array:
        """Return the position correction at joint variables, shape (n, outputs) or (outputs,) [mm].

        It is to be added to computed positions in the measuring frame, like the training residuals.

        q : joint variables, shape (n, joints) or (joints,) [rad]
        Raises InputError: another shape, or an angle that is not finite.
        """
        rows = joint_angles(q, self.layout.joints)
        inputs = network_inputs(self.layout, self.box, rows)
        out = self.output_scale_mm * forward(self.layout, self.weights[None], inputs)[0].T
        return np.asarray(out if np.ndim(q) == 2 else out[0], dtype=np.float64)

    def function(self) -> "casadi.Function":
        """Return the CasADi function ``network:(q[joints] rad)->(dp[outputs] mm)``."""
        import casadi

        q, centre, half = casadi.SX.sym("q", self.layout.joints), self.box.centre, self.box.half_width
        z: list[Any] = []
        for joint in range(self.layout.joints):
            periodic = joint in self.layout.periodic
            scaled = (q[joint] - centre[joint]) / half[joint]
            z += [casadi.sin(q[joint]), casadi.cos(q[joint])] if periodic else [scaled]
        *hidden, last = (np.asarray(layer) for layer in self.layout.layers(self.weights))
        column = casadi.vertcat(*z)
        for layer in hidden:
            column = casadi.tanh(casadi.DM(layer[:, :-1]) @ column + casadi.DM(layer[:, -1]))
        out = self.output_scale_mm * (casadi.DM(last[:, :-1]) @ column + casadi.DM(last[:, -1]))
        return casadi.Function("network", [q], [out], ["q"], ["dp"])


def joint_angles(q: ArrayLike, joints: int | None) -> Array:
    """Return q as an array of shape (n, joints) [rad]; a single pose may have shape (joints,).

    joints : required number of joints; None: any
    Raises InputError for another shape or values that are not finite.
    """
    rows = _numbers(q, "q")
    rows = rows[None] if rows.ndim == 1 else rows
    if rows.ndim != 2 or rows.shape[1] != (joints or rows.shape[1]):
        raise InputError(f"q must have shape (n, {joints or 'joints'}) [rad]; its shape is {np.shape(q)}")
    _finite(rows, "q", "rad")
    return rows


def residuals(residual_mm: ArrayLike, poses: int, outputs: int | None) -> Array:
    """Return residuals as an array of shape (poses, outputs) [mm].

    poses : required number of rows; outputs : required number of columns; None: any
    Raises InputError for another shape or values that are not finite.
    """
    rows = _numbers(residual_mm, "residual_mm")
    if rows.ndim != 2 or rows.shape != (poses, outputs or rows.shape[1]):
        raise InputError(
            f"residual_mm must have shape ({poses}, {outputs or 'outputs'}) [mm], one row for each "
            f"row of q; its shape is {rows.shape}"
        )
    _finite(rows, "residual_mm", "mm")
    return rows


def _numbers(values: ArrayLike, name: str) -> Array:
    """Return values as an array of doubles; name : of the argument, for the message."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of numbers: {error}") from None


def _finite(rows: Array, name: str, unit: str) -> None:
    """Check that all values are finite; name, unit : of the argument, for the message."""
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"{name}[{row}, {column}] is {rows[row, column]} {unit}: {len(bad)} value(s) of {name} "
            "are not finite; drop these poses or repair them"
        )


@dataclass(frozen=True)
class Loss:
    """The loss mean * mean(E) + max * max(E) of the poses' mean square errors E [mm^2].

    E is the mean over the outputs of a pose's squared errors. Source: paper, eqs. 12 and 14.

    mean, max : weights of the mean and the maximum over the poses; 1 and 0.7 in the paper
    """

    mean: float = 1.0
    max: float = 0.7

    def __post_init__(self) -> None:
        if not (self.mean >= 0 and self.max >= 0 and self.mean + self.max > 0):
            raise InputError(f"the weights of the loss must not be negative nor both zero; got {self}")

    def value(self, errors: Array) -> Array:
        """Return the loss of every network, shape (P,), in the squared unit of the errors.

        errors : outputs less targets, shape (P, outputs, N)
        """
        _, outputs, samples = errors.shape
        totals = np.einsum("pon,pon->pn", errors, errors)
        losses = np.maximum.reduce(totals, axis=1)
        losses *= self.max
        losses += totals @ np.full(samples, self.mean / samples, errors.dtype)
        losses /= outputs
        return np.asarray(losses)

    def slope(self, errors: Array) -> Array:
        """Return a (sub)gradient of the loss by the errors, shape (P, outputs, N), in their unit.

        errors : outputs less targets, shape (P, outputs, N)
        """
        networks, outputs, samples = errors.shape
        weight = np.full((networks, samples), self.mean / samples)
        worst = np.einsum("pon,pon->pn", errors, errors).argmax(axis=1)
        weight[np.arange(networks), worst] += self.max
        return np.asarray(2.0 / outputs * weight[:, None] * errors, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Task:
    """A training problem of N poses.

    layout : sizes of the network
    inputs : scaled joint angles as of `network_inputs`, shape (features + 1, N)
    targets : residuals divided by `scale_mm`, shape (outputs, N) [units of the output layer]
    scale_mm : millimetres of one unit of the output layer
    loss : loss that is minimised
    """

    layout: Layout
    inputs: Array
    targets: Array
    scale_mm: float = 1.0
    loss: Loss = Loss()

    def losses(self, weights: Array) -> Array:
        """Return the loss of every row of weights, shape (P,) [mm^2], without a ridge.

        It is `Loss.value`: by default the mean plus 0.7 times the maximum of mean square errors.

        weights : one network per row, shape (P, count)
        """
        try:  # each thread uses buffers of its own
            buffers = self._idle_buffers.pop()
        except IndexError:
            buffers = {}
        errors = forward(self.layout, weights, self.inputs, buffers)
        errors -= self.targets
        losses = self.loss.value(errors)
        self._idle_buffers.append(buffers)
        return np.asarray(self.scale_mm**2 * losses)

    @cached_property
    def _idle_buffers(self) -> list[OutputBuffers]:
        """Return buffers for `losses` that no thread uses at the moment."""
        return []

    def errors_mm(self, weights: Array) -> Array:
        """Return target minus output of one network (eq. 11), shape (N, outputs) [mm].

        weights : shape (count,)
        """
        outputs = forward(self.layout, weights[None], self.inputs)[0]
        return np.asarray(self.scale_mm * (self.targets - outputs).T, dtype=np.float64)


def make_task(
    layout: Layout, box: JointBox, q: Array, residual_mm: Array, *, scale_mm: float = 1.0, loss: Loss | None = None
) -> Task:
    """Return the problem of training a network on joint angles and residuals.

    layout : sizes of the network
    box : joint ranges by which the inputs are scaled [rad]
    q : shape (n, joints) [rad]: joint variables
    residual_mm : shape (n, outputs) [mm]: residuals, measured less computed
    scale_mm : millimetres of one unit of the output layer
    loss : loss that is minimised; None: the paper's
    Raises InputError: a scale that is not positive.

    Examples
    --------
    >>> from casadical.compensator import JointBox, Layout, make_task
    >>> make_task(Layout(2), JointBox((-3.0, -3.0), (3.0, 3.0)), poses.q, residual_mm).targets.shape
    (3, 40)
    """
    if not (np.isfinite(scale_mm) and scale_mm > 0):
        raise InputError(f"output_scale_mm must be positive and finite; got {scale_mm}")
    inputs = network_inputs(layout, box, q)
    targets = np.ascontiguousarray(residual_mm.T) / scale_mm
    return Task(layout, inputs, targets, scale_mm, loss if loss is not None else Loss())


def random_weights(layout: Layout, random: np.random.Generator, count: int) -> Array:
    """Return random start weights of `count` networks, shape (count, layout.count).

    They are normal, with the standard deviation 1 / sqrt(k + 1) for a neuron on k inputs.
    """
    spread = layout.weights([np.full(shape, shape[1] ** -0.5) for shape in layout.shapes])
    return np.asarray(spread * random.standard_normal((count, layout.count)), dtype=np.float64)


def training_masks(samples: int, folds: int, seed: int) -> Array:
    """Return a mask of the training samples of each random fold, shape (folds, samples).

    It is false for the samples that the fold holds out, whose numbers differ by at most one.

    samples : number of samples; seed : seed of the random folds
    """
    order = np.random.default_rng(seed).permutation(samples)
    masks = np.ones((folds, samples), dtype=bool)
    for mask, held_out in zip(masks, np.array_split(order, folds), strict=True):
        mask[held_out] = False
    return masks
