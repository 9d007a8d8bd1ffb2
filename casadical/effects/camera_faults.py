"""What a camera that measures full poses does wrong, fixed and looking at the flange, or on the flange itself.

Its columns are made of the measured poses (see `diagnosis.camera_columns`): `fixed_depth_x_m` .. the part of the way
to the target along the lens's axis, `fixed_radial_x_m` .. the part across it times its slope squared, for a camera
whose frame is the measuring frame with the third axis along the lens; `carried_...` for one in the tool frame.
"""

from dataclasses import dataclass

import casadi as ca

from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Effect

SIDES = ("fixed", "carried")


def columns(side: str, what: str) -> tuple[str, str, str]:
    """Names of a vector's columns; what : depth or radial."""
    x, y, z = (f"{side}_{what}_{c}_m" for c in "xyz")
    return x, y, z


@dataclass(frozen=True)
class CameraFault(Effect):
    """A cause that only measured orientations make a candidate."""

    of_measurement = True
    from_kind = True


def vector(context: Context, side: str, what: str) -> Symbolic:
    """A vector that columns hold, shape (3,) [m]."""
    return ca.vertcat(*(context.conditions[c] for c in columns(side, what)))
