"""The command `casadical diagnose`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from casadical.cli import options as o
from casadical.cli.progress import DIAGNOSIS, working
from casadical.cli.terminal import html, keep, with_json, wrapped
from casadical.core.errors import InputError, shown

if TYPE_CHECKING:
    from rich.console import Console

    from casadical.diagnosis.motion.result import LogDiagnosis
    from casadical.project.diagnosis import CampaignDiagnosis
    from casadical.robot.robot import Robot

Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Write diagnosed.robot.toml, the robot with its causes, for every command that takes a robot file; "
        "diagnosis.json and diagnosis.txt. With several campaigns, a folder for each.",
    ),
]
Unlisted = Annotated[
    bool,
    typer.Option("--unlisted", help="With --out: also have the description of an unknown cause in the robot's model."),
]
Together = Annotated[
    bool,
    typer.Option(
        "--together",
        help="The tables are of one robot as it stood, by one or several instruments, and are diagnosed as one; "
        "each has noise of its own.",
    ),
]
Laws = Annotated[
    bool | None,
    typer.Option(
        "--laws/--no-laws",
        help="Search for the law of what no listed effect explains: where it acts, what it follows, in which form; "
        "with --out also discovered.robot.toml, law.effect.toml (for --effects), discovery.json, discovery.txt. "
        "Default: where the verdict is unknown, and as a rival of all causes that were found; --no-laws: never.",
    ),
]
RivalLaws = Annotated[bool, typer.Option("--rival-laws", help="Laws compete at every ranking of causes.")]
OfMasses = Annotated[
    bool,
    typer.Option(
        "--nuisance-masses",
        help="Wrong declared masses of links are part of the base model, not a cause that may be named.",
    ),
]
Next = Annotated[
    Path | None,
    typer.Option("--next", metavar="FILE", help="Write poses that distinguish the leading causes, as CSV."),
]
NextN = Annotated[int, typer.Option(min=1, max=1000, help="How many of these poses.")]
Network = Annotated[
    bool,
    typer.Option("--network", help="Also train a 6-5-3 network, instead of the causes and after them (slow)."),
]
Line = Annotated[
    float | None,
    typer.Option(
        min=1,
        max=2000,
        metavar="CYCLES",
        help="Where the joints' error curves are named: look for lines up to so many cycles a turn, beyond the "
        "curves' harmonics, too (docs/diagnosis.md).",
    ),
]
Reference = Annotated[
    Path | None,
    typer.Option(
        "--reference",
        metavar="LOG",
        help="With joint logs: a log of the same arm in health on another day; what differs from it by more than a "
        "day's friction is a cause.",
    ),
]
DriveFile = Annotated[
    Path | None,
    typer.Option(
        "--drive",
        metavar="FILE.toml",
        help="With joint logs: what is known of the drives, a table [drive]; default: that of the robot file, or "
        "drive.toml beside it.",
    ),
]
Bootstrap = Annotated[
    int,
    typer.Option(
        min=0,
        max=1_000_000,
        metavar="N",
        help="Draws of noise alone that calibrate whether something is there: 2000.",
    ),
]


def diagnose(
    problem: o.Problem,
    campaigns: o.Campaigns = None,
    reference: Reference = None,
    drive: DriveFile = None,
    together: Together = False,
    effects: o.Effects = None,
    laws: Laws = None,
    rival_laws: RivalLaws = False,
    nuisance_masses: OfMasses = False,
    prior: o.Prior = None,
    prior_effects: o.PriorEffects = None,
    frozen: o.Frozen = False,
    measure_next: Next = None,
    next_n: NextN = 15,
    room: o.Room = None,
    network: Network = False,
    highest_line: Line = None,
    bootstrap: Bootstrap = 0,
    seed: o.Seed = 0,
    out: Out = None,
    unlisted: Unlisted = False,
    report_file: o.Report = None,
    json_file: o.Json = None,
    details: o.Details = False,
    quiet: o.Quiet = False,
) -> None:
    """Explain the error that is left: where it lies, which effect causes it, and how far it shrinks with the effect.

    Prints the verdict, the error before and after, and what must be known of them; with --details all that was found.
    Tables of a controller's own log (time_s, command1_rad, q1_rad, current1_A ...) are diagnosed as such: why the
    joints move otherwise than the model.

    Example: casadical diagnose arm CAMPAIGN.csv --details --report report.html

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    from casadical.project.diagnosis import Options, diagnose_campaign, read_campaigns

    tables = campaigns or _logs_of(problem)
    if _are_logs(tables, reference, drive):
        of_poses = {
            "--together": together, "--effects": effects, "--laws": laws, "--rival-laws": rival_laws, "--prior": prior,
            "--nuisance-masses": nuisance_masses, "--next": measure_next, "--room": room, "--network": network,
            "--highest-line": highest_line, "--bootstrap": bootstrap, "--unlisted": unlisted, "--report": report_file,
            "--details": details,
        }  # fmt: skip
        if unfit := [name for name, value in of_poses.items() if value]:
            raise InputError(f"{', '.join(unfit)}: of tables of measured poses; joint logs have --out and --json")
        _diagnose_logs(_with_drive(problem, drive), tables, reference, out, json_file, quiet)
        return
    if room and measure_next is None:
        raise InputError("--room says where the poses of --next may lie; give --next FILE, too")
    if unlisted and out is None:
        raise InputError("--unlisted says what --out writes; give --out DIR, too")
    console = wrapped(quiet)
    given = read_campaigns(problem, campaigns, o.carried(prior, prior_effects, frozen), together=together)
    if given[0].own_effects:
        console.print(f"Effects of the robot file are in the model, held at their values: {given[0].own_effects}.")
    workspace = given[0].workspace(room)
    options = Options(
        o.effects_of(effects), seed, bootstrap, "nuisance" if nuisance_masses else "candidate", rival_laws,
        laws,
    )  # fmt: skip
    file = measure_next if len(given) == 1 else None
    answers: list[CampaignDiagnosis] = []
    texts: dict[Path, str] = {}
    for campaign in given:
        with working(quiet, "diagnosing", campaign.name, DIAGNOSIS) as show:
            answer = diagnose_campaign(campaign, options, show).analysed(
                poses=next_n, workspace=workspace, networks=network, highest_line=highest_line,
                file=file.name if file else "", show=show,
            )  # fmt: skip
            if out:
                show("the robot with its causes")
                texts |= answer.files(out if len(given) == 1 else out / campaign.name, unlisted=unlisted)
        answers.append(answer)
        texts |= _printed(answer, details, file, console)
    if report_file:
        with working(quiet, "writing the report"):
            texts[report_file] = _report(answers)
    keep(with_json(texts, json_file, [answer.to_json() for answer in answers] if json_file else []), console)
    if not details:
        console.print("where it lies, how sure, what is left: --details, --out DIR or --report FILE.html", style="dim")


