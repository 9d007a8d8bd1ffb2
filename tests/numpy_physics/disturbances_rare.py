"""Further disturbances that are on no list, each with one driver at one place, to judge laws that are found from data.

`size` is an angle [rad] of joints and of what tilts, a length [m] of what shifts; a share of the payload.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics.plant import Array, Plant, back, motion, move, slide
from casadical.blind_check.mujoco_physics.stops import Stops, only
from numpy_physics.disturbance import Disturbance
from numpy_physics.state import State

Direction = tuple[float, float, float]
_ZERO = np.zeros(3)


@dataclass(frozen=True)
class _OfJoint(Disturbance):
    """A joint that is off by `size` times its course.

    share : 0 to 1, where within the driver's range it happens; phase : of what is periodic [rad]
    """

    joint: int
    size: float = 60e-6
    share: float = 0.5
    phase: float = 0.8

    def own(self, stops: Stops) -> Array:
        """The joint's reading, shape (n,) [rad]."""
        found: Array = stops.q[:, self.joint - 1]
        return found

    def next(self, stops: Stops) -> Array:
        """The reading of the joint behind it, of the last one that before it, shape (n,) [rad]."""
        found: Array = stops.q[:, self.joint if self.joint < 6 else self.joint - 2]
        return found

    def load(self, state: State) -> Array:
        """Load as a share of the rated torque, shape (n,)."""
        found: Array = state.load[:, self.joint - 1] / state.rated[self.joint - 1]
        return found


@dataclass(frozen=True)
class _OfReading(_OfJoint):
    """One whose course follows from the readings and circumstances."""

    def course(self, stops: Stops) -> Array:
        raise NotImplementedError

    def misread(self, stops: Stops) -> Array:
        return only(self.joint, self.size * self.course(stops))


@dataclass(frozen=True)
class _OfLoad(_OfJoint):
    """One whose course follows from the loads."""

    def course(self, state: State) -> Array:
        raise NotImplementedError

    def twist(self, state: State) -> Array:
        return only(self.joint, self.size * self.course(state))


def _placed(values: Array, share: float) -> float:
    """A value that so large a share of the values is below."""
    return float(np.quantile(values, 0.25 + 0.5 * share))


class SlippedMark(_OfReading):
    """A reference mark is read twice: beyond one reading the joint is off by a constant."""

    def course(self, stops: Stops) -> Array:
        q = self.own(stops)
        return (q > _placed(q, self.share)).astype(float)


class EncoderSubdivision(_OfReading):
    """Unequal sine and cosine of an encoder: an error with every line, 100 to 400 a turn (Heidenhain 2013)."""

    def course(self, stops: Stops) -> Array:
        found: Array = np.sin(np.round(100 + 300 * self.share) * self.own(stops) + self.phase)
        return found


class BeltWave(_OfReading):
    """A belt runs over the joint and the next: its splice follows the sum of both angles."""

    def course(self, stops: Stops) -> Array:
        return np.sin((2 + round(3 * self.share)) * (self.own(stops) + self.next(stops)) + self.phase)


class CableStop(_OfReading):
    """A cable becomes taut beyond an angle of the next joint, and pulls from there on."""

    def course(self, stops: Stops) -> Array:
        q = self.next(stops)
        return 2 * np.maximum(0, q - _placed(q, self.share)) / np.ptp(q)


class WarmSensor(_OfReading):
    """The scale of a joint's own sensor follows its temperature: an error of warmth times angle."""

    def course(self, stops: Stops) -> Array:
        return self.own(stops) * stops.warmth_after(15.0) / 5.0


class SawtoothRack(_OfReading):
    """A worn pinion creeps up each of some teeth and falls back: a sawtooth over the angle."""

    def course(self, stops: Stops) -> Array:
        turns = (2 + round(2 * self.share)) * self.own(stops) / (2 * np.pi) + self.phase
        return np.asarray(2 * (turns - np.floor(turns)) - 1)


class SquareCam(_OfReading):
    """A loose key tips over twice or more a turn: a square wave over the angle."""

    def course(self, stops: Stops) -> Array:
        return np.sign(np.sin((1 + round(2 * self.share)) * self.own(stops) + self.phase))


class SharpResolver(_OfReading):
    """A resolver with a short: its error is steep near one angle and flat elsewhere (eccentric anomaly)."""

    def course(self, stops: Stops) -> Array:
        q = self.own(stops) + self.phase
        found: Array = np.arctan2(0.75 * np.sin(q), 1 - 0.75 * np.cos(q))
        return found


class BeatingGear(_OfReading):
    """Two gears of nearly equal tooth numbers: their errors beat, a wave times a slow wave."""

    def course(self, stops: Stops) -> Array:
        q = self.own(stops)
        return np.sin((5 + round(3 * self.share)) * q + self.phase) * np.cos(1.3 * q)


