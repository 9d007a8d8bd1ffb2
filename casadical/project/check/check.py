"""The check of a whole problem before a solve: its files, its data, and the accuracy to expect."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from casadical.core.basics import InputError, Show, silent
from casadical.identification.accuracy import errors
from casadical.identification.identification import (
    METHODS,
    calibrate_base_model,
    lacks_declared_compliance,
    prepare,
    with_all_joints_compliant,
    with_method,
)
from casadical.identification.plausibility import check_against
from casadical.identification.sessions import place_sessions, split_by_session, undetermined_at_start, with_sessions
from casadical.measurements.columns import Source
from casadical.measurements.measurements import Measurements, Noise
from casadical.project.check import plausible as facts
from casadical.project.check.findings import (
    Finding,
    data_findings,
    far_rows,
    fault_findings,
    limits_findings,
    outlook_findings,
    set_findings,
    slip_finding,
    target_findings,
)
from casadical.project.check.information import Outlook, outlook
from casadical.project.check.result import Precheck
from casadical.project.check.slip_list import other_lengths
from casadical.project.check.slips import Slips, search_slips
from casadical.project.planning import more_poses
from casadical.project.problem import read_problem
from casadical.project.targets import Targets, middles, recognised, wrong_names
from casadical.robot.robot import Robot


def precheck(
    folder: str | Path,
    noise: float | None = None,
    show: Show = silent,
    tables: Sequence[str | Path] = (),
) -> Precheck:
    """Return what a check of a problem folder and its data finds, before a calibration.

    folder : problem folder or robot file
    noise : one sigma of a measured coordinate [m] for the forecasts; None: the residual of a linear
        step
    show : called with each line of progress
    tables : measured poses, in place of the folder's own or for a robot file (see `read_problem`)

    Faults of files and data (InputError) are findings, not exceptions.
    """
    if noise is not None:
        Noise(noise)  # which refuses zero
    folder, given = Path(folder), tuple(map(Path, tables))
    try:
        problem = read_problem(folder, tables=tables)
    except InputError as error:
        return Precheck(folder, tuple(fault_findings(error, "reading")), tables=given)
    show("comparing with the nominal robot")
    sets = split_by_session(problem.sets["identify"])
    others = facts.other_conventions(problem.robot_file)
    table = split_by_session([problem.table])[0] if problem.table is not None else None
    standard = facts.convention_of(problem.robot_file) == "standard"
    findings, slips, readings = _data_findings(problem.robot, sets, others, table, standard)
    usable = not any(f.topic in ("data", "units") and f.level == "error" for f in findings)
    targets = recognised(problem.robot, table) if table is not None else None
    wrong = wrong_names(problem.robot, table) if table is not None else None
    if wrong or (targets and targets.turning):  # those assume one target
        findings, usable, slips = [f for f in findings if f.topic not in ("units", "repeats", "rows")], False, None
    findings = [*target_findings(targets, wrong, sets[0].source), *findings]
    one = table if table is not None else sets[0] if sets[0].position is None else None
    if one is not None and not usable and wrong is None and (targets is None or targets.which is None):
        searched = _slips(problem.robot, one, targets, others, show)
        # What the single slips of `_plausible` cannot explain.
        more = searched and (searched.best.slips > 1 or other_lengths(searched.best, problem.robot))
        if searched and searched.explains and (not slips or not slips.explains or more):
            slips = searched
            findings = [f for f in findings if not (f.topic == "units" and f.level == "error")]
            findings.insert(0, slip_finding(slips, problem.robot, standard, sets[0]))
    findings += set_findings(problem)
    findings += limits_findings(problem.robot)
    stated = {
        "as given": noise,
        "as the problem states": next((m.sigma for m in sets if m.sigma), None),
        "as repeated readings show": next((s for s in (facts.repeats(m)[1] for m in sets) if s), None),
    }
    source = next((words for words, value in stated.items() if value), "")
    noise_m = stated.get(source)
    show("accuracy to expect")
    trusted = [m[np.flatnonzero(~facts.far_off(problem.robot, m)[0])] for m in sets] if usable else []
    start = place_sessions(problem.robot, trusted or sets)
    findings += [
        Finding("warning", "kind", f"these readings cannot {t}") for t in undetermined_at_start(start, trusted or sets)
    ]
    outlooks, faults = _outlooks(problem.methods if usable else (), start, trusted, noise)
    findings += faults
    for view in outlooks:
        findings += outlook_findings(view, problem.robot, noise_m)
    return Precheck(
        folder,
        tuple(findings),
        problem.title,
        problem.robot.name,
        tuple((name, sum(len(m) for m in parts)) for name, parts in problem.sets.items()),
        noise_m,
        source,
        facts.coverage(problem.robot, sets[0]),
        facts.margin(problem.robot, sets[0]),
        tuple(outlooks),
        problem.robot,
        slips,
        targets,
        wrong,
        given,
        more_poses(folder, sets[0]),
        readings,
    )


def _outlooks(
    methods: Sequence[str], start: Robot, sets: Sequence[Measurements], noise: float | None
) -> tuple[list[Outlook], list[Finding]]:
    """Return the expected accuracy by each method, and findings on methods that have none.

    noise : of a coordinate [m], None: as the data show
    """
    outlooks: list[Outlook] = []
    findings: list[Finding] = []
    for method in methods:
        try:
            several, sessions = with_sessions(start, sets)
            taken, free = with_method(place_sessions(several, sets) if sessions else several, method, sets)
            tried = method == "SKCM" and lacks_declared_compliance(taken)  # as `calibrate` tries it
            taken = with_all_joints_compliant(taken, sets)[0] if tried else taken
            view = outlook(taken, sets, (*METHODS[method], *free, *sessions), method, noise)
            if tried and not view.enough and any(other.enough for other in outlooks):
                text = f"{view.numbers} numbers are too few to see whether the joints give under load"
                findings.append(Finding("warning", "too few poses", f"{text}; measure more poses"))
            else:
                outlooks.append(view)
        except (InputError, np.linalg.LinAlgError) as error:
            findings.append(Finding("error", "identifiability", f"{method}: {error}"))
    return outlooks, findings


def _slips(
    robot: Robot, table: Measurements, targets: Targets | None, others: Sequence[Robot], show: Show
) -> Slips | None:
    """Return the slips, one or several, that explain a table; None if it cannot be fitted.

    Of several targets, the poses are those of the most measured one, or of the targets' centroid.
    """
    if targets and targets.turning:
        middle = middles(table, targets.count)
        return search_slips(robot, middle, others, show) if middle is not None else None
    names = [name for name in table.conditions if name.startswith("tool_")]
    if robot.targets and names:
        most = max(names, key=lambda name: table.conditions[name].sum())
        table = table[np.flatnonzero(table.conditions[most] > 0)]
    return search_slips(robot, table, others, show)


def _plausible(
    robot: Robot, m: Measurements, others: Sequence[Robot], standard: bool
) -> tuple[list[Finding], Slips | None]:
    """Return a finding on how well the nominal model explains a table, and its best single slip.

    The slip is None where there are too few poses, the kind is not judged (`plausible`), or the
    model itself explains the table.

    standard : whether the robot file has the standard DH convention
    """
    # Base and tool alone fit fewer than four poses with any model or none.
    judged = facts.plausible(robot, m, others) if len(m) >= 4 else None
    if judged is None:
        return [], None
    slips = Slips(*judged, ())
    # With a median error of up to 2 % of the reach the data do not contradict the nominal robot.
    if slips.explains or slips.before.error > 0.02 * robot.reach:
        return [slip_finding(slips, robot, standard, m)], slips
    text = f"{m.source}: the rigid nominal model, base and tool fitted, leaves {1e3 * slips.before.error:.3g} mm"
    fits = f"units, signs and zeros fit{', with each pose inverted' if m.inverted else ''}"
    return [Finding("note", "units", f"{text} (median, poses to fit): {fits}")], None


def _data_findings(
    robot: Robot, sets: tuple[Measurements, ...], others: Sequence[Robot], table: Measurements | None, standard: bool
) -> tuple[list[Finding], Slips | None, dict[str, dict[str, Source]]]:
    """Return findings on the fitted data, the first table's best single slip, and better readings.

    A slip is a mistake in the table or robot file, such as swapped joints; None as of `_plausible`.
    Better readings are columns that fit better, as of `_reading_findings`, by the table's source.

    table : all positions of the only table, held-out poses included; None where there is no such
        table
    """
    findings: list[Finding] = []
    single: Slips | None = None
    readings: dict[str, dict[str, Source]] = {}
    for k, m in enumerate(sets):
        try:
            check_against(robot, m)
        except InputError as error:
            findings += fault_findings(error, "data")
        said, slips = _plausible(robot, m, others, standard)
        findings += said
        single = slips if k == 0 else single
        if not any(f.level == "error" for f in said):
            findings += far_rows(robot, table or m)
            reading_findings, better = _reading_findings(robot, m)
            findings += reading_findings
            readings |= {m.source: better} if better else {}
        repeated_readings = any(np.array_equal(m.q, before.q) for before in sets[:k])  # of another wire
        findings += data_findings(robot, m, table or m, repeated_readings=repeated_readings)
    return findings, single, readings


def _reading_findings(robot: Robot, m: Measurements) -> tuple[list[Finding], dict[str, Source]]:
    """Return a finding on each second set of joint readings in a table, and the sources of better ones.

    Angles that a controller reads back may lag behind the joints, and commanded ones may not be
    reached: those are better that the calibrated robot explains better. Sources are by our column;
    they are empty where the present readings are the best.
    """

    def remaining(by: Measurements) -> float:
        """Return the median error of the robot calibrated by some readings [m]."""
        return float(np.median(errors(calibrate_base_model(prepare(robot, [by])).robot, by)))

    findings, better = list[Finding](), dict[str, Source]()
    others = facts.other_readings(robot, m)
    own = least = remaining(m) if others else 0.0
    for names, unit, other in others:
        q1, first = next(iter(robot.reading_units)), f"{m.source}: columns {names[0]!r} and on are readings, too"
        by_them = remaining(other)
        figures = f"calibrated by them {1e3 * by_them:.3g} mm remain (median), by {q1} and on {1e3 * own:.3g} mm"
        if by_them < own:
            line = f'columns = {{ {q1} = "{names[0]}", ... }} for every joint'
            how = f"take them: {line}, in problem.toml (as check --repair of a folder does)"
            findings.append(Finding("warning", "readings", f"{first}: {figures}; {how}"))
        else:
            findings.append(Finding("note", "readings", f"{first}: {figures}, which are taken"))
        if by_them < least:
            least, units = by_them, zip(robot.reading_units.items(), names, strict=True)
            better = {ours: Source(name, unit / own_unit) for (ours, own_unit), name in units}
    return findings, better
