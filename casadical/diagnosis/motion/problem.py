"""Linear regression problem of a joint log: rows are torques and position errors, columns causes.

Rows are means over windows. Blocks are windows, with a row for each joint's torque and, where both
were logged, one for its position error; columns are the base's and the causes'. Noise is
autocorrelated (AR(1)): rows are whitened with standard deviations and AR coefficients that are
estimated from the base's residual. With a reference, blocks of both logs are analysed together:
parameters that both share have wide priors, differences from day to day have tight ones, and causes
act in the log alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadical.core.basics import Array
from casadical.core.linear_gaussian.columns import Columns, Factors, row_columns
from casadical.core.linear_gaussian.noise import serial_noise
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.motion.base import BaseColumn, LogView, base_columns, body_columns
from casadical.diagnosis.motion.signals import delayed, lagged
from casadical.effects.definition import DefinedEffect
from casadical.effects.formula_effect import MOTION_NAME_OF_JOINT, MOTION_SEAMS
from casadical.effects.motion import Cause, motion_columns
from casadical.effects.settings import grid_points
from casadical.measurements.measurements import Noise

# Grid of the noise for likelihoods, in units of the estimated noise by which rows are whitened.
RELATIVE_NOISE_GRID = np.geomspace(0.4, 2.5, 25)
# Prior standard deviation of the relative change of a group of a joint's friction columns
# (`FRICTION_GROUPS`) from one day to another.
DAILY_FRICTION_SHARE = 0.15
# Largest prior standard deviation of the change, from one day to another, of the coefficient of a
# torque column, friction included, that `DAILY_SIGMAS` does not list; columns are divided by the
# peak torque.
MAX_DAILY_SIGMA = 0.01
# Prior standard deviation of the daily change of a position-error column's coefficient, divided by
# that of the coefficient.
DAILY_SERVO_SHARE = 0.7
MAX_AR_COEFFICIENT = 0.8  # largest AR(1) coefficient of the noise from one window to the next
NOISE_ROUNDS = 3  # number of alternating estimates of the base and of the noise
# Smallest noise of a torque row, divided by the peak torque, as every base is wrong by some amount.
BASE_TORQUE_ERROR = 0.005
# Smallest noise of a position-error row, divided by the rms error that the servo's equation gives.
BASE_SERVO_ERROR_SHARE = 0.03
BASE_TIME_ERROR_S = 1e-3  # time shift of the motion that gives the smallest noise of angles [s]
# Scale of residuals, in robust standard deviations, above which the weight of a row falls.
STUDENT_TAIL_SIGMAS = 8.0
# Absolute residuals are limited to this many robust standard deviations where the noise is
# estimated.
MAX_NOISE_SIGMAS = 4.0
UNIT_NOISE = Noise(1.0, 0.0)  # noise of whitened rows: standard deviation one
NO_COLUMNS = np.zeros(0, dtype=np.int64)  # indices of an empty set of columns
# Number of Gaussian bumps of a smooth function of one variable that stands for an unlisted cause.
BUMPS_PER_FUNCTION = 6
# Typical size of the coefficient of a Gaussian bump of an unlisted cause, in units of the row's
# noise; its prior standard deviation is a factor of `KAPPA_GRID` times this.
UNLISTED_SIGMAS = 3.0
# A candidate with one variant and, for each of its parameters, its column: values at the windows by
# row of a block.
_CandidateColumns = tuple[Candidate, list[Mapping[int, Array]]]
DRY_FRICTION_KINDS = ("slip", "dip", "at rest")  # beginnings of the kinds of dry friction columns
# Beginnings of kinds of base columns without a daily change of their own: they change with their
# group, or not at all.
UNCHANGED_KINDS = ("before", "dip", "root", "at rest", "absolute", "curved", "loaded ")
# Prior standard deviations of the daily changes of servo columns in torque rows, by kind: delay
# [s], filter [s^2], gain (relative).
DAILY_SIGMAS = {"delay": 1e-3, "filter": 1e-4, "gain": 0.05}
VISCOUS_KINDS = ("viscous", "root", "absolute", "curved")  # friction that grows with speed
LOAD_KINDS = ("loaded", "by side")  # friction that grows with load
# Groups of friction columns that change from day to day by a common factor: beginnings of their
# kinds by the name of the group.
FRICTION_GROUPS = {
    "dry": DRY_FRICTION_KINDS,
    "drag": VISCOUS_KINDS,
    "loaded": LOAD_KINDS,
    "friction": (*DRY_FRICTION_KINDS, *VISCOUS_KINDS, *LOAD_KINDS),
}


@dataclass(frozen=True, eq=False)
class RowNoise:
    """Autocorrelated noise of each row, and the rows' weights, each of shape (blocks, rows).

    sigma : standard deviation; ar_coefficient : AR(1) coefficient from window to window
    weight : robust weight of the value, 0 to 1
    """

    sigma: Array
    ar_coefficient: Array
    weight: Array

    def white(self, values: Array, first: Array) -> Array:
        """Return whitened rows of blocks, of the shape of `values`.

        values : shape (blocks, rows, ...); first : whether a block begins a run, shape (blocks,)
        """
        return serial_noise(self.ar_coefficient, first[:, None], self.weight / self.sigma).whiten(values)

    def row(self, row: int) -> RowNoise:
        """Return the noise of one row of each block, by its index, in arrays (blocks, 1)."""
        return RowNoise(*(a[:, row : row + 1] for a in (self.sigma, self.ar_coefficient, self.weight)))


@dataclass(frozen=True, eq=False)
class MotionCase:
    """The regression problem of a log, with its candidate causes.

    The rows of a block are the torques of all joints, divided by the peak torques, then, if both
    were logged, their position errors [rad].
    candidates : possible causes; variants : (candidate, variant) indices of each group of columns;
        groups : indices of the columns of each
    r : residual of the model with nominal parameters, shape (blocks, rows), not whitened
    base : columns of the base times their prior standard deviations, shape (blocks, rows, P), not
        whitened
    E : columns of the variants, not whitened; first : whether a block begins a run, shape (blocks,)
    noise : noise of each row of each block
    of_log : whether a block is of the log itself, not of the reference, shape (blocks,)
    parts : columns of the base after those of the bodies
    floor : smallest noise of each row, shape (rows,)
    trust : weight of each value, shape (blocks, rows)
    scale : factor from each joint's first row to the unit, shape (joints,)
    unit : "A" or "N m", that of the log's torques; None: rad
    region_values : angle, speed, load and time at the log's windows, each of shape (blocks, joints)
    """

    candidates: tuple[Candidate, ...]
    variants: tuple[tuple[int, int], ...]
    groups: tuple[Array, ...]
    r: Array
    base: Array
    E: Columns
    first: Array
    noise: RowNoise
    of_log: Array
    parts: tuple[BaseColumn, ...]
    floor: Array
    trust: Array
    scale: Array
    unit: str | None
    region_values: tuple[Array, ...]

    @property
    def joints(self) -> int:
        """Return the number of joints."""
        return len(self.scale)

    @cached_property
    def white(self) -> Evidence:
        """Return the linear model of the whitened residual, base and columns."""
        n, rows, P = self.base.shape
        made = tuple(
            (row, columns, self.noise.row(row).white(values.T[:, None], self.first)[:, 0].T)
            for row, columns, values in self.E.factors().blocks
        )
        return Evidence(
            self.noise.white(self.r, self.first),
            self.noise.white(self.base, self.first),
            np.zeros(P),
            np.ones(P),
            row_columns(Factors(made, self.E.shape[2]), n, rows),
            reference=1.0,
            near=(0,),
            Jq=np.zeros((n, rows, 1)),
            sigmas=RELATIVE_NOISE_GRID,
        )

    @cached_property
    def judged(self) -> Evidence:
        """Return the whitened model whose degrees of freedom exclude those that the base absorbs.

        Priors are unchanged, unlike in `BaseParameters.restricted`: a delay that is declared to a
        millisecond is evidence against another one.
        """
        return replace(self.white, absorbed=self.white.absorbed_by_base)

    @cached_property
    def by_label(self) -> Mapping[str, Candidate]:
        """Return the candidates by label."""
        return {c.label: c for c in self.candidates}

    def group(self, label: str, variant: int) -> Array:
        """Return the indices of the columns of one variant of the candidate with this label."""
        at = next(k for k, c in enumerate(self.candidates) if c.label == label)
        return self.groups[self.variants.index((at, variant))]

    def rows_of(self, columns: Array) -> tuple[int, ...]:
        """Return the indices of the rows of a block in which some columns are not zero."""
        return tuple(row for row, own, _ in self.E.factors().blocks if np.isin(own, columns).any())

    def only(self, columns: Array) -> MotionCase:
        """Return the case with the causes' columns of these indices only and without candidates."""
        return replace(self, E=self.E.only(columns), candidates=(), variants=(), groups=())

    def among(self, labels: Collection[str]) -> MotionCase:
        """Return the case with the candidates of these labels only."""
        selected = [k for k, c in enumerate(self.candidates) if c.label in labels]
        own = [i for i, (k, _) in enumerate(self.variants) if k in selected]
        columns = np.sort(np.concatenate([self.groups[i] for i in own]))
        return replace(
            self,
            candidates=tuple(self.candidates[k] for k in selected),
            variants=tuple((selected.index(self.variants[i][0]), self.variants[i][1]) for i in own),
            groups=tuple(np.searchsorted(columns, self.groups[i]) for i in own),
            E=self.E.only(columns),
        )

    def fitted(self, columns: Array) -> tuple[Array, Array]:
        """Return the coefficients of base and some columns in a joint fit, shapes (P,), (columns,).

        They are in units of the prior standard deviations. columns : indices of columns
        """
        fit = new_fit(self.white, columns, UNIT_NOISE, combined=False)
        P = self.base.shape[2]
        return fit.x[:P], fit.x[P:]

    def residual(self, columns: Array, x: Array, theta: Array) -> Array:
        """Return the residual for given coefficients, not whitened, shape (blocks, rows).

        columns : indices of columns; x, theta : coefficients of the base and of these columns
        """
        out = self.r - self.base @ x
        return np.asarray(out - self.E.take(columns) @ theta if len(columns) else out)

    def rms(self, residual: Array) -> Array:
        """Return the rms of each joint's first row over the log's windows, shape (joints,).

        It is in the unit `unit`. residual : shape (blocks, rows), not whitened
        """
        return np.asarray(np.sqrt((residual[self.of_log, : self.joints] ** 2).mean(axis=0)) * self.scale)

    def renewed(self, columns: Array = NO_COLUMNS) -> MotionCase:
        """Return the case with its noise estimated again from the residual given some causes.

        columns : indices of these causes' columns
        """
        few, every, P = self.only(columns), np.arange(len(columns)), self.base.shape[2]
        for _ in range(NOISE_ROUNDS):
            # The base's priors are eight times wider here, so that the residual is noise alone.
            x = new_fit(replace(few.white, reference=1 / 8), every, UNIT_NOISE, combined=False).x
            noise = row_noise(few.residual(every, x[:P], x[P:]), self.first, self.floor, self.trust, self.of_log)
            few = replace(few, noise=noise)
        return replace(self, noise=few.noise)


