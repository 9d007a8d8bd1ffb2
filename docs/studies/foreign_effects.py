"""Effects of machines and of their measuring set-ups, written by an author who has not read the diagnosis.

The author knew a simulator, and neither the diagnosis nor the causes that it can name. `FOREIGN` has the kinds by their
words, `draw_foreign` draws one, and `SAYS` has what a right statement about each would be. Thresholds are angles and
times of the machine, not of the campaign: another campaign of the same machine meets the same effect.
"""

import re
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from acting import Disturbance, State

from casadical.blind_check.mujoco_physics.plant import (
    Array,
    Plant,
    back,
    close_loop,
    motion,
    move,
    random_vector,
    rotated,
    slide,
)
from casadical.blind_check.mujoco_physics.stops import Stops, in_column

Direction = tuple[float, float, float]
_ZERO = np.zeros(3)
_DOWN = np.array([0.0, 0.0, -1.0])


def _waits(stops: Stops) -> Array:
    """Time since the stop before, of the first since the start, shape (n,) [s]."""
    return np.diff(stops.time_s, prepend=0.0)


def _moves(stops: Stops, joint: int) -> Array:
    """Motion of a joint since the stop before, of the first from reading zero, shape (n,) [rad]."""
    return np.diff(stops.q[:, joint - 1], prepend=0.0)


def _load(state: State, joint: int) -> Array:
    """Torque on a joint as a share of its rated torque, shape (n,)."""
    return np.asarray(state.load[:, joint - 1] / state.rated[joint - 1])


def _moment(state: State, link: int) -> Array:
    """Moment of all weights beyond a link (0 pedestal) about the joint at its end, seen from it, (n, 3) [N m]."""
    place = state.plant.base if link == 0 else state.bodies[link - 1]
    return back(place, state.wrench_beyond(link, state.axis(link + 1)[1])[1])


def _followed(stops: Stops, course: Array, minutes: float, start: Array) -> Array:
    """What follows a course (n, ...) with a lag, from a start on."""
    share = -np.expm1(-_waits(stops) / (60.0 * minutes))
    part, found = np.array(start, float), np.empty_like(course)
    for k, aim in enumerate(course):
        part = part + (aim - part) * share[k]
        found[k] = part
    return found


def _sight(station_m: Direction, xyz: Array) -> tuple[Array, Array]:
    """Distances (n,) [m] of points from an instrument, and directions (n, 3) from it to them."""
    line = xyz - np.asarray(station_m)
    length: Array = np.linalg.norm(line, axis=-1)
    return length, line / length[:, None]


@dataclass(frozen=True)
class GearLag(Disturbance):
    """Teeth, cages and seals rub while a gear winds up: some of its twist lags behind the torque, by where the torque
    came from (three elements with play; hysteresis curves of strain wave and cycloid gears, Ruderman 2009)."""

    joint: int = 3
    size: float = 250e-6
    share: float = 0.5

    def twist(self, state: State) -> Array:
        course = _load(state, self.joint)
        lag = np.zeros_like(course)
        for width in (0.1, 0.25, 0.5) * np.array(0.6 + 0.8 * self.share):
            held = course[0]
            for k, aim in enumerate(course):
                held = min(max(held, aim - width), aim + width)
                lag[k] += (held - aim) / (3 * width)
        return in_column(self.joint, self.size * lag)


@dataclass(frozen=True)
class ShortMoveStick(Disturbance):
    """A short move builds no film of oil in bearings and seals: the joint sticks before its aim, after a long move it
    does not (Stribeck friction, a servo loop whose integrator rests in a window of position)."""

    joint: int = 2
    size: float = 300e-6
    reach_rad: float = 0.5

    def misread(self, stops: Stops) -> Array:
        left = np.exp(-np.abs(_moves(stops, self.joint)) / self.reach_rad)
        return in_column(self.joint, -self.size * stops.approach[:, self.joint - 1] * left)


@dataclass(frozen=True)
class WrongTable(Disturbance):
    """The controller corrects a joint by a table over its own angle and another joint's, straight lines between nodes
    of 40 degrees; after a change of controllers it is the table of another arm, so numbers at random."""

    joint: int = 3
    other: int = 2
    size: float = 150e-6
    seed: int = 1

    def misread(self, stops: Stops) -> Array:
        nodes = np.random.default_rng(self.seed).standard_normal((9, 9))
        cell = 9 * stops.q[:, [self.joint - 1, self.other - 1]] / (2 * np.pi)
        low = np.floor(cell).astype(int)
        found = np.zeros(len(stops))
        for a, b in np.ndindex(2, 2):
            weight = np.abs(1 - np.array([a, b]) - (cell - low)).prod(-1)
            found += weight * nodes[(low[:, 0] + a) % 9, (low[:, 1] + b) % 9]
        return in_column(self.joint, self.size * found)


