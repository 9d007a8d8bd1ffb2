"""The command `casadical plan`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Context, Option

from casadical.cli import options as o
from casadical.cli.terminal import (
    PLAN,
    TABLE_WIDTH_WITHOUT_TERMINAL,
    print_result,
    save,
    suggest,
    tell,
    with_json,
    working,
    wrapped,
)
from casadical.core.basics import InputError
from casadical.core.reporting.blocks import Words

if TYPE_CHECKING:
    from casadical.project.planning import Places


# Name, in messages, of the mode that plans poses for a calibration.
CALIBRATION_MODE = "poses to calibrate with (--measured: those that there are)"
# Mode of the command -> names of the parameters that are allowed in it.
MODE_OPTIONS = {
    CALIBRATION_MODE: (
        *("n", "out", "effects", "room", "measured", "payloads", "every_payload", "both_approaches"),
        *("repeats", "noise_mm", "joint_noise_urad", "min_distance", "target_mm", "order", "wires"),
        *("sockets", "places", "prior", "prior_effects", "known_places", "seed", "json_file"),
        "details",
    ),
    "--isolability": ("poses", "effects", "json_file"),
    "--iso9283": ("out", "room", "cube_mm", "seed"),
    "--touches": ("out", "room", "touches", "noise_mm", "seed"),
    "--camera": ("n", "out", "room", "noise_mm", "view", "seed", "json_file"),
}


def plan(
    context: Context,
    problem: Path = Argument(
        ...,
        metavar="PROBLEM",
        help="Folder with the robot, or a robot file, such as calibrate writes.",
    ),
    poses: list[Path] | None = Argument(
        None,
        metavar="[POSES.csv...]",
        help="With --isolability: the poses in question; default: the tables of the folder.",
    ),
    n: int | None = Option(
        None,
        "-n",
        min=1,
        max=10_000,
        help="Number of joint readings to measure; without it, print how many are enough.",
    ),
    out: Path | None = Option(
        None,
        metavar="FILE.csv",
        help="The poses in order, expected figures next to it; default: plan.csv.",
    ),
    effects: str | None = Option(
        None,
        "--for",
        metavar="NAMES",
        autocompletion=o.effects,
        help="Effects to identify as well: names or labels (backlash@5), by commas.",
    ),
    isolability: bool = Option(
        False,
        "--isolability",
        help="Choose no poses: say what POSES could show of each effect (of --for; default: "
        "all), and which look alike. Measured positions are not needed.",
    ),
    room: o.Room = None,
    measured: Path | None = Option(None, metavar="FILE.csv", help="Poses already measured; the plan adds to them."),
    payloads: str | None = Option(None, metavar="KG,KG", help="Payloads that can be mounted, by commas."),
    every_payload: bool = Option(False, help="Measure each reading with all payloads."),
    both_approaches: bool = Option(False, help="Approach each reading from either side."),
    repeats: int = Option(1, min=1, max=1000, help="Passes over all poses."),
    noise_mm: float | None = Option(
        None,
        min=0,
        help="Noise of a coordinate or distance, one sigma; default: sigma_mm of problem.toml, "
        "or 0.02; estimated from --measured.",
    ),
    joint_noise_urad: float = Option(0.0, min=0, help="Repeatability of a joint, one sigma."),
    min_distance: float = Option(
        0.0,
        min=0,
        max=1,
        help="Least distance of two poses: in the joint that differs most, as a share of its range.",
    ),
    target_mm: float | None = Option(None, min=0, help="Wanted accuracy; prints how many poses are enough for it."),
    order: bool = Option(True, "--order/--no-order", help="Order the poses for short travel."),
    wires: int | None = Option(
        None,
        min=1,
        max=4,
        help="Plan for so many draw wires, and where they end, in place of positions.",
    ),
    sockets: int | None = Option(
        None,
        min=1,
        max=30,
        help="Plan for the tool's ball in so many sockets, in place of positions.",
    ),
    places: Path | None = Option(
        None,
        metavar="FILE.csv",
        help="Where wires or sockets may be: columns x_mm, y_mm, z_mm; default: about the robot.",
    ),
    prior: o.Prior = None,
    prior_effects: o.PriorEffects = None,
    known_places: bool = Option(False, help="The wires' ends will be measured, too."),
    iso9283: bool = Option(
        False,
        "--iso9283",
        help="Plan a test by ISO 9283 instead: five poses in the largest cube of the standard, "
        "30 visits each, three approach paths, drift over 8 hours; written to --out "
        "(default: iso9283.csv).",
    ),
    cube_mm: float | None = Option(None, min=10, max=5000, help="With --iso9283: side of the cube."),
    touches: int | None = Option(
        None,
        min=2,
        max=50,
        metavar="N",
        help="Plan N touches a day instead, that tell most about zeros, tool and foot of a "
        "calibrated robot; written to --out (default: touches.csv).",
    ),
    camera: bool = Option(
        False,
        "--camera",
        help="Choose stations (default: 25) at which a camera sees its board, from those measured "
        "so far (of a robot file: from --view and --noise-mm, with the camera on the flange), and say what 10, 15, 25 "
        "and 40 would give; written to --out (default: stations.csv).",
    ),
    view: str = Option(
        "0.3,0.9,25,50",
        metavar="NEAR,FAR,OFF,OBLIQUE",
        help="With --camera and a robot file: distances of the board [m], and its largest angles off the camera's axis "
        "and between line of sight and board's normal [deg].",
    ),
    seed: o.Seed = 0,
    details: o.Details = False,
    json_file: o.Json = None,
    quiet: o.Quiet = False,
) -> None:
    """Choose which poses to measure, and predict the accuracy of the calibration before measuring.

    Without -n only the stopping rule: the expected accuracy against the number of poses, given the
    poses measured so far. With --isolability: what given poses can show of each effect; with
    --touches: what to touch every day.

    Example: casadical plan arm -n 40 --target-mm 0.03 --out next.csv

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.project.planning import circumstances_of, plan_problem

    given = {"--isolability": isolability, "--iso9283": iso9283, "--touches": touches, "--camera": camera}
    o.refuse_of_others(context, next((mode for mode, asked in given.items() if asked), CALIBRATION_MODE), MODE_OPTIONS)
    if isolability:
        _isolability(problem, poses, effects, json_file, quiet)
        return
    if iso9283:
        _iso9283(problem, cube_mm, out or Path("iso9283.csv"), room, seed, quiet)
        return
    if touches:
        _touches(problem, touches, out or Path("touches.csv"), noise_mm, room, seed, quiet)
        return
    if camera:
        _camera(problem, n or 25, out or Path("stations.csv"), room, json_file, seed, quiet, view, noise_mm)
        return
    chosen = partial(
        plan_problem,
        problem,
        n,
        measured,
        o.carried_prior(prior, prior_effects, frozen=False),
        effects=effects.split(",") if effects else (),
        room=room,
        circumstances=circumstances_of(payloads, every_payload, both_approaches, repeats),
        noise_mm=noise_mm,
        joint_noise_urad=joint_noise_urad,
        min_distance=min_distance,
        target_mm=target_mm,
        order=order,
        places=_places(wires, sockets, places, known_places),
        seed=seed,
    )
    _poses(
        chosen,
        problem,
        out if n is None else out or Path("plan.csv"),
        measured,
        prior,
        json_file,
        quiet,
        details,
    )


