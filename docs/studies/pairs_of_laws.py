"""Pairs of laws that no simulator draws: written from the source that the effect names, in a simulator's geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from acting import Disturbance, State
from counterpart_pairs import Bench, Pair, approach, named, progress

from casadical.blind_check.mujoco_physics import Hidden
from casadical.blind_check.mujoco_physics.plant import motion, move, slide
from casadical.blind_check.mujoco_physics.stops import Stops, in_column
from casadical.core.basics import Array
from casadical.effects import (
    CrossCoupling,
    FrameStep,
    FrictionMemory,
    LoadHysteresis,
    SettlingLag,
    SmrOffset,
    ThermalBend,
)
from casadical.effects.registry import BacklashByLoad, FrameSettling
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import unmeasured


class FootSlip(Disturbance):
    """The foot slips once, in all directions: from then on everything is shifted and turned."""

    shift, turn = 60e-6 * np.array([0.6, -0.64, 0.48]), 30e-6 * np.array([0.48, 0.6, -0.64])

    def outboard(self, link: int, state: State) -> Array | None:
        when = (state.stops.progress > 0.5).astype(float)
        return motion(np.outer(when, self.turn), np.outer(when, self.shift), np.zeros(3)) if link == 0 else None


def slipped_foot(b: Bench) -> Pair:
    """A body's motion about the robot's origin, seen in the measuring frame: the frame moves with the base."""
    there = FootSlip()
    base = b.plant.base
    turn, shift = base[:3, :3] @ there.turn, base[:3, :3] @ there.shift
    shift = shift - np.cross(turn, base[:3, 3])
    v = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (*shift, *turn), strict=True))
    return Pair(b, [FrameStep(None, 0.5)], named("frame_step", v), progress(b), hidden=[there])


@dataclass(frozen=True)
class Displaced(Disturbance):
    """What is beyond a link's joint turns about the axes of the link's frame, and shifts along them, by a course."""

    link: int
    shift: Array
    turn: Array
    course: Array

    def outboard(self, link: int, state: Any) -> Array | None:
        if link != self.link:
            return None
        home = state.plant.home[link - 1]
        shift, turn = home[:3, :3] @ self.shift, home[:3, :3] @ self.turn
        return np.asarray(motion(np.outer(self.course, turn), np.outer(self.course, shift), home[:3, 3]))


def slipped_flange(b: Bench) -> Pair:
    shift, turn = np.array([30e-6, -32e-6, 24e-6]), np.array([19e-6, 24e-6, 26e-6])
    v = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (*shift, *turn), strict=True))
    there = Displaced(3, shift, turn, (b.stops.progress > 0.5).astype(float))
    return Pair(b, [FrameStep(3, 0.5)], named("frame_step@3", v), progress(b), hidden=[there])


def bent_link(b: Bench) -> Pair:
    """A bar that is warmer on one side bends to a circle: its end tilts by alpha length difference / height."""
    length, height, share = b.length(2), 0.1, 0.2
    per_K = 11.5e-6 * length * share / height
    warmth = b.stops.warmth_after(10.0)
    there = Displaced(2, np.zeros(3), per_K * np.array([0.8, -0.6, 0.0]), warmth)
    v = {"rx": 0.8 * per_K, "ry": -0.6 * per_K}
    return Pair(b, [ThermalBend(2)], named("thermal_bend@2", v), {"warmth_600s": warmth}, hidden=[there])


@dataclass(frozen=True)
class Misread(Disturbance):
    """A joint that is off its reading by these angles."""

    joint: int
    by: Array

    def misread(self, stops: Stops) -> Array:  # noqa: ARG002
        return in_column(self.joint, self.by)


def derived(b: Bench, name: str) -> dict[str, Array]:
    """The column as the package derives it from readings and times."""
    m = unmeasured(b.stops.q, {"time_s": b.stops.time_s})
    return {name: derive(m, [name])[0].conditions[name]}


def too_soon(b: Bench) -> Pair:
    """A drive of the first order is measured after 8 time constants: its way is integrated in small steps."""
    left, steps, q = np.zeros(len(b.stops)), 100_000, b.stops.q[:, 2]
    for k in range(1, len(q)):
        left[k] = (left[k - 1] + q[k - 1] - q[k]) * (1 - 8.0 / steps) ** steps
    values = {"settling_lag@3.share": float(np.exp(-8.0))}
    return Pair(b, [SettlingLag(3)], values, derived(b, "move3"), hidden=[Misread(3, left)])


def presliding(b: Bench) -> Pair:
    """Dahl: d state = (direction - state) |d angle| / way, integrated along each motion in small steps."""
    half, way, steps = 40e-6, 1.0, 100_000
    states, q = np.zeros(len(b.stops)), b.stops.q[:, 2]
    for k in range(1, len(q)):
        move_by = q[k] - q[k - 1]
        states[k] = np.sign(move_by) + (states[k - 1] - np.sign(move_by)) * (1 - abs(move_by) / way / steps) ** steps
    there = Misread(3, -half * states)
    values = {"friction_memory@3.half": half}
    return Pair(b, [FrictionMemory(3, 1000)], values, derived(b, "memory3_1000mrad"), hidden=[there])


def play_by_load(b: Bench) -> Pair:
    """Play between soft flanks, approached from either side: its mean without friction."""
    width = 0.1 * b.rated[3] / b.great[3]
    there = Given(4, lambda s: 60e-6 * np.tanh(s.load[:, 3] / (0.1 * s.rated[3])))
    effect = BacklashByLoad(4, 0.0, width)
    return Pair(b, [effect], {"backlash_by_load@4.half": 60e-6}, hidden=[there])


def hysteresis(b: Bench) -> Pair:
    """Friction in proportion to the load: the part of the simulator's windup that grows with it."""
    there = Hidden("friction_windup", 3, {"size": 1e-6, "load_share": 60.0})
    values = {"load_hysteresis@3.half": 60e-6 * b.great[2] / b.rated[2]}
    return Pair(b, [LoadHysteresis(3, 1)], values, approach(b, 3), hidden=[there])


