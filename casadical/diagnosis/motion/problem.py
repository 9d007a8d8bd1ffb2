"""The linear problem of a joint log: rows are torques and position errors of windows, columns the base and the causes.

Blocks are windows, with a row for each joint's torque and, where both were logged, one for its position error. Noise
follows itself: each row is divided by its noise, and the share that stays from window to window is taken off, both as
they are found in what the base leaves. With a reference, blocks of both logs are judged together: what is shared has
wide priors, what differs from day to day has tight ones, and causes act in the log alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import WHOLE_AXIS, Combined, Factors
from casadical.core.linear_gaussian.noise import serial_noise
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.motion.base import Look, Part, base_of, bodies_of
from casadical.diagnosis.motion.signals import lagged, late
from casadical.effects.definition import DefinedEffect
from casadical.effects.formula_effect import MOTION_OF, MOTION_SEAMS
from casadical.effects.motion import Cause, motion_columns
from casadical.effects.settings import grid_points
from casadical.measurements.measurements import Noise

# Of white rows, whose noise is about one.
SIGMAS = np.geomspace(0.4, 2.5, 25)
# Share of a friction, and of the great torque, that differs from day to day; of a prior of the servo.
DAILY, DAILY_LEAST, DAILY_SERVO = 0.15, 0.01, 0.7
# Most of the noise that stays from a window to the next; rounds in which noise is found, and least of a torque.
MOST_STAYS, ROUNDS = 0.8, 3
# A base errs by this share of the great torque, of what the servo yields, and by so much time of the motion [s].
ERRS, SERVO_ERRS, ERRS_BY = 0.005, 0.03, 1e-3
# Weight of a row that is so many times its noise away falls as Student's does.
TAIL, CUT = 8.0, 4.0
WHITE = Noise(1.0, 0.0)
NONE = np.zeros(0, dtype=np.int64)
# Of what is on no list: places of its bumps, and size in units of the row's noise.
BUMPS, UNLISTED = 6, 3.0
# A variant, and of each parameter what it does: row -> windows.
_Judged = tuple[Candidate, list[Mapping[int, Array]]]
FRICTIONS = ("slip", "dip", "at rest")
# Parts of the base that differ from day to day as their whole does, or not at all; and where the servo's are rows of
# torque, how much its delay [s], its filter [s^2] and its gain differ.
ALIKE = ("before", "dip", "root", "at rest", "absolute", "curved", "loaded ")
TODAY = {"delay": 1e-3, "filter": 1e-4, "gain": 0.05}
DRAGS, LOADED = ("viscous", "root", "absolute", "curved"), ("loaded", "by side")
WHOLES = {"dry": FRICTIONS, "drag": DRAGS, "loaded": LOADED, "friction": (*FRICTIONS, *DRAGS, *LOADED)}


@dataclass(frozen=True, eq=False)
class RowColumns:
    """Columns of which each acts in few rows of a block. made : with the rows as variables in between"""

    made: Factors
    rows: int
    blocks: int
    directions: Sequence[tuple[Array, Array]] = ()

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.blocks, self.rows, self.made.width

    def at(self, blocks: Array) -> RowColumns:
        return replace(self, made=self.made.at(blocks), blocks=len(np.arange(self.blocks)[blocks]))

    def only(self, columns: Array) -> RowColumns:
        return replace(self, made=self.made.only(columns))

    def after(self, column: int) -> RowColumns:
        return self.only(np.arange(column, self.made.width))

    def take(self, columns: Array, blocks: Array | slice = WHOLE_AXIS, every: Combined | None = None) -> Array:
        taken = self.made.only(columns).at(blocks)
        out = taken.columns_at(self.levers(blocks))
        return np.asarray(every.combine(out) if every else out)

    def factors(self, blocks: Array | slice = WHOLE_AXIS) -> Factors:
        return self.made.at(blocks)

    def levers(self, blocks: Array | slice = WHOLE_AXIS) -> Array:
        return np.broadcast_to(np.eye(self.rows), (len(np.arange(self.blocks)[blocks]), self.rows, self.rows))


@dataclass(frozen=True, eq=False)
class Following:
    """Of each number, shapes (blocks, rows): its noise, the share of it that stays from window to window, a weight."""

    sigma: Array
    stays: Array
    weight: Array

    def white(self, values: Array, first: Array) -> Array:
        """Rows of blocks as white ones; values : shape (blocks, rows, ...); first : blocks that begin a run."""
        return serial_noise(self.stays, first[:, None], self.weight / self.sigma).whiten(values)

    def row(self, row: int) -> Following:
        """Of one row alone."""
        return Following(*(a[:, row : row + 1] for a in (self.sigma, self.stays, self.weight)))


@dataclass(frozen=True, eq=False)
class MotionCase:
    """The problem of a log, with its candidates.

    candidates, variants, groups : as a ranking wants them, with columns of each variant
    r : residual as it is, shape (blocks, rows); base : columns of the base, sizes in them, (blocks, rows, P)
    E : columns of the variants, as they are; noise : of each row
    of_log : blocks of the log itself, not of the reference; parts : of the base, behind the bodies
    floor : least noise of each row, from the readings' steps; trust : weight of each number, shape (blocks, rows)
    scale : what one of each joint's first row is in the log's own unit, A or N m, or rad where unit is None
    over : of the log's windows, shape (blocks, joints), angle, speed, load and time
    """

    candidates: tuple[Candidate, ...]
    variants: tuple[tuple[int, int], ...]
    groups: tuple[Array, ...]
    r: Array
    base: Array
    E: RowColumns
    first: Array
    noise: Following
    of_log: Array
    parts: tuple[Part, ...]
    floor: Array
    trust: Array
    scale: Array
    unit: str | None
    over: tuple[Array, ...]

    @property
    def joints(self) -> int:
        """Of the arm."""
        return len(self.scale)

    @cached_property
    def white(self) -> Evidence:
        """Rows, base and columns, white."""
        n, rows, P = self.base.shape
        made = tuple(
            (row, columns, self.noise.row(row).white(values.T[:, None], self.first)[:, 0].T)
            for row, columns, values in self.E.made.blocks
        )
        return Evidence(
            self.noise.white(self.r, self.first), self.noise.white(self.base, self.first), np.zeros(P), np.ones(P),
            replace(self.E, made=Factors(made, self.E.made.width)),
            reference=1.0, near=(0,), Jq=np.zeros((n, rows, 1)), sigmas=SIGMAS,
        )  # fmt: skip

    @cached_property
    def judged(self) -> Evidence:
        """The same, where what the base takes tells nothing of the noise.

        Priors stay as they are, unlike in `restricted`: that a delay is known to a millisecond tells another one.
        """
        return replace(self.white, absorbed=self.white.absorbed_by_base)

    @cached_property
    def by_label(self) -> Mapping[str, Candidate]:
        """Candidates by label."""
        return {c.label: c for c in self.candidates}

    def group(self, label: str, variant: int) -> Array:
        """Columns of a candidate's variant."""
        at = next(k for k, c in enumerate(self.candidates) if c.label == label)
        return self.groups[self.variants.index((at, variant))]

    def rows_of(self, columns: Array) -> tuple[int, ...]:
        """Rows of a block in which some columns act."""
        return tuple(row for row, own, _ in self.E.made.blocks if np.isin(own, columns).any())

    def only(self, columns: Array) -> MotionCase:
        """The case with some columns of causes alone, and no candidates."""
        return replace(self, E=self.E.only(columns), candidates=(), variants=(), groups=())

    def among(self, labels: Collection[str]) -> MotionCase:
        """The case with some of the candidates alone."""
        kept = [k for k, c in enumerate(self.candidates) if c.label in labels]
        own = [i for i, (k, _) in enumerate(self.variants) if k in kept]
        columns = np.sort(np.concatenate([self.groups[i] for i in own]))
        return replace(
            self,
            candidates=tuple(self.candidates[k] for k in kept),
            variants=tuple((kept.index(self.variants[i][0]), self.variants[i][1]) for i in own),
            groups=tuple(np.searchsorted(columns, self.groups[i]) for i in own),
            E=self.E.only(columns),
        )

    def fitted(self, columns: Array) -> tuple[Array, Array]:
        """Coefficients of base and columns together, in sizes, shapes (P,) and (columns,)."""
        fit = new_fit(self.white, columns, WHITE, combined=False)
        P = self.base.shape[2]
        return fit.x[:P], fit.x[P:]

    def left(self, columns: Array, x: Array, theta: Array) -> Array:
        """What base and columns leave, as it is, shape (blocks, rows)."""
        out = self.r - self.base @ x
        return np.asarray(out - self.E.take(columns) @ theta if len(columns) else out)

    def rms(self, left: Array) -> Array:
        """Of the log's windows, of each joint's first row, shape (joints,), in the unit of `scale`."""
        return np.asarray(np.sqrt((left[self.of_log, : self.joints] ** 2).mean(axis=0)) * self.scale)

    def renewed(self, columns: Array = NONE) -> MotionCase:
        """The case with its noise as it is in what some causes and a base much freer than its priors leave."""
        few, every, P = self.only(columns), np.arange(len(columns)), self.base.shape[2]
        for _ in range(ROUNDS):
            # Noise is what is left where the base is so many times freer than its priors.
            x = new_fit(replace(few.white, reference=1 / 8), every, WHITE, combined=False).x
            noise = following(few.left(every, x[:P], x[P:]), self.first, self.floor, self.trust, self.of_log)
            few = replace(few, noise=noise)
        return replace(self, noise=few.noise)


