"""The command `casadical diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from casadical.cli.options import (
    Campaigns,
    Details,
    Effects,
    Frozen,
    Json,
    Prior,
    PriorEffects,
    Problem,
    Quiet,
    Report,
    carried,
    effects_of,
)
from casadical.cli.progress import DIAGNOSIS, working
from casadical.cli.terminal import as_text, as_typed, keep, keep_json, wrapped


def diagnose(
    problem: Problem,
    campaigns: Campaigns = None,
    json_file: Json = None,
    report_file: Report = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write diagnosed.robot.toml, the robot with its causes, for every command that takes a robot file; "
            "diagnosis.json and diagnosis.txt. With several campaigns, a folder for each.",
        ),
    ] = None,
    unlisted: Annotated[
        bool,
        typer.Option(
            "--unlisted", help="With --out: also have the description of an unknown cause in the robot's model."
        ),
    ] = False,
    effects: Effects = None,
    laws: Annotated[
        bool | None,
        typer.Option(
            "--laws/--no-laws",
            help="Laws (see discover) compete at every ranking, or never; default: with all causes that were found.",
        ),
    ] = None,
    prior: Prior = None,
    prior_effects: PriorEffects = None,
    frozen: Frozen = False,
    nuisance_masses: Annotated[
        bool,
        typer.Option(
            "--nuisance-masses",
            help="Wrong declared masses of links are part of the base model, not a cause that may be named.",
        ),
    ] = False,
    measure_next: Annotated[
        Path | None,
        typer.Option("--next", metavar="FILE", help="Write poses that distinguish the leading causes, as CSV."),
    ] = None,
    next_n: Annotated[int, typer.Option("--next-n", min=1, max=1000, help="How many of these poses.")] = 15,
    room: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Where these may lie: limits, floor, boxes, tracker; see docs/plan.md."),
    ] = None,
    network: Annotated[
        bool,
        typer.Option("--network", help="Also train a 6-5-3 network, instead of the causes and after them (slow)."),
    ] = False,
    highest_line: Annotated[
        float | None,
        typer.Option(
            min=1,
            max=2000,
            metavar="CYCLES",
            help="Where the joints' error curves are named: look for lines up to so many cycles a turn, beyond the "
            "curves' harmonics, too (docs/diagnosis.md).",
        ),
    ] = None,
    bootstrap: Annotated[
        int,
        typer.Option(
            min=0,
            max=1_000_000,
            metavar="N",
            help="Draws of noise alone that calibrate whether something is there: 2000.",
        ),
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of all chance.")] = 0,
    together: Annotated[
        bool,
        typer.Option(
            "--together",
            help="The tables are of one robot as it stood, by one or several instruments, and are diagnosed as one; "
            "each has noise of its own.",
        ),
    ] = False,
    isolability: Annotated[
        bool,
        typer.Option(
            "--isolability",
            help="Before any data: what these poses could show of each effect, and which look alike. Measured "
            "positions are not needed; nothing is diagnosed.",
        ),
    ] = False,
    details: Details = False,
    quiet: Quiet = False,
) -> None:
    """Explain the error that is left: where it lies, which effect causes it, and how far it shrinks with the effect.

    Prints the verdict, the error before and after, and what must be known of them; with --details all that was found.

    Example: casadical diagnose problems/hh800 CAMPAIGN.csv --details --report diagnosis.html

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.core.errors import InputError, shown
    from casadical.core.telling.terminal import terminal
    from casadical.diagnosis.posterior import Rivals, no_rivals
    from casadical.diagnosis.text import titled
    from casadical.pose_selection.workspace_file import read_workspace
    from casadical.project.diagnosis import Options, diagnose_campaign, read_campaigns

    if report_file:
        from casadical.core.telling.page import require

        require()
    if room and measure_next is None:
        raise InputError("--room says where the poses of --next may lie; give --next FILE, too")
    if unlisted and out is None:
        raise InputError("--unlisted says what --out writes; give --out DIR, too")
    rivals: Rivals = no_rivals
    if laws:
        from casadical.diagnosis.laws.rivals import law_rivals

        rivals = law_rivals
    console = wrapped(quiet)
    if isolability:
        _print_isolability(problem, campaigns, effects, json_file, console)
        return
    given = read_campaigns(problem, campaigns, carried(prior, prior_effects, frozen), together=together)
    robot = given[0].robot
    if given[0].own_effects:
        console.print(f"Effects of the robot file are in the model, held at their values: {given[0].own_effects}.")
    workspace = read_workspace(room, robot) if room else None
    options = Options(
        effects=effects_of(effects),
        seed=seed,
        bootstrap=bootstrap,
        masses="nuisance" if nuisance_masses else "candidate",
        rivals=rivals,
        laws=laws is not False,
    )
    file = measure_next if len(given) == 1 else None
    answers = []
    texts: dict[Path, str] = {}
    for campaign in given:
        with working(quiet, "diagnosing", campaign.name, DIAGNOSIS) as show:
            found = diagnose_campaign(campaign, options, show).analysed(
                poses=next_n,
                workspace=workspace,
                networks=network,
                highest_line=highest_line,
                file=file.name if file else "",
                show=show,
            )
            if out:
                show("the robot with its causes")
                texts |= found.files(out if len(given) == 1 else out / campaign.name, unlisted=unlisted)
        answers.append(found)
        if details:
            console.print(titled(campaign.title, found.text()), soft_wrap=True)
        else:
            console.print(terminal(found.brief()))
        console.print()
        if file and found.details.poses is not None:
            if len(found.details.poses):
                texts[file] = found.details.poses.to_csv(index=False)
            else:
                console.print(f"{shown(file)}: not written, for nothing is in question", markup=False)
    if json_file:
        texts[json_file] = as_text([found.to_json() for found in answers])
    if report_file:
        from casadical.core.telling.page import html_of
        from casadical.export.mjcf.replay_blocks import replay_blocks

        with working(quiet, "writing the report"):
            pages = [found.page([*replay_blocks(found.diagnosis)]) for found in answers]
            texts[report_file] = html_of(pages, as_typed())
    keep(texts, console)
    if not (details or isolability):
        console.print("where it lies, how sure, what is left: --details, --out DIR or --report FILE.html", style="dim")


def _print_isolability(
    problem: Path, tables: list[Path] | None, effects: str | None, json_file: Path | None, console: Console
) -> None:
    from casadical.diagnosis.isolability import isolability, isolability_json, isolability_page
    from casadical.diagnosis.text import titled
    from casadical.project.diagnosis import read_campaigns

    answers = []
    for campaign in read_campaigns(problem, tables, readings_only=True):
        (m,) = campaign.sets
        found = isolability(campaign.robot, m, effects_of(effects))
        answers.append(isolability_json(found, campaign.name))
        page = titled(f"{campaign.title}, {len(m)} poses", isolability_page(found))
        console.print(page, soft_wrap=True)
        console.print()
    keep_json(json_file, answers, console)