def _poses(
    chosen: Callable[..., Any],
    problem: Path,
    to: Path | None,
    measured: Path | None,
    prior: Path | None,
    json_file: Path | None,
    quiet: bool,
    details: bool,
) -> None:
    """Print which poses to measure, or how many are enough, and write requested files.

    chosen : function that makes the plan, called with a function that shows progress
    to : file of the poses; None: only the number of poses is printed
    measured, prior : as given to the command, for its sentence on the model
    details : whether all figures are printed
    """
    from casadical.project.planning import planned_with

    console = wrapped(quiet)
    with working(quiet, "choosing poses", steps=PLAN) as show:
        planned = chosen(show=show)
    print_result(console, [*planned.blocks(), Words(planned_with(problem, measured, prior), "note")], details)
    save(with_json(planned.files(to) if to else {}, json_file, planned.to_json()), console)
    if to:
        tables = (*([measured] if measured else []), to)
        suggest(
            console,
            "when what was measured is in columns next to these readings",
            "calibrate",
            problem,
            *tables,
        )
    else:
        enough = planned.forecast.stop()
        what = "as many as you can measure" if enough is None else "so many"
        suggest(console, f"to choose {what}", *sys.argv[1:], "-n", enough or 100)


def _iso9283(problem: Path, cube_mm: float | None, out: Path, room: Path | None, seed: int, quiet: bool) -> None:
    """Plan a test by ISO 9283, and write the table of its poses to `out`.

    cube_mm : side of the test cube; None: the largest that fits; room : file of a workspace
    """
    from casadical.project.planning import iso9283_plan

    console = wrapped(quiet)
    with working(quiet, "poses of the standard"):
        words, table = iso9283_plan(problem, cube_mm, room, seed)
    tell(console, *words)
    save({out: table.to_csv(index=False)}, console)
    suggest(console, "when it was measured", "verify", "RESULTS", out, "--iso9283")


