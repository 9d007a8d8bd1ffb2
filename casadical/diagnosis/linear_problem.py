"""The case to diagnose: a campaign, its calibrated base model and every candidate's columns."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.marginals import NO_COLUMNS, take_over_cache
from casadical.core.parameters import Parameter
from casadical.core.statistics import robust_std
from casadical.diagnosis.candidates import Candidate, choose
from casadical.diagnosis.cross_validation import fit_of
from casadical.diagnosis.evidence import RHO_GRID, SIGMA_GRID_M, WIDE_SIGMA_GRID_M, BaseParameters, Evidence, NoisePrior
from casadical.diagnosis.instrument_columns import with_anchor_columns, with_camera_columns
from casadical.diagnosis.linearisation import EffectColumns
from casadical.diagnosis.noise_evidence import WHITE_FORM, Form, prewhitened
from casadical.diagnosis.noise_floor import replicates
from casadical.diagnosis.observations import Observations, Sigmas, combined_table, observe, scales_of, stops_in
from casadical.effects import Effect
from casadical.identification.accuracy import predicted
from casadical.identification.prior import Prior
from casadical.identification.result import Identification
from casadical.measurements.derived_columns import derive
from casadical.measurements.kinds.position import PositionCovariance
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements, Noise, same_readings
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Case:
    """Data, base model, candidate causes and noise of one diagnosis.

    robot : calibrated base model
    given : the robot before calibration; values : its parameters after it, shape (P,) [SI]
    m : all poses, with every logged and derived column
    candidates : candidate causes whose columns were logged
    missing : columns that were not logged, by label of the candidate that needs them
    whole : linear model of all poses; base : the base model's parameters in it
    inliers : mask of the inlier poses among all n poses, shape (n,)
    columns : indices of each effect's columns in the linear model, by effect
    observations : residuals and Jacobians of the measurement sets
    free : labels of the given robot's effects that are free in the base model, by their own priors
    prior : prior of parameters from another campaign
    units : base parameters = units @ independent ones, shape (P, P), where this prior correlates
        them; None without such a prior
    assumed : assumptions made for the user, as sentences
    form : form of noise under which causes are compared
    selected : cached linear model of the inlier poses, at most one item
    """

    robot: Robot
    given: Robot
    values: Array
    m: Measurements
    candidates: tuple[Candidate, ...]
    missing: dict[str, tuple[str, ...]]
    whole: Evidence
    base: BaseParameters
    inliers: Array
    columns: dict[Effect, Array]
    observations: Observations
    free: tuple[str, ...] = ()
    prior: Prior = field(default_factory=Prior)
    units: Array | None = None
    assumed: tuple[str, ...] = ()
    form: Form = WHITE_FORM
    selected: list[Evidence] = field(init=False, repr=False, default_factory=list)

    @property
    def one_end(self) -> bool:
        """Return whether each row depends on one pose only, unlike a distance between two poses."""
        return self.observations.linear.far is None

    @property
    def rows(self) -> Array:
        """Return the index among the inlier poses of each row at an inlier pose, shape (rows,).

        Rows are those of the concatenated table of all sets.
        """
        return self.observations.stops.indices_among(self.inliers)

    @cached_property
    def positions(self) -> Array:
        """Return the point of each pose in the measuring frame, shape (n, 3) [m].

        It is the measured one if there is a single set with positions, else the predicted one.
        """
        if len(self.observations.sets) == 1 and self.m.position is not None:
            return self.m.position
        return predicted(self.robot, self.m)[0]

    @property
    def vectors(self) -> Array | None:
        """Return measured minus modelled positions of the inlier poses, shape (n_inliers, 3) [m].

        They are in the measuring frame; None unless it is one set with positions (no covariances).
        """
        several = len(self.observations.sets) > 1 or self.m.position is None or self.m.kind == PositionCovariance.name
        return None if several else self.evidence.r[:, :3]

    @property
    def lengths(self) -> Array:
        """Return the length residuals of the inlier poses, shape (n_inliers, numbers) [m].

        Angular residuals are zero; lengths are not scaled to equal noise, unlike in the model.
        """
        e = self.evidence
        return e.r if e.size is None else np.asarray(e.r * e.size)

    @property
    def evidence(self) -> Evidence:
        """Return the linear model of the inlier poses, for white noise."""
        if not self.selected:
            self.selected.append(self.whole if self.inliers.all() else self.whole.at(np.flatnonzero(self.inliers)))
        return self.selected[0]

    @cached_property
    def progress(self) -> Array:
        """Return each pose's place in the order of measuring, 0 first to 1 last, shape (n,)."""
        return derive(self.m, ["progress"])[0].conditions["progress"]

    @property
    def order(self) -> Array:
        """Return the inlier poses' indices among the inliers in the order of measuring.

        Their shape is (n_inliers,).
        """
        return np.argsort(self.progress[self.inliers], kind="stable")

    @cached_property
    def judged(self) -> Evidence:
        """Return the linear model of the inlier poses prewhitened for the form of noise.

        Causes are compared by its likelihoods.
        """
        return self.evidence if self.form is WHITE_FORM else prewhitened(self.evidence, self.form, self.order)

    def torques(self, m: Measurements) -> Array:
        """Return each joint's gravity torque at the poses of m, (len(m), joints) [N m or N]."""
        w = m.condition_matrix(self.given.conditions, self.given.declared)
        tau = self.given.model.function("torque", ("tau",)).map(len(m))(m.q.T, w.T, self.values)
        return np.asarray(tau.full().T)

    def with_form(self, form: Form) -> Case:
        """Return the case with another form of noise."""
        return replace(self, form=form)._with_evidence(self.evidence)

    def with_scatter(self, joint: int, times: float) -> Case:
        """Return the case with a joint's (1-based) repeatability error multiplied by `times`."""
        own = np.where(np.arange(self.whole.Jq.shape[2]) == joint - 1, times, 1.0)
        return replace(self, whole=replace(self.whole, Jq=self.whole.Jq * own))

    @cached_property
    def lags(self) -> Array | None:
        """Return the displacement of each pose by its last motion, shape (n, numbers) [m].

        Readings that lag behind the joints displace a pose by a random share of it. None if the
        order of poses is unknown, a row depends on two poses, or the lag is in the noise already.
        """
        m, missing = derive(self.m, names := [f"move{j}" for j in self.robot.numbers])
        if missing or not self.one_end or self.whole.Jq.shape[2] > self.robot.n:
            return None
        behind = np.column_stack([m.conditions[name] for name in names])
        return np.asarray(np.einsum("nij,nj->ni", self.whole.Jq, behind))

    def _with_evidence(self, evidence: Evidence) -> Case:
        """Store `evidence` as the linear model of the inlier poses, and return the case itself."""
        self.selected[:] = [evidence]
        return self

    def prior_parts(self, prior: Prior) -> tuple[Array, Array, Array]:
        """Return mean and sigma of independent combinations of the base parameters, and these.

        Mean and sigma have the shape (P,), that of the mean minus the present value; base
        parameters = combinations @ independent ones, shape (P, P) [SI].
        prior : prior of parameters from another campaign; parameters that it does not name keep the
            mean and sigma of the base model
        """
        mean, sigma, units = self.base.delta0.copy(), self.base.prior.copy(), np.eye(len(self.values))
        places = {name: k for k, name in enumerate(self.given.parameters.names)}
        for name, (value, width) in prior.means.items():
            mean[places[name]], sigma[places[name]] = value - self.values[places[name]], width
        for names, matrix in prior.covariances:
            own = [k for k, name in enumerate(names) if self.given.parameters[name].group in prior.labels]
            at, L = [places[names[k]] for k in own], np.linalg.cholesky(matrix[np.ix_(own, own)])
            units[np.ix_(at, at)], sigma[at], mean[at] = L, 1.0, np.linalg.solve(L, mean[at])
        return mean, sigma, units

    def with_prior(self, prior: Prior, reference: float) -> Case:
        """Return the case with the prior of another campaign on its base parameters.

        reference : noise standard deviation at which the priors hold [m]
        """
        mean, sigma, units = self.prior_parts(prior)
        whole = replace(self.whole, J=self.base.J @ units, delta0=mean, prior=sigma, reference=reference)
        whole, base = BaseParameters.restricted(whole)
        return replace(self, whole=whole, base=base, prior=prior, units=units)

    def with_all_sigmas(self) -> Case:
        """Return the case with the noise grid `WIDE_SIGMA_GRID_M`.

        Where the rms residual of the base model exceeds the previous grid, the base priors hold at
        this noise, and the typical sizes of effects grow in proportion.
        """
        residual_sd, most = (
            float(np.sqrt(np.sum(self.evidence.r**2) / self.evidence.count)),
            float(self.whole.sigmas[-1]),
        )
        whole = replace(self.whole, sigmas=WIDE_SIGMA_GRID_M)
        if residual_sd > most:
            assert isinstance(whole.E, EffectColumns)
            whole = replace(
                whole,
                reference=residual_sd,
                E=replace(whole.E, growth=residual_sd / most, first=None, cached={}),
            )
        return replace(self, whole=whole)

    @property
    def growth(self) -> float:
        """Return the factor on the typical sizes of all effects (see `with_all_sigmas`)."""
        return self.whole.E.growth if isinstance(self.whole.E, EffectColumns) else 1.0

    def screened(self, inliers: Array) -> Case:
        """Return the case with other inliers. Raises InputError if most poses are outliers.

        inliers : mask of the inliers, shape (n,)
        """
        if 2 * inliers.sum() < len(inliers):
            raise InputError(
                f"{self.m.source}: the model does not fit: {len(inliers) - int(inliers.sum())} of "
                f"{len(inliers)} poses are far off; check the signs and zeros of the joints, their order, units "
                "and the DH convention, which casadical check looks for"
            )
        return self.with_inliers(inliers)

    def with_inliers(self, inliers: Array) -> Case:
        """Return the case with other inliers; cached sums are updated if few poses change.

        inliers : mask of the inliers, shape (n,)
        """
        if np.array_equal(inliers, self.inliers):
            return self
        more = replace(self, inliers=inliers)
        # Few changed poses are subtracted from the sums, or added; with many the sums are computed again.
        if (inliers != self.inliers).sum() <= 0.2 * self.inliers.sum():
            lost, gained = (
                self.whole.at(np.flatnonzero(a & ~b)) for a, b in ((self.inliers, inliers), (inliers, self.inliers))
            )
            take_over_cache(more.evidence, self.evidence, (lost, gained))
            if self.form.ar_coefficient:
                before, judged = self.judged, more.judged
                rows = before.at(_changed_rows(self, more)), judged.at(_changed_rows(more, self))
                take_over_cache(judged, before, rows)
        return more

    @property
    def _successions(self) -> Array:
        """Return the indices of each inlier pose and the inlier before it, shape (n_inliers, 2).

        Rows are in the order of measuring; the first one has no predecessor, -1.
        """
        poses = np.flatnonzero(self.inliers)[self.order]
        return np.column_stack([poses, np.append(-1, poses[:-1])])

    @cached_property
    def groups(self) -> Mapping[tuple[str, int], Array]:
        """Return the indices of each variant's columns, by label and index of the variant."""
        return {(c.label, v): self.group(e) for c in self.candidates for v, e in enumerate(c.variants)}

    def group(self, effects: Sequence[Effect]) -> Array:
        """Return the indices of the columns of some effects, shape (k,); empty for no effects."""
        return np.concatenate([NO_COLUMNS, *(self.columns[e] for e in effects)])

    def with_sizes(self, effect: Effect, factors: Mapping[int, float], noise: Noise) -> tuple[Case, Effect]:
        """Return the case and the effect with other prior sizes of the effect's parts.

        factors : factor on the prior size of each part, by its key in `effect.parts`
        noise : noise at which the priors hold from now on; only the points of `RHO_GRID` next to
            its ratio are evaluated
        """
        learnt = effect.with_sizes({part: self.growth * factor for part, factor in factors.items()})
        columns = self.columns[effect]
        cause_prior = self.whole.cause_prior_sigmas.copy()
        for part, places in effect.parts.items():
            cause_prior[columns[places]] *= factors[part]
        candidates = tuple(
            replace(c, variants=tuple(tuple(learnt if e == effect else e for e in v) for v in c.variants))
            for c in self.candidates
        )
        rho = int(np.argmin(np.abs(RHO_GRID - noise.repeatability / noise.sigma)))
        near = tuple(range(max(rho - 1, 0), min(rho + 2, len(RHO_GRID))))
        whole = replace(self.whole, cause_prior=cause_prior, reference=noise.sigma, near=near)
        more = replace(self, candidates=candidates, columns={**self.columns, learnt: columns}, whole=whole)
        take_over_cache(more.evidence, self.evidence)
        if self.form is not WHITE_FORM:
            take_over_cache(more.judged, self.judged)
        return more, learnt

    def sizes(self, columns: Array) -> Array:
        """Return the typical sizes of the parameters of these columns, shape (k,) [SI].

        They include the factor `growth`.
        """
        assert isinstance(self.whole.E, EffectColumns)
        return self.whole.E.sizes[columns]

    def with_events(self, count: int, claimed: Collection[str]) -> Case:
        """Return the case in which each kind of event (slip, jump) has enough candidates.

        What slipped once may slip again: a later event has the columns of the first.
        count : least number of a kind's candidates (by joint) that are not in the model
        claimed : labels of the causes in the model
        """
        case, first = self, [c for c in self.candidates if getattr(c.variants[0][0], "event", 0) == 1]
        for c in first:
            own = [k for k in self.candidates if (k.name, k.joint) == (c.name, c.joint)]
            for number in range(len(own) + 1, count + 1 + sum(k.label in claimed for k in own)):
                later = {e: cast(Any, replace)(e, event=number) for v in c.variants for e in v}
                columns = {**case.columns, **{new: self.columns[old] for old, new in later.items()}}
                more = Candidate(next(iter(later.values())).label, c.name, c.joint, tuple((e,) for e in later.values()))
                case = replace(case, candidates=(*case.candidates, more), columns=columns)
        return case._with_evidence(self.evidence) if case is not self else self

    def with_events_at(self, time: float | None) -> Case:
        """Return the case in which every kind of event is a candidate at a time, unless it is None.

        The kinds would else be compared at different times, those of their grids.
        """
        if time is None:
            return self
        every = [(cast(Any, e), c.label) for c in self.candidates for v in c.variants for e in v if hasattr(e, "at")]
        moved = {(replace(event, at=time),): label for event, label in every}
        return self.with_variants({v: label for v, label in moved.items() if v[0] not in self.columns})

    def with_variants(self, variants: Mapping[tuple[Effect, ...], str]) -> Case:
        """Return the case with additional variants (settings) of candidates.

        variants : label of the candidate by the effects of each new variant
        """
        if not variants:
            return self
        candidates = tuple(
            replace(c, variants=(*c.variants, *(v for v, label in variants.items() if label == c.label)))
            for c in self.candidates
        )
        effects = tuple(dict.fromkeys(e for v in variants for e in v if e not in self.columns))
        if not effects:
            return replace(self, candidates=candidates)
        m, _ = derive(self.m, [c for e in effects for c in e.conditions], self.given.loads)
        columns = {**self.columns, **column_indices(effects, self.whole.width)}
        assert isinstance(self.whole.E, EffectColumns)
        E = self.whole.E.plus(effects, m.conditions)
        # Learnt sizes are carried over.
        cause_prior = (
            E.prior_sigma
            if self.whole.cause_prior is None
            else np.append(self.whole.cause_prior, E.prior_sigma[self.whole.width :])
        )
        more, evidence = replace(self, m=m, candidates=candidates, columns=columns), self.evidence
        more = replace(more, whole=replace(self.whole, E=E, cause_prior=cause_prior))
        own = replace(evidence, E=E.at(np.flatnonzero(self.inliers)), cause_prior=cause_prior)
        take_over_cache(own, evidence)
        for name in ("fits", "noise_forms"):  # of columns that both have
            own.cache[name] = evidence.cache.setdefault(name, {})
        more._with_evidence(own)
        if self.form is not WHITE_FORM:
            take_over_cache(more.judged, self.judged)
        return more