def row_noise(residual: Array, first: Array, floor: Array, trust: Array, of_log: Array) -> RowNoise:
    """Return the noise estimated from a residual, separately for the log and its reference.

    The arguments are fields of `MotionCase`; residual has the shape (blocks, rows).
    """
    parts = [_row_noise(residual[k], first[k], floor, trust[k]) for k in (of_log, ~of_log) if k.any()]
    return RowNoise(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _row_noise(residual: Array, first: Array, floor: Array, trust: Array) -> tuple[Array, Array, Array]:
    """Return standard deviation, AR(1) coefficient and robust weight, (blocks, rows) each.

    They are estimated from the residual of one log; the first two are equal in all blocks.
    """
    usual = 1.4826 * np.nanmedian(np.where(trust < trust.max(axis=0), np.nan, np.abs(residual)), axis=0)
    usual = np.maximum(usual, floor)
    weight = trust / np.sqrt(1 + (residual / (STUDENT_TAIL_SIGMAS * usual)) ** 2)
    inner = ~first[1:]
    a, b = (residual * weight**2)[1:][inner], (residual * weight**2)[:-1][inner]
    ar_coefficient = (a * b).sum(axis=0) / np.maximum((a * a).sum(axis=0), (b * b).sum(axis=0) + 1e-300)
    cut = trust * np.minimum(np.abs(residual), MAX_NOISE_SIGMAS * usual)  # outliers are no noise
    sigma = np.maximum(np.sqrt((cut**2).sum(axis=0) / (trust**2).sum(axis=0)), floor)
    return (
        np.broadcast_to(sigma, residual.shape),
        np.broadcast_to(np.clip(ar_coefficient, 0.0, MAX_AR_COEFFICIENT), residual.shape),
        weight,
    )


def motion_case(
    log_views: Sequence[LogView],
    reference_coefficients: Mapping[tuple[str, int, bool], float] | None = None,
    chosen: Sequence[Cause] | None = None,
) -> MotionCase:
    """Return the problem of a log, with a reference appended to it if there are two views.

    log_views : the log and, if there is one, the reference
    reference_coefficients : coefficients of the base of the reference alone (see `coefficients`)
    chosen : causes that are candidates; None: no candidates
    """
    log = log_views[0]
    rows = log.arm.joints * (1 if log.response is None else 2)
    ends = np.cumsum([0, *(len(one.motion.windows) for one in log_views)])
    first = np.concatenate([one.motion.first for one in log_views])
    bodies = np.zeros((ends[-1], rows, log.arm.spread.shape[1]))
    columns: dict[tuple[str, int, bool], tuple[BaseColumn, Array]] = {}
    for at, one in enumerate(log_views):
        bodies[ends[at] : ends[at + 1], : log.arm.joints] = body_columns(one)
        base = base_columns(one)
        for part in base + daily_changes(base, reference_coefficients) if reference_coefficients and not at else base:
            own = part.kind.startswith("before") and at > 0
            key = (f"{part.kind}, reference", *part.key[1:]) if own else part.key
            values = columns.setdefault(key, (part, np.zeros((ends[-1], rows))))[1]
            row = part.joint + log.arm.joints * part.response
            values[ends[at] : ends[at + 1], row] = one.motion.averaged(part.samples)
    parts = tuple(part for part, _ in columns.values())
    J = np.concatenate([bodies, np.stack([p.size * v for p, v in columns.values()], axis=2)], axis=2)
    residual = np.concatenate([_residual(one) for one in log_views])
    nothing = row_columns(Factors((), 0), int(ends[-1]), rows)
    floor = _floor(log)
    trust = np.concatenate([_trust(one, rows) for one in log_views])
    of_log = np.arange(ends[-1]) < ends[1]
    noise = row_noise(residual, first, floor, trust, of_log)
    case = MotionCase(
        (),
        (),
        (),
        residual,
        J,
        nothing,
        first,
        noise,
        of_log,
        parts,
        floor,
        trust,
        *_reported(log),
    ).renewed()
    return case if chosen is None else with_candidates(case, log, chosen)


def _floor(log: LogView) -> Array:
    """Return the smallest noise of each row, from reading resolution and base errors, (rows,).

    Torque rows are divided by the peak torque; position-error rows are in rad.
    """
    m, arm, step = log.motion, log.arm, log.motion.quantum / np.sqrt(12)
    delayed = BASE_TIME_ERROR_S * np.sqrt((m.v**2).mean(axis=0))
    if m.torque is None:
        return np.asarray(np.hypot(log.gain * np.hypot(step, delayed) / log.peak_torque, BASE_TORQUE_ERROR))
    at_torque = (
        np.hypot(log.gain * step / log.peak_torque, BASE_TORQUE_ERROR)
        if arm.kp is not None
        else np.full(arm.joints, BASE_TORQUE_ERROR)
    )
    if log.response is None:
        return at_torque
    served = (
        BASE_SERVO_ERROR_SHARE * np.sqrt((log.variables["servo"] ** 2).mean(axis=0))
        if "servo" in log.variables
        else 0.0
    )
    return np.concatenate([at_torque, np.sqrt(step**2 + delayed**2 + served**2)])


def _trust(one: LogView, rows: int) -> Array:
    """Return the weight of each value, (windows, rows): 0.2 for torques at rest, else 1.

    At rest friction may be any torque up to its limit.
    """
    trust = np.ones((len(one.motion.windows), rows))
    stands = one.motion.averaged((one.motion.rest > 0) * 1.0) > 0.5
    # weight of the torque of a joint at rest
    trust[:, : one.arm.joints][stands] = 0.2
    return trust


def _reported(log: LogView) -> tuple[Array, str | None, tuple[Array, ...]]:
    """Return the fields scale, unit and region_values of `MotionCase`."""
    arm, unit, scale = log.arm, None, log.peak_torque / log.gain
    if log.motion.torque is not None:
        unit = "N m" if arm.per_ampere is None else "A"
        scale = log.peak_torque / (1.0 if arm.per_ampere is None else arm.per_ampere)
    region_values = tuple(log.motion.averaged(log.variables[k]) for k in ("q", "v", "load", "time"))
    return scale, unit, region_values


def _residual(one: LogView) -> Array:
    """Return the residual of a log's model with nominal parameters, shape (windows, rows)."""
    torque = one.motion.averaged(one.torque)
    return torque if one.response is None else np.concatenate([torque, one.motion.averaged(one.response)], axis=1)


def coefficients(case: MotionCase) -> dict[tuple[str, int, bool], float]:
    """Return fitted coefficients of the base's columns after the bodies, by `BaseColumn.key`."""
    x = case.fitted(NO_COLUMNS)[0][-len(case.parts) :]
    return {p.key: c * p.size for p, c in zip(case.parts, x.tolist(), strict=True)}


def daily_changes(
    base: Sequence[BaseColumn], reference_coefficients: Mapping[tuple[str, int, bool], float]
) -> list[BaseColumn]:
    """Return base columns for the changes of a log's base since the day of the reference.

    They are one column for each joint's groups of friction, and small changes of other columns.
    base : base columns of the log; reference_coefficients : see `coefficients`
    """
    parts: list[BaseColumn] = []
    group_columns: dict[tuple[str, int], Array] = {}
    for p in base:
        if not p.kind.startswith(UNCHANGED_KINDS):
            size = DAILY_SERVO_SHARE * p.size if p.response else min(DAILY_SIGMAS.get(p.kind, MAX_DAILY_SIGMA), p.size)
            parts.append(replace(p, kind=f"{p.kind}, today", size=size))
        for name, kinds in FRICTION_GROUPS.items():
            if p.kind.startswith(kinds) and not p.response:
                group_columns[name, p.joint] = (
                    group_columns.get((name, p.joint), 0.0) + reference_coefficients.get(p.key, 0.0) * p.samples
                )
    return parts + [
        BaseColumn(f"{name}, today", j, DAILY_FRICTION_SHARE, samples) for (name, j), samples in group_columns.items()
    ]


def frictions(case: MotionCase, log: LogView) -> dict[str, Array]:
    """Return the friction torques of the fitted base, divided by peak torque, (samples, joints).

    Key `friction` is dry friction, `drag` friction that grows with speed.
    """
    known = coefficients(case)
    out = {"friction": np.zeros_like(log.motion.q), "drag": np.zeros_like(log.motion.q)}
    for p in case.parts:
        kind = (
            "friction" if p.kind.startswith(DRY_FRICTION_KINDS) else "drag" if p.kind.startswith(VISCOUS_KINDS) else ""
        )
        if kind and not p.response and len(p.samples) == len(log.motion.time):
            out[kind][:, p.joint] += known[p.key] * p.samples
    return out


def with_candidates(case: MotionCase, log: LogView, chosen: Sequence[Cause]) -> MotionCase:
    """Return the case with candidates: chosen causes, and smooth functions for unlisted ones."""
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
    E = row_columns(Factors(tuple(blocks), width), total, rows)
    return replace(case, E=E, candidates=tuple(candidates.values()), variants=tuple(variants), groups=tuple(groups))


def _listed(log: LogView, chosen: Sequence[Cause]) -> Iterator[_CandidateColumns]:
    """Yield each variant of each cause as a candidate, with the columns of its parameters.

    Causes whose variables were not logged are omitted.
    """
    for kind in chosen:
        name = kind.answers_as or kind.name
        for joint in range(1, log.arm.joints + 1) if kind.acts_at == "joints" else (None,):
            for point in grid_points(kind):
                effect = kind(joint, **point)
                columns = columns_of(log, effect)
                if columns:
                    yield Candidate(name if joint is None else f"{name}@{joint}", name, joint, ((effect,),)), columns


def columns_of(log_view: LogView, effect: DefinedEffect) -> list[Mapping[int, Array]]:
    """Return, for each parameter of a cause, its column: values at the windows by row of a block.

    It is that of the parameter's typical size; columns of zeros are omitted. The list is empty
    where variables of the cause were not logged.
    """
    n, out = log_view.arm.joints, [dict[int, Array]() for _ in effect.sizes()]
    known = {**log_view.variables, **own_variables(log_view, effect)}
    for seam in MOTION_SEAMS:
        if seam not in effect.formulas:
            continue
        numbered = {name: match for name in effect.drivers if (match := MOTION_NAME_OF_JOINT.fullmatch(name))}
        if not {numbered[k][1] if k in numbered else k for k in effect.drivers} <= known.keys():
            return []
        where = range(n) if seam.endswith("s") else [(effect.joint or 1) - 1]
        for j in where:
            variables = {k: known[k][:, j] for k in effect.drivers if k not in numbered}
            variables |= {k: known[of[1]][:, int(of[2]) - 1] for k, of in numbered.items()}
            variables = variables or {"none": np.zeros(len(log_view.motion.time))}
            for k, values in enumerate(motion_columns(effect, seam, variables)):
                at_response = seam.startswith("response")
                if at_response and log_view.response is None:
                    values = log_view.as_torque(values, j)
                row = n + j if at_response and log_view.response is not None else j
                out[k][row] = log_view.motion.averaged(values)
    return [column for column in out if any(np.abs(v).max() > 0 for v in column.values())]


def own_variables(log_view: LogView, effect: DefinedEffect) -> dict[str, Array]:
    """Return the variables that belong to a cause's own link, joint or settings, by name.

    Each has the shape (samples, joints); only those that its formulas use are returned.
    """
    variables: dict[str, Array] = {}
    if "link" in effect.drivers and effect.joint:
        own = slice(10 * effect.joint - 10, 10 * effect.joint)
        variables["link"] = log_view.Y[:, :, own] @ log_view.arm.inertial[own] / log_view.peak_torque
    if "zero" in effect.drivers and effect.joint:
        variables["zero"] = log_view.by_angle(effect.joint - 1)
    m = log_view.motion
    if "delayed" in effect.drivers and m.command is not None:
        variables["delayed"] = m.by_run(lambda c: c - delayed(c, effect.late / m.step), m.command)
    if "filtered" in effect.drivers and m.command is not None:
        variables["filtered"] = m.by_run(lambda c: c - lagged(c, effect.within, m.step), m.command)
    return variables | {k: v for k, v in log_view.frictions.items() if k in effect.drivers}


def _unlisted(log: LogView, sigma: Array) -> Iterator[_CandidateColumns]:
    """Yield candidates for unlisted causes: smooth functions of one variable in one row.

    The variables are time, the joint's load, angles and speeds (of all joints in torque rows, else
    the joint's own), and its angle, with the sign of the direction of motion.
    sigma : noise of each row, shape (rows,)
    """
    n, variables = log.arm.joints, log.variables
    for row in range(len(sigma)):
        j, what = row % n, "torque" if row < n else "response"
        every = range(n) if row < n else [j]
        drivers = {"load": variables["load"][:, j], "time": variables["t"][:, j]}
        for letter, variable in (("q", "turned"), ("v", "speed")):
            drivers |= {f"{letter}{k + 1}": variables[variable][:, k] for k in every}
        drivers["q and direction"] = variables["turned"][:, j]
        for name, values in drivers.items():
            ends = np.quantile(values, [0.01, 0.99])
            if ends[1] - ends[0] < 1e-6:
                continue
            centres = np.linspace(ends[0], ends[1], BUMPS_PER_FUNCTION)
            wide = (centres[1] - centres[0]) * 1.2
            way = variables["slip"][:, j] if "direction" in name else 1.0
            bumps = [log.motion.averaged(way * np.exp(-0.5 * ((values - c) / wide) ** 2)) for c in centres]
            label = f"smooth {what} of joint {j + 1} by {name}"
            yield (
                Candidate(label, "unknown", None, ((),), listed=False),
                [{row: UNLISTED_SIGMAS * sigma[row] * b} for b in bumps],
            )
