"""Diagnosis of the error that remains after calibration: verdict, causes and gap."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from casadical.core.basics import Array, InputError, Show, silent
from casadical.core.linear_gaussian.marginals import NO_COLUMNS
from casadical.core.statistics import robust_std
from casadical.diagnosis.candidates import Candidate, EffectChoice, candidates_of
from casadical.diagnosis.changes import changes
from casadical.diagnosis.conclusion import conclude
from casadical.diagnosis.cross_validation import errors_and_distances, likely_noise
from casadical.diagnosis.evidence import WIDE_SIGMA_GRID_M
from casadical.diagnosis.laws.search import laws_before_causes, log_mass_of_causes, replaces_causes
from casadical.diagnosis.linear_problem import Case, make_case, updated_sigmas
from casadical.diagnosis.noise_forms import likely_lag, noisy_joint
from casadical.diagnosis.observations import Sigmas
from casadical.diagnosis.posterior import PRIOR_FIRST, Ranking, rank
from casadical.diagnosis.result import Change, Diagnosis
from casadical.diagnosis.search import State, next_cause, search, search_with_forms
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.structure import shown_by
from casadical.effects import Effect, LinkMasses
from casadical.identification.accuracy import predicted
from casadical.identification.identification import (
    Prepared,
    calibrate_base_model,
    prepare,
    prepared_again,
    with_compliance_if_supported,
)
from casadical.identification.plausibility import fault_of_orientations
from casadical.identification.prior import Prior
from casadical.identification.result import Identification
from casadical.identification.sessions import sessions_in
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

__all__ = ["Diagnosis", "Masses", "diagnose"]


# Treatment of wrong declared link masses: a candidate cause, or nuisance parameters of the base
# model.
Masses = Literal["candidate", "nuisance"]


def diagnose(
    robot: Robot | Prepared | Identification,
    m: Measurements | Sequence[Measurements] | None = None,
    effects: EffectChoice = "standard",
    *,
    seed: int = 0,
    bootstrap: int = 0,
    prior: Robot | Prior | None = None,
    masses: Masses = "candidate",
    laws: bool = True,
    show: Show = silent,
) -> Diagnosis:
    """Diagnose the error that calibration leaves on a campaign: which effect causes it.

    robot : nominal model with the compliances that it should have, which is calibrated on the
        campaign first; or robot, measurements and prior together, as `prepare` returns them; or an
        identification, whose own measurements are diagnosed unless others of its robot are given
    m : one set of any kind, or several sets of the same robot, each with its own noise; an unknown
        tool rotation is free where orientations were measured; orientations that contradict the
        model are ignored
    effects : "standard" or "extended", or names (backlash), labels (backlash@5) and own effects
    seed : seed of all random numbers
    bootstrap : number of draws of pure noise that calibrate the detection (2000: seconds); 0: none
    prior : the same robot as identified on another campaign, whose effects enter the base model
        with their values and covariance as a prior; changes since then are detected first
        (`Diagnosis.changes`). Or a prior of `carry_over`, with its robot
    masses : "candidate": wrong declared link masses are a cause that may be named; "nuisance": they
        are free in the base model within the robot's `body_width`, never named (as if undeclared)
    laws : whether the causes must hold against the best expression of an unlisted effect (about 1 s
        for 100 poses); if the expression wins, the verdict is unknown
    show : called with a line of progress
    Returns verdict, causes and gap; more expensive results are computed on request.
    Raises InputError: where the measurements cannot carry a diagnosis or arguments contradict.

    Examples
    --------
    >>> measured = casadical.from_table(table, 2)
    >>> diagnosis = casadical.diagnose(robot, measured, ["gear_eccentricity", "backlash"])
    >>> diagnosis.verdict, [cause.label for cause in diagnosis.causes]
    ('explained', ['gear_eccentricity@2'])
    """
    if bootstrap < 0:
        raise InputError(f"bootstrap is {bootstrap}; give the number of draws, 2000 say, or 0 for none")
    prepared = _prepared(robot, m, prior, masses)
    return _Question(prepared, effects, seed, bootstrap, laws, show).answer()


@dataclass(frozen=True, eq=False)
class _Question:
    """The arguments of a diagnosis, and the stages of its computation.

    prepared : robot, measurements and prior; effects, seed, bootstrap, laws, show : see `diagnose`
    """

    prepared: Prepared
    effects: EffectChoice
    seed: int
    bootstrap: int
    laws: bool
    show: Show

    @cached_property
    def base(self) -> Identification:
        """Return the calibrated base model, the given identification or a robust fit.

        Orientations that do not fit the robot (of another convention, for example) are ignored,
        because they would distort the base model. Outliers are screened later.
        """
        given = self.prepared
        if given.identification:
            return given.identification
        self.show("calibrating the base model")
        sets = tuple(m.positions_alone() if fault_of_orientations(given.robot, m) else m for m in given.sets)
        calibration = calibrate_base_model(prepared := replace(given, sets=sets))
        # A standard deviation of orientations above 0.05 rad means another convention, not noise.
        off = [m.orientation is not None and s[1] > 0.05 for m, s in zip(sets, calibration.problem.sigmas, strict=True)]
        if not any(off):
            return calibration
        alone = (m.positions_alone() if bad else m for m, bad in zip(sets, off, strict=True))
        return calibrate_base_model(replace(prepared, sets=tuple(alone)))

    @cached_property
    def candidates(self) -> Sequence[Candidate]:
        """Return the candidate causes.

        With the list "standard" and several sessions that share a base, a step of the base or
        instrument between them is one, too.
        """
        given, effects = self.base.given, self.effects
        self.show("signatures of the candidates")
        if effects == "standard" and given.sessions.base == "shared" and len(sessions_in(self.prepared.sets)) > 1:
            effects = ["standard", "frame_step"]
        return candidates_of(given, effects)

    def case(self, sigmas: Sigmas | None = None) -> Case:
        """Return the case of the base model and candidates, without a prior from another campaign.

        sigmas : noise of the sets, see `make_case`
        """
        return make_case(self.base, self.candidates, self.prepared.free, sigmas)

    def with_unchanged_prior(self, case: Case, unchanged: Prior) -> Case:
        """Return the case with the prior of an earlier campaign on the unchanged effects.

        It is returned without it if the prior has no free parameter.
        """
        return case.with_prior(unchanged, self.base.sigmas[0][0]) if unchanged.free else case

    def searched(self, case: Case) -> Diagnosis:
        """Return the diagnosis of a case, including causes that the noise of one joint hides.

        The search ends when a noisy joint is the most probable cause. Causes are then searched with
        this joint's larger repeatability error in the noise, under which their probabilities hold.
        The remaining error is evaluated without it: an unlisted effect at that joint may cause it,
        so that the verdict remains unknown. Where a random lag is likely, see `lagging`.
        """
        case = replace(case, assumed=_assumed(case, self.base, self.prepared.sets))
        state = search_with_forms(case, self.seed, self.bootstrap, self.show)
        found = conclude(self.base, state, self.seed)
        if share := likely_lag(found.case, found.rankings[-1], found.columns):
            return self.lagging(case, share)
        joint = noisy_joint(case, found.rankings[-1]) if found.verdict == "unknown" else None
        if joint is None:
            return found
        self.show(f"causes given poor repeatability of joint {joint}")
        with_it = search(case.with_scatter(joint, SETTINGS.noisy_joint_factor), self.seed, 0, self.show)
        if len(with_it.steps) <= len(found.effects()) or with_it.rankings[0].none > SETTINGS.max_p_nothing_under_form:
            return found
        plain = replace(with_it, case=with_it.case.with_scatter(joint, 1 / SETTINGS.noisy_joint_factor))
        plain = replace(plain, rankings=plain.rankings[: len(plain.steps)]).ranked()
        end, _ = next_cause(plain, plain.rankings[-1])
        more = conclude(self.base, replace(plain, end=end, p_nothing=state.p_nothing), self.seed)
        return more if more.verdict == "unknown" and len(more.effects()) > len(found.effects()) else found

    def lagging(self, case: Case, share: float) -> Diagnosis:
        """Return the diagnosis of a case with a random lag of the readings in its noise.

        share : of `LAG_SHARES`, standard deviation of the lag as a share of the motion, divided by
            that of the joints' repeatability [1/rad]
        """
        self.show("causes given readings that lag behind the last motion")
        assert case.lags is not None
        Jq = np.concatenate([case.whole.Jq, share * case.lags[:, :, None]], axis=2)
        case = replace(case, whole=replace(case.whole, Jq=Jq))
        # Poses that a great lag displaced are no outliers.
        noise = likely_noise(case.evidence.log_base(), case.whole.sigmas)
        _, distance = errors_and_distances(case.whole, NO_COLUMNS, noise, case.inliers)
        found = self.searched(case.screened(distance < SETTINGS.outlier_distance))
        lag = f"{1e3 * share * found.noise.repeatability:.2g} mrad per rad"
        said = (
            f"{case.m.source}: the readings of each pose lag behind its last motion by a random share of it, {lag} "
            "(one sigma), which is taken as noise; give the commanded angles, or wait until the joints have settled"
        )
        return replace(found, case=replace(found.case, assumed=(*found.case.assumed, said)))

    def answer(self) -> Diagnosis:
        """Return the diagnosis; the search is repeated if the noise differs from that assumed.

        Raises InputError where the base model can absorb all that was measured, or where the noise
        lies beyond the widest grid.
        """
        prior = self.prepared.prior
        case, unchanged, changed = self.case(), prior, tuple[Change, ...]()
        e = case.evidence
        if e.count - e.absorbed < 1:  # less than one degree of freedom
            raise InputError(
                f"{case.m.source}: base and geometry can absorb all that its {len(case.m)} rows measure, so that no "
                "residual remains to be diagnosed; measure more poses (casadical plan)"
            )
        if prior.free:
            self.show("what changed since the campaign of the prior")
            changed, unchanged = changes(case, prior)
        if not case.observations.plain:  # a step would count as noise of its set
            noise = likely_noise(case.judged.log_base(), case.judged.sigmas)
            steps = shown_by(case, NO_COLUMNS, noise, case.form)[1]
            stepped = case.with_variants({(step,): label for step, label in steps.items()})
            if sigmas := updated_sigmas(stepped, np.sort(stepped.group([*steps])), noise):
                case = self.case(sigmas).with_inliers(case.inliers)
        found = self.searched(case := self.with_unchanged_prior(case, unchanged))
        # The sets' noise is estimated again with the causes in the model, at most twice.
        for _ in range(2):
            sigmas = updated_sigmas(found.case, found.columns, found.noise)
            if sigmas is None:
                break
            self.show("the sets' noise differs from that of the base model: searched again")
            # Outliers stay those given the causes: to the noise without a step, every pose near it
            # is a gross error of the base model.
            again = self.case(sigmas).with_inliers(found.case.inliers)
            found = self.searched(case := self.with_unchanged_prior(again, unchanged))
        usual = case.whole.sigmas
        if not usual[0] < found.noise.sigma < usual[-1]:
            self.show("the noise lies beyond the usual grid: searched again on a wider one")
            found, most = self.searched(case.with_all_sigmas()), float(WIDE_SIGMA_GRID_M[-1])
            if found.noise.sigma >= most:  # the robot differs too much from its file
                remain = f"{1e3 * robust_std(found.case.whole.r):.2g} mm per coordinate remain"
                raise InputError(
                    f"{case.m.source}: {remain}, and noise beyond {1e3 * most:.2g} mm is not "
                    "diagnosed; correct the robot file or the units"
                )
        if self.laws:
            self.show("laws in place of the causes")
            found = _compared_with_laws(found)
        found = _with_masses_and_order_varied(self.with_level_varied(found))
        return replace(found, prior=prior if prior.free or prior.frozen else None, changes=changed)

    def with_level_varied(self, found: Diagnosis) -> Diagnosis:
        """Return the diagnosis with a sentence where its cause at joint 1 hangs on the level.

        The weight turns an upright axis only as far as it leans in the frame of an instrument that is
        taken as level. Where the cause is not the most probable or below `Settings.min_claim` if
        the robot stands upright instead, the sentence says so. For that the poses are turned.
        """
        case = found.case
        likely = {k for r in found.rankings for k, p in r.probability.items() if p >= SETTINGS.min_claim}
        causes = [c for c in found.causes if c.joint == 1 and c.effects and c.label in likely]
        turn = _turn_to_upright(case.robot, case.m) if causes and case.observations.plain else None
        if turn is None:
            return found
        self.show("the causes of joint 1 if the robot stands upright")
        lean = float(np.degrees(np.arccos(turn[2, 2])))
        (m,) = self.prepared.sets
        upright = replace(self.prepared, sets=(replace(m, position=m.position @ turn.T),), identification=None)
        # Rivals of a cause are at its joint.
        near = [c for c in self.candidates if c.joint == 1 or c.variants[0][0].joint == 1]
        other = make_case(calibrate_base_model(upright), near, self.prepared.free)
        other, said = other.with_inliers(case.inliers).with_form(case.form), []
        for cause in causes:
            ranking = State(other.with_variants({cause.effects: cause.label})).rank(())
            if ranking.order[0] != cause.label or ranking.probability[cause.label] < SETTINGS.min_claim:
                said.append(
                    f"the instrument is level, and the axis of joint 1 leans by {lean:.2g} deg: {cause.label} hangs on "
                    f"it; if the robot stands upright instead, it is {_most_likely(ranking)}; level the "
                    'instrument, or say frame = "base" in [gravity] of the robot file'
                )
        return replace(found, case=replace(case, assumed=(*case.assumed, *said)))


def _with_masses_and_order_varied(found: Diagnosis) -> Diagnosis:
    """Return the diagnosis with a sentence for each certain cause that hangs on masses or order.

    It hangs on the declared masses if it is improbable with their errors in the model, and on the
    order of the rows if it follows a direction of approach that was not logged.
    """
    case, said = found.case, []
    named = {c.label: c.effects for c in found.causes if c.effects}
    # Rivals are neither of many columns nor of several joints, which may include the cause.
    every = [c for c in case.candidates if not (c.variants[0][0].parts or c.together) or c.label in named]
    listed = replace(case, candidates=tuple(c for c in every if c.listed))._with_evidence(case.evidence)
    masses = {c.label: c.variants[0] for c in every if isinstance(c.variants[0][0], LinkMasses)}
    logged = set[str]().union(*(m.conditions for m in found.identification.measurements))
    derived = {c for c in case.m.conditions if c.startswith("approach")} - logged
    free = (replace(c, variants=tuple(v for v in c.variants if not _needs(v, derived))) for c in every)
    undirected = replace(case, candidates=tuple(c for c in free if c.variants))
    undirected = undirected._with_evidence(case.evidence)

    for cause in (c for c in found.causes if c.effects and c.confidence >= SETTINGS.min_claim):
        others = {label: effects for label, effects in named.items() if label != cause.label}
        if masses and not masses.keys() & named.keys():
            ranking = _given(listed, others | masses)
            if ranking.probability.get(cause.label, 1.0) < SETTINGS.min_doubtful:
                width = case.given.body_width
                said.append(
                    f"the masses are as declared: {cause.label} hangs on them; if they are wrong by "
                    f"{100 * width.mass_share:.2g} % and {1e3 * width.com:.2g} mm (one sigma), it is "
                    f"{_most_likely(ranking)}; weigh the links, or measure with another payload"
                )
        if _needs(cause.effects, derived):
            also = {label: effects for label, effects in others.items() if not _needs(effects, derived)}
            ranking = _given(undirected, also)
            said.append(
                f"the rows are in the order of measuring: {cause.label} hangs on it; "
                f"without it, it is {_most_likely(ranking)}; log approach{cause.joint}"
            )
    return replace(found, case=replace(case, assumed=(*case.assumed, *said)))


def _given(case: Case, causes: Mapping[str, tuple[Effect, ...]]) -> Ranking:
    """Return the ranking of a case's candidates given causes, by label."""
    columns = np.unique(case.group([e for effects in causes.values() for e in effects]))
    return rank(case, columns, frozenset(causes))


