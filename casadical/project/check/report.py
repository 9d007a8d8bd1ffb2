"""A precheck as text to read and as plain data to keep."""

from dataclasses import asdict
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from casadical.core.blocks import Table
from casadical.project.check.check import Precheck
from casadical.project.check.information import Outlook

# So many findings fit the screen.
FINDINGS = 6
_MARK = {"error": ("ERROR", "bold red"), "warning": ("WARNING", "yellow"), "note": ("note", "dim")}


def report(found: Precheck) -> RenderableType:
    """What `casadical check` prints of one problem: verdict, findings, ranges, expected accuracy."""
    head = Text(f"{found.folder.name}: {_verdict(found)}", style="bold")
    parts: list[RenderableType] = [head]
    if found.title:
        sets = ", ".join(f"{name} {n}" for name, n in found.poses)
        parts.append(Text(f"{found.title}; {found.robot}; poses: {sets}"))
    parts.append(Text())
    for level in ("error", "warning", "note"):
        for f in found.of(level):
            mark, style = _MARK[level]
            parts.append(Text.assemble((mark, style), f" {f.topic}: {f.text}"))
    if found.joints:
        parts += [Text(), _ranges(found)]
    for view in found.outlooks:
        parts += [Text(), *_outlook(view, found)]
    return Group(*parts)


def brief(found: Precheck) -> RenderableType:
    """The same in few lines: verdict, errors and warnings, accuracy to expect."""
    parts: list[RenderableType] = [Text(f"{found.folder.name}: {_verdict(found)}", style="bold")]
    if found.title:
        sets = ", ".join(f"{name} {n}" for name, n in found.poses)
        parts.append(Text(f"{found.title}; {found.robot}; poses: {sets}"))
    told = [f for level in ("error", "warning") for f in found.of(level)]
    told += [f for f in found.of("note") if f.topic == "units"]
    for f in told[:FINDINGS]:
        mark, style = _MARK[f.level]
        parts.append(Text.assemble((mark, style), f" {f.topic}: {f.text}"))
    if len(told) > FINDINGS:
        parts.append(Text(f"and {len(told) - FINDINGS} more"))
    for view in found.outlooks:
        parts.append(Text(f"{view.method}: {len(view.names)} parameters identifiable, {len(view.held)} not."))
        if view.held_out is not None:
            parts.append(Text(f"Expected mean error on other poses like these: {1e3 * view.held_out:.3g} mm."))
    if found.slips and found.slips.explains:
        parts.append(Text("casadical check --repair writes the best repair and shows what it changes", style="bold"))
    parts.append(Text("ranges of the joints, what is held and why: --details", style="dim"))
    return Group(*parts)


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


def _outlook(view: Outlook, found: Precheck) -> list[RenderableType]:
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
    parts: list[RenderableType] = [Text(line) for line in lines]
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
