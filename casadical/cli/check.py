"""The command `casadical check`."""

from typing import Annotated

from typer import Exit, Option, echo

from casadical.cli.options import Details, Json, Problems, Quiet, problems_of
from casadical.cli.terminal import BAD_INPUT, CHECK, keep, with_json, working, wrapped
from casadical.core.basics import InputError, shown

# Slips hide targets, and targets slips: one is repaired after the other.
REPAIRS = 3


def check(
    problems: Problems,
    noise_mm: Annotated[float | None, Option(min=0, metavar="MM")] = None,
    strict: Annotated[bool, Option("--strict")] = False,
    repair: Annotated[bool, Option("--repair")] = False,
    details: Details = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Check a problem and its data before a solve, and predict the accuracy.

    Looks for faults of the files; slips that the nominal model contradicts, several at once (signs, zeros, units,
    swapped columns, shifted rows, a left-handed frame, coupled readings, a wrong length, the other convention);
    joints that hardly move, too few poses, a four-bar near its end; shows which parameters the poses determine and how
    well.

    Example: casadical check arm

    Exit codes: 0 ready, 2 something is wrong, 70 a bug in casadical.

    noise_mm : Noise of a measured coordinate, one sigma, for the forecast; default: estimated from the data.
    strict : Exit with code 2 on warnings too.
    repair : Write the best repair of slips into problem.toml (columns) and the robot file.
    """
    from casadical.core.telling.result import terminal
    from casadical.project.check import precheck
    from casadical.project.check.repair import not_repaired, repaired

    console = wrapped(quiet)
    checks = []
    for name, (folder, tables) in problems_of(problems).items():
        noise = None if noise_mm is None else 1e-3 * noise_mm
        if repair and tables:
            raise InputError(f"{name}: --repair writes problem.toml; make a folder of it first: casadical new --data")
        with working(quiet, "reading", name, CHECK) as show:
            checks.append(precheck(folder, noise, show=show, tables=tables))
        for _ in range(REPAIRS if repair else 0):
            text = repaired(checks[-1])
            if not text:
                console.print(not_repaired(checks[-1]), end="\n" * (not checks[-1].ok), style="yellow")
                break
            console.print(text, markup=False, highlight=False, soft_wrap=True)
            with working(quiet, "reading again", name, CHECK) as show:
                checks[-1] = precheck(folder, noise, show=show)
        console.print(terminal(checks[-1].blocks() if details else checks[-1].brief()))
        console.print()
    keep(with_json({}, json_file, [f.to_json() for f in checks]), console)
    if quiet:
        for f in checks:
            for finding in f.of_level("error"):
                echo(f"casadical: {shown(f.folder)}: {finding.topic}: {finding.text}", err=True)
    if not all(f.ok and not (strict and f.of_level("warning")) for f in checks):
        raise Exit(BAD_INPUT)