def _needs(effects: Sequence[Effect], conditions: Collection[str]) -> bool:
    """Return whether any of the effects has one of the conditions."""
    return any(c in conditions for e in effects for c in e.conditions)


def _most_likely(ranking: Ranking) -> str:
    """Return the two most probable outcomes of a ranking, nothing among them, as text."""
    every = {"nothing": ranking.none, **ranking.probability}
    best = sorted(every, key=lambda k: -every[k])[:2]
    return " or ".join(f"{k} ({every[k]:.2f})" for k in best)


def _prepared(
    robot: Robot | Prepared | Identification,
    m: Measurements | Sequence[Measurements] | None,
    prior: Robot | Prior | None,
    masses: Masses,
) -> Prepared:
    """Return robot and measurements prepared for a diagnosis. Raises InputError."""
    if isinstance(robot, Prepared):
        given = {"m": m is not None, "prior": prior is not None, "masses": masses != "candidate"}
        if any(given.values()):
            what = " and ".join(name for name, is_given in given.items() if is_given)
            raise InputError(
                f"{what}: robot and measurements are prepared already; give what is to change to prepare(...)"
            )
        if robot.method is not None:
            raise InputError(
                f"method={robot.method!r}: a diagnosis has its own base model; call prepare without a method"
            )
        return robot
    sets = () if m is None else (m,) if isinstance(m, Measurements) else tuple(m)
    if isinstance(robot, Identification):
        if prior is not None or masses == "nuisance":
            what = "prior" if prior is not None else "masses='nuisance'"
            raise InputError(f"{what}: this robot is identified already; give the nominal robot and the measurements")
        return prepared_again(robot, sets)
    if not sets:
        raise InputError("measurements are missing; give diagnose(robot, measurements), or an identification alone")
    of_masses: Literal["free", "unknown"] = "free" if masses == "nuisance" else "unknown"
    found = with_compliance_if_supported(prepare(robot, sets, prior, masses=of_masses, tool_turns=True))
    if masses != "nuisance" or any(isinstance(e, LinkMasses) for e in found.robot.effects):
        return found
    # The errors of masses act through compliances, which the file need not declare.
    errors = tuple(LinkMasses.candidates(found.robot))
    return replace(found, robot=found.robot.with_effect(*errors), free=(*found.free, *(e.label for e in errors)))


