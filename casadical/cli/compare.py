"""The command `casadical compare`."""

import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from casadical.cli.options import Json, Quiet, Report
from casadical.cli.terminal import NOT_VALID, html, keep, suggest, with_json, working, wrapped
from casadical.core.telling.result import terminal


def compare(
    campaigns: Annotated[list[Path], Argument(metavar="OLD NEW...")],
    robot: Annotated[Path | None, Option(metavar="PROBLEM_DIR")] = None,
    same_tool: Annotated[bool, Option("--same-tool")] = False,
    same_frame: Annotated[bool, Option("--same-frame")] = False,
    json_file: Json = None,
    report_file: Report = None,
    quiet: Quiet = False,
) -> None:
    """Say what changed in a robot since an earlier campaign: which parameter or effect, since when, by how much.

    Base and tool are fitted again in each campaign, because the instrument stands elsewhere. Of many campaigns it says
    whether a change is a jump or a drift, and since when. Dates are read from names (2026-03-14).

    Example: casadical compare results-2025/SKCM.robot.toml results-2026/SKCM.robot.toml

    Exit codes: 0 nothing changed, 2 bad input, 3 no optimum found, 5 something changed, or a campaign leaves what
    nothing explains, 70 a bug in casadical.

    campaigns : Two campaigns of one robot or more: robot files as `casadical calibrate --out` writes them, folders of
        results, problem folders, or tables of measurements (with --robot). Or one problem folder whose later tables lie
        in its folder campaigns.
    robot : Problem folder or robot file by which tables are understood; default: the first campaign that is no table.
    same_tool : The same point of the same tool was measured: one that moved is a change.
    same_frame : All positions are in one frame: a base that moved is a change of the foot.
    """
    from casadical.fleet.campaigns import compare_files

    console = wrapped(quiet)
    with working(quiet, "reading") as show:
        comparison = compare_files(campaigns, robot, same_tool=same_tool, same_frame=same_frame, show=show)
    console.print(terminal(comparison.blocks()))
    texts: dict[Path, str] = {}
    if report_file:
        texts[report_file] = html([comparison.page(campaigns)])
    keep(with_json(texts, json_file, comparison.to_json()), console)
    if not comparison.next:
        suggest(console, "when it was measured again", *sys.argv[1:], "LATER.csv")
    if comparison.changed or comparison.unexplained:
        raise Exit(NOT_VALID)
