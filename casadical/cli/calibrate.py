"""The commands `casadical check` and `casadical calibrate`."""

from pathlib import Path
from typing import Any

from typer import Exit, Option, echo

from casadical.cli import options as o
from casadical.cli import terminal as t
from casadical.core.basics import InputError, shown


def check(
    problems: o.Problems,
    noise_mm: float | None = Option(
        None,
        min=0,
        metavar="MM",
        help="Noise of a measured coordinate, one sigma, for the forecast; default: estimated from the data.",
    ),
    strict: bool = Option(False, "--strict", help="Exit with code 2 on warnings too."),
    repair: bool = Option(False, "--repair", help="Write the best repair of slips into the files."),
    details: o.Details = False,
    json_file: o.Json = None,
    quiet: o.Quiet = False,
) -> None:
    """Check a problem and its data before a solve, and predict the accuracy.

    Looks for faults of the files; slips that the nominal model contradicts, several at once (signs,
    zeros, units, swapped columns, shifted rows, a left-handed frame, coupled readings, a wrong
    length, the other convention); joints that hardly move, too few poses, a four-bar near its end;
    shows which parameters the poses determine and how well.

    Example: casadical check arm

    Exit codes: 0 ready, 2 something is wrong, 70 a bug in casadical.
    """
    from casadical.project.check.check import precheck
    from casadical.project.check.repair import not_repaired, repaired

    console = t.wrapped(quiet)
    checks = []
    for name, (folder, tables) in o.problems_of(problems).items():
        noise = None if noise_mm is None else 1e-3 * noise_mm
        if repair and tables:
            raise InputError(f"{name}: --repair writes problem.toml: name the table there, and give the folder alone")
        with t.working(quiet, "reading", name, t.CHECK) as show:
            checks.append(precheck(folder, noise, show=show, tables=tables))
        # Up to three repairs in a row: a slip may hide another one, or a target.
        for _ in range(3 if repair else 0):
            text = repaired(checks[-1])
            if not text:
                console.print(not_repaired(checks[-1]), end="\n" * (not checks[-1].ok), style="yellow")
                break
            console.print(text, markup=False, highlight=False, soft_wrap=True)
            with t.working(quiet, "reading again", name, t.CHECK) as show:
                checks[-1] = precheck(folder, noise, show=show)
        t.tell(console, *checks[-1].blocks() if details else checks[-1].brief())
        console.print()
    t.save(t.with_json({}, json_file, [f.to_json() for f in checks]), console)
    if quiet:
        for f in checks:
            for finding in f.of_level("error"):
                echo(f"casadical: {shown(f.folder)}: {finding.topic}: {finding.text}", err=True)
    if not all(f.ok and not (strict and f.of_level("warning")) for f in checks):
        raise Exit(t.EXIT_BAD_INPUT)


def calibrate(
    problems: o.Problems,
    out: Path | None = Option(
        None,
        metavar="DIR",
        help="Write the calibrated robots (METHOD.robot.toml), parameters "
        "(METHOD.parameters.csv), networks (METHOD.compensator.json) and result.json here; "
        "with several problems, into one folder for each.",
    ),
    json_file: o.Json = None,
    report_file: o.Report = None,
    method: str | None = Option(
        None,
        metavar="METHOD",
        autocompletion=o.methods,
        help="KM (kinematics only), SKCM (with joint compliance), or a network on what SKCM "
        "leaves, such as IWO-NN-SKCM (the paper's) or GP-NN-SKCM; docs/compensator.md has "
        "them all. Default: the problem's.",
    ),
    loss: str | None = Option(
        None,
        metavar="LOSS",
        autocompletion=o.losses,
        help="linear; huber or soft_l1, which leave outliers out and name them; auto: huber "
        "where it finds any. Default: the problem's, which is auto unless it says "
        "otherwise.",
    ),
    seed: int | None = Option(
        None,
        min=0,
        help="Seed of the random split into sets; default: the problem's. No effect where a column names the sets.",
    ),
    prior: o.Prior = None,
    prior_effects: o.PriorEffects = None,
    frozen: o.Frozen = False,
    details: o.Details = False,
    quiet: o.Quiet = False,
) -> None:
    """Identify a robot's parameters and report the accuracy on poses that were held out.

    Prints, for each problem, the position errors before and after and what must be known of them;
    with --details also every parameter with its standard error, and what could not be identified
    and why. Results are written when all problems are done: all of them or none.

    Example: casadical calibrate arm --out results

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 4 held-out poses are worse than before
    (nothing is written then), 70 a bug in casadical.
    """
    with t.importing():
        from casadical.project import calibration as work

    console = t.wrapped(quiet)
    carried = o.carried_prior(prior, prior_effects, frozen)
    asked: dict[str, Any] = {"method": method, "loss": loss, "seed": seed, "carried": carried}
    done: list[work.Calibration] = []
    texts: dict[Path, Any] = {}
    given = o.problems_of(problems)
    for name, (source, tables) in given.items():
        with t.working(quiet, "reading", name) as show:
            done.append(work.calibrate(source, tables=tables, show=show, **asked))
        t.tell(console, *done[-1].blocks() if details else done[-1].brief())
        if len(given) == 1 or len(done) < len(given) or out:
            console.print()
        if out:
            texts |= done[-1].files(out if len(given) == 1 else out / name)
    worse = [f"{name}: {c.worse}" for name, c in zip(given, done, strict=True) if c.worse]
    if worse:
        echo("casadical: nothing was written: " + "\n".join(worse), err=True)
        raise Exit(t.EXIT_WORSE)
    if json_file:
        figures = {name: c.to_json() for name, c in zip(given, done, strict=True)}
        texts = t.with_json(texts, json_file, figures if len(figures) > 1 else [*figures.values()])
    if report_file:
        with t.working(quiet, "writing the report"):
            texts[report_file] = t.html([c.page() for c in done])
    t.save(texts, console)
    for source, tables in given.values() if len(given) == 1 else ():
        t.tell(console, done[0].next_command(source, tables, written=bool(out)))
    if len(given) > 1:
        when = "to diagnose and compare them all"
        t.suggest(console, when, "fleet", *problems, "--store", "fleet.parquet")
    if not details and len(given) == 1:
        console.print("all parameters and figures: --details, --out DIR or --report FILE.html", style="dim")
