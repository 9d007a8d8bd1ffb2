"""What an instrument that measures distances does wrong: a wire, a ball bar, a tracker that reads distances alone.

Up to so many instruments, each to places of its own; the diagnosis numbers them in the order of its tables. Its columns
`wire1` .. say which one read a pose, `far_x_m` .. where its far end is (see `diagnosis.observations`).
"""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect

WIRES = 4
FAR = ("far_x_m", "far_y_m", "far_z_m")
FLAGS = tuple(f"wire{k}" for k in range(1, WIRES + 1))


@dataclass(frozen=True)
class DistanceFault(Effect):
    """What is added to a distance is moved along the beam, away from its far end."""

    of_measurement = True
    from_kind = True
    needs = (*FAR, *FLAGS)

    def of_wires(self, context: Context, name: str) -> Symbolic:
        """A parameter of the instrument that reads here."""
        return sum(self.value(context, f"{name}{k}") * context.conditions[f] for k, f in enumerate(FLAGS, 1))

    def beam(self, point: Symbolic, context: Context) -> Symbolic:
        """From the far end to the point, shape (3,) [m]."""
        return point - ca.vertcat(*(context.conditions[c] for c in FAR))


def along(beam: Symbolic) -> Symbolic:
    """Its direction."""
    return beam / ca.sqrt(ca.sumsqr(beam) + 1e-12)
