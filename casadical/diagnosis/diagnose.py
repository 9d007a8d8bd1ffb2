"""Diagnose what is left after calibration: the verdict, its causes, and how far the gap shrinks without them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from casadical.core.errors import InputError
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.changes import changes
from casadical.diagnosis.conclusion import conclude
from casadical.diagnosis.evidence import ALL_SIGMAS
from casadical.diagnosis.linear_problem import Case, make_case
from casadical.diagnosis.posterior import Rivals, no_rivals
from casadical.diagnosis.result import Change, Diagnosis
from casadical.diagnosis.search import Show, search
from casadical.effects import Effect, LinkMasses
from casadical.identification.identification import Identification, identify
from casadical.identification.least_squares import robust_std
from casadical.identification.prior import Prior, carry_over
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

__all__ = ["Diagnosis", "Masses", "diagnose"]

# What wrong declared masses of links are: a cause like others, or part of the base model.
Masses = Literal["candidate", "nuisance"]


def diagnose(
    robot: Robot | Identification,
    m: Measurements | None = None,
    effects: Sequence[str | Effect] | Literal["standard", "extended"] = "standard",
    *,
    seed: int = 0,
    bootstrap: int = 0,
    prior: Robot | Prior | None = None,
    masses: Masses = "candidate",
    rivals: Rivals = no_rivals,
    show: Show = lambda _text: None,
) -> Diagnosis:
    """Diagnose the gap that calibration leaves on a campaign.

    Parameters
    ----------
    robot : Robot | Identification
        nominal model, with the compliances that it should have, which is calibrated on the campaign first; or an
        identification, whose own measurements are diagnosed unless others of the same robot are given
    m : Measurements, optional
        one set of measured positions; of full poses, the positions are used
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
        the robot's `body_width`, and never named
    rivals : Rivals, default no_rivals
        what competes with the candidates at every ranking, as a search for laws does (see `posterior.Rival`)
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
    if masses == "nuisance":
        if isinstance(robot, Identification):
            raise InputError("masses='nuisance': this robot is identified already; give the nominal robot instead")
        robot, free = _with_free_masses(robot)
    known = prior if isinstance(prior, Prior) else Prior()
    if isinstance(robot, Identification):
        identification = robot if m is None else _of(robot.given, m, known, free, show)
    elif m is None:
        raise InputError("measurements are missing; give diagnose(robot, measurements), or an identification alone")
    else:
        identification = _of(robot, m, known, free, show)
    show("signatures of the candidates")
    case = make_case(identification, candidates_of(identification.given, effects), free)
    changed: tuple[Change, ...] = ()
    if known.free:
        show("what changed since the campaign of the prior")
        changed, known = changes(case, known)
        case = case.with_prior(known, identification.sigmas[0][0])

    def searched(case: Case) -> Diagnosis:
        state, end, p_nothing = search(case, seed, bootstrap, show, rivals)
        return conclude(identification, state, end, seed, p_nothing)

    found = searched(case)
    usual = case.whole.sigmas
    if not usual[0] < found.noise.sigma < usual[-1]:
        show("the noise lies beyond the usual grid: searched again on a wider one")
        found = _refuse_coarser(searched(case.with_all_sigmas()))
    return replace(found, prior=prior if isinstance(prior, Prior) else None, changes=changed)


def _with_free_masses(robot: Robot) -> tuple[Robot, tuple[str, ...]]:
    """The robot with masses and mass centres of links in its model, and their label; none where none are declared."""
    if not any(isinstance(e, LinkMasses) for e in robot.effects):
        robot = robot.with_effect(*LinkMasses.candidates(robot))
    return robot, tuple(e.label for e in robot.effects if isinstance(e, LinkMasses))


def _of(robot: Robot, m: Measurements, prior: Prior, free: tuple[str, ...], show: Show) -> Identification:
    """The base model calibrated; gross errors have little weight, and are screened with the causes, not before."""
    show("calibrating the base model")
    if m.position is not None:  # an orientation that is off by a convention would spoil the base model
        m = m.positions_alone()
    return identify(robot, m, ("kinematic", "compliance", *free), loss="huber", priors=True, prior=prior, screen=False)


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
