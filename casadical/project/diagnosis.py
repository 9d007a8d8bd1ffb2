"""Diagnosis of the campaigns and joint logs of a problem folder: options, results and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casadical.core.basics import InputError, Show, silent
from casadical.core.drive import read_drive
from casadical.core.reporting.blocks import Block, Page, Section, Table, Words, next_step
from casadical.core.reporting.figure import Figure
from casadical.core.reporting.result import Result
from casadical.diagnosis.candidates import EffectChoice, EffectName, OwnCauses, own_causes
from casadical.diagnosis.details import Details, analyse
from casadical.diagnosis.diagnose import Masses, diagnose
from casadical.diagnosis.isolability import Isolability, isolability
from casadical.diagnosis.laws.answer import Discovery
from casadical.diagnosis.next_poses import discrimination_probability
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.statements import is_rare, resembles
from casadical.diagnosis.text import as_json, brief, detailed, diagnosis_files
from casadical.identification.pose_selection.workspace import Workspace, read_workspace
from casadical.identification.prior import Prior
from casadical.measurements.logs.findings import found_in
from casadical.measurements.logs.log import JointLog, joined
from casadical.measurements.logs.reading import is_log, read_log
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import refuse_shared_rows
from casadical.project.problem import Carried, nothing_carried, read_campaign, read_campaign_robot, tool_as_measured
from casadical.project.problem_file import own_tables, problem_file, tables_of
from casadical.robot.effect_tables import read_effects
from casadical.robot.robot import Robot

if TYPE_CHECKING:
    from casadical.diagnosis.motion.replay import Replay
    from casadical.diagnosis.motion.result import LogDiagnosis


def effects_named(text: str | None) -> EffectChoice:
    """Return the candidate causes that a text names; "standard" where there is no text.

    text : names, labels or effect files (`.toml`), separated by commas; an effect file stands for
        its effects, or else for those that it defines
    Raises InputError for a file that cannot be read.
    """
    named: list[EffectName] = []
    for word in text.split(",") if text else ():
        if not word.strip().endswith(".toml"):
            named.append(word)
            continue
        file = read_effects(word.strip())
        named += file.effects or file.kinds
    return named or "standard"


@dataclass(frozen=True, eq=False)
class Campaign:
    """A robot and the measurements of it that are diagnosed together.

    robot : nominal robot, as a diagnosis takes it (`read_campaign_robot`), with the effects of the
        prior in its model
    sets : measurements, one for each table
    tables : their files
    folder : of the problem, or the robot file
    prior : prior from another campaign, None without one
    own_effects : effects of the robot file, in words; they are fixed at their values
    workspace : where poses of the next campaign may lie; None: within the robot's limits
    """

    robot: Robot
    sets: tuple[Measurements, ...]
    tables: tuple[Path, ...] = ()
    folder: Path = Path()
    prior: Prior | None = None
    own_effects: str = ""
    workspace: Workspace | None = None

    @property
    def name(self) -> str:
        """Return the name of the results: that of the first table, without its ending."""
        return self.tables[0].stem if self.tables else self.sets[0].source

    @property
    def title(self) -> str:
        """Return the title of what is printed: all tables, and the robot."""
        return f"{', '.join(path.stem for path in self.tables) or self.name} ({self.robot.name})"


def read_campaigns(
    folder: Path,
    tables: Sequence[Path] | None = None,
    carried: Carried = nothing_carried,
    *,
    together: bool = False,
    readings_only: bool = False,
    room: Path | None = None,
) -> tuple[Campaign, ...]:
    """Read the campaigns of a problem folder or of given tables; each table is one campaign.

    folder : problem folder or robot file
    tables : tables in place of the folder's own
    carried : function that puts the prior of another campaign into the robot (see `carry_over`)
    together : whether all tables are one campaign
    readings_only : whether poses are planned, not measured
    room : file of a workspace
    Raises InputError for a table that cannot be used.
    """
    paths = list(tables or own_tables(folder))
    nominal = read_campaign_robot(folder)
    robot, prior = carried(nominal)
    sets = {path: read_campaign(folder, path, robot, readings_only=readings_only) for path in paths}
    if together and not readings_only:
        refuse_shared_rows([sets[path] for path in paths])
    robot = tool_as_measured(robot, folder, sets.values())
    groups = [paths] if together else [[path] for path in sets]
    workspace = read_workspace(room, robot) if room else None
    return tuple(
        Campaign(robot, tuple(sets[p] for p in group), tuple(group), folder, prior, nominal.effects_in_words, workspace)
        for group in groups
    )


@dataclass(frozen=True, eq=False)
class CampaignDiagnosis(Result):
    """A diagnosed campaign.

    campaign : what was diagnosed
    diagnosis : verdict, causes and gap
    laws : whether an expression for an unlisted effect is searched for; None: where the verdict is
        unknown, and as a rival of all causes together; True: reported in full, too
    details : further results, which `analysed` computes
    """

    campaign: Campaign
    diagnosis: Diagnosis
    laws: bool | None = None
    details: Details = field(default_factory=Details)

    def analysed(self, **asked: Any) -> CampaignDiagnosis:
        """Return the diagnosis with its `details` computed by `casadical.diagnosis.analyse`.

        asked : its arguments but `laws` and those of the campaign. Raises ConvergenceError.
        """
        asked |= {"laws": self.laws, "workspace": self.campaign.workspace}
        return replace(self, details=analyse(self.diagnosis, **asked))

    def brief(self) -> Sequence[Words | Table]:
        """Return the main results in a few lines: verdict, errors before and after, doubts."""
        return brief(self.campaign.title, self.diagnosis, self._details_without_laws)

    @property
    def _details_without_laws(self) -> Details:
        """Return the details, without the search for an expression where that is reported apart."""
        return replace(self.details, laws=None) if self.searched else self.details

    @property
    def searched(self) -> Discovery | None:
        """Return the search for an unlisted effect, if `laws` asked for it."""
        return self.details.laws if self.laws else None

    def blocks(self) -> list[Words | Table]:
        """Return the text blocks and tables of the page, without its figures."""
        return [b for section in self.page().sections for b in section.blocks if not isinstance(b, Figure)]

    def detailed(self) -> Sequence[Words | Table]:
        """Return all results as text and tables (see `casadical.diagnosis.page_of`)."""
        return [Words(self.campaign.title, "title"), *detailed(self.diagnosis, self._details_without_laws)]

    def next_command(self, typed: Sequence[str], robot: Path | None = None, planned: Path | None = None) -> Words:
        """Return the command to run next: what may tell more, else to keep what was found.

        typed : arguments of the command that made this diagnosis
        robot, planned : files of the robot and of poses to measure that were written, if any
        """
        d, poses, u = self.diagnosis, self.details.poses, self.details.unlisted
        unknown, out = d.verdict == "unknown", () if robot else ("--out", "diagnosed")
        if unknown and (found := self.details.laws) and found.laws and "--laws" not in typed:
            return next_step("to keep the law that was found", *typed, *out, "--laws")
        if unknown and is_rare(d, resembles(d)) and "--effects" not in typed:
            return next_step("to try rarer effects, too", *typed, "--effects", "extended")
        if d.verdict in ("unknown", "ambiguous") and poses is not None and len(poses):
            before, after = discrimination_probability(d, poses)
            if after - before >= SETTINGS.min_decision_gain and planned:
                every = (self.campaign.folder, *self.campaign.tables, planned, "--together")
                return next_step("when these poses were measured, too", "diagnose", *every)
            if after - before >= SETTINGS.min_decision_gain:
                return next_step("for poses that tell more", *typed, "--next", "next.csv")
        if unknown and u and u.shrink_interval[0] > 0 and "--unlisted" not in typed:
            return next_step("to keep what was found", *typed, *out, "--unlisted")
        if unknown and not d.account.anchored:
            return next_step("with ten of these poses measured again, in the same table", *typed)
        if robot and d.verdict == "none":
            given = ("c", robot, "--nominal", self.campaign.folder, "--out", "c")
            return next_step("to have the correction of joint commands", "export", *given)
        if robot:
            return next_step("when it was measured again", "compare", robot, "LATER.csv")
        if any(cause.effects for cause in d.causes):
            return next_step("to keep the robot with its causes", *typed, *out)
        if d.verdict == "none":
            own = (self.campaign.folder, *(t for t in self.campaign.tables if str(t) in typed))
            return next_step("to keep the calibrated robot", "calibrate", *own, "--out", "results")
        return next_step("to keep what was found", *typed, *out)

    def figures(self) -> dict[str, Figure]:
        """Return every figure by name (see `diagnosis_figures`)."""
        from casadical.diagnosis.page import diagnosis_figures

        return {figure.name: figure for figure in diagnosis_figures(self.diagnosis, self.details)}

    def page(self, replayed: Sequence[Block] = ()) -> Page:
        """Return the page that `casadical diagnose --report` writes.

        replayed : blocks on the replay of the poses in a simulator
        """
        from casadical.diagnosis.page import diagnosis_page
        from casadical.project.reporting import campaign_files

        page = diagnosis_page(self.diagnosis, self.campaign.name, self.details, replayed)
        return replace(page, files=campaign_files(self.campaign.folder, self.campaign.tables))

    @property
    def _tables(self) -> list[dict[str, Any]]:
        """Return how the folder's tables are read, by JSON keys (`DataTable.interpretation`)."""
        return [table.interpretation for table in tables_of(self.campaign.folder)]

    def to_json(self) -> dict[str, Any]:
        """Return the diagnosis for a JSON file.

        The key `laws` is there if expressions for an unlisted effect were searched for.
        """
        answer = {**as_json(self.diagnosis, self.campaign.name, self.details), "tables": self._tables}
        return {**answer, "laws": self.searched.to_json(self.campaign.name)} if self.searched else answer

    def files(self, folder: str | Path, *, unlisted: bool = False) -> Mapping[Path, str | bytes]:
        """Return path -> content: robot file with the causes, JSON, and files of `searched`.

        unlisted : whether the description of an unknown cause is one of them
        """
        name = self.campaign.name
        texts = diagnosis_files(folder, self.diagnosis, self.details, name, unlisted=unlisted, tables=self._tables)
        return {**texts, **self.searched.files(Path(folder), name)} if self.searched else texts