def _changed_rows(case: Case, other: Case) -> Array:
    """Return the indices of the poses whose prewhitened rows differ between two cases, shape (k,).

    Indices count the inliers of `case` in the order of measuring; the poses are those that have
    another predecessor in `other` or are no inliers there.
    """
    others = set(map(tuple, other._successions.tolist()))
    return np.array(
        [k for k, pair in enumerate(case._successions.tolist()) if tuple(pair) not in others], dtype=np.int64
    )


def make_case(
    identification: Identification,
    candidates: Sequence[Candidate],
    free: tuple[str, ...] = (),
    sigmas: Sigmas | None = None,
) -> Case:
    """Return the case of an identification on its own measurements.

    candidates : possible causes; those whose columns were not logged are listed in `Case.missing`
    free : labels of the robot's effects that are free in the base model
    sigmas : noise of the sets' lengths and angles, by default that of the base fit
    """
    robot, sets = identification.given, identification.measurements
    stops = stops_in(sets)
    m = combined_table(sets, robot, stops)
    m = with_camera_columns(with_anchor_columns(m, sets, identification.unknown_points, stops), sets, stops)
    # A payload that was not logged is the declared one at all poses, as in the model.
    if robot.payload and "payload_kg" not in m.conditions:
        m = replace(m, conditions={**m.conditions, "payload_kg": np.full(len(m), robot.payload.mass)})
    possible, missing = choose(candidates, m, robot.loads)
    effects = tuple(dict.fromkeys(e for c in possible for v in c.variants for e in v))
    m, _ = derive(m, [c for e in effects for c in e.conditions], robot.loads)
    values = robot.values_of(identification.robot)
    seen = observe(identification, m, sets, values, sigmas or identification.problem.sigmas, stops)
    inliers, whole, base = _problem(identification, seen, effects, values, free)
    columns = column_indices(effects, 0)
    possible = tuple(possible)
    return Case(identification.robot, robot, values, m, possible, missing, whole, base, inliers, columns, seen, free)