@dataclass(frozen=True)
class UnevenPlanets(Disturbance):
    """One planet of the gear's last stage carries less than the others: where it meshes the gear is softer, so that its
    stiffness changes with its own angle, some times a turn."""

    joint: int = 3
    size: float = 250e-6
    cycles: int = 3
    phase: float = 0.8

    def twist(self, state: State) -> Array:
        wave = np.sin(self.cycles * state.stops.q[:, self.joint - 1] + self.phase)
        return in_column(self.joint, self.size * _load(state, self.joint) * wave)


@dataclass(frozen=True)
class WarmBalancer(Disturbance):
    """The gas of joint 2's balancer warms up behind the arm: its pressure rises (at constant volume by 1/293 a kelvin),
    and its torque with the sine of the angle from where cylinder and swing are in line."""

    size: float = 0.08
    at_rad: float = 0.0
    minutes: float = 20.0

    def torque(self, state: State) -> Array:
        rise = state.stops.warmth_after(self.minutes) / 10.0
        return in_column(2, self.size * state.rated[1] * rise * np.sin(state.stops.q[:, 1] - self.at_rad))


@dataclass(frozen=True)
class HoseWinds(Disturbance):
    """A hose package from the forearm to the flange winds up as joint 4 turns from where it was fitted: it becomes
    shorter with the square of the angle, and pulls the bent joint 5 straight."""

    size: float = 0.2
    at_rad: float = 0.3

    def torque(self, state: State) -> Array:
        wound = ((state.stops.q[:, 3] - self.at_rad) / 2.0) ** 2
        return in_column(5, -self.size * state.rated[4] * wound * np.sin(state.stops.q[:, 4]))


@dataclass(frozen=True)
class BearingClearance(Disturbance):
    """A joint's bearing has lost its preload: the axis lies over within the clearance, to the side to which the moment
    across it points, and nearly as far under a small moment as under a large one."""

    joint: int = 2
    size: float = 160e-6
    share: float = 0.5

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.joint - 1:
            return None
        axis = state.plant.axes[link]
        across = _moment(state, link)
        across = across - (across @ axis)[:, None] * axis
        strength = np.linalg.norm(across, axis=-1, keepdims=True) + (0.05 + 0.25 * self.share) * state.rated[link]
        return motion(self.size * across / strength, _ZERO, state.plant.centres[link])


@dataclass(frozen=True)
class RacewayDent(Disturbance):
    """A crash has dented the raceway of a joint's bearing: near one angle a roller drops into the dent and the axis
    tilts there, about a direction fixed to the link before the joint; elsewhere nothing happens."""

    joint: int = 1
    size: float = 250e-6
    at_rad: float = 0.2
    width_rad: float = 0.25
    towards: Direction = (1.0, 0.0, 0.0)

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.joint - 1:
            return None
        drop = np.exp(-(((state.stops.q[:, link] - self.at_rad) / self.width_rad) ** 2))
        axis, towards = state.plant.axes[link], np.asarray(self.towards)
        across = np.cross(axis, towards) + 0.1 * np.cross(axis, np.roll(axis, 1))
        return motion(self.size * drop[:, None] * across / np.linalg.norm(across), _ZERO, state.plant.centres[link])


@dataclass(frozen=True)
class CreepingGlue(Disturbance):
    """The seam between a link's tube and its casting is glued: it gives way slowly, so that the link's end tilts as the
    moment of some minutes before (a Kelvin body; creep of epoxy)."""

    link: int = 2
    size: float = 450e-6
    minutes: float = 4.0

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.link:
            return None
        share = _moment(state, link) / state.rated[link]
        tilt = self.size * _followed(state.stops, share, self.minutes, share[0])
        return motion(tilt, _ZERO, state.plant.centres[link])


@dataclass(frozen=True)
class ChurnedGrease(Disturbance):
    """Each move churns the grease of a joint's gear and warms its housing, which cools with its own time constant; the
    housing grows along the joint's axis. The arm's thermometer does not see it."""

    joint: int = 3
    size: float = 50e-6
    minutes: float = 12.0

    def outboard(self, link: int, state: State) -> Array | None:
        if link != self.joint:
            return None
        pace = np.abs(_moves(state.stops, self.joint)) / _waits(state.stops) / 0.03
        heat = _followed(state.stops, pace, self.minutes, np.zeros(()))
        return slide(self.size * heat[:, None] * state.plant.axes[link - 1])


@dataclass(frozen=True)
class LooseAnchor(Disturbance):
    """One anchor bolt of the foot is loose: while the arm's moment presses that side down nothing happens, beyond the
    preload that is left the foot lifts there and the base tilts, about a horizontal direction."""

    size: float = 200e-6
    phase: float = 0.8
    share: float = 0.5

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 0:
            return None
        about = np.array([np.cos(self.phase), np.sin(self.phase), 0.0])
        lifted = np.maximum(0.0, _moment(state, 0) @ about / state.rated.max() - 0.3 * self.share)
        return motion(self.size * lifted[:, None] * about, _ZERO, _ZERO)


