"""Effects that a base model leaves out: one symbolic term each, at a named seam of the model."""

from .axis_wobble import AxisWobble
from .backlash import Backlash
from .base import Context, Effect
from .base_compliance import BaseCompliance
from .cubic_stiffness import CubicStiffness
from .frame_drift import FrameDrift
from .friction_windup import FrictionWindup
from .gear_eccentricity import GearEccentricity
from .gravity_compensator import GravityCompensator
from .joint_coupling import JointCoupling
from .joint_scale import JointScale
from .joint_zero_step import JointZeroStep
from .link_flexure import LinkFlexure
from .nonlinear_stiffness import NonlinearStiffness
from .payload_error import PayloadError
from .target_shift import TargetShift
from .thermal_growth import ThermalGrowth
from .thermal_zero_drift import ThermalZeroDrift
from .transmission_ripple import TransmissionRipple

__all__ = [
    "AxisWobble",
    "Backlash",
    "BaseCompliance",
    "Context",
    "CubicStiffness",
    "Effect",
    "FrameDrift",
    "FrictionWindup",
    "GearEccentricity",
    "GravityCompensator",
    "JointCoupling",
    "JointScale",
    "JointZeroStep",
    "LinkFlexure",
    "NonlinearStiffness",
    "PayloadError",
    "TargetShift",
    "ThermalGrowth",
    "ThermalZeroDrift",
    "TransmissionRipple",
]
