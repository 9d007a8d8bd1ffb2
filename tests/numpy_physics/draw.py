"""A disturbance drawn at random: the effect is given; size, phase, time and direction follow from a seed."""

from dataclasses import fields
from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics.plant import random_vector
from casadical.core.basics import InputError
from numpy_physics.disturbance import Disturbance
from numpy_physics.disturbances import LISTED, UNLISTED

_EITHER_SIGN = {
    *("joint_scale", "joint_coupling", "joint_zero_step", "thermal_zero_drift", "payload_error"),
    "beam_refraction",
}
_CYCLES = {"transmission_ripple": (2, 3, 4, 6, 8, 16, 32), "axis_wobble": (1, 2)}
_SIZES = {"size", "oval", "shift_m", "turn_rad", "share", "gradient_K_per_m"}


def draw_disturbance(effect: str, seed: int, *, joint: int | None = None, scale: float = 1.0) -> Disturbance:
    """The effect with 0.7 to 1.5 times its usual size, times ``scale``, and everything else at random."""
    kind = (LISTED | UNLISTED).get(effect)
    if kind is None:
        raise InputError(f"effect {effect!r} is unknown; there are {', '.join([*LISTED, *UNLISTED])}")
    names = [f.name for f in fields(kind)]
    lowest = 2 if "source" in names else 1
    if "joint" in names and (joint is None or not lowest <= joint <= 6):
        raise InputError(f"effect {effect!r} needs a joint from {lowest} to 6, not {joint}")
    if "joint" not in names and joint is not None:
        raise InputError(f"effect {effect!r} sits in no joint; leave joint={joint} out")
    rng = np.random.default_rng(seed)
    size = scale * rng.uniform(0.7, 1.5) * (rng.choice([-1, 1]) if effect in _EITHER_SIGN else 1)
    values: dict[str, Any] = {"joint": joint, "source": None if joint is None else joint - 1}
    values |= {f.name: _drawn(effect, f.name, f.default, size, rng) for f in fields(kind) if f.name not in values}
    return kind(**{name: values[name] for name in names})


def _drawn(effect: str, name: str, usual: Any, size: float, rng: np.random.Generator) -> Any:
    if name in ("towards", "about") or (name == "shift_m" and isinstance(usual, tuple)):
        return random_vector(rng, abs(size) * float(np.linalg.norm(usual)) if name == "shift_m" else 1.0)
    if name in _SIZES:
        return usual * size
    if name in ("phase", "oval_phase"):
        return float(rng.uniform(0, 2 * np.pi))
    if name == "at":
        return float(rng.uniform(0.3, 0.7))
    if name == "link":
        return int(rng.choice([2, 3]))
    return int(rng.choice(_CYCLES[effect])) if name == "cycles" else usual
