"""Every effect of the package, one per line, in the order of the candidates of a diagnosis.

Effects that are formulas are defined in `listed.effect.toml`; the others are classes.
"""
# ruff: noqa: E402, I001

from casadical.effects.definition import LISTED_EFFECTS_FILE as _LISTED_EFFECTS_FILE
from casadical.effects.definition import read_definitions as _read

_defined = _read(_LISTED_EFFECTS_FILE, __name__)

GearEccentricity = _defined["gear_eccentricity"]
TransmissionRipple = _defined["transmission_ripple"]
from casadical.effects.play import AxisWobble as AxisWobble

JointScale = _defined["joint_scale"]
JointCoupling = _defined["joint_coupling"]
JointZeroStep = _defined["joint_zero_step"]
ThermalZeroDrift = _defined["thermal_zero_drift"]
from casadical.effects.play import Backlash as Backlash
from casadical.effects.play import BacklashByLoad as BacklashByLoad

FrictionWindup = _defined["friction_windup"]
ThermalGrowth = _defined["thermal_growth"]
TargetShift = _defined["target_shift"]
PayloadError = _defined["payload_error"]
from casadical.effects.springs import LinkMasses as LinkMasses
from casadical.effects.springs import GravityCompensator as GravityCompensator

from casadical.effects.springs import BaseCompliance as BaseCompliance
from casadical.effects.instrument import FrameDrift as FrameDrift
from casadical.effects.instrument import FrameSettling as FrameSettling
from casadical.effects.joint_error_curve import JointErrorCurve as JointErrorCurve

NonlinearStiffness = _defined["nonlinear_stiffness"]
CubicStiffness = _defined["cubic_stiffness"]
from casadical.effects.springs import LinkFlexure as LinkFlexure

LoadHysteresis = _defined["load_hysteresis"]
CrossCoupling = _defined["cross_coupling"]
from casadical.effects.play import BearingPlay as BearingPlay

GearMesh = _defined["gear_mesh"]
MissingCompliance = _defined["missing_compliance"]
from casadical.effects.springs import HoseDrag as HoseDrag
from casadical.effects.instrument import FrameStep as FrameStep

ThermalBend = _defined["thermal_bend"]
FrictionMemory = _defined["friction_memory"]
SettlingLag = _defined["settling_lag"]
TrackerScale = _defined["tracker_scale"]
Refraction = _defined["refraction"]
from casadical.effects.instrument import SmrOffset as SmrOffset

WireOffset = _defined["wire_offset"]
WireScale = _defined["wire_scale"]
WireDrift = _defined["wire_drift"]
StationStep = _defined["station_step"]
WireStep = _defined["wire_step"]
LensScale = _defined["lens_scale"]
HandEyeStep = _defined["hand_eye_step"]
StandStep = _defined["stand_step"]
from casadical.effects.smooth import SmoothInJoint as SmoothInJoint
from casadical.effects.smooth import AnyOfOwnAngle as AnyOfOwnAngle
from casadical.effects.smooth import AnyOfOtherAngle as AnyOfOtherAngle
from casadical.effects.smooth import AnyOfTime as AnyOfTime
from casadical.effects.smooth import AnyOfLoad as AnyOfLoad
from casadical.effects.smooth import AnyOfAngleAndLoad as AnyOfAngleAndLoad
from casadical.effects.smooth import FrameInTime as FrameInTime
from casadical.effects.smooth import ToolInTime as ToolInTime
from casadical.effects.smooth import BaseByMoment as BaseByMoment
from casadical.effects.smooth import AxisByAngle as AxisByAngle
from casadical.effects.smooth import SmoothInJoints as SmoothInJoints
from casadical.effects.smooth import SmoothInTime as SmoothInTime
from casadical.effects.smooth import WarmUp as WarmUp
from casadical.effects.smooth import SmoothInSpace as SmoothInSpace
from casadical.effects.smooth import SmoothInLoad as SmoothInLoad
from casadical.effects.formula_effect import Law as Law
from casadical.effects.instrument import Session as Session