def diagnose_campaign(
    campaign: Campaign,
    effects: EffectChoice = "standard",
    *,
    seed: int = 0,
    bootstrap: int = 0,
    masses: Masses = "candidate",
    laws: bool | None = None,
    show: Show = silent,
) -> CampaignDiagnosis:
    """Return the diagnosis of a campaign, without `details`.

    effects, seed, bootstrap, masses : as of `casadical.diagnose`; laws : as of `CampaignDiagnosis`
    show : called with each line of progress
    Raises InputError.
    """
    diagnosis = diagnose(
        campaign.robot,
        campaign.sets,
        effects,
        seed=seed,
        bootstrap=bootstrap,
        prior=campaign.prior,
        masses=masses,
        laws=laws is not False,
        show=show,
    )
    return CampaignDiagnosis(campaign, diagnosis, laws)


@dataclass(frozen=True, eq=False)
class LogCampaign:
    """Joint logs of one robot, which are diagnosed together.

    robot : robot, with what is declared of its drives
    logs : files of the logs
    healthy : log of the same robot in health on another day, None without one
    withheld : files of logs that are not fitted, but replayed
    own : user-defined causes, in addition to those of the list
    read : cache of the logs that were read
    """

    robot: Robot
    logs: tuple[Path, ...]
    healthy: JointLog | None = None
    withheld: tuple[Path, ...] = ()
    own: OwnCauses = ()
    read: dict[Path, JointLog] = field(default_factory=dict)  # cache of `log`

    def log(self, path: Path) -> JointLog:
        """Return the log in a file, from the cache if it was read before. Raises InputError."""
        return self.read.get(path) or self.read.setdefault(path, read_log(path, self.robot))

    def diagnosed(self, show: Show = silent) -> LogDiagnosis:
        """Return the diagnosis of all `logs` together (`diagnose_log`). Raises InputError."""
        from casadical.diagnosis.motion.result import diagnose_log

        logs = joined([self.log(path) for path in self.logs])
        if len(self.logs) > 1:
            logs = replace(logs, findings=tuple(found_in(logs)))
        return diagnose_log(self.robot, logs, self.healthy, show, own=self.own)

    def replayed(self, show: Show = silent, against: Sequence[Path] = ()) -> Replay | None:
        """Return the replay of the withheld logs from their commands; None if any has no commands.

        Without withheld logs the runs of `logs` are held out in turn; a single run is replayed by
        its own fit.
        against : files of drive parameters that are replayed, too. Raises InputError.
        """
        logs, withheld = ([self.log(path) for path in paths] for paths in (self.logs, self.withheld))
        if any(log.command is None for log in (*logs, *withheld)):
            return None
        from casadical.diagnosis.motion.replay import replayed

        return replayed(self.robot, logs, withheld, show, against)

    def page(self, answer: LogDiagnosis | None, replay: Replay | None) -> Page:
        """Return the page that `casadical diagnose ARM LOG... --report` writes.

        answer : diagnosis of the logs; replay : of the withheld logs; None: no such section
        """
        sections = [Section("Replay", replay.blocks())] if replay else []
        sections += [Section("Causes", answer.blocks())] if answer else []
        title = f"Joint logs of {self.robot.name}"
        return Page(
            "Diagnosis of joint logs", title, f"{len(self.logs)} logs", sections, files=(*self.logs, *self.withheld)
        )


