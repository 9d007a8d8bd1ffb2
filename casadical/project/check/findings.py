"""The findings of a check, in sentences, each with a level and a topic."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from casadical.core.basics import FaultsError, InputError, shown
from casadical.core.parts import GRAVITY_COLUMNS
from casadical.identification.identifiability import CONFOUNDED_CONDITION_NUMBER
from casadical.identification.identification import lacks_declared_compliance
from casadical.identification.plausibility import check_against
from casadical.measurements.columns import FULL_TURN_RAD
from casadical.measurements.derived_columns import clock_faults
from casadical.measurements.measurements import Measurements
from casadical.project.check.information import Outlook
from casadical.project.check.plausible import coverage, far_off, margin, repeats
from casadical.project.check.slip_list import LENGTHS_MIRROR_WARNING, MIRROR_WARNING, error_in_mm, in_words
from casadical.project.check.slips import Slips
from casadical.project.problem import Problem
from casadical.project.recognition import computed
from casadical.project.robot_columns import some_rows
from casadical.project.targets import Targets, WrongNames
from casadical.robot.kinematics import MIN_LOOP_MARGIN
from casadical.robot.robot import Robot

# Severity of a finding.
Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One finding.

    level : error (a calibration would be useless), warning (to be examined) or note
    topic : one word or two, such as "units"
    text : sentence
    """

    level: Level
    topic: str
    text: str


def fault_findings(error: InputError, topic: str) -> list[Finding]:
    """Return each fault of an error as a finding of level error."""
    faults = [*error.faults, *error.others] if isinstance(error, FaultsError) else [error]
    return [Finding("error", topic, str(fault)) for fault in faults]


def target_findings(targets: Targets | None, wrong: WrongNames | None, source: str) -> list[Finding]:
    """Return findings on a table that measures several targets without naming them, or wrongly.

    targets : what repeated readings show, if they disagree
    wrong : rows whose position fits another target of the robot file than the named one
    source : name of the table, for the text
    """
    if wrong:
        return [Finding("error", "targets", wrong.in_words(source))]
    if not targets:
        return []
    text = targets.in_words(source)
    if not targets.turning:
        return [Finding("warning", "targets", text)]
    if targets.which is None:
        more = "which row is which is not known before the nominal model fits the middle of the targets"
    else:
        more = "they belong into `tools` of problem.toml and [[tool]], where check --repair of a folder writes them"
    return [Finding("error", "targets", f"{text}; {more}")]


def slip_finding(slips: Slips, robot: Robot, standard: bool, m: Measurements) -> Finding:
    """Return the finding on data that contradict the nominal robot, with the slips that explain it.

    m : the table, for its name and kind
    standard : whether the rows of the robot file are of the standard DH convention
    """
    before, best = slips.before, slips.best
    source, of_positions = m.source, m.position is not None
    text = f"{source}: with base and tool fitted the rigid nominal model is {1e3 * before.error:.4g} mm (median) from "
    text += f"the data, {100 * before.error / robot.reach:.2g} % of its reach"
    if not slips.explains:
        text += "; no slip of unit, sign or zero explains it: check the units of its columns, then the robot file"
        return Finding("error", "units", text)
    text += f"; {error_in_mm(best, robot)} would be left if {'; '.join(in_words(best, robot, standard))}"
    for rival in slips.rivals:
        text += f". Rival, {error_in_mm(rival, robot)}: {'; '.join(in_words(rival, robot, standard))}"
    mirrored = f". But {MIRROR_WARNING}" if best.mirrored else "" if of_positions else f". {LENGTHS_MIRROR_WARNING}"
    return Finding("error", "units", f"{text}{mirrored}")


