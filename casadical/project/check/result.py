"""The result of a check before a solve, as sentences and tables, and as plain data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from casadical.core.reporting.blocks import Block, Table, Words, next_step
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key, written
from casadical.core.reporting.result import Result
from casadical.measurements.columns import Source
from casadical.project.check.findings import Finding, Level
from casadical.project.check.information import Outlook
from casadical.project.check.plausible import JointCoverage
from casadical.project.check.slips import Slips
from casadical.project.targets import Targets, WrongNames
from casadical.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Precheck(Result):
    """The result of a check of one problem.

    folder : problem folder or robot file
    findings : all findings
    title, robot : names, empty where they could not be read
    poses : (name, number of poses) of each set
    noise : noise of a coordinate [m], given, declared or by repeated readings; None if unknown
    noise_source : where it is from, in words
    joints : joint ranges that the fitted poses cover
    margin : smallest margin of the four-bars over the poses; None without four-bars
    outlooks : expected accuracy by each method, () where the data are unusable
    nominal : nominal robot
    slips : best slips where data contradict the robot, also if they do not explain the data (see
        `Slips.explains`); None where the robot fits or none were searched for
    targets : several targets on one flange that the table does not name; None if there are none
    wrong_names : rows that name another target than was measured; None if there are none
    tables : tables given in place of the folder's own
    more : command that plans more poses
    readings : columns of joint readings in a table that the robot fits better than the present
        ones, by our column, by the name of the table's file
    """

    report: ClassVar[str] = "check.j2"
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
    readings: Mapping[str, Mapping[str, Source]] = field(default_factory=dict)

    def of_level(self, level: Level) -> tuple[Finding, ...]:
        """Return the findings of a level."""
        return tuple(f for f in self.findings if f.level == level)

    @property
    def ok(self) -> bool:
        """Return whether there are no errors."""
        return not self.of_level("error")

    def words_of(self, findings: Sequence[Finding]) -> list[Words]:
        """Return findings as sentences with their level: errors, then warnings, then notes."""
        marks: dict[Level, str] = {"error": "ERROR", "warning": "WARNING", "note": "note"}
        ordered = [f for level in marks for f in findings if f.level == level]
        return [Words(f"{f.topic}: {f.text}", f.level, mark=marks[f.level]) for f in ordered]

    def brief(self) -> list[Block]:
        """Return the result in few lines: verdict, errors and warnings, accuracy to expect."""
        important = [f for f in self.findings if f.level != "note" or f.topic == "units"]
        important.sort(key=lambda f: ("error", "warning", "note").index(f.level))
        return self._report_blocks(brief=True, important=important)

    @property
    def next(self) -> tuple[Words, ...]:
        """Return the command to run next, by whether there are errors and a repair.

        Errors without a repair must be corrected by hand first.
        """
        if self.ok:
            return (next_step("to calibrate", "calibrate", self.folder, *self.tables, "--out", "results"),)
        if all(f.topic == "too few poses" for f in self.of_level("error")):
            return (self.more,) if self.more else ()
        repairable = self.wrong_names or (self.targets and self.targets.which is not None)
        if not self.tables and (repairable or (self.slips and self.slips.explains)):
            return (next_step("to write the best repair and see what it changes", "check", self.folder, "--repair"),)
        return (next_step("when this is corrected", "check", self.folder, *self.tables),)

    @property
    def ranges(self) -> list[Table]:
        """Return a table of each joint's range over the fitted poses, and its limits; or []."""
        rows = []
        for c in self.joints:
            limits, covered = f"{c.lower:.0f} .. {c.upper:.0f}", f"{100 * c.share:.0f} %"
            rows.append((str(c.joint), f"{c.low:.1f}", f"{c.high:.1f} {c.unit}", limits, covered))
        columns = ("joint", "from", "to", "limits", "covered")
        title = "Readings of the poses that are fitted"
        return [Table(title, columns, rows, frozenset(range(5)))] if rows else []
