"""The commands `casadical compare` and `casadical fleet`: changes of one robot, and many robots."""

import sys
from pathlib import Path

from typer import Argument, Exit, Option, echo

from casadical.cli.options import Details, Json, Quiet, Report
from casadical.cli.terminal import EXIT_NOT_VALID, html, print_result, save, suggest, tell, with_json, working, wrapped
from casadical.core.basics import shown


def compare(
    campaigns: list[Path] = Argument(
        ...,
        metavar="OLD NEW...",
        help="Two campaigns of one robot or more: robot files as `casadical calibrate --out` "
        "writes them, folders of results, problem folders, or tables of measurements (with "
        "--robot). Or one problem folder whose later tables lie in its folder campaigns.",
    ),
    robot: Path | None = Option(
        None,
        metavar="PROBLEM_DIR",
        help="Problem folder or robot file by which tables are understood; default: the first "
        "campaign that is no table.",
    ),
    same_tool: bool = Option(
        False,
        "--same-tool",
        help="The same point of one tool was measured: its motion is a change.",
    ),
    same_frame: bool = Option(
        False, "--same-frame", help="All positions are in one frame: a moved base is a moved foot."
    ),
    details: Details = False,
    json_file: Json = None,
    report_file: Report = None,
    quiet: Quiet = False,
) -> None:
    """Say what changed in a robot since an earlier campaign: which parameter or effect, since when, by how much.

    Base and tool are fitted again in each campaign, because the instrument stands elsewhere. Of
    many campaigns it says whether a change is a jump or a drift, and since when. Dates are read
    from names (2026-03-14).

    Example: casadical compare results-2025/SKCM.robot.toml results-2026/SKCM.robot.toml

    Exit codes: 0 nothing changed, 2 bad input, 3 no optimum found, 5 something changed, or a
    campaign leaves what nothing explains, 70 a bug in casadical.
    """
    from casadical.fleet.campaigns import compare_files

    console = wrapped(quiet)
    with working(quiet, "reading") as show:
        comparison = compare_files(campaigns, robot, same_tool=same_tool, same_frame=same_frame, show=show)
    print_result(console, comparison.blocks(), details)
    texts: dict[Path, str] = {}
    if report_file:
        texts[report_file] = html([comparison.page(campaigns)])
    save(with_json(texts, json_file, comparison.to_json()), console)
    if not comparison.next:
        suggest(console, "when it was measured again", *sys.argv[1:], "LATER.csv")
    if comparison.changed or comparison.unexplained:
        raise Exit(EXIT_NOT_VALID)


def fleet(
    folders: list[Path] = Argument(
        ..., metavar="FOLDER...", help="Problem folders, one a robot, or folders that hold them."
    ),
    store: Path = Option(..., metavar="STORE.parquet", help="One Parquet file a robot; continued."),
    scheduler: str | None = Option(
        None, metavar="ADDRESS", help="Dask scheduler, as tcp://host:8786; default: own cores."
    ),
    workers: int | None = Option(
        None, min=1, max=1024, metavar="N", help="Processes of this machine; default: one a core."
    ),
    diagnose: bool = Option(True, "--diagnose/--no-diagnose", help="Diagnose every robot, which takes longest."),
    priors: Path | None = Option(
        None,
        metavar="DIR",
        help="Write what robots of one type have in common, TYPE.robot.toml, for calibrate "
        "--prior FILE --prior-effects all.",
    ),
    json_file: Json = None,
    report_file: Report = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate, diagnose and compare every robot of a fleet, on all cores or on a Dask cluster.

    A robot is a problem folder; its later campaigns are tables in its folder `campaigns`, with
    their days in their names. What the store has already is not computed again, and one robot that
    fails stops nobody. Robots of one type share what was learnt from them: common faults of the
    drawing, and a prior with which a new robot needs fewer poses.

    Example: casadical fleet plants/* --store fleet.parquet --report fleet.html

    Exit codes: 0 done, also where single robots failed, 2 bad input or no scheduler, 70 a bug in
    casadical.
    """
    from casadical.fleet.run import run_fleet

    console = wrapped(quiet)
    try:
        with working(quiet, "starting") as show:
            robots = run_fleet(
                folders,
                store,
                scheduler=scheduler,
                workers=workers,
                with_diagnosis=diagnose,
                show=show,
            )
    except KeyboardInterrupt as stop:
        echo(f"casadical: {stop or 'interrupted'}", err=True)
        raise Exit(130) from None
    tell(console, *robots.blocks())
    texts = dict(robots.prior_files(priors)) if priors else {}
    if priors and not texts:
        console.print("note: no prior is written: no type has five calibrated robots or more.", style="yellow")
    for path in sorted(priors.glob(12 * "[0-9a-f]" + ".robot.toml")) if priors else ():
        if path not in texts:
            words = f"note: {shown(path)}: of no type of this fleet with five robots; not written now."
            console.print(words, style="yellow", soft_wrap=True)
    if report_file:
        texts[report_file] = html([robots.page()])
    save(with_json(texts, json_file, robots.to_json()), console)
    if not robots.next:
        suggest(console, "when robots were measured again", *sys.argv[1:])
