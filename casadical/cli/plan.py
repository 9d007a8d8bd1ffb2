"""The command `casadical plan`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from casadical.cli import completion as words
from casadical.cli.options import Json, Prior, PriorEffects, Quiet, carried
from casadical.cli.progress import PLAN, working
from casadical.cli.terminal import keep, wrapped
from casadical.core.errors import InputError

if TYPE_CHECKING:
    from casadical.project.planning import Places


def plan(
    problem: Annotated[
        Path,
        typer.Argument(metavar="PROBLEM", help="Folder with the robot, or a robot file, such as calibrate writes."),
    ],
    n: Annotated[
        int | None,
        typer.Option(
            "-n", min=1, max=10_000, help="Number of joint readings to measure; without it, print how many are enough."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="The poses in order, expected figures beside it; default: plan.csv."),
    ] = None,
    effects: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="NAMES",
            autocompletion=words.effects,
            help="Effects to identify as well: names or labels (backlash@5), by commas.",
        ),
    ] = None,
    criterion: Annotated[
        str,
        typer.Option(
            metavar="WORD", autocompletion=words.criteria, help="V (accuracy over all poses), D, A, or O1 to O5."
        ),
    ] = "V",
    room: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Limits, floor, boxes, tracker; see docs/plan.md.")
    ] = None,
    measured: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Poses already measured; the plan adds to them.")
    ] = None,
    payloads: Annotated[
        str | None, typer.Option(metavar="KG,KG", help="Payloads that can be mounted, by commas.")
    ] = None,
    every_payload: Annotated[bool, typer.Option(help="Measure each reading with all payloads.")] = False,
    both_approaches: Annotated[bool, typer.Option(help="Approach each reading from either side.")] = False,
    repeats: Annotated[int, typer.Option(min=1, max=1000, help="Passes over all poses.")] = 1,
    noise_mm: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Noise of a coordinate or distance, one sigma; default: sigma_mm of problem.toml, or 0.02; "
            "estimated from --measured.",
        ),
    ] = None,
    joint_noise_urad: Annotated[float, typer.Option(min=0, help="Repeatability of a joint, one sigma.")] = 0.0,
    min_distance: Annotated[
        float,
        typer.Option(
            min=0, max=1, help="Least distance of two poses: in the joint that differs most, as a share of its range."
        ),
    ] = 0.0,
    target_mm: Annotated[
        float | None, typer.Option(min=0, help="Wanted accuracy; prints how many poses are enough for it.")
    ] = None,
    order: Annotated[
        bool, typer.Option("--order/--no-order", help="Order the poses for short travel (needs networkx).")
    ] = True,
    wires: Annotated[
        int | None,
        typer.Option(min=1, max=4, help="Plan for so many draw wires, and where they end, in place of positions."),
    ] = None,
    sockets: Annotated[
        int | None,
        typer.Option(min=1, max=30, help="Plan for the tool's ball in so many sockets, in place of positions."),
    ] = None,
    places: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Where wires or sockets may be: columns x_mm, y_mm, z_mm; default: about the robot.",
        ),
    ] = None,
    prior: Prior = None,
    prior_effects: PriorEffects = None,
    known_places: Annotated[bool, typer.Option(help="The wires' ends will be measured, too.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Choose which poses to measure, and predict the accuracy of the calibration before measuring.

    Without -n only the stopping rule: the expected accuracy against the number of poses, given the poses measured
    so far.

    Example: casadical plan problems/kr210 -n 40 --target-mm 0.03 --out next.csv

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.core.files import json_text
    from casadical.diagnosis.candidates import named
    from casadical.measurements.noise import Noise
    from casadical.pose_selection.candidates import Circumstances
    from casadical.pose_selection.criteria import checked
    from casadical.pose_selection.workspace_file import read_workspace
    from casadical.project.planning import noise_declared, planned_with, robot_of
    from casadical.project.planning import plan as run
    from casadical.project.problem import read_campaign

    robot = robot_of(problem)
    robot, known = carried(prior, prior_effects, frozen=False)(robot)
    before = read_campaign(problem, measured, robot) if measured else None
    wanted = [c for c in named(robot, effects.split(",")) if c.listed] if effects else []
    # An effect with a grid of settings is planned for with the middle one.
    added = [e for c in wanted for e in c.variants[len(c.variants) // 2]]
    where = _places(wires, sockets, places, known_places)
    if noise_mm is None and measured is None:
        noise_mm = noise_declared(problem, robot, where)
    noise = None if noise_mm is None else Noise(1e-3 * noise_mm, 1e-6 * joint_noise_urad)
    target = None if target_mm is None else 1e-3 * target_mm
    workspace = read_workspace(room, robot) if room else None
    circumstances = Circumstances(_numbers(payloads), every_payload, both_approaches, repeats)
    word = checked(criterion)
    with working(quiet, "choosing poses", steps=PLAN) as show:
        found = run(
            robot, n, added, criterion=word, workspace=workspace, circumstances=circumstances, measured=before,
            noise=noise, min_distance=min_distance, order=order, target=target, seed=seed, show=show,
            places=where, prior=known,
        )  # fmt: skip
    place = out if n is None else out or Path("plan.csv")
    texts = found.files(place) if place else {}
    if json_file:
        texts[json_file] = json_text(found.to_json())
    console = wrapped(quiet)
    console.print(found.report())
    console.print(planned_with(problem, measured, prior))
    keep(texts, console)


def _places(wires: int | None, sockets: int | None, candidates: Path | None, known: bool) -> "Places | None":
    """What is planned for in place of positions. Raises InputError where the options contradict each other."""
    from casadical.project.planning import Places, read_places

    if wires and sockets:
        raise InputError("--wires and --sockets: give one of them; each is a plan of its own")
    if not (wires or sockets):
        if candidates is not None or known:
            raise InputError("--places and --known-places are of --wires N or --sockets N; give one of these, too")
        return None
    where = read_places(candidates) if candidates else None
    return Places("wires", wires, where, known) if wires else Places("sockets", sockets or 1, where, known)


def _numbers(text: str | None) -> tuple[float, ...]:
    """Payloads by commas. Raises InputError."""
    from casadical.measurements.columns import POSSIBLE

    try:
        found = tuple(float(word) for word in text.split(",")) if text else ()
    except ValueError:
        raise InputError(f"--payloads {text}: allowed: numbers by commas, such as 0,120") from None
    least, most = POSSIBLE["payload_kg"]
    for number in found:
        if not least <= number <= most:
            raise InputError(f"--payloads {text}: {number:g} kg is not possible; allowed: {least:g} to {most:g}")
    return found
