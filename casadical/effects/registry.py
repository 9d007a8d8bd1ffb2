"""Every effect of the package, a line each; their order is that of the candidates of a diagnosis."""
# ruff: noqa: I001

from casadical.effects.gear_eccentricity import GearEccentricity as GearEccentricity
from casadical.effects.transmission_ripple import TransmissionRipple as TransmissionRipple
from casadical.effects.axis_wobble import AxisWobble as AxisWobble
from casadical.effects.joint_scale import JointScale as JointScale
from casadical.effects.joint_coupling import JointCoupling as JointCoupling
from casadical.effects.joint_zero_step import JointZeroStep as JointZeroStep
from casadical.effects.thermal_zero_drift import ThermalZeroDrift as ThermalZeroDrift
from casadical.effects.backlash import Backlash as Backlash
from casadical.effects.friction_windup import FrictionWindup as FrictionWindup
from casadical.effects.thermal_growth import ThermalGrowth as ThermalGrowth
from casadical.effects.target_shift import TargetShift as TargetShift
from casadical.effects.payload_error import PayloadError as PayloadError
from casadical.effects.gravity_compensator import GravityCompensator as GravityCompensator
from casadical.effects.base_compliance import BaseCompliance as BaseCompliance
from casadical.effects.frame_drift import FrameDrift as FrameDrift
from casadical.effects.frame_settling import FrameSettling as FrameSettling
from casadical.effects.joint_error_curve import JointErrorCurve as JointErrorCurve
from casadical.effects.nonlinear_stiffness import NonlinearStiffness as NonlinearStiffness
from casadical.effects.cubic_stiffness import CubicStiffness as CubicStiffness
from casadical.effects.link_flexure import LinkFlexure as LinkFlexure
from casadical.effects.load_hysteresis import LoadHysteresis as LoadHysteresis
from casadical.effects.cross_coupling import CrossCoupling as CrossCoupling
from casadical.effects.bearing_play import BearingPlay as BearingPlay
from casadical.effects.gear_mesh import GearMesh as GearMesh
from casadical.effects.missing_compliance import MissingCompliance as MissingCompliance
from casadical.effects.hose_drag import HoseDrag as HoseDrag
from casadical.effects.tracker_scale import TrackerScale as TrackerScale
from casadical.effects.refraction import Refraction as Refraction
from casadical.effects.smr_offset import SmrOffset as SmrOffset
from casadical.effects.smooth import SmoothInJoint as SmoothInJoint
from casadical.effects.smooth import AnyOfOwnAngle as AnyOfOwnAngle
from casadical.effects.smooth import SmoothInJoints as SmoothInJoints
from casadical.effects.smooth import SmoothInTime as SmoothInTime
from casadical.effects.smooth import SmoothInSpace as SmoothInSpace
from casadical.effects.smooth import SmoothInLoad as SmoothInLoad
