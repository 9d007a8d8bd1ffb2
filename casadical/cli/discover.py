"""The command `casadical discover`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from casadical.cli.options import Effects, Json, Problem, Quiet, Report, effects_of
from casadical.cli.progress import DISCOVERY, working
from casadical.cli.terminal import as_text, as_typed, keep, wrapped


def discover(
    problem: Problem,
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN.csv", help="Measured positions.")],
    json_file: Json = None,
    report_file: Report = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write discovered.robot.toml, the robot with the law or the smooth forms, whichever predict better; "
            "law.effect.toml, the law alone, for diagnose --effects; discovery.json and discovery.txt.",
        ),
    ] = None,
    effects: Effects = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all chance.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Search for the law of what no listed effect explains: where it acts, what it follows, in which form.

    Laws compete with listed effects and smooth forms, and pay for the search; see docs/diagnosis.md.

    Example: casadical discover problems/hh800 CAMPAIGN.csv --out law

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    from casadical.core.telling.terminal import terminal
    from casadical.diagnosis.laws.discovery import laws_beside
    from casadical.project.diagnosis import Options, diagnose_campaign, read_campaigns

    if report_file:
        from casadical.core.telling.page import require

        require()
    console = wrapped(quiet)
    (given,) = read_campaigns(problem, [campaign])
    texts: dict[Path, str] = {}
    with working(quiet, "diagnosing", campaign.stem, DISCOVERY) as show:
        diagnosed = diagnose_campaign(given, Options(effects_of(effects), seed), show)
        found = laws_beside(diagnosed.diagnosis, show)
        if out:
            show("the robot with its law")
            texts |= found.files(out, campaign.stem)
    console.print(terminal(found.blocks()))
    if json_file:
        texts[json_file] = as_text([found.to_json(campaign.stem)])
    if report_file:
        from casadical.core.telling.page import html_of
        from casadical.project.sources import campaign_files

        with working(quiet, "writing the report"):
            texts[report_file] = html_of([found.page(campaign.stem, campaign_files(problem, [campaign]))], as_typed())
    keep(texts, console)