class StribeckLag(_OfReading):
    """Friction that falls with the way travelled: the lag behind the last motion is large after short ways."""

    def course(self, stops: Stops) -> Array:
        way = np.abs(np.diff(self.own(stops), prepend=self.own(stops)[0]))
        return np.asarray(-stops.approach[:, self.joint - 1] * np.exp(-way / (0.3 + 0.5 * self.share)))


class RunningIn(_OfReading):
    """Grease spreads: the lag behind the last motion fades with time."""

    def course(self, stops: Stops) -> Array:
        return np.asarray(-stops.approach[:, self.joint - 1] * np.exp(-stops.progress / (0.1 + 0.3 * self.share)))


class LostClamp(_OfReading):
    """A clamp slips and is found: the joint is off between two times only."""

    def course(self, stops: Stops) -> Array:
        first = 0.15 + 0.4 * self.share
        found: Array = ((stops.progress > first) & (stops.progress < first + 0.3)).astype(float)
        return found


class ServoDroop(_OfLoad):
    """An integrator that is limited: the joint droops with its load, and no further than a bound."""

    def course(self, state: State) -> Array:
        return np.tanh(self.load(state) / (0.1 + 0.2 * self.share))


class WormSlack(_OfLoad):
    """A worm holds small loads; beyond a load of either sign it gives way."""

    def course(self, state: State) -> Array:
        load, free = self.load(state), 0.2 + 0.2 * self.share
        return np.asarray(np.sign(load) * 2 * np.maximum(0, np.abs(load) - free))


class RelayMemory(_OfLoad):
    """A seat tips when the load passes a bound and tips back at the opposite one: it remembers its side."""

    def course(self, state: State) -> Array:
        load = self.load(state)
        centre, half = float(np.median(load)), 0.3 * float(load.std()) * (1 + self.share)
        side, found = 1.0, np.empty(len(load))
        for k in np.argsort(state.stops.time_s, kind="stable"):
            side = 1.0 if load[k] > centre + half else -1.0 if load[k] < centre - half else side
            found[k] = side
        return found


class AfterCreep(_OfLoad):
    """Plastic in the drive creeps back from the load of the pose before."""

    def course(self, state: State) -> Array:
        load, order = self.load(state), np.argsort(state.stops.time_s, kind="stable")
        before = np.empty(len(load))
        before[order] = np.concatenate([load[order[:1]], load[order[:-1]]])
        return before


@dataclass(frozen=True)
class _OfLink(Disturbance):
    """A link (0 the foot) that tilts or shifts along one direction; share : as of joints."""

    link: int = 2
    size: float = 60e-6
    towards: Direction = (0.6, -0.64, 0.48)
    share: float = 0.5

    def course(self, state: State) -> Array:
        raise NotImplementedError

    def tilted(self, state: State) -> Array:
        """Tilt by the course about the link's joint, shape (n, 4, 4) [m]."""
        about = state.plant.centres[self.link - 1] if self.link else _ZERO
        return motion(np.outer(self.size * self.course(state), self.towards), _ZERO, about)

    def outboard(self, link: int, state: State) -> Array | None:
        return self.tilted(state) if link == self.link else None


class WarmLink(_OfLink):
    """A casting warmer on one side bends: the link tilts with its warmth, later than the surface."""

    def course(self, state: State) -> Array:
        return state.stops.warmth_after(20.0) / 5.0


class OpenBolt(_OfLink):
    """A flange of a link opens once the moment on it exceeds what its bolts hold."""

    def course(self, state: State) -> Array:
        _, about = state.axis(self.link)
        moment = np.linalg.norm(state.wrench_beyond(self.link, about)[1], axis=1)
        return np.asarray(2 / np.ptp(moment) * np.maximum(0, moment - _placed(moment, self.share)))


class OilFilm(_OfLink):
    """A bearing's film thins as it warms: the link sinks along one direction, fast at first."""

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.link:
            return None
        thin = -np.expm1(-state.stops.warmth_after(2.0) / (0.5 + self.share))
        return slide(np.outer(2 * self.size * thin, self.towards))


class FootSlip(_OfLink):
    """The foot slips once, in all directions: from then on everything is shifted and turned."""

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 0:
            return None
        when = (state.stops.progress > 0.25 + 0.5 * self.share).astype(float)
        x, y, z = self.towards
        return motion(np.outer(0.5 * self.size * when, (z, x, y)), np.outer(self.size * when, self.towards), _ZERO)


class FootLift(_OfLink):
    """The foot lifts on one side once the overturning moment exceeds a bound."""

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 0:
            return None
        base = state.plant.base
        moment = back(base, state.wrench_beyond(0, base[:3, 3])[1])[:, 0]
        lift = np.maximum(0, moment - _placed(moment, self.share)) / np.ptp(moment) * 2
        return motion(np.outer(self.size * lift, (1.0, 0.0, 0.0)), _ZERO, _ZERO)