@dataclass(frozen=True)
class NeighbourPress(Disturbance):
    """A press beside the robot is loaded and unloaded at times that nobody writes down: while it is loaded, the floor
    slab tilts and drops under the robot's base, by the same amount each time."""

    size: float = 40e-6
    phase: float = 0.8
    minutes: float = 6.0
    seed: int = 1

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 0:
            return None
        rests = np.random.default_rng(self.seed).exponential(60.0 * self.minutes, 1000)
        loaded = np.searchsorted(np.cumsum(rests), state.stops.time_s) % 2
        about = np.array([np.cos(self.phase), np.sin(self.phase), 0.0])
        beside = 2.0 * np.array([-np.sin(self.phase), np.cos(self.phase), 0.0])
        return motion(self.size * loaded[:, None] * about, _ZERO, beside)


@dataclass(frozen=True)
class SlippingPart(Disturbance):
    """The target sits on the part, and the jaws hold the part too weakly: each long move of one joint lets it slip a
    little further, the same way; when the part is taken again it is in its place again."""

    joint: int = 1
    size: float = 20e-6
    long_rad: float = 1.5
    towards: Direction = (1.0, 0.0, 0.0)

    def reflector(self, stops: Stops) -> Array:
        slips, count = np.empty(len(stops)), 0.0
        for k, move_rad in enumerate(_moves(stops, self.joint)):
            held = k > 0 and stops.payload_kg[k] == stops.payload_kg[k - 1] > 0
            count = count + (abs(move_rad) > self.long_rad) if held else 0.0
            slips[k] = count
        return np.asarray(self.size * slips[:, None] * self.towards)


@dataclass(frozen=True)
class SloshingTank(Disturbance):
    """The payload is a tank that is half full: the liquid runs to the low side, and the mass centre moves across the
    tank's axis towards gravity, as seen from the flange; its weight then bends all joints."""

    size: float = 0.06
    towards: Direction = (0.0, 0.0, 1.0)

    def torque(self, state: State) -> Array:
        flange, along = state.bodies[6], np.asarray(self.towards)
        down = -flange[:, 2, :3]
        run = rotated(flange, self.size * (down - (down @ along)[:, None] * along))
        about = np.cross(run, 9.81 * state.stops.payload_kg[:, None] * _DOWN)
        tau = np.stack([np.sum(state.axis(joint)[0] * about, -1) for joint in range(1, 7)], -1)
        if state.plant.four_bar is not None:
            tau[:, 2] *= close_loop(state.plant, state.angles[:, 2] - state.angles[:, 1]).lever
            tau[:, 1] -= tau[:, 2]
        return np.asarray(tau)


@dataclass(frozen=True)
class CyclicRange(Disturbance):
    """Crosstalk between sender and receiver of a distance meter that compares phases: its range errs by a sine over the
    range, with half the wavelength of the modulation (Rueger, Electronic Distance Measurement)."""

    size: float = 40e-6
    period_m: float = 0.6
    phase: float = 0.8
    station_m: Direction = (4.0, 0.0, 1.0)

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:  # noqa: ARG002
        length, sight = _sight(self.station_m, xyz)
        return np.asarray(xyz + self.size * np.sin(2 * np.pi * length / self.period_m + self.phase)[:, None] * sight)


@dataclass(frozen=True)
class GlassCorner(Disturbance):
    """The target is a corner cube of solid glass at the flange: seen askew the way through the glass changes, and the
    point seems to lie farther along the sight (n - sqrt(n^2 - sin^2) of the angle of incidence, Rueger)."""

    size: float = 80e-6
    towards: Direction = (1.0, 0.0, 0.0)
    station_m: Direction = (4.0, 0.0, 1.0)

    def outboard(self, link: int, state: State) -> Array | None:
        if link != 6:
            return None
        flange, plant = state.bodies[6], state.plant
        sight = back(flange, _sight(self.station_m, move(flange, plant.at_home(6, plant.reflector)))[1])
        askew, n = 1.0 - (sight @ np.asarray(self.towards)) ** 2, 1.51
        far = (n - np.sqrt(n**2 - askew)) / (n - np.sqrt(n**2 - 1.0))
        return slide(self.size * far[:, None] * sight)


class Says(NamedTuple):
    """A right statement: where the effect is, what drives it, and how; N is the joint or link that was drawn."""

    place: str
    driver: str
    formula: str


