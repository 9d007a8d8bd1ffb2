"""The command line: casadical COMMAND PROBLEM_DIR.

Exit codes: 0 done; 2 bad input; 3 the solver found no optimum; 70 a bug of ours.
"""

from __future__ import annotations

import json
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from . import __version__
from .controller.commands import correct, export_app
from .errors import ConvergenceError, InputError

if TYPE_CHECKING:
    from .robot import Robot

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
            "(back-propagation), IWO-NN-SKCM (the paper's), LM-NN-SKCM, IWO-LM-NN-SKCM or "
            "GP-NN-SKCM; default: the problem's.",
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
        typer.Option(
            metavar="NAMES",
            help="standard (the default), extended, or only these: names (backlash) or labels (backlash@5), by commas.",
        ),
    ] = None,
    measure_next: Annotated[
        Path | None,
        typer.Option("--next", metavar="FILE", help="Poses that would tell apart what one campaign cannot, as CSV."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the partitions into folds.")] = 0,
    isolability: Annotated[
        bool,
        typer.Option(
            "--isolability",
            help="Before any data: what these poses could show of each effect, and which look alike. Measured "
            "positions are not needed; nothing is diagnosed.",
        ),
    ] = False,
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
    if isolability:
        _print_isolability(robot, campaigns, effects, json_file, console)
        return
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
        if measure_next and len(campaigns) == 1:
            poses = found.next_poses(15)
            write_whole(measure_next, poses.to_csv(index=False))
            what = f"to tell {' from '.join(found.in_question)}" if len(poses) else "none: nothing is in question"
            console.print(f"wrote {measure_next} ({len(poses)} poses, {what})")
    if json_file:
        whole = answers if len(answers) > 1 else answers[0]
        write_whole(json_file, json.dumps(whole, indent=1, allow_nan=False) + "\n")
        console.print(f"wrote {json_file}")


def _print_isolability(
    robot: Robot, campaigns: list[Path], effects: str | None, json_file: Path | None, console: Console
) -> None:
    from .diagnosis.isolability import isolability
    from .diagnosis.isolability_report import as_json, report
    from .files import write_whole
    from .measurements import read_readings

    answers = []
    for path in campaigns:
        m = read_readings(path, [j.kind for j in robot.joints])
        found = isolability(robot, m, effects.split(",") if effects else "standard")
        answers.append(as_json(found, path.stem))
        console.print(report(found, f"{path.stem} ({robot.name}), {len(m)} poses"))
        console.print()
    if json_file:
        whole = answers if len(answers) > 1 else answers[0]
        write_whole(json_file, json.dumps(whole, indent=1, allow_nan=False) + "\n")
        console.print(f"wrote {json_file}")


@app.command()
def plan(
    problem: Annotated[Path, typer.Argument(metavar="PROBLEM", help="Folder with the robot, or a robot file.")],
    n: Annotated[
        int | None,
        typer.Option(
            "-n", min=1, help="Number of joint readings to measure; without it, say only how many are enough."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="The poses in order, expected figures beside it; default: plan.csv."),
    ] = None,
    effects: Annotated[
        str | None,
        typer.Option("--for", metavar="NAMES", help="Effects to be told: names or labels (backlash@5), by commas."),
    ] = None,
    criterion: Annotated[
        str, typer.Option(metavar="WORD", help="V (accuracy over all poses), D, A, or O1 to O5.")
    ] = "V",
    room: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Limits, floor, boxes, tracker; see docs/plan.md.")
    ] = None,
    measured: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Poses measured already, which the choice adds to.")
    ] = None,
    payloads: Annotated[
        str | None, typer.Option(metavar="KG,KG", help="Payloads that can be mounted, by commas.")
    ] = None,
    every_payload: Annotated[bool, typer.Option(help="Measure each reading with all payloads.")] = False,
    both_approaches: Annotated[bool, typer.Option(help="Approach each reading from either side.")] = False,
    repeats: Annotated[int, typer.Option(min=1, help="Passes over all poses.")] = 1,
    noise_mm: Annotated[
        float | None, typer.Option(min=0, help="Of a coordinate, one sigma; default: 0.02, or what was measured shows.")
    ] = None,
    joint_noise_urad: Annotated[float, typer.Option(min=0, help="Repeatability of a joint, one sigma.")] = 0.0,
    min_distance: Annotated[
        float, typer.Option(min=0, max=1, help="Between poses, in the joint that differs most, share of its range.")
    ] = 0.0,
    target_mm: Annotated[float | None, typer.Option(min=0, help="Accuracy wanted: how many poses are enough?")] = None,
    order: Annotated[bool, typer.Option("--order/--no-order", help="Order for little travel (needs networkx).")] = True,
    seed: Annotated[int, typer.Option(min=0, help="Of all chance.")] = 0,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Choose which poses to measure, and say what accuracy to expect of them before measuring.

    Without -n it is the stopping rule alone: the accuracy to expect against the number of poses, with what was
    measured so far.
    """
    from .diagnosis.library import named
    from .files import write_together
    from .pose_selection.candidates import Circumstances
    from .pose_selection.criteria import checked
    from .pose_selection.information import Noise
    from .pose_selection.planning import look_ahead, robot_of
    from .pose_selection.planning import plan as run
    from .pose_selection.report import how_many, plan_files, report
    from .pose_selection.room import read_room

    robot = robot_of(problem)
    wanted = [c for c in named(robot, effects.split(",")) if c.listed] if effects else []
    # Of settings on a grid, the middle one.
    added = [e for c in wanted for e in c.variants[len(c.variants) // 2]]
    given = noise_mm is not None or measured is None
    noise = Noise(1e-3 * (0.02 if noise_mm is None else noise_mm), 1e-6 * joint_noise_urad) if given else None
    target = None if target_mm is None else 1e-3 * target_mm
    workspace = read_room(room, robot) if room else None
    circumstances = Circumstances(_numbers(payloads), every_payload, both_approaches, repeats)
    word = checked(criterion)
    console = Console(quiet=quiet)
    with _progress(quiet) as bar:
        bar.add_task("choosing poses", total=None)
        if n is None:
            ahead = look_ahead(
                robot,
                added,
                workspace=workspace,
                circumstances=circumstances,
                measured=measured,
                noise=noise,
                seed=seed,
            )
        else:
            found, ahead = run(
                robot, n, added, criterion=word, workspace=workspace, circumstances=circumstances, measured=measured,
                noise=noise, min_distance=min_distance, order=order, seed=seed,
            )  # fmt: skip
    if n is None:
        console.print(how_many(ahead, target))
        texts = {out: ahead.table.to_csv(index=False, float_format="%.6g")} if out else {}
    else:
        console.print(report(found, ahead, target))
        texts = plan_files(out or Path("plan.csv"), found, ahead)
    write_together(texts)
    for path in texts:
        console.print(f"wrote {path}", soft_wrap=True)


def _numbers(text: str | None) -> tuple[float, ...]:
    """Payloads by commas. Raises InputError."""
    try:
        return tuple(float(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise InputError(f"--payloads {text}: allowed: numbers by commas, such as 0,120") from None


app.add_typer(export_app, name="export")
app.command()(correct)


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