def _problem(
    identification: Identification,
    seen: Observations,
    effects: tuple[Effect, ...],
    values: Array,
    free: tuple[str, ...],
) -> tuple[Array, Evidence, BaseParameters]:
    """Return the mask of poses without gross errors (n,), the linear model and its base parameters.

    The priors hold at 20 um, the usual noise of a laser tracker, for a single set of positions,
    else at the robust standard deviation of the base model's residuals.
    """
    robot, r, numbers = identification.given, seen.r, np.maximum(seen.measured.sum(axis=1), 1)
    delta0 = robot.parameters.values - values
    delta0[[n.startswith(("base_", "tool_r")) for n in robot.parameters.names]] = 0.0
    residual_sd = robust_std(r)
    # Only gross outliers are removed: an effect that splits the residuals into two clusters must
    # not lose one of them.
    # A pose is a gross outlier beyond five robust standard deviations (scaled median absolute
    # deviations).
    inliers = seen.measured.any(axis=1) & (np.linalg.norm(r, axis=1) / np.sqrt(numbers) <= 5.0 * residual_sd)
    E = EffectColumns(replace(seen.linear, J=seen.linear.J[:, :, :0]), effects).with_directions()
    again = replicates(seen.m, r, inliers, seen.apart, seen.measured)
    lengths = [length for length, _ in seen.sigmas]
    # Declared sigma in units of the residuals [m]; the ratios scale a declaring set's lengths to
    # the noise of the first set.
    declared = lengths[0] if any(m.sigma for m in seen.sets) else 0.0
    each = zip(seen.sets, lengths, strict=True)
    sheet = 0.0 if declared else min((m.datasheet * lengths[0] / own for m, own in each if m.datasheet), default=0.0)
    # Poses at equal readings are one stop, where several targets share stops.
    stop, several = same_readings(seen.m.q), len(seen.m.target_names) > 1
    # Repeated poses count for at most 60 degrees of freedom, because poses that are measured one
    # after the other share slow errors.
    whole = Evidence(
        r,
        np.concatenate([seen.linear.J, seen.U], axis=2) if seen.U.size else seen.linear.J,
        np.append(delta0, seen.mean),
        np.append(base_prior_sigmas(robot, free), np.ones(len(seen.mean))),
        E,
        cause_prior=E.prior_sigma,
        Jq=seen.Jq,
        noise_prior=NoisePrior(
            declared, sheet, again.sigma, min(again.freedom, 60), float(np.sqrt((seen.Jq**2).sum() / numbers.sum()))
        ),
        measured=seen.measured,
        size=seen.size,
        stop=stop if several and stop.max() + 1 < len(stop) else None,
        alike=seen.alike,
        unsure=unsure_tables(seen),
    )
    if not seen.plain:
        whole = replace(whole, reference=max(residual_sd, float(SIGMA_GRID_M[0])))
    return inliers, *BaseParameters.restricted(whole)