def _compared_with_laws(found: Diagnosis) -> Diagnosis:
    """Return the diagnosis without its causes if an expression (law) explains the data better.

    An expression that was claimed is attached to it as `Diagnosis.law`. Without causes, one is
    searched where no declared noise or repeated poses confirm the noise. Effects with learnt sizes
    have more freedom than any expression and are not compared; nor are distances between poses.
    """
    effects, e = found.effects(), found.case.evidence
    # The verdict may be "explained" by outliers alone.
    done = not effects and found.verdict in ("none", "explained")
    # Expressions are searched in place of noise only with at least 24 degrees of freedom beyond
    # those that the base model absorbs.
    noise = done and found.account.rules in ("fit", "data sheet") and e.count - e.absorbed >= 24
    if not (effects or noise) or not found.case.one_end or any(e.parts for e in effects):
        return found
    # The log mass of "nothing" and of all causes is what a law has to exceed.
    needed = max(float(np.log(PRIOR_FIRST["none"])), log_mass_of_causes(found))
    law, case = laws_before_causes(found, needed) or (None, found.case)
    if law and replaces_causes(found, law):
        state = State(case, rankings=found.rankings[:1]) if case is found.case else State(case).ranked()
        state = replace(state, end="unknown", p_nothing=found.p_nothing)
        found = conclude(found.identification, state, found.seed)
    return replace(found, law=law if law and law.claimed else None)


