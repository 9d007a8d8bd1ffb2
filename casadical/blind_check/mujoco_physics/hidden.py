"""Hidden effects by their names, those that are on no list too, drawn with real robots' sizes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics import causes_load as load
from casadical.blind_check.mujoco_physics import causes_structure as structure
from casadical.blind_check.mujoco_physics.cause import (
    Cause,
    Kind,
    largest_torque,
    length_of,
    rated_torque,
    stretched_moments,
)
from casadical.blind_check.mujoco_physics.plant import Plant, random_vector
from casadical.core.basics import InputError


def _by_name(*kinds: Kind) -> dict[str, Kind]:
    """Return kinds of causes by their names."""
    return {kind.name: kind for kind in kinds}


# Effects on the list of those that the diagnosis knows, by name.
LISTED: Mapping[str, Kind] = _by_name(
    *(load.gear_eccentricity, load.transmission_ripple, load.joint_scale),
    *(load.joint_coupling, load.joint_zero_step, structure.thermal_growth),
    *(load.thermal_zero_drift, load.target_shift, structure.payload_error),
    *(structure.axis_wobble, load.gravity_compensator, load.nonlinear_stiffness),
    *(load.backlash, load.friction_windup, structure.link_flexure, structure.base_compliance),
    *(load.frame_drift, load.outliers),
)

# Effects that the diagnosis does not know, by name.
UNLISTED: Mapping[str, Kind] = _by_name(
    *(structure.loose_flange, structure.tool_slip, structure.bearing_play, load.hose_pull),
    *(structure.cracked_link, structure.loose_anchor, structure.thermal_bend),
    *(load.encoder_pit, load.damaged_tooth, structure.loose_cargo, load.tight_cable),
    *(load.lost_bits, load.rubber_coupling, load.range_offset),
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


# Mean time between two poses of a campaign [s].
SECONDS_A_POSE = 30.0
# Names of effects that are visible only in joints that carry a torque.
_EFFECTS_UNDER_LOAD = ("backlash", "nonlinear_stiffness", "rubber_coupling")


def draw_effect(plant: Plant, effect: str, rng: np.random.Generator, poses: int = 100) -> Hidden:
    """Return a hidden effect of this name with random sizes and, if it belongs to one, joint.

    plant : robot as built; effect : name in `LISTED` or `UNLISTED`
    poses : number of poses of the campaign, which determines its duration
    Raises InputError for an unknown name.
    """
    if effect not in {**LISTED, **UNLISTED}:
        raise InputError(f"effect {effect!r} is unknown; there are {', '.join([*LISTED, *UNLISTED])}")
    joint: int | None = None
    # Names of effects that any revolute joint may have.
    effects_of_any_joint = (
        *("gear_eccentricity", "transmission_ripple", "joint_scale", "joint_zero_step", "thermal_zero_drift"),
        *("axis_wobble", "friction_windup", "bearing_play", "encoder_pit", "damaged_tooth"),
        *("tight_cable", "lost_bits"),
    )
    if effect in _EFFECTS_UNDER_LOAD:
        torque = rated_torque(plant) * np.isin(np.arange(1, plant.n + 1), plant.turning)
        joint = int(rng.choice(np.flatnonzero(torque > 0.06 * torque.max()) + 1))
    elif effect == "joint_coupling":
        joint = int(rng.integers(plant.n - 2, plant.n + 1))
    elif effect in effects_of_any_joint:
        joint = plant.turning[int(rng.integers(len(plant.turning)))]
    usual = float(np.exp(rng.normal(0.2, 0.4)))
    return Hidden(effect, joint, _size(plant, effect, joint, usual, rng, SECONDS_A_POSE * poses))


def impossible(plant: Plant) -> dict[str, str]:
    """Return the names of effects that a robot cannot have, each with the reason.

    There are none for a six-axis robot with payload that stands upright.
    """
    n, last, down = plant.n, range(plant.n - 2, plant.n + 1), plant.base[:3, :3].T @ plant.gravity / plant.weight
    bar, arm = plant.four_bar, plant.centres[2] - plant.centres[1] if n > 2 else np.zeros(3)
    torque, full = largest_torque(plant)[np.array(plant.turning) - 1], stretched_moments(plant, 0)[1]
    lifted = {1, 2} <= set(plant.turning) and np.linalg.norm(arm) > 0.01 * plant.reach
    reasons = {
        "it has no payload": (plant.payload_kg <= 0, ("payload_error", "loose_flange", "tool_slip", "loose_cargo")),
        "its payload's mass centre lies in the flange": (not plant.payload_com.any(), ("loose_flange",)),
        "no revolute joint carries weight": (torque.max() < 1e-3 * full, _EFFECTS_UNDER_LOAD),
        "it has no revolute wrist of three joints": (
            n < 4 or not set(last) <= set(plant.turning) or (bar is not None and bar.driven in last),
            ("joint_coupling",),
        ),
        "its joint 2 lifts no arm": (
            not lifted or abs(plant.axes[1] @ down) > 0.5 or down[2] > -0.8,
            ("gravity_compensator",),
        ),
        "it has no six revolute joints": (n != 6 or bool(plant.slides), ("hose_pull",)),
        "its links 2 and 3 have no length or carry nothing": (not _links(plant), ("link_flexure", "cracked_link")),
        "it has one link": (n < 2, ("thermal_bend",)),
    }
    excluded: dict[str, str] = {}
    for reason, (true, effects) in reasons.items():
        excluded |= {effect: reason for effect in effects if true and effect not in excluded}
    return excluded


def _links(plant: Plant) -> list[int]:
    """Return the numbers, from 1, of links that may bend or crack.

    They are 2 and 3, if longer than 1 % of the reach and loaded with 0.1 % of the base's moment.
    """
    least = 1e-3 * stretched_moments(plant, 0)[1]
    long = [k for k in (2, 3) if k <= plant.n and np.linalg.norm(length_of(plant, k)) > 0.01 * plant.reach]
    return [k for k in long if stretched_moments(plant, k)[0] > least]


def _size(
    plant: Plant, effect: str, joint: int | None, usual: float, rng: np.random.Generator, lasts_s: float
) -> dict[str, Any]:
    """Return random sizes of an effect by name [SI].

    joint : its joint, from 1, or None; usual : factor on the sizes that most robots have
    lasts_s : duration of the campaign [s]
    """

    def between(low: float, high: float) -> float:
        """Return a random number, uniform between two limits."""
        return float(rng.uniform(low, high))

    sign, angle = float(rng.choice([-1.0, 1.0])), between(0, 2 * np.pi)
    middle = float(np.round(rng.uniform(0.3, 0.7) * lasts_s))
    own, links = (joint or 1) - 1, _links(plant) or [2]
    inside = between(*plant.ranges[own])
    # In a nearly rigid joint, below 10 urad at the rated torque, friction in proportion to the
    # torque that winds it by the play would hold the load; it is therefore reduced.
    given = float(rated_torque(plant)[own] / plant.stiffness[own]) if effect == "backlash" else 1.0
    rub = given / (60e-6 * usual) if given < 1e-5 else 1.0
    source = plant.n - 1 if joint == plant.n - 2 else (joint or 5) - 1
    sizes: dict[str, dict[str, Any]] = {
        "gear_eccentricity": {
            "size": 40e-6 * usual,
            "towards": angle,
            "oval": between(0.2, 0.8) * 40e-6 * usual,
            "oval_towards": between(0, 2 * np.pi),
        },
        "transmission_ripple": {
            "size": 20e-6 * usual,
            "cycles": int(rng.choice((2, 3, 4, 6, 8, 16, 32))),
            "phase": angle,
        },
        "joint_scale": {"size": 60e-6 * usual * sign},
        "joint_coupling": {"source": source, "size": 80e-6 * usual * sign},
        "joint_zero_step": {"size": 40e-6 * usual * sign, "at_s": middle},
        "thermal_growth": {"size": 11.5e-6 * float(np.clip(usual, 0.8, 2.0)), "lag_minutes": between(4, 12)},
        "thermal_zero_drift": {"size": 5e-6 * usual * sign, "lag_minutes": between(4, 15)},
        "target_shift": {"shift_m": random_vector(rng, 50e-6 * usual), "at_s": middle},
        "payload_error": {"size": 0.05 * usual * sign, "shift_m": random_vector(rng, 0.03 * usual)},
        "axis_wobble": {
            "size": 25e-6 * usual,
            "shift_m": 10e-6 * usual,
            "cycles": int(rng.choice([1, 2])),
            "phase": angle,
        },
        "gravity_compensator": {"size": 0.2 * usual, "lean": between(-0.4, 0.4), "post": between(1.5, 4)},
        "nonlinear_stiffness": {
            "size": 90e-6 * usual,
            "knee": float(rng.choice([0.0, between(0.1, 0.3)])),
            "linear": between(0.1, 0.3),
        },
        "backlash": {"size": 60e-6 * usual, "friction": rub * between(0.01, 0.05)},
        "friction_windup": {"size": 40e-6 * usual, "load_share": between(0, 0.8)},
        "link_flexure": {"link": int(rng.choice(links)), "size": 60e-6 * usual, "torsion": between(0.6, 1.0)},
        "base_compliance": {"size": 50e-6 * usual, "across": between(0.5, 1.0), "height_m": 0.3},
        "frame_drift": {
            "shift_m": random_vector(rng, 50e-6 * usual),
            "turn_rad": random_vector(rng, 20e-6 * usual),
            "settling_minutes": between(15, 60),
        },
        "outliers": {"share": between(0.02, 0.05), "size": 0.7e-3 * usual},
        "loose_flange": {"size": 60e-6 * usual},
        "tool_slip": {"size": 40e-6 * usual, "grip": between(0.3, 0.6)},
        "bearing_play": {"size": 30e-6 * usual},
        "hose_pull": {"size": 100e-6 * usual},
        "cracked_link": {"link": int(rng.choice(links)), "size": 100e-6 * usual, "towards": angle},
        "loose_anchor": {"size": 40e-6 * usual, "towards": angle},
        "thermal_bend": {"size": 15e-6 * usual, "towards": angle, "lag_minutes": between(15, 40)},
        "encoder_pit": {"size": 100e-6 * usual * sign, "at_rad": inside, "width_rad": between(0.3, 0.9)},
        "damaged_tooth": {"size": 80e-6 * usual, "ratio": float(rng.choice([3.0, 5.0, 7.5, 10.0])), "at_rad": angle},
    }
    if effect in sizes:
        return sizes[effect]
    # These are drawn after the others, whose sizes thus stay the same for the same seed.
    added: dict[str, dict[str, Any]] = {
        "loose_cargo": {"size": 80e-6 * usual},
        "tight_cable": {"size": 100e-6 * usual, "free": between(0.2, 0.6)},
        "lost_bits": {"size": 100e-6 * usual, "at_rad": inside},
        "rubber_coupling": {"size": 120e-6 * usual, "lag_minutes": between(0.7, 4.0)},
    }
    # A tracker stands outside of the robot's reach, at eye level or lower.
    away = plant.reach * between(1.3, 2.0)
    stand = away * float(np.cos(angle)), away * float(np.sin(angle)), between(0.0, 1.5)
    return (added | {"range_offset": {"size": 150e-6 * usual * sign, "stand_m": stand}})[effect]