_KINDS: list[type[Disturbance]] = [
    *(GearLag, ShortMoveStick, WrongTable, UnevenPlanets, WarmBalancer, HoseWinds),
    *(BearingClearance, RacewayDent, CreepingGlue, ChurnedGrease, LooseAnchor),
    *(NeighbourPress, SlippingPart, SloshingTank, CyclicRange, GlassCorner),
]
FOREIGN = {re.sub(r"(?<!^)([A-Z])", r"_\1", kind.__name__).lower(): kind for kind in _KINDS}  # gear_lag: GearLag, ...
SAYS = {
    "gear_lag": Says("joint N", "load torque of this pose and of those before", "dq = sum of (play_w(tau) - tau) / w"),
    "short_move_stick": Says("joint N", "own previous move: length and direction", "dq = -s sign(dm) exp(-|dm| / d)"),
    "wrong_table": Says("joint N", "own angle and another joint's angle", "dq = table[qN, qM], lines between nodes"),
    "uneven_planets": Says("joint N", "load torque times a wave of the own angle", "dq = s tau sin(k qN + p)"),
    "warm_balancer": Says("joint 2", "lagged temperature times a sine of the own angle", "dtau = s dT sin(q2 - a)"),
    "hose_winds": Says("joint 5", "angle of joint 4 and own angle", "dtau = -s (q4 - a)^2 sin q5"),
    "bearing_clearance": Says("joint N, its axis tilts", "direction of the moment across it", "tilt = s M / (|M| + m)"),
    "raceway_dent": Says("joint N, its axis tilts", "own angle, near one value", "tilt = s exp(-((qN - a) / w)^2)"),
    "creeping_glue": Says("link N, its end tilts", "moment at it, lagged by minutes", "T dtilt/dt = s M - tilt"),
    "churned_grease": Says("link N, shift along axis N", "own travel, lagged by minutes", "T dx/dt = s |dqN/dt| - x"),
    "loose_anchor": Says("base, tilt about one direction", "moment at it, beyond a value", "tilt = s max(0, M.u - m)"),
    "neighbour_press": Says("base, tilt and drop", "time: on and off by chance", "tilt = s on(t), two values"),
    "slipping_part": Says("tool, shift one way", "count of joint N's long moves with payload", "d = s #(|dm| > a)"),
    "sloshing_tank": Says("payload, mass centre", "gravity direction at the flange", "dc = s (g - u (u.g))"),
    "cyclic_range": Says("instrument", "range", "dr = s sin(2 pi r / L + p)"),
    "glass_corner": Says("tool or instrument", "sight seen from the flange", "dr = s (n - sqrt(n^2 - sin^2 i))"),
}
_OF_LOAD = {"gear_lag", "uneven_planets"}  # not joint 1, whose axis stands upright
_ONE_SIGN = {"short_move_stick", "bearing_clearance", "loose_anchor", "churned_grease", "sloshing_tank"}


def draw_foreign(word: str, seed: int, plant: Plant, scale: float = 1.0) -> Disturbance:
    """An effect of FOREIGN at its usual size times `scale`; joint, phase, thresholds and times follow from the seed."""
    kind = FOREIGN[word]
    rng = np.random.default_rng([seed, 7])
    joint = int(rng.integers(2, 5) if word in _OF_LOAD else rng.integers(1, 6))
    low, high = plant.ranges[1 if word == "warm_balancer" else 3 if word == "hose_winds" else joint - 1]
    away, azimuth = rng.uniform(3.0, 6.0), rng.uniform(0, 2 * np.pi)
    station = plant.base[:3, 3] + [away * np.cos(azimuth), away * np.sin(azimuth), rng.uniform(0.5, 2.0)]
    other, link = rng.choice([j for j in range(1, 7) if j != joint]), rng.integers(1, 5)
    cycles, number = int(rng.integers(3, 6)), int(rng.integers(1 << 30))
    drawn: dict[str, Any] = {"joint": joint, "other": int(other), "link": int(link), "cycles": cycles, "seed": number}
    for name, least, most in (("at_rad", 0.3, 0.7), ("long_rad", 0.25, 0.45), ("width_rad", 0.12, 0.2)):
        drawn[name] = float(low * (name == "at_rad") + rng.uniform(least, most) * (high - low))
    spans = {"reach_rad": (0.3, 0.8), "share": (0.0, 1.0), "phase": (0.0, 2 * np.pi), "period_m": (0.4, 0.9)}
    drawn |= {name: float(rng.uniform(*span)) for name, span in spans.items()}
    usual: dict[str, Any] = {f.name: f.default for f in fields(kind)}
    drawn["size"] = scale * usual["size"] * (1 if word in _ONE_SIGN else int(rng.choice([-1, 1])))
    drawn["minutes"] = usual.get("minutes", 0.0) * float(rng.uniform(0.6, 1.7))
    drawn |= {"towards": random_vector(rng, 1.0), "station_m": tuple(station.tolist())}
    return kind(**{name: drawn[name] for name in usual})
