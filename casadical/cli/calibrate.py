"""The command `casadical calibrate`."""

from pathlib import Path
from typing import Annotated, Any

from typer import Exit, Option, echo

from casadical.cli import options as o
from casadical.cli.terminal import WORSE, html, keep, suggest, with_json, working, wrapped
from casadical.core.telling.result import terminal


def calibrate(
    problems: o.Problems,
    out: Annotated[Path | None, Option(metavar="DIR")] = None,
    json_file: o.Json = None,
    report_file: o.Report = None,
    method: Annotated[str | None, Option(metavar="METHOD", autocompletion=o.methods)] = None,
    loss: Annotated[str | None, Option(metavar="LOSS", autocompletion=o.losses)] = None,
    seed: Annotated[int | None, Option(min=0)] = None,
    prior: o.Prior = None,
    prior_effects: o.PriorEffects = None,
    frozen: o.Frozen = False,
    details: o.Details = False,
    quiet: o.Quiet = False,
) -> None:
    """Identify a robot's parameters and report the accuracy on poses that were held out.

    Prints, for each problem, the position errors before and after and what must be known of them; with --details also
    every parameter with its standard error, and what could not be identified and why. Results are written when all
    problems are done: all of them or none.

    Example: casadical calibrate arm --out results

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 4 held-out poses are worse than before (nothing is written
    then), 70 a bug in casadical.

    out : Write the calibrated robots (METHOD.robot.toml), parameters (METHOD.parameters.csv), networks
        (METHOD.compensator.json) and result.json here; with several problems, into one folder for each.
    method : KM (kinematics only), SKCM (with joint compliance), or a network on what SKCM leaves, such as IWO-NN-SKCM
        (the paper's) or GP-NN-SKCM; docs/compensator.md has them all. Default: the problem's.
    loss : linear; huber or soft_l1, which leave outliers out and name them; auto: huber where it finds any. Default:
        the problem's, which is auto unless it says otherwise.
    seed : Seed of the random split into sets; default: the problem's. No effect where a column names the sets.
    """
    from casadical.project import calibration as work

    console = wrapped(quiet)
    known = o.carried(prior, prior_effects, frozen)
    done: list[work.Calibration] = []
    texts: dict[Path, Any] = {}
    given = o.problems_of(problems)
    for name, (source, tables) in given.items():
        with working(quiet, "reading", name) as show:
            done.append(
                work.calibrate(source, method=method, loss=loss, seed=seed, carried=known, tables=tables, show=show)
            )
        console.print(terminal(done[-1].blocks() if details else done[-1].brief()))
        if len(given) == 1 or len(done) < len(given) or out:
            console.print()
        if out:
            texts |= done[-1].files(out if len(given) == 1 else out / name)
    worse = [f"{name}: {c.worse}" for name, c in zip(given, done, strict=True) if c.worse]
    if worse:
        echo("casadical: nothing was written: " + "\n".join(worse), err=True)
        raise Exit(WORSE)
    if json_file:
        figures = {name: c.to_json() for name, c in zip(given, done, strict=True)}
        texts = with_json(texts, json_file, figures if len(figures) > 1 else [*figures.values()])
    if report_file:
        with working(quiet, "writing the report"):
            texts[report_file] = html([c.page() for c in done])
    keep(texts, console)
    for source, tables in given.values() if len(given) == 1 else ():
        console.print(terminal([done[0].next_command(source, tables, kept=bool(out))]))
    if len(given) > 1:
        suggest(console, "to diagnose and compare them all", "fleet", *problems, "--store", "fleet.parquet")
    if not details and len(given) == 1:
        console.print("all parameters and figures: --details, --out DIR or --report FILE.html", style="dim")
