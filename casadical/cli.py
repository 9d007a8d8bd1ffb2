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
from rich.progress import Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

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
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Keep the calibrated robots (METHOD.robot.toml), parameters (METHOD.parameters.csv), networks "
            "(METHOD.compensator.json) and result.json here; with several problems, in a folder for each.",
        ),
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Keep all figures as JSON.")] = None,
    method: Annotated[
        str | None,
        typer.Option(
            metavar="METHOD",
            help="KM (kinematics only), SKCM (with joint compliance), or a network on what SKCM leaves: NN-SKCM "
            "(back-propagation), IWO-NN-SKCM (the paper's), LM-NN-SKCM or IWO-LM-NN-SKCM; default: the problem's.",
        ),
    ] = None,
    loss: Annotated[
        str | None,
        typer.Option(
            metavar="LOSS",
            help="linear, or with outliers huber or soft_l1, which leave them out; default: the problem's.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Of the random split into sets; default: the problem's. No effect where a column names the sets.",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Identify a robot's parameters and say what they are worth on poses that were held out.

    Prints, for each problem, the position errors before and after, every parameter with its standard error, and what
    could not be identified and why. Results are written when all problems are done: all of them or none.

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 70 a bug of ours.
    """
    from .calibration import calibrate_problem, problem_networks, result_files
    from .files import write_together
    from .tables import as_json, report

    console = Console(quiet=quiet, soft_wrap=False)
    found: dict[str, object] = {}
    texts: dict[Path, str] = {}
    for name, folder in _by_name(problems).items():
        with _progress(quiet) as bar:
            task = bar.add_task(f"{name}: reading", total=None)

            def show(text: str, name: str = name, bar: Progress = bar, task: TaskID = task) -> None:
                bar.update(task, description=f"{name}: {text}")

            run = calibrate_problem(folder, method=method, loss=loss, seed=seed, show=show)
            networks = problem_networks(run[0], run[1], show)
        found[name] = as_json(*run, networks)
        console.print(report(*run, networks))
        console.print()
        if out:
            texts |= result_files(out if len(problems) == 1 else out / name, *run, networks)
    if json_file:
        whole = found if len(found) > 1 else next(iter(found.values()))
        texts[json_file] = json.dumps(whole, indent=1, allow_nan=False) + "\n"
    write_together(texts)
    for path in texts:
        console.print(f"wrote {path}", soft_wrap=True)


def _by_name(folders: list[Path]) -> dict[str, Path]:
    """Problem folders by the names that their results get. Raises InputError."""
    found: dict[str, Path] = {}
    for folder in folders:
        name = folder.resolve().name
        if name in found:
            raise InputError(f"{folder}: a second problem of the name {name!r}; calibrate them one after the other")
        found[name] = folder
    return found


@app.command()
def diagnose(
    problem: Annotated[Path, typer.Argument(metavar="PROBLEM_DIR", help="Folder with the robot.")],
    campaigns: Annotated[list[Path], typer.Argument(metavar="CAMPAIGN.csv...", help="Measured positions.")],
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Keep the answer as JSON; with several campaigns, a list."),
    ] = None,
    effects: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Only these effects: names (backlash) or labels (backlash@5), by commas."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the partitions into folds.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Say why there is still a gap: where it lies, which effect causes it, how far it shrinks without it."""
    from .diagnosis.answer import as_json, report
    from .diagnosis.diagnosis import diagnose as run
    from .files import write_whole
    from .measurements import read_measurements
    from .problem import read_campaign_robot

    console = Console(quiet=quiet)
    robot = read_campaign_robot(problem)
    answers = []
    for path in campaigns:
        m = read_measurements(path, [j.kind for j in robot.joints])
        with _progress(quiet) as bar:
            task = bar.add_task(path.stem, total=None)

            def show(text: str, bar: Progress = bar, task: TaskID = task, name: str = path.stem) -> None:
                bar.update(task, description=f"{name}: {text}")

            found = run(robot, m, effects.split(",") if effects else "standard", seed=seed, show=show)
        answers.append(as_json(found, path.stem))
        console.print(report(found, f"{path.stem} ({robot.name})"))
        console.print()
    if json_file:
        whole = answers if len(answers) > 1 else answers[0]
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
