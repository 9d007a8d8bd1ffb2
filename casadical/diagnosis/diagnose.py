"""Diagnose what is left after calibration: the verdict, its causes, and how far the gap shrinks without them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from casadical.core.errors import InputError
from casadical.core.transforms import frame
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.changes import changes
from casadical.diagnosis.conclusion import conclude
from casadical.diagnosis.evidence import ALL_SIGMAS
from casadical.diagnosis.laws.contest import beside_nothing, instead
from casadical.diagnosis.linear_problem import Case, better_ratios, make_case
from casadical.diagnosis.posterior import Rivals, no_rivals
from casadical.diagnosis.result import Change, Diagnosis
from casadical.diagnosis.search import Show, State, search
from casadical.effects import Effect, LinkMasses, PayloadError
from casadical.identification.identification import identify
from casadical.identification.placement import place_frames
from casadical.identification.prior import Prior, carry_over
from casadical.identification.result import Identification
from casadical.identification.sessions import sessions_in, with_sessions
from casadical.identification.unknown_masses import with_unknown_masses
from casadical.identification.variance import robust_std
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

__all__ = ["Diagnosis", "Masses", "diagnose"]

# Orientations that the base model leaves so far off [rad] are of another convention, not noisy.
NO_NOISE = 0.05
# Times that the ratios of several noises are estimated again with the causes in the model.
MOST_RATIOS = 2
# How the reason begins for which a kind of measurement does not determine where the base is.
WITHOUT = "nothing at rest"

# What wrong declared masses of links are: a cause like others, or part of the base model.
Masses = Literal["candidate", "nuisance"]


def diagnose(
    robot: Robot | Identification,
    m: Measurements | Sequence[Measurements] | None = None,
    effects: Sequence[str | Effect] | Literal["standard", "extended"] = "standard",
    *,
    seed: int = 0,
    bootstrap: int = 0,
    prior: Robot | Prior | None = None,
    masses: Masses = "candidate",
    rivals: Rivals = no_rivals,
    laws: bool = True,
    show: Show = lambda _text: None,
) -> Diagnosis:
    """Diagnose the gap that calibration leaves on a campaign.

    Parameters
    ----------
    robot : Robot | Identification
        nominal model, with the compliances that it should have, which is calibrated on the campaign first; or an
        identification, whose own measurements are diagnosed unless others of the same robot are given
    m : Measurements | Sequence[Measurements], optional
        one set of any kind, or several that were measured of the same robot, each with noise of its own; an unknown
        tool turns freely where orientations were measured, and these are left aside where they contradict the model
    effects : Sequence[str | Effect] | {"standard", "extended"}, default "standard"
        "standard" or "extended", or names (backlash), labels (backlash@5) and own effects
    seed : int, default 0
        of everything random
    bootstrap : int, default 0
        draws of noise alone that calibrate whether something is there (2000 take some seconds); 0 for none
    prior : Robot | Prior, optional
        the same robot as another campaign found it, whose effects are in the base model with their values and
        covariance as a prior; what changed is found first (`Diagnosis.changes`). Or as of `carry_over`, with its
        robot
    masses : Masses, default "candidate"
        whether wrong declared masses of links are a cause that may be named, or are in the base model, free within
        the robot's `body_width`, and never named, as those are always that nobody declared
    rivals : Rivals, default no_rivals
        what competes with the candidates at every ranking, as a search for laws does (see `posterior.Rival`)
    laws : bool, default True
        whether the causes that are found must hold against the best law of a form that is on no list (1 to 2 s for
        100 poses); where it wins, the verdict is unknown
    show : Show, optional
        called with a line of progress

    Returns
    -------
    Diagnosis
        verdict, causes and gap; what costs more is computed when asked for

    Raises
    ------
    InputError
        where the measurements cannot carry a diagnosis

    Examples
    --------
    >>> diagnosis = casadical.diagnose(robot, casadical.from_table(table, 2), ["gear_eccentricity", "backlash"])
    >>> diagnosis.verdict, [cause.label for cause in diagnosis.causes]
    ('explained', ['gear_eccentricity@2'])
    """
    if bootstrap < 0:
        raise InputError(f"bootstrap is {bootstrap}; give the number of draws, 2000 say, or 0 for none")
    if prior is not None and isinstance(robot, Identification):
        raise InputError("prior: this robot is identified already; give the nominal robot and the measurements")
    if isinstance(prior, Robot) and isinstance(robot, Robot):
        robot, prior = carry_over(robot, prior)
    free: tuple[str, ...] = ()
    given = () if m is None else (m,) if isinstance(m, Measurements) else tuple(m)
    if isinstance(robot, Identification):
        if masses == "nuisance":
            raise InputError("masses='nuisance': this robot is identified already; give the nominal robot instead")
        free = _free_masses(robot)
    else:
        robot, free = with_unknown_masses(robot, given)
        if not free and (masses == "nuisance" or robot.masses == "estimated"):
            robot, free = _with_free_masses(robot)
        if given:
            robot, sessions = with_sessions(robot, given)
            free = (*free, *sessions)
    known = prior if isinstance(prior, Prior) else Prior()
    if isinstance(robot, Identification):
        identification = robot if m is None else _of(robot.given, given, known, free, show)
    elif not given:
        raise InputError("measurements are missing; give diagnose(robot, measurements), or an identification alone")
    else:
        identification = _of(robot, given, known, free, show)
    show("signatures of the candidates")
    if effects == "standard" and identification.given.sessions.base == "shared" and len(sessions_in(given)) > 1:
        effects = ["standard", "frame_step"]  # a foot or an instrument that moved between them
    candidates = candidates_of(identification.given, effects)
    case = make_case(identification, candidates, free)
    changed: tuple[Change, ...] = ()
    if known.free:
        show("what changed since the campaign of the prior")
        changed, known = changes(case, known)

    def searched(case: Case) -> Diagnosis:
        case = replace(case, assumed=_assumed(case, identification, given))
        state, end, p_nothing = search(case, seed, bootstrap, show, rivals)
        return conclude(identification, state, end, seed, p_nothing)

    def prepared(case: Case) -> Case:
        return case.with_prior(known, identification.sigmas[0][0]) if known.free else case

    found = searched(case := prepared(case))
    for _ in range(MOST_RATIOS):
        ratios = better_ratios(found.case, found.columns, found.noise)
        if ratios is None:
            break
        show("the sets' noise differs from what the base model left: searched again")
        found = searched(case := prepared(make_case(identification, candidates, free, ratios)))
    usual = case.whole.sigmas
    if not usual[0] < found.noise.sigma < usual[-1]:
        show("the noise lies beyond the usual grid: searched again on a wider one")
        found = _refuse_coarser(searched(case.with_all_sigmas()))
    if laws:
        show("laws in place of the causes")
        found = _held_against_laws(found)
    return replace(found, prior=prior if isinstance(prior, Prior) else None, changes=changed)


def _held_against_laws(found: Diagnosis) -> Diagnosis:
    """The diagnosis, without its causes where a law explains better what is there.

    An effect whose sizes are learnt has more freedom than any law and is not compared; nor are distances between poses.
    """
    effects = found.effects()
    if not effects or not found.case.one_end or any(e.parts for e in effects):
        return found
    law = beside_nothing(found)
    if instead(found, law):
        state = State(found.case, rankings=found.rankings[:1])
        found = conclude(found.identification, state, "unknown", found.seed, found.p_nothing)
    return replace(found, law=law)


def _with_free_masses(robot: Robot) -> tuple[Robot, tuple[str, ...]]:
    """The robot with masses and mass centres of links in its model, and their label; none where none are declared."""
    if not any(isinstance(e, LinkMasses) for e in robot.effects):
        robot = robot.with_effect(*LinkMasses.candidates(robot))
    return robot, tuple(e.label for e in robot.effects if isinstance(e, LinkMasses))


def _free_masses(found: Identification) -> tuple[str, ...]:
    """Labels of what an identification found of masses that nobody knows."""
    if found.given.masses != "estimated":
        return ()
    freed = {found.given.parameters[name].group for name in found.names}
    of_masses = (e.label for e in found.given.effects if isinstance(e, (LinkMasses, PayloadError)))
    return tuple(label for label in of_masses if label in freed)


def _of(
    robot: Robot, sets: tuple[Measurements, ...], prior: Prior, free: tuple[str, ...], show: Show
) -> Identification:
    """The base model calibrated; gross errors have little weight, and are screened with the causes, not before.

    Orientations of another convention than the robot's would spoil it: they are left aside where they do not fit.
    """
    show("calibrating the base model")
    turned = any(m.orientation is not None for m in sets)
    if turned and robot.tool.unknown == "position":
        robot = replace(robot, tool=replace(robot.tool, unknown="pose"))
    if turned and robot.tool.unknown == "pose":
        placed = place_frames(robot, next(m for m in sets if m.orientation is not None))
        robot = replace(robot, tool=replace(robot.tool, T=frame(placed.tool.T[:3, :3], robot.tool.T[:3, 3])))
    wanted = ("kinematic", "compliance", *free)

    def fitted(sets: tuple[Measurements, ...]) -> Identification:
        return identify(robot, sets, wanted, loss="huber", priors=True, prior=prior, screen=False)

    found = fitted(sets)
    off = [m.orientation is not None and s[1] > NO_NOISE for m, s in zip(sets, found.problem.sigmas, strict=True)]
    if any(off):
        return fitted(tuple(m.positions_alone() if bad else m for m, bad in zip(sets, off, strict=True)))
    return found


def _assumed(case: Case, found: Identification, given: Sequence[Measurements]) -> tuple[str, ...]:
    """What was taken for granted of kinds of measurement other than positions."""
    said = [
        f"{m.source}: its orientations do not fit the robot, by more than {np.degrees(NO_NOISE):.0f} deg, and are left "
        "aside; check their convention"
        for m, used in zip(given, found.measurements, strict=False)
        if m.orientation is not None and used.orientation is None
    ]
    if case.others is None:
        return tuple(said)
    held = (u.reason.split(";")[0] for u in found.identifiability.held)
    said += dict.fromkeys(reason for reason in held if reason.startswith(WITHOUT))
    stops = case.others.stops
    if stops.most > 1:
        said.append(
            f"{len(stops.of)} rows were read at {len(stops.rows)} stops of the robot: rows at equal readings share how "
            "its joints repeat there; if it moved between them, say so by numbers in a column pose"
        )
    ends = [np.concatenate([m.q, m.other]) for m in case.others.sets if m.other is not None]
    if any(len(np.unique(q, axis=0)) < len(q) for q in ends):
        said.append(
            "rows between poses that share a pose: their noise is taken as independent; what they share, joint "
            "repeatability too, may look like something unknown"
        )
    for m, (length, angle) in zip(case.others.sets, case.others.ratios.sigmas, strict=True):
        kind = find_kind(m.kind)
        parts = [f"{1e3 * length:.3g} mm of a length"] * bool(kind.lengths)
        parts += [f"{1e3 * angle:.3g} mrad of an angle"] * bool(kind.angles)
        said.append(f"noise of {m.source} ({m.kind}): {' and '.join(parts)}, before causes or declared")
    return tuple(said)


def _refuse_coarser(found: Diagnosis) -> Diagnosis:
    """Where even the best model leaves more than the widest noise grid holds, the robot is not the file's."""
    most = float(ALL_SIGMAS[-1])
    if found.noise.sigma < most:
        return found
    left = 1e3 * robust_std(found.case.whole.r)
    raise InputError(
        f"{found.case.m.source}: {left:.2g} mm a coordinate are left, and noise beyond {1e3 * most:.2g} mm is not "
        "diagnosed; correct the robot file or the units"
    )
