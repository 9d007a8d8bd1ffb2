"""The compensator network: joint angles [rad] -> position correction [mm], in numpy and in CasADi (paper, eq. 10)."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from casadical.compensator.checks import joint_angles
from casadical.compensator.forward import forward
from casadical.compensator.layout import JointBox, Layout, network_inputs
from casadical.core.arrays import Array
from casadical.core.errors import InputError

if TYPE_CHECKING:
    import casadi


@dataclass(frozen=True, eq=False)
class Network:
    """A trained network.

    layout : layer sizes
    box : joint ranges of the input scaling [rad]
    weights : shape (layout.count,): in the order that `casadical.compensator.layout` defines
    output_scale_mm : the linear output layer's sum is multiplied by this to give millimetres; 1 in the paper

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
        """The correction, shape (n, outputs) or (outputs,) [mm], at readings q, shape (n, joints) or (joints,) [rad].

        Raises InputError: another shape, or an angle that is not finite.
        """
        rows = joint_angles(q, self.layout.joints)
        inputs = network_inputs(self.layout, self.box, rows)
        out = self.output_scale_mm * forward(self.layout, self.weights[None], inputs)[0].T
        return np.asarray(out if np.ndim(q) == 2 else out[0], dtype=np.float64)

    def function(self) -> "casadi.Function":
        """Return the CasADi function ``network:(q[joints])->(dp[outputs])``: q in radians, dp in millimetres."""
        import casadi

        q = casadi.SX.sym("q", self.layout.joints)
        return casadi.Function("network", [q], [self._expression(q)], ["q"], ["dp"])

    def _expression(self, q: Any) -> Any:
        """Write the network as a CasADi expression in q."""
        import casadi

        centre, half = self.box.centre, self.box.half_width
        z: list[Any] = []
        for joint in range(self.layout.joints):
            periodic = joint in self.layout.periodic
            scaled = (q[joint] - centre[joint]) / half[joint]
            z += [casadi.sin(q[joint]), casadi.cos(q[joint])] if periodic else [scaled]
        *hidden, last = (np.asarray(layer) for layer in self.layout.layers(self.weights))
        column = casadi.vertcat(*z)
        for layer in hidden:
            column = casadi.tanh(casadi.DM(layer[:, :-1]) @ column + casadi.DM(layer[:, -1]))
        return self.output_scale_mm * (casadi.DM(last[:, :-1]) @ column + casadi.DM(last[:, -1]))