def data_findings(robot: Robot, m: Measurements, table: Measurements, *, repeated_readings: bool) -> list[Finding]:
    """Return the findings on one table that is fitted.

    m : the fitted poses
    table : poses whose clock is checked: the only table with its held-out poses, or else m
    repeated_readings : whether an earlier table had the same readings, so that findings on them are
        omitted
    """
    findings = [] if repeated_readings else _coverage_findings(robot, m)
    smallest = None if repeated_readings else margin(robot, m)
    if smallest is not None and MIN_LOOP_MARGIN <= smallest < 5 * MIN_LOOP_MARGIN:
        text = f"nearly folded in some pose (margin {smallest:.3f}; 1 is square, {MIN_LOOP_MARGIN} refused)"
        text = f"{m.source}: the four-bar is {text}; small errors of the bars count much there"
        findings.append(Finding("warning", "four-bar", text))
    if computed(robot, m):
        text = f"{m.source}: the positions are the nominal robot's own to the last digit: computed, not measured?"
        findings.append(Finding("warning", "data", text))
    findings += _unknown_columns(robot, [*m.conditions], m.source)
    findings += [Finding("warning", "clock", text) for text in clock_faults(table)]
    distinct, _ = repeats(m)
    if distinct < len(m):
        text = f"{m.source}: {len(m)} measurements at {distinct} distinct readings"
        few = 3 * distinct < len(m)
        more = "; repeats show the noise, only new readings determine parameters" if few else ""
        findings.append(Finding("warning" if few else "note", "repeats", text + more))
    return findings


def far_rows(robot: Robot, m: Measurements) -> list[Finding]:
    """Return a finding on rows with more than five times the median error, or [].

    It is an error where some are off by more than half the robot's reach, else a warning.
    """
    far, e = far_off(robot, m)
    if not far.any():
        return []
    gross = m.row[far & (e > 0.5 * robot.reach)]
    order = [k for k in np.argsort(-e) if far[k]]
    rows = some_rows([f"{m.row[k]} ({1e3 * e[k]:.3g} mm)" for k in order])
    text = (
        f"{m.source}: spreadsheet rows {rows} are far off, where the median is {1e3 * float(np.median(e)):.3g} "
        "mm; calibrate leaves out those that its fit does not explain, and names them and those "
        "that are held out; the accuracy to expect is without them"
    )
    if len(gross):
        text += f". Rows {', '.join(map(str, gross))} lie further off than half the reach: correct them, or leave them "
        text += f"out (leave_out = {gross.tolist()} in problem.toml, under [[measurements]])"
    return [Finding("error" if len(gross) else "warning", "rows", text)]


def _coverage_findings(robot: Robot, m: Measurements) -> list[Finding]:
    """Return findings on joints that do not move, or cover less than a quarter of their range."""
    findings = []
    for c, moved in zip(coverage(robot, m), np.ptp(m.q, axis=0), strict=True):
        if moved < np.deg2rad(1.0):
            text = f"joint {c.joint} does not move: its parameters cannot be distinguished from those of its neighbours"
            findings.append(Finding("warning", "coverage", f"{m.source}: {text}"))
        elif c.share < 0.25:
            text = f"joint {c.joint} covers {c.low:.0f} .. {c.high:.0f} {c.unit}, {100 * c.share:.0f} % of its range"
            doubt = "; are these radians?" if c.unit == "deg" and max(-c.low, c.high) <= FULL_TURN_RAD else ""
            findings.append(
                Finding("warning", "coverage", f"{m.source}: {text}; expect little beyond these readings{doubt}")
            )
    return findings


def _unknown_columns(robot: Robot, conditions: Sequence[str], source: str) -> list[Finding]:
    """Return findings on misspelt columns, and on columns that this robot does not use."""
    findings = []
    if robot.gravity_frame != "logged" and {*GRAVITY_COLUMNS} <= {*conditions}:
        text = f"{source}: its columns say how the base tilts, and the robot file takes it as still"
        text += ': write frame = "logged" in [gravity] ([urdf.gravity] of a URDF), or leave them out'
        findings.append(Finding("warning", "columns", text))
    beyond = [c for c in conditions if (match := re.fullmatch(r"approach(\d+)", c)) and int(match[1]) > robot.n]
    if beyond:
        text = f"{source}: column {beyond[0]!r} has no effect: this robot has {robot.n} joints"
        findings.append(Finding("warning", "columns", text))
    # Columns that the model or an effect may need, besides readings and observations.
    understood_columns = (
        *("payload_kg", "temperature_degC", "time_s", "warmth_K", "weight"),
        *("set", "point", "pose", "other_pose"),
    )
    for name in conditions:
        near = [candidate for candidate in understood_columns if candidate.startswith(f"{name}_")]
        # At 0.84 a height is not taken for a weight (0.83), but temperature_C for temperature_degC.
        near = near or difflib.get_close_matches(name.casefold(), understood_columns, 1, 0.84)
        if name not in understood_columns and near and not name.startswith(("warmth_", "approach")):
            text = f"{source}: column {name!r} is no name that anything asks for; is {near[0]!r} meant?"
            findings.append(Finding("warning", "columns", text))
    return findings


