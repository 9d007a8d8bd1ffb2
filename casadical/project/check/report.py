"""A precheck as words and tables, and as plain data to keep."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any

from casadical.core.telling.blocks import Table, Words
from casadical.project.check.check import Precheck
from casadical.project.check.findings import Finding, Level
from casadical.project.check.information import Outlook

# So many findings fit the screen.
FINDINGS = 6
LEVELS: tuple[Level, ...] = ("error", "warning", "note")
_MARKS = {"error": "ERROR", "warning": "WARNING", "note": "note"}


def blocks(checked: Precheck) -> list[Words | Table]:
    """What `casadical check --details` prints of one problem: verdict, findings, ranges, expected accuracy."""
    told: list[Words | Table] = [*_head(checked), Words("")]
    told += _findings(f for level in LEVELS for f in checked.of(level))
    if checked.joints:
        told.append(_ranges(checked))
    for view in checked.outlooks:
        told += [*([] if isinstance(told[-1], Table) else [Words("")]), *_outlook(view, checked)]
    return told


def brief(checked: Precheck) -> list[Words | Table]:
    """The same in few lines: verdict, errors and warnings, accuracy to expect."""
    findings = [f for level in LEVELS[:2] for f in checked.of(level)]
    findings += [f for f in checked.of("note") if f.topic == "units"]
    told: list[Words | Table] = [*_head(checked), *_findings(findings[:FINDINGS])]
    if len(findings) > FINDINGS:
        told.append(Words(f"and {len(findings) - FINDINGS} more"))
    for view in checked.outlooks:
        told.append(Words(f"{view.method}: {len(view.names)} parameters identifiable, {len(view.held)} not."))
        if view.held_out is not None:
            told.append(Words(f"Expected mean error on other poses like these: {1e3 * view.held_out:.3g} mm."))
    if checked.slips and checked.slips.explains:
        told.append(Words("casadical check --repair writes the best repair and shows what it changes", "verdict"))
    return [*told, Words("ranges of the joints, what is held and why: --details", "note")]


def _head(checked: Precheck) -> Iterator[Words]:
    yield Words(f"{checked.folder.name}: {_verdict(checked)}", "verdict")
    if checked.title:
        sets = ", ".join(f"{name} {n}" for name, n in checked.poses)
        yield Words(f"{checked.title}; {checked.robot}; poses: {sets}")


def _findings(findings: Iterable[Finding]) -> list[Words]:
    return [Words(f"{f.topic}: {f.text}", f.level, mark=_MARKS[f.level]) for f in findings]


def _verdict(found: Precheck) -> str:
    errors, warnings = len(found.of("error")), len(found.of("warning"))
    if errors:
        return f"NOT READY, {errors} error{'s' if errors > 1 else ''}"
    return f"ready, {warnings} warning{'s' if warnings > 1 else ''}" if warnings else "ready"


def _ranges(found: Precheck) -> Table:
    rows = [
        (
            str(c.joint),
            f"{c.low:.1f}",
            f"{c.high:.1f} {c.unit}",
            f"{c.lower:.0f} .. {c.upper:.0f}",
            f"{100 * c.share:.0f} %",
        )
        for c in found.joints
    ]
    columns = ("joint", "from", "to", "limits", "covered")
    return Table("Readings of the poses that are fitted", columns, rows, frozenset(range(5)))


def _outlook(view: Outlook, found: Precheck) -> list[Words | Table]:
    lines = [
        f"{view.method}: {len(view.names)} parameters identifiable from {view.numbers} numbers, {len(view.held)} not; "
        f"condition number {view.condition:.0f}, observability O1 {view.O1:.3g}."
    ]
    if view.enough and view.names:
        given = found.noise_source == "as given"
        cause = f"noise of {1e3 * view.noise:.3g} mm a coordinate" if given else "the scatter in the data"
        lines.append(
            f"Expected accuracy: {1e3 * view.accuracy:.3g} mm rms over the joints' ranges for the parameters alone, of "
            f"{cause}. A linear step leaves {1e3 * view.scatter:.3g} mm."
        )
        if view.held_out is not None:
            lines.append(f"Expected mean error on other poses like these: {1e3 * view.held_out:.3g} mm.")
    parts: list[Words | Table] = [Words(line) for line in lines]
    if view.held:
        parts.append(Table("", ("held", "why"), [(u.name, u.reason) for u in view.held]))
    return parts


def as_json(found: Precheck) -> dict[str, Any]:
    """The same as plain data."""
    return {
        "problem": found.folder.name,
        "ok": found.ok,
        "title": found.title,
        "robot": found.robot,
        "poses": dict(found.poses),
        "findings": [asdict(f) for f in found.findings],
        "joints": [asdict(c) for c in found.joints],
        "four_bar_margin": found.margin,
        "noise_mm": None if found.noise is None else 1e3 * found.noise,
        "noise_source": found.noise_source,
        "methods": {
            view.method: {
                "identifiable": list(view.names),
                "held": {u.name: u.reason for u in view.held},
                "numbers": view.numbers,
                "condition": view.condition,
                "O1": view.O1,
                "scatter_mm": 1e3 * view.scatter if view.enough else None,
                "expected_held_out_mean_mm": None if view.held_out is None else 1e3 * view.held_out,
                "expected_accuracy_mm": 1e3 * view.accuracy if view.enough and view.names else None,
                "std_error": dict(zip(view.names, view.errors.tolist(), strict=True)),
            }
            for view in found.outlooks
        },
    }
