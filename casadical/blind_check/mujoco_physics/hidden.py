"""Hidden effects by their names: those of the diagnosis' list, and those that are on no list."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.blind_check.mujoco_physics.causes_drive import (
    DamagedTooth,
    EncoderPit,
    GearEccentricity,
    JointCoupling,
    JointScale,
    JointZeroStep,
    ThermalZeroDrift,
    TransmissionRipple,
)
from casadical.blind_check.mujoco_physics.causes_load import (
    Backlash,
    FrictionWindup,
    GravityCompensator,
    HosePull,
    NonlinearStiffness,
)
from casadical.blind_check.mujoco_physics.causes_loose import (
    BearingPlay,
    CrackedLink,
    LooseAnchor,
    LooseFlange,
    ToolSlip,
)
from casadical.blind_check.mujoco_physics.causes_odd import (
    LooseCargo,
    LostBits,
    RangeOffset,
    RubberCoupling,
    TightCable,
)
from casadical.blind_check.mujoco_physics.causes_setup import FrameDrift, Outliers, TargetShift
from casadical.blind_check.mujoco_physics.causes_structure import (
    AxisWobble,
    BaseCompliance,
    LinkFlexure,
    PayloadError,
    ThermalBend,
    ThermalGrowth,
)
from casadical.core.errors import InputError

LISTED: Mapping[str, type[Cause]] = {
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
    "gravity_compensator": GravityCompensator,
    "nonlinear_stiffness": NonlinearStiffness,
    "backlash": Backlash,
    "friction_windup": FrictionWindup,
    "link_flexure": LinkFlexure,
    "base_compliance": BaseCompliance,
    "frame_drift": FrameDrift,
    "outliers": Outliers,
}

UNLISTED: Mapping[str, type[Cause]] = {
    "loose_flange": LooseFlange,
    "tool_slip": ToolSlip,
    "bearing_play": BearingPlay,
    "hose_pull": HosePull,
    "cracked_link": CrackedLink,
    "loose_anchor": LooseAnchor,
    "thermal_bend": ThermalBend,
    "encoder_pit": EncoderPit,
    "damaged_tooth": DamagedTooth,
    "loose_cargo": LooseCargo,
    "tight_cable": TightCable,
    "lost_bits": LostBits,
    "rubber_coupling": RubberCoupling,
    "range_offset": RangeOffset,
}


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: its name, the joint (1-based) it sits in or None, and everything else about it in SI units."""

    effect: str
    joint: int | None
    size: Mapping[str, Any]

    @property
    def label(self) -> str:
        """``effect`` or ``effect@joint``."""
        return self.effect if self.joint is None else f"{self.effect}@{self.joint}"


def cause(hidden: Hidden) -> Cause:
    """What a hidden effect does in the engine. Raises InputError when its name, joint or sizes are not those of one."""
    kind = {**LISTED, **UNLISTED}.get(hidden.effect)
    if kind is None:
        raise InputError(f"effect {hidden.effect!r} is unknown; there are {', '.join([*LISTED, *UNLISTED])}")
    names = {f.name for f in fields(kind)}
    given = {k: tuple(v) if isinstance(v, list) else v for k, v in hidden.size.items()}
    if "joint" in names:
        given["joint"] = hidden.joint
    elif hidden.joint is not None:
        raise InputError(f"effect {hidden.effect!r} sits in no joint; leave joint={hidden.joint} out")
    if set(given) != names:
        raise InputError(f"effect {hidden.effect!r} has the sizes {sorted(given)}; it needs {sorted(names)}")
    if "joint" in names and hidden.joint not in range(1, 7):
        raise InputError(f"effect {hidden.effect!r} needs a joint from 1 to 6, not {hidden.joint}")
    return kind(**given)


def causes(hidden: Sequence[Hidden]) -> list[Cause]:
    """What hidden effects do in the engine, in the order in which they are built in."""
    return sorted((cause(h) for h in hidden), key=lambda c: c.last)