def _assumed(case: Case, found: Identification, given: Sequence[Measurements]) -> tuple[str, ...]:
    """Return sentences on assumptions about orientations, noise, stops and fixed parameters.

    All but those on ignored orientations are for other measurements than one set of positions.
    found : base model with the sets that it used; given : the sets before, in the same order
    """
    said = [
        f"{m.source}: its orientations do not fit the robot and are not used; check their convention and frame"
        for m, used in zip(given, found.measurements, strict=False)
        if m.orientation is not None and used.orientation is None
    ]
    if case.observations.plain:
        return tuple(said)
    reasons = (why.split(";")[0] for why in found.identifiability.unidentifiable.values())
    # The reason for fixed parameters begins so where measurements do not determine the base.
    said += dict.fromkeys(reason for reason in reasons if reason.startswith("nothing at rest"))
    stops = case.observations.stops
    if stops.most > 1:
        said.append(
            f"{len(stops.of)} rows were read at {len(stops.rows)} stops of the robot: rows at equal readings share how "
            "its joints repeat there; if it moved between them, say so by numbers in a column pose"
        )
    ends = [np.concatenate([m.q, m.other]) for m in case.observations.sets if m.other is not None]
    if any(len(np.unique(q, axis=0)) < len(q) for q in ends):
        said.append(
            "rows between poses that share a pose: their noise is taken as independent; what they share, joint "
            "repeatability too, may look like something unknown"
        )
    for m, (length, angle) in zip(case.observations.sets, case.observations.sigmas, strict=True):
        kind = find_kind(m.kind)
        parts = [f"{1e3 * length:.3g} mm of a length"] * bool(kind.lengths)
        parts += [f"{1e3 * angle:.3g} mrad of an angle"] * bool(kind.angles)
        said.append(f"noise of {m.source} ({m.kind}): {' and '.join(parts)}, before causes or declared")
    return tuple(said)


def _turn_to_upright(robot: Robot, m: Measurements) -> Array | None:
    """Return the rotation that makes the axis of a leaning joint 1 vertical, shape (3, 3); or None.

    None unless the robot file declares gravity along the measuring frame's z, joint 1 is revolute
    and its axis leans by 0.2 to 3 degrees: the base of an arm that leans more is no upright one.
    robot : calibrated; m : its poses
    """
    if robot.gravity_frame != "measuring" or robot.joints[0].kind != "revolute" or np.any(robot.gravity[:2]):
        return None
    two = m[np.zeros(2, dtype=np.int64)]
    R = predicted(robot, replace(two, q=two.q + np.outer([0.0, np.pi / 2], np.eye(robot.n)[0])))[1]
    S = R[1] @ R[0].T
    axis = np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]]) / 2
    up = np.array([0.0, 0.0, np.copysign(1.0, axis[2])])
    v, c = np.cross(axis, up), float(axis @ up)
    if not np.radians(0.2) < np.arccos(min(c, 1.0)) < np.radians(3.0):
        return None
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(np.eye(3) + K + K @ K / (1 + c))