def following(left: Array, first: Array, floor: Array, trust: Array, of_log: Array) -> Following:
    """The noise as it is in what was left, shape (blocks, rows), of the log and of its reference on its own.

    floor : least of each row
    """
    parts = [_following(left[k], first[k], floor, trust[k]) for k in (of_log, ~of_log) if k.any()]
    return Following(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _following(left: Array, first: Array, floor: Array, trust: Array) -> tuple[Array, Array, Array]:
    usual = 1.4826 * np.nanmedian(np.where(trust < trust.max(axis=0), np.nan, np.abs(left)), axis=0)
    usual = np.maximum(usual, floor)
    weight = trust / np.sqrt(1 + (left / (TAIL * usual)) ** 2)
    inner = ~first[1:]
    a, b = (left * weight**2)[1:][inner], (left * weight**2)[:-1][inner]
    stays = (a * b).sum(axis=0) / np.maximum((a * a).sum(axis=0), (b * b).sum(axis=0) + 1e-300)
    cut = trust * np.minimum(np.abs(left), CUT * usual)  # what is far out is no noise
    sigma = np.maximum(np.sqrt((cut**2).sum(axis=0) / (trust**2).sum(axis=0)), floor)
    return np.broadcast_to(sigma, left.shape), np.broadcast_to(np.clip(stays, 0.0, MOST_STAYS), left.shape), weight


def motion_case(
    looks: Sequence[Look], known: Mapping[tuple[str, int, bool], float] | None = None,
    chosen: Sequence[Cause] | None = None,
) -> MotionCase:  # fmt: skip
    """The problem of a log, and of a reference behind it where there are two looks.

    known : coefficients of the base of the reference alone (see `coefficients`)
    chosen : causes that are candidates; None for no candidates at all
    """
    log = looks[0]
    rows = log.arm.joints * (1 if log.response is None else 2)
    ends = np.cumsum([0, *(len(one.motion.windows) for one in looks)])
    first = np.concatenate([one.motion.first for one in looks])
    bodies = np.zeros((ends[-1], rows, log.arm.spread.shape[1]))
    columns: dict[tuple[str, int, bool], tuple[Part, Array]] = {}
    for at, one in enumerate(looks):
        bodies[ends[at] : ends[at + 1], : log.arm.joints] = bodies_of(one)
        base = base_of(one)
        for part in base + today_of(base, known) if known and not at else base:
            own = part.kind.startswith("before") and at > 0
            key = (f"{part.kind}, reference", *part.key[1:]) if own else part.key
            values = columns.setdefault(key, (part, np.zeros((ends[-1], rows))))[1]
            row = part.joint + log.arm.joints * part.response
            values[ends[at] : ends[at + 1], row] = one.motion.averaged(part.samples)
    parts = tuple(part for part, _ in columns.values())
    J = np.concatenate([bodies, np.stack([p.size * v for p, v in columns.values()], axis=2)], axis=2)
    residual = np.concatenate([_residual(one) for one in looks])
    nothing = RowColumns(Factors((), 0), rows, int(ends[-1]))
    floor = _floor(log)
    trust = np.concatenate([_trust(one, rows) for one in looks])
    of_log = np.arange(ends[-1]) < ends[1]
    noise = following(residual, first, floor, trust, of_log)
    case = MotionCase(
        (), (), (), residual, J, nothing, first, noise,
        of_log, parts, floor, trust, *_reported(log),
    ).renewed()  # fmt: skip
    return case if chosen is None else with_candidates(case, log, chosen)


def _floor(log: Look) -> Array:
    """Noise of each row at least: readings in steps, and what every base errs by."""
    m, arm, step = log.motion, log.arm, log.motion.quantum / np.sqrt(12)
    late = ERRS_BY * np.sqrt((m.v**2).mean(axis=0))
    if m.torque is None:
        return np.asarray(np.hypot(log.gain * np.hypot(step, late) / log.great, ERRS))
    at_torque = np.hypot(log.gain * step / log.great, ERRS) if arm.kp is not None else np.full(arm.joints, ERRS)
    if log.response is None:
        return at_torque
    served = SERVO_ERRS * np.sqrt((log.names["servo"] ** 2).mean(axis=0)) if "servo" in log.names else 0.0
    return np.concatenate([at_torque, np.sqrt(step**2 + late**2 + served**2)])


def _trust(one: Look, rows: int) -> Array:
    """Weight of each number: of a joint that stands friction may be any torque up to its own."""
    trust = np.ones((len(one.motion.windows), rows))
    stands = one.motion.averaged((one.motion.rest > 0) * 1.0) > 0.5
    # Weight of the torque of a joint that stands.
    trust[:, : one.arm.joints][stands] = 0.2
    return trust


def _reported(log: Look) -> tuple[Array, str | None, tuple[Array, ...]]:
    """What a report says of the log: scale and unit of its residual, and over what it is looked at."""
    arm, unit, scale = log.arm, None, log.great / log.gain
    if log.motion.torque is not None:
        unit = "N m" if arm.per_ampere is None else "A"
        scale = log.great / (1.0 if arm.per_ampere is None else arm.per_ampere)
    over = tuple(log.motion.averaged(log.names[k]) for k in ("q", "v", "load", "time"))
    return scale, unit, over


def _residual(one: Look) -> Array:
    torque = one.motion.averaged(one.torque)
    return torque if one.response is None else np.concatenate([torque, one.motion.averaged(one.response)], axis=1)


def coefficients(case: MotionCase) -> dict[tuple[str, int, bool], float]:
    """Of each part of a base that was fitted alone."""
    x = case.fitted(NONE)[0][-len(case.parts) :]
    return {p.key: c * p.size for p, c in zip(case.parts, x.tolist(), strict=True)}


def today_of(base: Sequence[Part], known: Mapping[tuple[str, int, bool], float]) -> list[Part]:
    """What of a base differs from that of a healthy day: each joint's frictions as wholes, and a little of the rest."""
    parts: list[Part] = []
    whole: dict[tuple[str, int], Array] = {}
    for p in base:
        if not p.kind.startswith(ALIKE):
            size = DAILY_SERVO * p.size if p.response else min(TODAY.get(p.kind, DAILY_LEAST), p.size)
            parts.append(replace(p, kind=f"{p.kind}, today", size=size))
        for name, kinds in WHOLES.items():
            if p.kind.startswith(kinds) and not p.response:
                whole[name, p.joint] = whole.get((name, p.joint), 0.0) + known.get(p.key, 0.0) * p.samples
    return parts + [Part(f"{name}, today", j, DAILY, samples) for (name, j), samples in whole.items()]


def frictions(case: MotionCase, log: Look) -> dict[str, Array]:
    """Friction as the base has it, shape (samples, joints), in great torques: what is dry, what grows with speed."""
    known = coefficients(case)
    out = {"friction": np.zeros_like(log.motion.q), "drag": np.zeros_like(log.motion.q)}
    for p in case.parts:
        kind = "friction" if p.kind.startswith(FRICTIONS) else "drag" if p.kind.startswith(DRAGS) else ""
        if kind and not p.response and len(p.samples) == len(log.motion.time):
            out[kind][:, p.joint] += known[p.key] * p.samples
    return out


def with_candidates(case: MotionCase, log: Look, chosen: Sequence[Cause]) -> MotionCase:
    """The case with candidates: chosen causes, and what is on no list."""
    log = replace(log, frictions=frictions(case, log))
    total, rows = case.r.shape
    made: dict[int, list[tuple[int, Array]]] = {r: [] for r in range(rows)}
    candidates: dict[str, Candidate] = {}
    variants: list[tuple[int, int]] = []
    groups: list[Array] = []
    width = 0
    for candidate, columns in (*_listed(log, chosen), *_unlisted(log, case.noise.sigma[0])):
        known = candidates.setdefault(candidate.label, replace(candidate, variants=()))
        variants.append((list(candidates).index(candidate.label), len(known.variants)))
        candidates[candidate.label] = replace(known, variants=(*known.variants, *candidate.variants))
        groups.append(np.arange(width, width + len(columns)))
        for column in columns:
            for row, values in column.items():
                made[row].append((width, np.pad(values, (0, total - len(values)))))
            width += 1
    blocks = [(row, np.array([c for c, _ in own]), np.stack([v for _, v in own])) for row, own in made.items() if own]
    E = RowColumns(Factors(tuple(blocks), width), rows, total)
    return replace(case, E=E, candidates=tuple(candidates.values()), variants=tuple(variants), groups=tuple(groups))


def _listed(log: Look, chosen: Sequence[Cause]) -> Iterator[_Judged]:
    """Each variant of each cause, as a candidate of its own, with what its parameters do to the rows."""
    for kind in chosen:
        name = kind.answers_as or kind.name
        for joint in range(1, log.arm.joints + 1) if kind.acts_at == "joints" else (None,):
            for point in grid_points(kind):
                effect = kind(joint, **point)
                columns = columns_of(log, effect)
                if columns:
                    yield Candidate(name if joint is None else f"{name}@{joint}", name, joint, ((effect,),)), columns


def columns_of(look: Look, effect: DefinedEffect) -> list[Mapping[int, Array]]:
    """Of each parameter, what one size does to each row's windows; none where its variables were not logged."""
    n, out = look.arm.joints, [dict[int, Array]() for _ in effect.sizes()]
    known = {**look.names, **arm_names(look, effect)}
    for seam in MOTION_SEAMS:
        if seam not in effect.formulas:
            continue
        numbered = {name: match for name in effect.drivers if (match := MOTION_OF.fullmatch(name))}
        if not {numbered[k][1] if k in numbered else k for k in effect.drivers} <= known.keys():
            return []
        where = range(n) if seam.endswith("s") else [(effect.joint or 1) - 1]
        for j in where:
            names = {k: known[k][:, j] for k in effect.drivers if k not in numbered}
            names |= {k: known[of[1]][:, int(of[2]) - 1] for k, of in numbered.items()}
            names = names or {"none": np.zeros(len(look.motion.time))}
            for k, values in enumerate(motion_columns(effect, seam, names)):
                at_response = seam.startswith("response")
                if at_response and look.response is None:
                    values = look.as_torque(values, j)
                row = n + j if at_response and look.response is not None else j
                out[k][row] = look.motion.averaged(values)
    return [column for column in out if any(np.abs(v).max() > 0 for v in column.values())]


def arm_names(look: Look, effect: DefinedEffect) -> dict[str, Array]:
    """Variables of a cause's own link or joint, at every joint's torque."""
    names: dict[str, Array] = {}
    if "link" in effect.drivers and effect.joint:
        own = slice(10 * effect.joint - 10, 10 * effect.joint)
        names["link"] = look.Y[:, :, own] @ look.arm.inertial[own] / look.great
    if "zero" in effect.drivers and effect.joint:
        names["zero"] = look.by_angle(effect.joint - 1)
    m = look.motion
    if "delayed" in effect.drivers and m.command is not None:
        names["delayed"] = m.by_run(lambda c: c - late(c, effect.late / m.step), m.command)
    if "filtered" in effect.drivers and m.command is not None:
        names["filtered"] = m.by_run(lambda c: c - lagged(c, effect.within, m.step), m.command)
    return names | {k: v for k, v in look.frictions.items() if k in effect.drivers}


def _unlisted(log: Look, sigma: Array) -> Iterator[_Judged]:
    """Smooth functions at a row: of time, own load, all angles and speeds, and of the angle with the sign of motion."""
    n, names = log.arm.joints, log.names
    for row in range(len(sigma)):
        j, what = row % n, "torque" if row < n else "response"
        every = range(n) if row < n else [j]
        drivers = {"load": names["load"][:, j], "time": names["t"][:, j]}
        for letter, variable in (("q", "turned"), ("v", "speed")):
            drivers |= {f"{letter}{k + 1}": names[variable][:, k] for k in every}
        drivers["q and direction"] = names["turned"][:, j]
        for name, values in drivers.items():
            ends = np.quantile(values, [0.01, 0.99])
            if ends[1] - ends[0] < 1e-6:
                continue
            centres = np.linspace(ends[0], ends[1], BUMPS)
            wide = (centres[1] - centres[0]) * 1.2
            way = names["slip"][:, j] if "direction" in name else 1.0
            bumps = [log.motion.averaged(way * np.exp(-0.5 * ((values - c) / wide) ** 2)) for c in centres]
            label = f"smooth {what} of joint {j + 1} by {name}"
            yield (
                Candidate(label, "unknown", None, ((),), listed=False),
                [{row: UNLISTED * sigma[row] * b} for b in bumps],
            )