def _touches(
    robot: Path,
    n: int,
    out: Path,
    noise_mm: float | None,
    room: Path | None,
    seed: int,
    quiet: bool,
) -> None:
    """Choose n points to touch every day, and write their table to `out`.

    noise_mm : of a touch, None: the default; room : file of a workspace
    """
    from casadical.fleet.touches import plan_touches

    console = wrapped(quiet)
    with working(quiet, "choosing touches"):
        table = plan_touches(robot, n, noise_mm=noise_mm, room=room, seed=seed)
    console.print(
        f"{n} touches that tell most about zeros, tool and foot. Touch them every day in the frame "
        "of the calibration, put x_mm, y_mm, z_mm into a copy whose name has the day "
        "(2026-03-14.csv), and have the copies verified."
    )
    save({out: table.to_csv(index=False)}, console)
    suggest(console, "when they were touched", "verify", robot, "DAY.csv", "--touches")


def _camera(
    problem: Path,
    n: int,
    out: Path,
    room: Path | None,
    json_file: Path | None,
    seed: int,
    quiet: bool,
    view: str,
    noise_mm: float | None,
) -> None:
    """Choose n stations at which a camera sees its board, and write their table to `out`.

    room : file of a workspace; view, noise_mm : of the camera, where only a robot is given
    """
    from casadical.pose_selection.camera_stations import camera_stations, read_view, simulated_stations
    from casadical.pose_selection.workspace import read_workspace
    from casadical.project.calibration import calibrate
    from casadical.project.problem import read_campaign_robot

    console = wrapped(quiet)
    with working(quiet, "choosing stations"):
        seen = read_view(view) if problem.is_file() else None
        if seen:
            found = simulated_stations(
                read_campaign_robot(problem), seen, 1e-3 * (1.0 if noise_mm is None else noise_mm), seed
            )
        else:
            found = calibrate(problem).identification
        workspace = read_workspace(room, found.robot) if room else None
        planned = camera_stations(found, n, workspace, seed, seen)
    tell(console, *planned.blocks())
    save(with_json({out: planned.table.to_csv(index=False)}, json_file, planned.to_json()), console)
    suggest(console, "when the poses of the board are in columns next to these readings", "calibrate", problem, out)


def _isolability(
    problem: Path,
    poses: list[Path] | None,
    effects: str | None,
    json_file: Path | None,
    quiet: bool,
) -> None:
    """Print which effects could be detected and distinguished at given poses, before any data."""
    from casadical.project.diagnosis import effects_named, isolability_of, read_campaigns

    console = wrapped(quiet, None if sys.stdout.isatty() else TABLE_WIDTH_WITHOUT_TERMINAL)
    answers = []
    for campaign in read_campaigns(problem, poses, readings_only=True):
        shows = isolability_of(campaign, effects_named(effects))
        answers.append(shows.to_json(campaign.name))
        title = Words(f"{campaign.title}, {sum(map(len, campaign.sets))} poses", "title")
        tell(console, title, *shows.blocks())
        console.print()
    save(with_json({}, json_file, answers), console)
    suggest(console, "for poses that distinguish effects", "plan", problem, "-n", 60)


def _places(wires: int | None, sockets: int | None, candidates: Path | None, surveyed: bool) -> Places | None:
    """Return the wires or sockets to plan for in place of positions; None without these options.

    wires, sockets : their number; candidates : table of candidate places; surveyed : whether
        the places will be measured. Raises InputError where the options contradict each other.
    """
    from casadical.project.planning import Places, read_places

    if wires and sockets:
        raise InputError("--wires and --sockets: give one of them; each is a plan of its own")
    if not (wires or sockets):
        if candidates is not None or surveyed:
            raise InputError("--places and --known-places are of --wires N or --sockets N; give one of these, too")
        return None
    where = read_places(candidates) if candidates else None
    return Places("wires", wires, where, surveyed) if wires else Places("sockets", sockets or 1, where, surveyed)
