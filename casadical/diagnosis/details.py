"""Analyses for the report of a diagnosis: localisation, isolability, checks, next poses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from casadical.core.basics import Show, silent
from casadical.diagnosis.held_out_gap import Check, NetworkGap, check_refit, network_gaps
from casadical.diagnosis.isolability import Isolability, isolability, ruled_out
from casadical.diagnosis.joint_curves import JointCurve, curve_of, joint_curves
from casadical.diagnosis.laws.answer import Discovery
from casadical.diagnosis.laws.discovery import describe_unlisted, laws_of_diagnosis
from casadical.diagnosis.localisation import Localisation, localise
from casadical.diagnosis.next_poses import next_poses
from casadical.diagnosis.noise_floor import noise_floor
from casadical.diagnosis.result import Diagnosis, Unlisted
from casadical.diagnosis.settings import SETTINGS
from casadical.identification.pose_selection.workspace import Workspace


@dataclass(frozen=True, eq=False)
class Details:
    """Analyses that a report shows in addition to the diagnosis; None for what was not computed.

    where : localisation of the gap, see `localise`
    isolability : isolability of the candidates in these poses, see `isolability`
    unlisted : description of an unlisted cause, see `describe_unlisted`
    check : nonlinear refit against linear model; networks : gap with a network (see `held_out_gap`)
    curves : joint error curves, see `joint_curves`
    laws : expressions of an unlisted effect, see `laws_of_diagnosis`; computed if the verdict is
        unknown, or on request
    poses : next poses to measure, see `next_poses`; file : name of the file that has them, or empty
    floor : mean held-out error by noise alone under the best model of the report [m]
    ruled_out : labels of causes that are ruled out, by multiple of their usual size (see
        `isolability.ruled_out`)
    laws_skipped : whether none was searched: complete causes, only the noise's size in doubt
    """

    where: Localisation | None = None
    isolability: Isolability | None = None
    unlisted: Unlisted | None = None
    check: Check | None = None
    networks: tuple[NetworkGap, NetworkGap] | None = None
    curves: tuple[JointCurve, ...] = ()
    laws: Discovery | None = None
    poses: pd.DataFrame | None = None
    file: str = ""
    floor: float | None = None
    ruled_out: Mapping[str, Sequence[str]] = field(default_factory=dict)
    laws_skipped: bool = False


def analyse(
    found: Diagnosis,
    *,
    poses: int = 15,
    workspace: Workspace | None = None,
    networks: bool = False,
    laws: bool | None = None,
    file: str = "",
    show: Show = silent,
) -> Details:
    """Return the analyses that `casadical diagnose` reports in addition to the diagnosis.

    They take some seconds, with networks minutes.
    poses : number of poses to choose for the next measurements
    workspace : region in which the next poses may lie
    networks : whether to train networks, instead of the causes and in addition to them
    laws : whether to search the expression of an unlisted effect; None: if the verdict is unknown,
        unless rows are distances, or causes are complete and only the noise's size is in doubt
    file : name of the file to which the next poses are written, for the report
    show : called with a line of progress
    Raises ConvergenceError: Ipopt finds no optimum.

    Examples
    --------
    >>> details = casadical.diagnosis.analyse(diagnosis, poses=2)
    >>> details.check.agree, len(details.where.joints)
    (True, 3)
    """
    show("where it lies")
    where = localise(found)
    check = check_refit(found, show) if found.effects() else None
    gaps = network_gaps(found, show=show) if networks else None
    curved = found.case.one_end and curve_of(found.causes)
    if curved:
        show("joint error curves")
    curves = joint_curves(found) if curved else ()
    # A law describes the form of a residual: where only the size of the noise is in doubt, there is none.
    searched = found.case.one_end and found.verdict == "unknown" if laws is None else laws
    complete = bool(found.effects()) and found.rankings[-1].none > SETTINGS.max_p_nothing_further
    skipped = laws is None and complete and found.account.only_size_doubted
    discovery = laws_of_diagnosis(found, show) if searched and not skipped else None
    show("poses to measure next")
    chosen = next_poses(found, poses, workspace=workspace)
    show("what these poses can show")
    unlisted = describe_unlisted(found)
    out = ruled_out(found, unlisted)
    # The noise floor is that of the best model: causes, smooth forms or an expression.
    best, noise = found.gap.after, found.noise
    if unlisted and unlisted.further and unlisted.after < best:
        best, noise = unlisted.after, unlisted.further.noise[""]
    if discovery and discovery.gap.get("law", best) < best:
        best, noise = discovery.gap["law"], discovery.noise
    floor = min(noise_floor(found.case.evidence, noise, found.account.anchor, found.seed), best)
    return Details(
        where, isolability(found), unlisted, check, gaps, curves, discovery, chosen, file, floor, out, skipped
    )
