"""The candidates: every listed effect, whole and per joint, with its settings on a grid; and the unknown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.errors import InputError
from casadical.diagnosis.smooth_candidates import unknowns
from casadical.effects import (
    AxisWobble,
    Backlash,
    BaseCompliance,
    BearingPlay,
    CrossCoupling,
    CubicStiffness,
    Effect,
    FrameDrift,
    FrictionWindup,
    GearEccentricity,
    GearMesh,
    GravityCompensator,
    HoseDrag,
    JointCoupling,
    JointScale,
    JointZeroStep,
    LinkFlexure,
    LoadHysteresis,
    MissingCompliance,
    NonlinearStiffness,
    PayloadError,
    Refraction,
    SmrOffset,
    TargetShift,
    ThermalGrowth,
    ThermalZeroDrift,
    TrackerScale,
    TransmissionRipple,
)
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

LAGS = (0.0, 300.0, 600.0, 1200.0, 2400.0)
TIMES = tuple(float(t) for t in np.linspace(0.03, 0.97, 32))
PHASES = tuple(float(p) for p in np.deg2rad(np.arange(0, 360, 30)))
FRICTIONS = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
CYCLES = tuple(float(c) for c in np.arange(2, 32.01, 0.5))
# Usual ratios of strain-wave and cycloid gears; a gear of another ratio is a candidate of its own, GearMesh(3, 171.5).
RATIOS = (50.0, 80.0, 100.0, 120.0, 160.0)
# A link shorter than this share of the longest bends a thirtieth of it.
BEAM = 0.3


@dataclass(frozen=True)
class Candidate:
    """One possible cause.

    label : name, or name@joint; name : word by which answers name it; joint : 1-based or None
    variants : settings on a grid; each variant is one or more effects that act together
    listed : False for the unknown
    """

    label: str
    name: str
    joint: int | None
    variants: tuple[tuple[Effect, ...], ...]
    listed: bool = True


def standard_candidates(robot: Robot) -> list[Candidate]:
    """Every effect of the standard list, for a robot; unlisted, the rarer effects and every form of the unknown."""
    return [*_listed(robot), *_unlisted(robot), *_smooth(robot)]


def extended_candidates(robot: Robot) -> list[Candidate]:
    """The same and the rarer effects, many of which look like standard ones or like the base model."""
    return [*_listed(robot), *_rare(robot), *_smooth(robot)]


def candidates_of(robot: Robot, effects: str | Sequence[str | Effect]) -> list[Candidate]:
    """Candidates of a choice of effects: "standard", "extended", or a sequence of names, labels and own effects.

    Raises InputError for a name that is no effect.
    """
    chosen = [effects] if isinstance(effects, str) else list(effects)
    return named(robot, [e for e in chosen if isinstance(e, str)], [e for e in chosen if isinstance(e, Effect)])


def choose(
    candidates: Sequence[Candidate], m: Measurements
) -> tuple[tuple[Candidate, ...], dict[str, tuple[str, ...]]]:
    """Those candidates (with those variants) whose columns were logged, and what is missing for the others."""
    _, missing = derive(m, [c for k in candidates for v in k.variants for e in v for c in e.conditions])
    possible, without = [], {}
    for candidate in candidates:
        lacking = [tuple(c for e in v for c in e.conditions if c in missing) for v in candidate.variants]
        variants = tuple(v for v, lack in zip(candidate.variants, lacking, strict=True) if not lack)
        if variants:
            possible.append(Candidate(candidate.label, candidate.name, candidate.joint, variants, candidate.listed))
        else:
            without[candidate.label] = tuple(dict.fromkeys(c for lack in lacking for c in lack))
    return tuple(possible), without


def named(robot: Robot, names: Iterable[str], extra: Iterable[Effect] = ()) -> list[Candidate]:
    """Candidates chosen by list (standard, extended), name (backlash) or label (backlash@5), and a user's own effects.

    Raises InputError for a name that is no effect.
    """
    standard = _listed(robot)
    every = [*standard, *_rare(robot)]
    lists = {"standard": standard, "extended": every}
    chosen = [_single(e) for e in extra]
    for name in names:
        hit = lists.get(name) or [c for c in every if name in (c.name, c.label)]
        if not hit:
            known = ", ".join([*lists, *sorted({c.name for c in every})])
            raise InputError(f"no effect {name!r} of this robot; there are {known}; with a joint: backlash@5")
        chosen += hit
    # An own effect stands for the list's one of the same label.
    unique = {c.label: c for c in reversed(chosen)}
    rivals = [c for c in _unlisted(robot) if "standard" in names and c.label not in unique]
    return [*unique.values()][::-1] + rivals + _smooth(robot)


def _single(effect: Effect) -> Candidate:
    return Candidate(effect.label, effect.name, effect.joint, ((effect,),))


def _grouped(effects: Iterable[Effect]) -> list[Candidate]:
    """One candidate a label, with a variant for each of its effects."""
    by_label: dict[str, list[Effect]] = {}
    for effect in effects:
        by_label.setdefault(effect.label, []).append(effect)
    return [
        Candidate(label, found[0].name, found[0].joint, tuple((e,) for e in found)) for label, found in by_label.items()
    ]


def _listed(robot: Robot) -> list[Candidate]:
    effects: list[Effect] = []
    for j, joint in enumerate(robot.joints, 1):
        if joint.kind == "revolute":
            effects += [GearEccentricity(j), *(TransmissionRipple(j, c) for c in CYCLES)]
            effects += [AxisWobble(j, cycles, still) for cycles in (1, 2) for still in (False, True)]
        effects += [JointScale(j), *(JointCoupling(j, i) for i in _coupled(robot, j))]
        effects += [JointZeroStep(j, t) for t in TIMES]
        effects += [ThermalZeroDrift(j, lag) for lag in LAGS]
        effects += [Backlash(j, f, f * w) for f in FRICTIONS for w in (0.3, 0.6, 1.2)]
        effects += [FrictionWindup(j)]
    effects += [ThermalGrowth(None, lag) for lag in LAGS]
    effects += [TargetShift(None, t) for t in TIMES]
    effects += [PayloadError()] if robot.payload else []
    effects += [GravityCompensator(2, a, p) for a in (1.2, 2.0, 4.0) for p in PHASES] if robot.n >= 2 else []
    effects += [BaseCompliance(), *(FrameDrift(None, s) for s in (0.5, 1.0, 2.0))]
    return [*_grouped(effects), *_stiffness(robot), _flexure(robot)]


def _rare(robot: Robot) -> list[Candidate]:
    """Effects of the extended list alone."""
    effects: list[Effect] = []
    for j, joint in enumerate(robot.joints, 1):
        effects += [LoadHysteresis(j, power) for power in (1, 2)]
        effects += [CrossCoupling(j, i) for i in _coupled(robot, j)]
        effects += [BearingPlay(j, soft) for soft in (0.1, 0.3)]
        effects += [GearMesh(j, ratio) for ratio in RATIOS] if joint.kind == "revolute" else []
        effects += [MissingCompliance(j)] if not joint.compliance else []
    if robot.n >= 6:
        effects += [HoseDrag(None, clip, side) for clip in (0.3, 0.6, 0.9) for side in (0.0, 0.2)]
    return _grouped([*effects, TrackerScale(), Refraction(), SmrOffset()])


def _stiffness(robot: Robot) -> list[Candidate]:
    """A joint that stiffens with torque, by either law."""
    laws: dict[int, list[Effect]] = {
        j: [*(NonlinearStiffness(j, k) for k in (0.1, 0.2, 0.4, 0.7)), CubicStiffness(j)] for j in range(1, robot.n + 1)
    }
    name = NonlinearStiffness.name
    return [Candidate(f"{name}@{j}", name, j, tuple((e,) for e in found)) for j, found in laws.items()]


def _coupled(robot: Robot, j: int) -> list[int]:
    """Joints whose motors can move joint j: those right before it and behind it."""
    return [i for i in (j - 2, j - 1, j + 1, j + 2) if 1 <= i <= robot.n]


def _flexure(robot: Robot) -> Candidate:
    """Each beam alone, and all of them together; short links are castings, and what gives way there is a bearing."""
    links = [LinkFlexure(None, k) for k in _beams(robot)]
    return Candidate("link_flexure", "link_flexure", None, (*((e,) for e in links), tuple(links)))


def _beams(robot: Robot) -> list[int]:
    """Links (1-based) long enough to bend: a beam's sag goes with the cube of its length."""
    after = robot.joints[1:]
    lengths = np.array([np.hypot(j.a, j.d) for j in after])
    return [k for k, length in enumerate(lengths, 1) if length >= BEAM * lengths.max()]


def _unlisted(robot: Robot) -> list[Candidate]:
    """The rarer effects as rivals of the standard ones: what they explain better is unknown to the standard list."""
    return [replace(c, listed=False) for c in _rare(robot) if c.name != GearMesh.name]


def _smooth(robot: Robot) -> list[Candidate]:
    return [Candidate(e.label, "unknown", None, ((e,),), listed=False) for e in unknowns(robot)]
