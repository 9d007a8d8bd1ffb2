"""What was found of a problem before a solve; as words and tables, and as plain data to keep."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from casadical.core.telling.blocks import Table, Words, next_step
from casadical.core.telling.plain import IN_MM, WRITTEN, Key, written
from casadical.core.telling.result import Result
from casadical.project.check.information import Outlook
from casadical.project.check.plausible import Finding, JointCoverage, Level
from casadical.project.check.slips import Slips
from casadical.project.check.targets import Targets, WrongNames
from casadical.robot.robot import Robot

# So many findings fit the screen.
FINDINGS = 6
LEVELS: tuple[Level, ...] = ("error", "warning", "note")
_MARKS = {"error": "ERROR", "warning": "WARNING", "note": "note"}


@dataclass(frozen=True, eq=False)
class Precheck(Result):
    """What was found of one problem.

    title, robot : names, empty where they could not be read; poses : in each set
    noise : of a coordinate [m] as far as it is known beforehand; noise_source : from where, in words
    joints : covered ranges in the set that is fitted; margin : smallest one of the four-bars
    outlooks : for each method; none where the data are unusable
    nominal : the robot; slips : what explains data that contradict it, where several slips were searched for
    targets : several on one flange, that the table does not name; wrong_names : rows that name another one
    tables : given in place of the folder's own; more : the step that plans more poses
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("problem", "folder.name"),
        Key("ok"),
        Key("next", "commands"),
        Key("poses", lambda check: dict(check.poses)),
        Key("methods", lambda check: {view.method: view for view in check.outlooks}),
    )

    folder: Path
    findings: tuple[Finding, ...] = field(metadata=WRITTEN)
    title: str = field(default="", metadata=WRITTEN)
    robot: str = field(default="", metadata=WRITTEN)
    poses: tuple[tuple[str, int], ...] = ()
    noise: float | None = field(default=None, metadata=IN_MM)
    noise_source: str = field(default="", metadata=WRITTEN)
    joints: tuple[JointCoverage, ...] = field(default=(), metadata=WRITTEN)
    margin: float | None = field(default=None, metadata=written("four_bar_margin"))
    outlooks: tuple[Outlook, ...] = ()
    nominal: Robot | None = None
    slips: Slips | None = None
    targets: Targets | None = None
    wrong_names: WrongNames | None = None
    tables: tuple[Path, ...] = ()
    more: Words | None = None

    def of_level(self, level: Level) -> tuple[Finding, ...]:
        return tuple(f for f in self.findings if f.level == level)

    @property
    def ok(self) -> bool:
        return not self.of_level("error")

    def blocks(self) -> list[Words | Table]:
        """What `casadical check --details` prints of one problem: verdict, findings, ranges, expected accuracy."""
        blocks: list[Words | Table] = [*self._head(), Words("")]
        blocks += _findings(f for level in LEVELS for f in self.of_level(level))
        if self.joints:
            blocks.append(self._ranges())
        for view in self.outlooks:
            blocks += [*([] if isinstance(blocks[-1], Table) else [Words("")]), *_outlook(view, self.noise_source)]
        return [*blocks, *self.next]

    def brief(self) -> list[Words | Table]:
        """The same in few lines: verdict, errors and warnings, accuracy to expect."""
        findings = [f for level in LEVELS[:2] for f in self.of_level(level)]
        findings += [f for f in self.of_level("note") if f.topic == "units"]
        blocks: list[Words | Table] = [*self._head(), *_findings(findings[:FINDINGS])]
        if len(findings) > FINDINGS:
            blocks.append(Words(f"and {len(findings) - FINDINGS} more"))
        for view in self.outlooks:
            blocks.append(Words(f"{view.method}: {len(view.names)} parameters identifiable, {len(view.held)} not."))
            if view.held_out is not None:
                blocks.append(Words(f"Expected mean error on other poses like these: {1e3 * view.held_out:.3g} mm."))
        if self.joints:
            blocks.append(Words("ranges of the joints, what is held and why: --details", "note"))
        return [*blocks, *self.next]

    @property
    def next(self) -> tuple[Words, ...]:
        """What to do now; only the errors are to be corrected, where they have no repair."""
        if self.ok:
            return (next_step("to calibrate", "calibrate", self.folder, *self.tables, "--out", "results"),)
        if all(f.topic == "too few poses" for f in self.of_level("error")):
            return (self.more,) if self.more else ()
        known = self.wrong_names or (self.targets and self.targets.which is not None)
        if not self.tables and (known or (self.slips and self.slips.explains)):
            return (next_step("to write the best repair and see what it changes", "check", self.folder, "--repair"),)
        return (next_step("when this is corrected", "check", self.folder, *self.tables),)

    def _head(self) -> Iterator[Words]:
        errors, warnings = len(self.of_level("error")), len(self.of_level("warning"))
        verdict = f"ready, {warnings} warning{'s' * (warnings > 1)}" if warnings else "ready"
        verdict = f"NOT READY, {errors} error{'s' * (errors > 1)}" if errors else verdict
        yield Words(f"{self.folder.resolve().name}: {verdict}", "verdict")
        if self.title:
            sets = ", ".join(f"{name} {n}" for name, n in self.poses)
            yield Words(f"{self.title}; {self.robot}; poses: {sets}")

    def _ranges(self) -> Table:
        rows = []
        for c in self.joints:
            limits, covered = f"{c.lower:.0f} .. {c.upper:.0f}", f"{100 * c.share:.0f} %"
            rows.append((str(c.joint), f"{c.low:.1f}", f"{c.high:.1f} {c.unit}", limits, covered))
        columns = ("joint", "from", "to", "limits", "covered")
        return Table("Readings of the poses that are fitted", columns, rows, frozenset(range(5)))


def _findings(findings: Iterable[Finding]) -> list[Words]:
    return [Words(f"{f.topic}: {f.text}", f.level, mark=_MARKS[f.level]) for f in findings]


def _outlook(view: Outlook, noise_source: str) -> list[Words | Table]:
    lines = [
        f"{view.method}: {len(view.names)} parameters identifiable from {view.numbers} numbers, {len(view.held)} not; "
        f"condition number {view.condition:.0f}."
    ]
    if view.enough and view.names:
        given = noise_source == "as given"
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
