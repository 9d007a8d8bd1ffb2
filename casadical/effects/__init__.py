"""Effects that a base model leaves out: one symbolic term each, at a named seam of the model."""

from .axis_wobble import AxisWobble
from .backlash import Backlash
from .base import Context, Effect
from .base_compliance import BaseCompliance
from .bearing_play import BearingPlay
from .cross_coupling import CrossCoupling
from .cubic_stiffness import CubicStiffness
from .frame_drift import FrameDrift
from .friction_windup import FrictionWindup
from .gear_eccentricity import GearEccentricity
from .gear_mesh import GearMesh
from .gravity_compensator import GravityCompensator
from .hose_drag import HoseDrag
from .joint_coupling import JointCoupling
from .joint_scale import JointScale
from .joint_zero_step import JointZeroStep
from .link_flexure import LinkFlexure
from .load_hysteresis import LoadHysteresis
from .missing_compliance import MissingCompliance
from .nonlinear_stiffness import NonlinearStiffness
from .payload_error import PayloadError
from .refraction import Refraction
from .smr_offset import SmrOffset
from .target_shift import TargetShift
from .thermal_growth import ThermalGrowth
from .thermal_zero_drift import ThermalZeroDrift
from .tracker_scale import TrackerScale
from .transmission_ripple import TransmissionRipple

__all__ = [
    "AxisWobble",
    "Backlash",
    "BaseCompliance",
    "BearingPlay",
    "Context",
    "CrossCoupling",
    "CubicStiffness",
    "Effect",
    "FrameDrift",
    "FrictionWindup",
    "GearEccentricity",
    "GearMesh",
    "GravityCompensator",
    "HoseDrag",
    "JointCoupling",
    "JointScale",
    "JointZeroStep",
    "LinkFlexure",
    "LoadHysteresis",
    "MissingCompliance",
    "NonlinearStiffness",
    "PayloadError",
    "Refraction",
    "SmrOffset",
    "TargetShift",
    "ThermalGrowth",
    "ThermalZeroDrift",
    "TrackerScale",
    "TransmissionRipple",
]