def unsure_tables(seen: Observations) -> tuple[Array, ...]:
    """Return `Evidence.unsure`, at most two masks (n, numbers) of small tables without a sigma.

    The lengths and the angles of a set are a table each; small ones have less than 100 numbers, but
    at least a tenth of all. If no table declares its sigma, the largest is the reference and excluded.
    """
    masks, declared = [], False
    for m, poses, places in zip(seen.sets, seen.layout.poses, seen.layout.places, strict=True):
        lengths = find_kind(m.kind).lengths
        for part, sigma in ((places[:, :lengths], m.sigma), (places[:, lengths:], m.sigma_angle)):
            mask = np.zeros(seen.r.shape, dtype=bool)
            mask[poses, part] = seen.measured[poses, part]
            if sigma:
                declared = True
            elif mask.any():
                masks.append(mask)
    counts = [int(mask.sum()) for mask in masks]
    rising = np.argsort(counts, kind="stable")[: len(masks) - (not declared)]
    # Tables with a smaller fraction of all numbers have too little influence.
    least = 0.1 * int(seen.measured.sum())
    # The noise ratio of tables with 100 numbers is certain to 7 %.
    return tuple(masks[k] for k in rising if least <= counts[k] < 100)[:2]


def updated_sigmas(case: Case, columns: Array, noise: Noise) -> Sigmas | None:
    """Return the noise of each set estimated from a fit with causes; None if it hardly changes.

    Declared sigmas are unchanged; for a single set of positions the result is None.
    columns : indices of the causes' columns, shape (k,); noise : assumed by the fit
    """
    seen = case.observations
    if seen.plain:
        return None
    fit = fit_of(case.evidence, columns, noise)
    squares, leverage = (
        fit.whitened_residual.reshape(case.evidence.r.shape) ** 2,
        fit.leverage(np.arange(len(case.evidence.r))),
    )
    freedom = seen.measured[case.inliers] - np.diagonal(leverage, axis1=1, axis2=2)
    place, found = np.cumsum(case.inliers) - 1, list[tuple[float, float]]()
    each = zip(seen.sets, seen.sigmas, seen.layout.poses, seen.layout.places, strict=True)
    for m, (length, angle), poses, places in each:
        own, kind = case.inliers[poses[:, 0]], find_kind(m.kind)
        poses, places = place[poses[own]], places[own]
        parts = (places[:, : kind.lengths], places[:, kind.lengths :])
        factors = [
            float(np.sqrt(squares[poses, part].sum() / max(float(freedom[poses, part].sum()), 1.0))) or 1.0
            for part in parts
        ]
        found.append((length if m.sigma else length * factors[0], angle if m.sigma_angle else angle * factors[1]))
    more = tuple(found)
    old, new = ([scales_of(own, k) for k in range(len(more))] for own in (seen.sigmas, more))
    change = np.log(np.divide(new, old).ravel())
    counts = [bool(n) for m in seen.sets for n in (find_kind(m.kind).lengths, find_kind(m.kind).angles)]
    # Ratios count as assumed if their logarithms change by at most 0.2.
    return more if np.abs(change[counts]).max() > 0.2 else None


