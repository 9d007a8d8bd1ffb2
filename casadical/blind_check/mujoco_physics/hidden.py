"""Hidden effects by their names: those of the diagnosis' list, and those that are on no list."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics import causes_drive, causes_load, causes_loose, causes_setup, causes_structure
from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.core.errors import InputError

LISTED: Mapping[str, type[Cause]] = {
    "gear_eccentricity": causes_drive.GearEccentricity,
    "transmission_ripple": causes_drive.TransmissionRipple,
    "joint_scale": causes_drive.JointScale,
    "joint_coupling": causes_drive.JointCoupling,
    "joint_zero_step": causes_drive.JointZeroStep,
    "thermal_growth": causes_structure.ThermalGrowth,
    "thermal_zero_drift": causes_drive.ThermalZeroDrift,
    "target_shift": causes_setup.TargetShift,
    "payload_error": causes_structure.PayloadError,
    "axis_wobble": causes_structure.AxisWobble,
    "gravity_compensator": causes_load.GravityCompensator,
    "nonlinear_stiffness": causes_load.NonlinearStiffness,
    "backlash": causes_load.Backlash,
    "friction_windup": causes_load.FrictionWindup,
    "link_flexure": causes_structure.LinkFlexure,
    "base_compliance": causes_structure.BaseCompliance,
    "frame_drift": causes_setup.FrameDrift,
    "outliers": causes_setup.Outliers,
}

UNLISTED: Mapping[str, type[Cause]] = {
    "loose_flange": causes_loose.LooseFlange,
    "tool_slip": causes_loose.ToolSlip,
    "bearing_play": causes_loose.BearingPlay,
    "hose_pull": causes_load.HosePull,
    "cracked_link": causes_loose.CrackedLink,
    "loose_anchor": causes_loose.LooseAnchor,
    "thermal_bend": causes_structure.ThermalBend,
    "encoder_pit": causes_drive.EncoderPit,
    "damaged_tooth": causes_drive.DamagedTooth,
    "loose_cargo": causes_loose.LooseCargo,
    "tight_cable": causes_load.TightCable,
    "lost_bits": causes_drive.LostBits,
    "rubber_coupling": causes_load.RubberCoupling,
    "range_offset": causes_setup.RangeOffset,
}


def sizes_in_words(sizes: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {np.round(value, 9).tolist()}" for name, value in sizes.items())


@dataclass(frozen=True)
class Hidden:
    """One hidden effect: its name, the joint it sits in (1-based, None: none), everything else about it [SI]."""

    effect: str
    joint: int | None
    size: Mapping[str, Any]

    @property
    def about(self) -> str:
        return sizes_in_words(self.size)

    @property
    def label(self) -> str:
        return self.effect if self.joint is None else f"{self.effect}@{self.joint}"


def cause(hidden: Hidden, joints: int = 6) -> Cause:
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
    if "joint" in names and hidden.joint not in range(1, joints + 1):
        raise InputError(f"effect {hidden.effect!r} needs a joint from 1 to {joints}, not {hidden.joint}")
    return kind(**given)


def causes(hidden: Sequence[Hidden], joints: int = 6) -> list[Cause]:
    """What hidden effects do in the engine, in the order in which they are built in."""
    return sorted((cause(h, joints) for h in hidden), key=lambda c: c.last)