def read_logs(
    folder: Path,
    tables: Sequence[Path] | None = None,
    reference: Path | None = None,
    drive: Path | None = None,
    effects: Sequence[str] = (),
) -> LogCampaign | None:
    """Return the campaign of a folder's joint logs, or of given ones; None for tables of poses.

    folder : problem folder or robot file
    tables : files in place of the folder's own, which then withholds none
    reference : log of the same robot in health; it is read here, the others when they are used
    drive : file that declares the drives; None: the robot file, or drive.toml next to it
    effects : effect files, whose causes are candidates in addition to those of the list
    Raises InputError: logs and measured poses together, or what is wrong with robot, drives or
        reference.
    """
    withheld: list[Path] = []
    if not tables and (folder / "problem.toml").is_file() and (own := problem_file(folder).logs):
        tables, withheld = ([folder / path for path in paths] for paths in (own.identify, own.report))
    logs = [is_log(path) for path in tables or ()]
    if not any(logs):
        return None
    if not all(logs):
        raise InputError("joint logs and tables of measured poses; diagnose them by a command each")
    robot = read_campaign_robot(folder)
    drive_file = folder.parent / "drive.toml" if folder.is_file() else folder / "drive.toml"
    if path := drive or (drive_file if robot.drive is None and drive_file.is_file() else None):
        robot = replace(robot, drive=read_drive(path, robot.n))
    healthy = read_log(reference, robot) if reference else None
    return LogCampaign(robot, tuple(tables or ()), healthy, tuple(withheld), own_causes(effects))


def isolability_of(campaign: Campaign, effects: EffectChoice) -> Isolability:
    """Return which effects could be detected and isolated at a campaign's poses.

    campaign : of one table, of which the poses alone count; effects : candidate causes
    """
    (m,) = campaign.sets
    return isolability(campaign.robot, m, effects)
