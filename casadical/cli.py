"""The command line: casadical COMMAND PROBLEM_DIR.

Exit codes: 0 done; 2 bad input; 3 the solver found no optimum; 70 a bug of ours.
"""

from __future__ import annotations

import json
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from . import __version__
from .errors import ConvergenceError, InputError

BAD_INPUT, NO_CONVERGENCE, OUR_BUG = 2, 3, 70

app = typer.Typer(
    name="casadical",
    help=(
        "Calibrate robots from measured poses.\n\n"
        "A PROBLEM_DIR is a folder with problem.toml, a robot file (TOML or URDF) and measurements (CSV). Start with "
        "one of the folders in problems/, for example:\n\n    casadical calibrate problems/ur10 --out results/ur10"
    ),
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"casadical {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


@app.command()
def calibrate(
    problems: Annotated[list[Path], typer.Argument(metavar="PROBLEM_DIR...", help="One or more problem folders.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the calibrated robot (TOML, and URDF for a URDF robot) and tables.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="File for all figures as JSON.")] = None,
    method: Annotated[
        str | None, typer.Option(help="KM (kinematics only) or SKCM (with joint compliance); default: the problem's.")
    ] = None,
    loss: Annotated[str | None, typer.Option(help="linear, huber or soft_l1; default: the problem's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of the split into sets; default: the problem's.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Identify a robot's parameters and say what they are worth on poses that were held out."""
    from .calibration import calibrate_problem, write_results
    from .tables import as_json, report

    console = Console(quiet=quiet, soft_wrap=False)
    found = {}
    for folder in problems:
        with _progress(quiet) as bar:
            task = bar.add_task(f"{folder.name}: reading", total=None)

            def show(text: str, folder: Path = folder, bar: Progress = bar, task: object = task) -> None:
                bar.update(task, description=f"{folder.name}: {text}")  # type: ignore[arg-type]

            run = calibrate_problem(folder, method=method, loss=loss, seed=seed, show=show)
        found[folder.name] = as_json(*run)
        console.print(report(*run))
        console.print()
        if out:
            target = out if len(problems) == 1 else out / folder.name
            for path in write_results(target, *run):
                console.print(f"wrote {path}")
    if json_file:
        from .files import write_whole

        whole = found if len(found) > 1 else next(iter(found.values()))
        write_whole(json_file, json.dumps(whole, indent=1, allow_nan=False) + "\n")
        console.print(f"wrote {json_file}")


def _progress(quiet: bool) -> Progress:
    """Live progress on a terminal's standard error; silent elsewhere."""
    console = Console(stderr=True)
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    )


def main() -> None:
    """Run the command line; a user's mistake ends in a message and an exit code, never in a traceback."""
    try:
        app()
    except InputError as error:
        print(f"casadical: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(BAD_INPUT)
    except ConvergenceError as error:
        print(f"casadical: no optimum found, nothing was written: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(NO_CONVERGENCE)
    except KeyboardInterrupt:
        print("casadical: interrupted, nothing was written", file=sys.stderr)  # noqa: T201
        sys.exit(130)
    except Exception:
        traceback.print_exc()
        print("casadical: this is a bug of ours; please report it with the lines above", file=sys.stderr)  # noqa: T201
        sys.exit(OUR_BUG)
