"""Effects that a base model leaves out: one symbolic term each, at a named seam of the model."""

from casadical.effects.axis_wobble import AxisWobble
from casadical.effects.backlash import Backlash
from casadical.effects.base import Context, Effect
from casadical.effects.base_compliance import BaseCompliance
from casadical.effects.bearing_play import BearingPlay
from casadical.effects.cross_coupling import CrossCoupling
from casadical.effects.cubic_stiffness import CubicStiffness
from casadical.effects.frame_drift import FrameDrift
from casadical.effects.friction_windup import FrictionWindup
from casadical.effects.gear_eccentricity import GearEccentricity
from casadical.effects.gear_mesh import GearMesh
from casadical.effects.gravity_compensator import GravityCompensator
from casadical.effects.hose_drag import HoseDrag
from casadical.effects.joint_coupling import JointCoupling
from casadical.effects.joint_scale import JointScale
from casadical.effects.joint_zero_step import JointZeroStep
from casadical.effects.link_flexure import LinkFlexure
from casadical.effects.load_hysteresis import LoadHysteresis
from casadical.effects.missing_compliance import MissingCompliance
from casadical.effects.nonlinear_stiffness import NonlinearStiffness
from casadical.effects.payload_error import PayloadError
from casadical.effects.refraction import Refraction
from casadical.effects.smr_offset import SmrOffset
from casadical.effects.target_shift import TargetShift
from casadical.effects.thermal_growth import ThermalGrowth
from casadical.effects.thermal_zero_drift import ThermalZeroDrift
from casadical.effects.tracker_scale import TrackerScale
from casadical.effects.transmission_ripple import TransmissionRipple

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