@dataclass(frozen=True)
class Given(Disturbance):
    """A joint's twist as a function of the state."""

    joint: int
    law: Callable[[Any], Array]

    def twist(self, state: Any) -> Array:
        return in_column(self.joint, self.law(state))


def inner_friction(b: Bench) -> Pair:
    """Rayleigh: the branches of a loop lie apart by the square of the load."""
    there = Given(3, lambda s: -40e-6 * s.stops.approach[:, 2] * (s.load[:, 2] / b.great[2]) ** 2)
    values = {"load_hysteresis@3.half": 40e-6}
    return Pair(b, [LoadHysteresis(3, 2)], values, approach(b, 3), hidden=[there])


def off_diagonal(b: Bench) -> Pair:
    """A compliance matrix with a term off its diagonal [rad/(N m)]."""
    per_Nm = 60e-6 / b.great[1]
    there = Given(3, lambda s: per_Nm * s.load[:, 1])
    return Pair(b, [CrossCoupling(3, 2)], {"cross_coupling@3.k2": 60e-6}, hidden=[there])


class Newton(Disturbance):
    """The measuring frame follows a stand that cools by Newton's law, integrated in small steps; a motion of points."""

    settles, shift, turn = 0.12, np.array([30e-6, -32e-6, 24e-6]), np.array([19e-6, 24e-6, 26e-6])

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        fine = np.linspace(0.0, 1.0, 100_001)
        rest = np.cumprod(np.r_[1.0, np.full(len(fine) - 1, 1 - (fine[1] - fine[0]) / self.settles)])
        moved = 1 - np.interp(stops.progress, fine, rest)
        return move(motion(np.outer(moved, self.turn), np.outer(moved, self.shift), np.zeros(3)), xyz)


def settling_frame(b: Bench) -> Pair:
    v = dict(zip("xyz", Newton.shift, strict=True)) | {f"r{c}": t for c, t in zip("xyz", Newton.turn, strict=True)}
    effect = FrameSettling(None, settles=Newton.settles)
    return Pair(b, [effect], named("frame_settling", v), progress(b), hidden=[Newton()])


class OffCentre(Disturbance):
    """A reflector's offset in its own axes, turned to face the instrument by azimuth, then elevation."""

    offset, station = (12e-6, -9e-6, 15e-6), np.array([3.0, -2.5, 0.4])

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        x, y, z = (xyz - self.station).T
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
        flat = slide(np.broadcast_to(np.array(self.offset), xyz.shape))
        raised = motion(np.outer(-elevation, (0.0, 1.0, 0.0)), np.zeros(3), np.zeros(3))
        turned = motion(np.outer(azimuth, (0.0, 0.0, 1.0)), np.zeros(3), np.zeros(3))
        return xyz + move(turned @ raised @ flat, np.zeros(3))


def reflector(b: Bench) -> Pair:
    v = dict(zip(("along", "across", "above"), OffCentre.offset, strict=True))
    effect = SmrOffset(None, tuple(float(x) for x in OffCentre.station))
    return Pair(b, [effect], named("smr_offset", v), hidden=[OffCentre()])