def column_indices(effects: Sequence[Effect], first: int) -> dict[Effect, Array]:
    """Return the indices of each effect's columns, by effect; they are consecutive from `first`."""
    edges = first + np.cumsum([0, *(len(e.sizes()) for e in effects)])
    return {e: np.arange(a, b) for e, a, b in zip(effects, edges[:-1], edges[1:], strict=True)}


def base_prior_sigmas(robot: Robot, free: Collection[str] = ()) -> Array:
    """Return the prior standard deviation of every parameter of the base model, shape (P,) [SI].

    free : labels of the effects of the robot that are not fixed, unlike all its other effects
    """
    fixed = {e.label for e in robot.effects} - set(free)

    def sigma(p: Parameter) -> float:
        """Return the prior standard deviation of one parameter [SI]."""
        if p.group in fixed:
            # A prior standard deviation of 1e-3 of the parameter's scale is practically fixed.
            return 1e-3 * p.scale
        # The prior standard deviation of a data-sheet compliance is the compliance itself: a joint
        # that is 2.5 times softer is no rarity, and a narrower prior makes an effect out of it
        # (with 0.5 of the compliance three of four claims were false on such a robot in MuJoCo;
        # with 1.0 none).
        return p.value if p.group == "compliance" and p.value > 0 else p.prior

    return np.array([sigma(p) for p in robot.parameters])
