"""Hidden effects by their names: those of the diagnosis' list, and those that are on no list."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics import causes_drive, causes_load, causes_setup, causes_structure
from casadical.blind_check.mujoco_physics.cause import Cause
from casadical.core.basics import InputError


def _by_name(*kinds: type[Cause]) -> dict[str, type[Cause]]:
    return {re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower(): kind for kind in kinds}


LISTED: Mapping[str, type[Cause]] = _by_name(
    causes_drive.GearEccentricity, causes_drive.TransmissionRipple, causes_drive.JointScale,
    causes_drive.JointCoupling, causes_drive.JointZeroStep, causes_structure.ThermalGrowth,
    causes_drive.ThermalZeroDrift, causes_setup.TargetShift, causes_structure.PayloadError,
    causes_structure.AxisWobble, causes_load.GravityCompensator, causes_load.NonlinearStiffness,
    causes_load.Backlash, causes_load.FrictionWindup, causes_structure.LinkFlexure, causes_structure.BaseCompliance,
    causes_setup.FrameDrift, causes_setup.Outliers,
)  # fmt: skip

UNLISTED: Mapping[str, type[Cause]] = _by_name(
    causes_structure.LooseFlange, causes_structure.ToolSlip, causes_structure.BearingPlay, causes_load.HosePull,
    causes_structure.CrackedLink, causes_structure.LooseAnchor, causes_structure.ThermalBend,
    causes_drive.EncoderPit, causes_drive.DamagedTooth, causes_structure.LooseCargo, causes_load.TightCable,
    causes_drive.LostBits, causes_load.RubberCoupling, causes_setup.RangeOffset,
)  # fmt: skip


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