def _logs_of(problem: Path) -> list[Path]:
    """The joint logs that a problem folder gives to be fitted."""
    from casadical.project.problem_file import problem_file

    logs = problem_file(problem).logs if (problem / "problem.toml").is_file() else None
    return [problem / path for path in logs.identify] if logs else []


def _are_logs(tables: list[Path], reference: Path | None, drive: Path | None) -> bool:
    """Whether all tables are logs of joints in motion. Raises InputError where some are, or an option is for none."""
    from casadical.measurements.logs.reading import is_log

    logs = [is_log(path) for path in tables]
    if any(logs) and not all(logs):
        raise InputError("joint logs and tables of measured poses; diagnose them by a command each")
    for name, given in (("--reference", reference), ("--drive", drive)):
        if given and not any(logs):
            raise InputError(f"{name} goes with a joint log; the tables are none (see docs/joint-logs.md)")
    return any(logs)


def _with_drive(problem: Path, drive: Path | None) -> Robot:
    """The robot, with what is known of its drives. Raises InputError."""
    from casadical.core.drive import read_drive
    from casadical.project.problem import read_campaign_robot

    robot = read_campaign_robot(problem)
    beside = problem.parent / "drive.toml" if problem.is_file() else problem / "drive.toml"
    path = drive or (beside if robot.drive is None and beside.is_file() else None)
    return replace(robot, drive=read_drive(path, robot.n)) if path else robot


def _diagnose_logs(
    robot: Robot, logs: list[Path], reference: Path | None, out: Path | None, json_file: Path | None, quiet: bool
) -> None:
    from casadical.core.telling.terminal import terminal
    from casadical.diagnosis.motion.result import diagnose_log
    from casadical.measurements.logs.reading import read_log

    console = wrapped(quiet)
    healthy = read_log(reference, robot) if reference else None
    answers: list[LogDiagnosis] = []
    texts: dict[Path, str] = {}
    for path in logs:
        with working(quiet, "diagnosing", path.name) as show:
            answers.append(diagnose_log(robot, read_log(path, robot), healthy, show))
        console.print(terminal(answers[-1].blocks()))
        console.print()
        if out:
            texts |= answers[-1].files(out if len(logs) == 1 else out / path.name.partition(".")[0])
    keep(with_json(texts, json_file, [answer.to_json() for answer in answers] if json_file else []), console)


def _printed(found: CampaignDiagnosis, details: bool, file: Path | None, console: Console) -> dict[Path, str]:
    """Print a diagnosis; the file of its next poses, where there are any to measure."""
    from casadical.core.telling.terminal import terminal

    if details:
        console.print(found.titled_text(), soft_wrap=True)
    else:
        console.print(terminal(found.brief()))
    if found.law_blocks():
        console.print(terminal(found.law_blocks()))
    console.print()
    if file is None or found.details.poses is None:
        return {}
    if len(found.details.poses):
        return {file: found.details.poses.to_csv(index=False)}
    console.print(f"{shown(file)}: not written, for nothing is in question", markup=False)
    return {}


def _report(answers: list[CampaignDiagnosis]) -> str:
    """The page of all, each with what a simulator says of its poses."""
    from casadical.export.mjcf.replay import replay_blocks

    return html([found.page([*replay_blocks(found.diagnosis)]) for found in answers])
