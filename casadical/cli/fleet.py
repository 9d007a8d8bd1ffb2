"""The command `casadical fleet`."""

import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option, echo

from casadical.cli.options import Json, Quiet, Report
from casadical.cli.terminal import html, keep, suggest, with_json, working, wrapped
from casadical.core.basics import shown
from casadical.core.telling.result import terminal


def fleet(
    folders: Annotated[list[Path], Argument(metavar="FOLDER...")],
    store: Annotated[Path, Option(metavar="STORE.parquet")],
    scheduler: Annotated[str | None, Option(metavar="ADDRESS")] = None,
    workers: Annotated[int | None, Option(min=1, max=1024, metavar="N")] = None,
    diagnose: Annotated[bool, Option("--diagnose/--no-diagnose")] = True,
    priors: Annotated[Path | None, Option(metavar="DIR")] = None,
    json_file: Json = None,
    report_file: Report = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate, diagnose and compare every robot of a fleet, on all cores or on a Dask cluster.

    A robot is a problem folder; its later campaigns are tables in its folder `campaigns`, with their days in their
    names. What the store has already is not computed again, and one robot that fails stops nobody. Robots of one type
    share what was learnt from them: common faults of the drawing, and a prior with which a new robot needs fewer poses.

    Example: casadical fleet plants/* --store fleet.parquet --report fleet.html

    Exit codes: 0 done, also where single robots failed, 2 bad input or no scheduler, 70 a bug in casadical.

    folders : Problem folders, one a robot, or folders that hold them.
    store : Folder of parquet files, a row of each robot; continued.
    scheduler : Dask scheduler, as tcp://host:8786; default: this machine's cores.
    workers : Processes of this machine; default: one a core.
    diagnose : Diagnose every robot, which takes longest.
    priors : Write what robots of one type have in common, TYPE.robot.toml, for calibrate --prior FILE --prior-effects
        all.
    """
    from casadical.fleet.run import run_fleet

    console = wrapped(quiet)
    try:
        with working(quiet, "starting") as show:
            robots = run_fleet(folders, store, scheduler=scheduler, workers=workers, with_diagnosis=diagnose, show=show)
    except KeyboardInterrupt as stop:
        echo(f"casadical: {stop or 'interrupted'}", err=True)
        raise Exit(130) from None
    console.print(terminal(robots.blocks()))
    texts = dict(robots.prior_files(priors)) if priors else {}
    if priors and not texts:
        console.print("note: no prior is written: no type has five calibrated robots or more.", style="yellow")
    for path in sorted(priors.glob(12 * "[0-9a-f]" + ".robot.toml")) if priors else ():
        if path not in texts:
            words = f"note: {shown(path)}: of no type of this fleet with five robots; not written now."
            console.print(words, style="yellow", soft_wrap=True)
    if report_file:
        texts[report_file] = html([robots.page()])
    keep(with_json(texts, json_file, robots.to_json()), console)
    if not robots.next:
        suggest(console, "when robots were measured again", *sys.argv[1:])
