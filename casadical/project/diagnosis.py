"""A campaign of a problem folder diagnosed: one result, what was asked of it, and its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from casadical.core.basics import InputError, Show, silent
from casadical.core.drive import read_drive
from casadical.core.telling.blocks import Block, Page, Section, Table, Words
from casadical.core.telling.figure import Figure
from casadical.core.telling.result import Result
from casadical.diagnosis.details import Details, analyse
from casadical.diagnosis.diagnose import Masses, diagnose
from casadical.diagnosis.figures import diagnosis_figures
from casadical.diagnosis.isolability import Isolability, isolability
from casadical.diagnosis.json_answer import as_json, diagnosis_files
from casadical.diagnosis.laws.answer import Discovery
from casadical.diagnosis.motion.replay import Replay, replayed
from casadical.diagnosis.motion.result import LogDiagnosis as LogDiagnosis
from casadical.diagnosis.motion.result import diagnose_log
from casadical.diagnosis.page import diagnosis_page
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.text import brief, detailed
from casadical.effects import Effect
from casadical.effects.definition import DefinedEffect
from casadical.effects.formula_effect import MOTION_SEAMS
from casadical.effects.motion import Cause
from casadical.effects.plugins import known_effects
from casadical.identification.prior import Prior
from casadical.measurements.logs.log import JointLog
from casadical.measurements.logs.reading import is_log, read_log
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import refuse_shared_rows
from casadical.pose_selection.workspace import Workspace, read_workspace
from casadical.project.problem import Carried, nothing_carried, read_campaign, read_campaign_robot, tool_as_measured
from casadical.project.problem_file import own_tables, problem_file
from casadical.project.telling import campaign_files
from casadical.robot.effect_tables import read_effects
from casadical.robot.robot import Robot

# What is asked for as causes: the name of a list, or names, labels, effects and classes of effects.
EffectChoice = Literal["standard", "extended"] | Sequence[str | Effect | type[Effect]]


def all_effects() -> tuple[str, ...]:
    return tuple(sorted(kind.name for kind in known_effects().values() if kind.on_list != "unknown"))


def effects_named(text: str | None) -> EffectChoice:
    """Effects by commas: names, labels, and effect files (`.toml`); without any "standard". Raises InputError."""
    named: list[str | Effect | type[Effect]] = []
    for word in text.split(",") if text else ():
        if not word.strip().endswith(".toml"):
            named.append(word)
            continue
        file = read_effects(word.strip())
        named += file.effects or file.kinds
    return named or "standard"


@dataclass(frozen=True, eq=False)
class Campaign:
    """What a diagnosis is of: a robot, and what was measured of it as it stood.

    robot : nominal, as a diagnosis takes it (`read_campaign_robot`), with the effects of the prior in its model
    sets : one for each table; tables : their files; folder : of the problem, or the robot file
    prior : what another campaign told; own_effects : of the robot file, in words, which are held at their values
    """

    robot: Robot
    sets: tuple[Measurements, ...]
    tables: tuple[Path, ...] = ()
    folder: Path = Path()
    prior: Prior | None = None
    own_effects: str = ""

    @property
    def name(self) -> str:
        """Of the results: that of the first table."""
        return self.tables[0].stem if self.tables else self.sets[0].source

    @property
    def title(self) -> str:
        """Of what is printed: all tables, and the robot."""
        return f"{', '.join(path.stem for path in self.tables) or self.name} ({self.robot.name})"

    def workspace(self, room: Path | None) -> Workspace | None:
        """Where poses may lie, of a file; None without one. Raises InputError."""
        return read_workspace(room, self.robot) if room else None


def read_campaigns(
    folder: Path,
    tables: Sequence[Path] | None = None,
    carried: Carried = nothing_carried,
    *,
    together: bool = False,
    readings_only: bool = False,
) -> tuple[Campaign, ...]:
    """The campaigns of a problem folder, or of tables beside a robot file; each table is one.

    tables : in place of the folder's own; carried : puts the prior of another campaign into the robot
    together : whether the tables are one campaign; readings_only : of poses that are planned, not measured
    Raises InputError.
    """
    paths = list(tables or own_tables(folder))
    nominal = read_campaign_robot(folder)
    robot, prior = carried(nominal)
    sets = {path: read_campaign(folder, path, robot, readings_only=readings_only) for path in paths}
    if together and not readings_only:
        refuse_shared_rows([sets[path] for path in paths])
    robot = tool_as_measured(robot, folder, sets.values())
    groups = [paths] if together else [[path] for path in sets]
    return tuple(
        Campaign(robot, tuple(sets[p] for p in group), tuple(group), folder, prior, nominal.effects_in_words)
        for group in groups
    )


@dataclass(frozen=True)
class Options:
    """How a campaign is diagnosed; each as in `casadical.diagnose`.

    laws : whether the missing law is searched for; by default where the verdict is unknown, and as a rival of all
        causes together; asked for, it is told in full
    """

    effects: EffectChoice = "standard"
    seed: int = 0
    bootstrap: int = 0
    masses: Masses = "candidate"
    laws: bool | None = None


@dataclass(frozen=True, eq=False)
class CampaignDiagnosis(Result):
    """A diagnosed campaign; details : what `analysed` adds."""

    campaign: Campaign
    options: Options
    diagnosis: Diagnosis
    details: Details = field(default_factory=Details)

    def analysed(self, **asked: Any) -> CampaignDiagnosis:
        """The same with its details; asked : as of `casadical.diagnosis.analyse`. Raises ConvergenceError."""
        return replace(self, details=analyse(self.diagnosis, laws=self.options.laws, **asked))

    def brief(self) -> Sequence[Words | Table]:
        """What counts, in a few lines: verdict, errors before and after, what must be known of them."""
        return brief(self.campaign.title, self.diagnosis, self._beside_laws)

    @property
    def _beside_laws(self) -> Details:
        """The details without the laws where these are told in full."""
        return replace(self.details, laws=None) if self.searched else self.details

    @property
    def searched(self) -> Discovery | None:
        """The search for the missing law, where it was asked for."""
        return self.details.laws if self.options.laws else None

    def blocks(self) -> list[Words | Table]:
        return [b for section in self.page().sections for b in section.blocks if not isinstance(b, Figure)]

    def detailed(self) -> Sequence[Words | Table]:
        """All that was found, without figures (see `casadical.diagnosis.page_of`)."""
        return [Words(self.campaign.title, "title"), *detailed(self.diagnosis, self._beside_laws)]

    def figures(self) -> dict[str, Figure]:
        """Every figure, by name (see `diagnosis_figures`)."""
        return {figure.name: figure for figure in diagnosis_figures(self.diagnosis, self.details)}

    def page(self, replayed: Sequence[Block] = ()) -> Page:
        """As `casadical diagnose --report` writes it; replayed : what a simulator says of the poses."""
        page = diagnosis_page(self.diagnosis, self.campaign.name, self.details, replayed)
        return replace(page, files=campaign_files(self.campaign.folder, self.campaign.tables))

    def to_json(self) -> dict[str, Any]:
        answer = as_json(self.diagnosis, self.campaign.name, self.details)
        return {**answer, "laws": self.searched.to_json(self.campaign.name)} if self.searched else answer

    def files(self, folder: str | Path, *, unlisted: bool = False) -> Mapping[Path, str]:
        """Robot file with the causes, figures and page; unlisted : with the description of an unknown cause, too."""
        name = self.campaign.name
        texts = diagnosis_files(folder, self.diagnosis, self.details, name, unlisted=unlisted)
        return {**texts, **self.searched.files(Path(folder), name)} if self.searched else texts


def diagnose_campaign(campaign: Campaign, options: Options | None = None, show: Show = silent) -> CampaignDiagnosis:
    """Diagnose a campaign, for all that ask: the command, a fleet, a replay, exports. Raises InputError."""
    asked = options or Options()
    diagnosis = diagnose(
        campaign.robot, campaign.sets, asked.effects, seed=asked.seed, bootstrap=asked.bootstrap, prior=campaign.prior,
        masses=asked.masses, laws=asked.laws is not False, show=show,
    )  # fmt: skip
    return CampaignDiagnosis(campaign, asked, diagnosis)


@dataclass(frozen=True, eq=False)
class LogCampaign:
    """Joint logs of one robot, of which each is diagnosed.

    robot : with what is known of its drives; logs : their files
    healthy : of the same robot in health on another day, if there is one
    withheld : files of logs that are not fitted, but replayed; own : causes beside those of the list
    """

    robot: Robot
    logs: tuple[Path, ...]
    healthy: JointLog | None = None
    withheld: tuple[Path, ...] = ()
    own: tuple[Cause, ...] = ()
    read: dict[Path, JointLog] = field(default_factory=dict)  # so far

    def log(self, path: Path) -> JointLog:
        """A log, read once. Raises InputError."""
        return self.read.get(path) or self.read.setdefault(path, read_log(path, self.robot))

    def diagnosed(self, log: Path, show: Show = silent) -> LogDiagnosis:
        """Why the arm moves otherwise than its model in one of the logs, as of `diagnose_log`. Raises InputError."""
        return diagnose_log(self.robot, self.log(log), self.healthy, show, own=self.own)

    def replayed(self, show: Show = silent) -> Replay | None:
        """Runs that were not fitted, from their commands alone; None where no commands were logged."""
        logs, withheld = ([self.log(path) for path in paths] for paths in (self.logs, self.withheld))
        if any(log.command is None for log in (*logs, *withheld)):
            return None
        return replayed(self.robot, logs, withheld, show)

    def page(self, answers: Sequence[LogDiagnosis], replay: Replay | None) -> Page:
        """As `casadical diagnose ARM LOG... --report` writes it."""
        sections = [Section("Replay", replay.blocks())] if replay else []
        sections += [Section(answer.log.source, answer.blocks()) for answer in answers]
        title = f"Joint logs of {self.robot.name}"
        return Page(
            "Diagnosis of joint logs", title, f"{len(answers)} logs", sections, files=(*self.logs, *self.withheld)
        )


def read_logs(
    folder: Path, tables: Sequence[Path] | None = None, reference: Path | None = None, drive: Path | None = None,
    effects: Sequence[str] = (),
) -> LogCampaign | None:  # fmt: skip
    """The joint logs of a problem folder, or those that are given; None where the tables are of measured poses.

    reference : a log of the same robot in health
    drive : a file with what is known of the drives; None: the robot file, or drive.toml beside it
    effects : effect files, whose causes are judged beside those of the list
    Raises InputError: logs and measured poses together, or what is wrong with robot, drives or reference.
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
    beside = folder.parent / "drive.toml" if folder.is_file() else folder / "drive.toml"
    if path := drive or (beside if robot.drive is None and beside.is_file() else None):
        robot = replace(robot, drive=read_drive(path, robot.n))
    healthy = read_log(reference, robot) if reference else None
    return LogCampaign(robot, tuple(tables or ()), healthy, tuple(withheld), own_causes(effects))


def own_causes(files: Sequence[str]) -> tuple[Cause, ...]:
    """Causes of joint logs that effect files define. Raises InputError: names, and effects of poses."""
    kinds: list[Cause] = []
    for word in files:
        if not word.strip().endswith(".toml"):
            raise InputError(f"--effects {word}: of joint logs every cause of the list is judged; own ones are files")
        file = read_effects(word.strip())
        own = [k for k in file.kinds if issubclass(k, DefinedEffect) and {*k.definition.formulas} <= {*MOTION_SEAMS}]
        other = [k.name for k in file.kinds if k not in own] + [e.name for e in file.effects]
        if other:
            raise InputError(f"{word}: {other[0]} is of poses; causes of joint logs act at {', '.join(MOTION_SEAMS)}")
        kinds += own
    return tuple(kinds)


def isolability_of(campaign: Campaign, effects: EffectChoice) -> Isolability:
    """What the poses of a campaign could show of each effect, before any data."""
    (m,) = campaign.sets
    return isolability(campaign.robot, m, effects)