class AirConditioning(_OfLink):
    """The hall's air swings: the stand of the robot sways with a period of some minutes."""

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 0:
            return None
        swing = np.sin(2 * np.pi * (2 + 2 * self.share) * state.stops.progress + 1.0)
        return slide(np.outer(self.size * swing, self.towards))


class LooseProbe(_OfLink):
    """A probe leans in its holder to the side where gravity pulls it, as far as it can."""

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 6:
            return None
        down = back(state.bodies[5], np.array([0.0, 0.0, -1.0]))[:, 0]
        return slide(np.outer(self.size * np.tanh(down / (0.1 + 0.1 * self.share)), self.towards))


class DryingGlue(_OfLink):
    """A glued reflector creeps while its glue dries: with the logarithm of time."""

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 6:
            return None
        dried = np.log1p(state.stops.progress / (0.01 + 0.03 * self.share))
        return slide(np.outer(0.5 * self.size * dried, self.towards))


@dataclass(frozen=True)
class LeakingPayload(Disturbance):
    """The payload loses mass with time: `size` is the share that is gone at the end."""

    size: float = 0.1

    def torque(self, state: State) -> Array:
        gone = -self.size * state.stops.progress * state.stops.payload_kg * state.plant.payload_factor
        centre = move(state.bodies[6], state.plant.at_home(6, state.plant.payload_com))
        force = np.zeros((len(gone), 3))
        force[:, 2] = -9.81 * gone
        found = np.empty((len(gone), 6))
        for joint in range(1, 7):
            axis, about = state.axis(joint)
            found[:, joint - 1] = np.sum(axis * np.cross(centre - about, force), -1)
        return found


@dataclass(frozen=True)
class RangeRipple(Disturbance):
    """An interferometer's periodic error: the range is off by a wave of some decimetres (crosstalk in phase meters)."""

    size: float = 40e-6
    share: float = 0.5
    station_m: Direction = (4.0, -3.0, 1.2)

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        beam = xyz - np.array(self.station_m)
        r = np.linalg.norm(beam, axis=1, keepdims=True)
        return np.asarray(xyz + self.size * np.sin((4 + 6 * self.share) * r + 1.0) * beam / r)


@dataclass(frozen=True)
class TwistedHose(Disturbance):
    """A hose along the forearm winds up about joint 4: its pull on joint 5 is a rectified sine, in joint 5's drive."""

    size: float = 80e-6
    phase: float = 0.8

    def misread(self, stops: Stops) -> Array:
        return only(5, self.size * np.abs(np.sin(stops.q[:, 3] + self.phase)))


RARE: dict[str, type[Disturbance]] = {
    "slipped_mark": SlippedMark,
    "encoder_subdivision": EncoderSubdivision,
    "belt_wave": BeltWave,
    "cable_stop": CableStop,
    "warm_sensor": WarmSensor,
    "lost_clamp": LostClamp,
    "servo_droop": ServoDroop,
    "worm_slack": WormSlack,
    "warm_link": WarmLink,
    "open_bolt": OpenBolt,
    "foot_slip": FootSlip,
    "foot_lift": FootLift,
    "leaking_payload": LeakingPayload,
    "sawtooth_rack": SawtoothRack,
    "square_cam": SquareCam,
    "sharp_resolver": SharpResolver,
    "beating_gear": BeatingGear,
    "stribeck_lag": StribeckLag,
    "running_in": RunningIn,
    "relay_memory": RelayMemory,
    "after_creep": AfterCreep,
    "oil_film": OilFilm,
    "air_conditioning": AirConditioning,
    "loose_probe": LooseProbe,
    "drying_glue": DryingGlue,
    "range_ripple": RangeRipple,
    "twisted_hose": TwistedHose,
}


def draw_rare(effect: str, seed: int, plant: Plant, *, scale: float = 1.0) -> Disturbance:
    """A disturbance of RARE with everything at random but its size, which is the usual one times `scale`."""
    kind = RARE[effect]
    rng = np.random.default_rng([seed, 3])
    towards = rng.standard_normal(3)
    towards /= np.linalg.norm(towards)
    station = np.array([4.0, 0, 1.0]) + rng.uniform(-2, 2, 3) * [1, 2, 0.4] + plant.base[:3, 3]
    drawn: dict[str, Any] = {
        "joint": int(rng.integers(1, 7)),
        "link": int(rng.integers(1, 5)),
        "share": float(rng.random()),
        "phase": float(rng.uniform(0, 2 * np.pi)),
        "towards": tuple(towards.tolist()),
        "station_m": tuple(station.tolist()),
    }
    known: dict[str, Any] = {f.name: f.default for f in fields(kind)}
    drawn["size"] = scale * float(rng.choice([-1, 1])) * known["size"]
    return kind(**{name: drawn[name] for name in known})