def limits_findings(robot: Robot) -> list[Finding]:
    """Return one note on all joints whose limits are the defaults of a robot file, or [].

    The defaults are 360 deg to either side, 10 m for a prismatic joint.
    """
    assumed = {"revolute": (-2 * np.pi, 2 * np.pi), "prismatic": (-10.0, 10.0)}
    wide = [str(i) for i, j in enumerate(robot.joints, 1) if (j.lower, j.upper) == assumed[j.kind]]
    if not wide:
        return []
    text = f"joint{'s' if len(wide) > 1 else ''} {', '.join(wide)}: -360 .. 360 deg (-10 .. 10 m of a prismatic one)"
    more = "is what is taken where the robot file gives no limits; shares and forecasts below, and plan, go by it"
    return [Finding("note", "limits", f"{text} {more}")]


def set_findings(problem: Problem) -> list[Finding]:
    """Return findings on targets, masses, signs, held-out poses, copied rows, unused columns."""
    findings = [Finding("error", "targets", text) for text in problem.unfitted]
    findings += [Finding("warning", "masses", n) for n in problem.robot.notes if n.startswith("masses left out: ")]
    for table in problem.tables:
        made = {ours[0]: made for ours, made in table.get("columns", {}).items() if ours[0] in "xyz"}
        turned = [c for c, source in made.items() if isinstance(source, Mapping) and source.get("times", 1.0) < 0]
        if len(turned) % 2:
            text = f"problem.toml turns the sign of {', '.join(turned)}: {MIRROR_WARNING}"
            findings.append(Finding("warning", "units", text))
    if lost := problem.unmeasured_targets:
        text = f"the robot file has {', '.join(lost)}, which no row names: it stays where the file says"
        findings.append(Finding("warning", "targets", text))
    for name, m in problem.parts():
        if not name.startswith("identify"):
            try:
                check_against(problem.robot, m)
            except InputError as error:
                findings += [replace(f, text=f"set {name}: {f.text}") for f in fault_findings(error, "data")]
    for m in problem.sets["identify"]:
        unused = [column for column in m.unused if column != problem.set_column]
        if unused:
            text = f"{m.source}: columns of words or without a cell are left out: {', '.join(map(shown, unused))}"
            findings.append(Finding("note", "columns", text))
        if m.copies:
            findings.append(Finding("warning", "data", m.copies_in_words))
    return findings


def outlook_findings(view: Outlook, robot: Robot, noise: float | None) -> list[Finding]:
    """Return findings on what one method is expected to determine: data, confounding, misfit.

    view : the expectation
    noise : noise of a coordinate [m] to compare with, None where it is unknown
    """
    p = view.unknowns
    if not view.enough:
        text = f"{view.method}: {view.numbers} numbers were measured for {p} unknowns; measure more poses"
        return [Finding("error", "too few poses", text)]
    if not view.names:
        text = f"{view.method}: with noise of {1e3 * view.noise:.3g} mm per coordinate no parameter is determined; "
        return [Finding("error", "identifiability", f"{text}measure more accurately, or more poses spread wider")]
    findings = []
    if view.numbers < 3 * p:
        text = f"{view.method}: {view.numbers} numbers for {p} unknowns; 3 for each show how good it is"
        findings.append(Finding("warning", "too few poses", text))
    if view.condition > CONFOUNDED_CONDITION_NUMBER:
        text = f"{view.method}: condition number {view.condition:.0f}: some parameters are nearly confounded"
        findings.append(Finding("warning", "identifiability", f"{text}; spread the poses wider (casadical plan)"))
    # A scatter of more than this many times the noise shows that the model is incomplete.
    if noise and view.scatter > 4 * noise:
        text = f"{view.method}: a linear step leaves {1e3 * view.scatter:.3g} mm per coordinate, the noise is "
        text += f"{1e3 * noise:.3g}: the model lacks something, or base and tool are far off"
        findings.append(Finding("warning", "misfit", text))
    if (
        view.method == "SKCM"
        and not lacks_declared_compliance(robot)
        and not {f"c{i}" for i in robot.numbers} & {*view.names}
    ):
        text = "SKCM: no compliance is identifiable (no compliant joint, no masses, or constant gravity torques)"
        findings.append(Finding("warning", "identifiability", text))
    return findings
