"""Hidden effects by their names: those of the diagnosis' list, and those that are on no list."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics import causes_drive as drive
from casadical.blind_check.mujoco_physics import causes_load as load
from casadical.blind_check.mujoco_physics import causes_setup as setup
from casadical.blind_check.mujoco_physics import causes_structure as structure
from casadical.blind_check.mujoco_physics.cause import Cause, Kind
from casadical.core.basics import InputError


def _by_name(*kinds: Kind) -> dict[str, Kind]:
    """Return kinds of causes by their names."""
    return {kind.name: kind for kind in kinds}


# Effects on the list of those that the diagnosis knows, by name.
LISTED: Mapping[str, Kind] = _by_name(
    *(drive.gear_eccentricity, drive.transmission_ripple, drive.joint_scale),
    *(drive.joint_coupling, drive.joint_zero_step, structure.thermal_growth),
    *(drive.thermal_zero_drift, setup.target_shift, structure.payload_error),
    *(structure.axis_wobble, load.gravity_compensator, load.nonlinear_stiffness),
    *(load.backlash, load.friction_windup, structure.link_flexure, structure.base_compliance),
    *(setup.frame_drift, setup.outliers),
)

# Effects that the diagnosis does not know, by name.
UNLISTED: Mapping[str, Kind] = _by_name(
    *(structure.loose_flange, structure.tool_slip, structure.bearing_play, load.hose_pull),
    *(structure.cracked_link, structure.loose_anchor, structure.thermal_bend),
    *(drive.encoder_pit, drive.damaged_tooth, structure.loose_cargo, load.tight_cable),
    *(drive.lost_bits, load.rubber_coupling, setup.range_offset),
)


@dataclass(frozen=True)
class Hidden:
    """One hidden effect.

    effect : name of the effect, in `LISTED` or `UNLISTED`
    joint : number of its joint, from 1; None if it belongs to none
    size : its sizes by name [SI], the keyword arguments of its function
    """

    effect: str
    joint: int | None
    size: Mapping[str, Any]

    @property
    def about(self) -> str:
        """Return the sizes as text, "NAME VALUE, .." [SI]."""
        return ", ".join(f"{name} {np.round(value, 9).tolist()}" for name, value in self.size.items())

    @property
    def label(self) -> str:
        """Return the label of the effect: EFFECT, or EFFECT@JOINT."""
        return self.effect if self.joint is None else f"{self.effect}@{self.joint}"


def cause(hidden: Hidden, joints: int = 6) -> Cause:
    """Return the cause by which a hidden effect acts in the engine.

    joints : number of the robot's joints
    Raises InputError when its name, joint or sizes are not those of an effect.
    """
    kind = {**LISTED, **UNLISTED}.get(hidden.effect)
    if kind is None:
        raise InputError(f"effect {hidden.effect!r} is unknown; there are {', '.join([*LISTED, *UNLISTED])}")
    names = kind.sizes
    given = {k: tuple(v) if isinstance(v, list) else v for k, v in hidden.size.items()}
    if "joint" in names:
        given["joint"] = hidden.joint
    elif hidden.joint is not None:
        raise InputError(f"effect {hidden.effect!r} sits in no joint; leave joint={hidden.joint} out")
    if set(given) != names:
        raise InputError(f"effect {hidden.effect!r} has the sizes {sorted(given)}; it needs {sorted(names)}")
    if "joint" in names and hidden.joint not in range(1, joints + 1):
        raise InputError(f"effect {hidden.effect!r} needs a joint from 1 to {joints}, not {hidden.joint}")
    return Cause(kind, given)


def causes(hidden: Sequence[Hidden | Cause], joints: int = 6) -> list[Cause]:
    """Return the causes by which hidden effects act in the engine, couplings of joints last.

    hidden : effects by name, or causes, which are taken unchanged
    joints : number of the robot's joints
    """
    acting = (h if isinstance(h, Cause) else cause(h, joints) for h in hidden)
    return sorted(acting, key=lambda c: c.kind.name == "joint_coupling")
