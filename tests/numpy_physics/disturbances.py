"""All disturbances by the words of the diagnosis, and those that are on no list."""

from numpy_physics.disturbance import Disturbance
from numpy_physics.disturbances_drive import (
    GearEccentricity,
    JointCoupling,
    JointScale,
    JointZeroStep,
    ThermalZeroDrift,
    TransmissionRipple,
)
from numpy_physics.disturbances_load import (
    Backlash,
    FrictionWindup,
    HardeningSpring,
    HoseDrag,
    LooseFlange,
    SpringBalancer,
)
from numpy_physics.disturbances_setup import BeamRefraction, FrameDrift, Outliers, TargetShift
from numpy_physics.disturbances_structure import (
    AxisWobble,
    BearingSag,
    LinkFlexure,
    PayloadError,
    PedestalTilt,
    ThermalGrowth,
)

LISTED: dict[str, type[Disturbance]] = {
    "gear_eccentricity": GearEccentricity,
    "transmission_ripple": TransmissionRipple,
    "joint_scale": JointScale,
    "joint_coupling": JointCoupling,
    "joint_zero_step": JointZeroStep,
    "thermal_growth": ThermalGrowth,
    "thermal_zero_drift": ThermalZeroDrift,
    "target_shift": TargetShift,
    "payload_error": PayloadError,
    "axis_wobble": AxisWobble,
    "gravity_compensator": SpringBalancer,
    "nonlinear_stiffness": HardeningSpring,
    "backlash": Backlash,
    "friction_windup": FrictionWindup,
    "link_flexure": LinkFlexure,
    "base_compliance": PedestalTilt,
    "frame_drift": FrameDrift,
    "outliers": Outliers,
}

UNLISTED: dict[str, type[Disturbance]] = {
    "hose_drag": HoseDrag,
    "loose_flange": LooseFlange,
    "beam_refraction": BeamRefraction,
    "bearing_sag": BearingSag,
}

__all__ = sorted(["LISTED", "UNLISTED", "Disturbance", *(d.__name__ for d in (LISTED | UNLISTED).values())])
