"""The command `casadical plan`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from typer import Argument, Context, Option

from casadical.cli import options as o
from casadical.cli import terminal as t
from casadical.core.reporting.blocks import Words

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
    "--camera of a robot file": ("n", "out", "room", "noise_mm", "view", "seed", "json_file"),
    "--camera of a folder": ("n", "out", "room", "seed", "json_file"),
}


def plan(
    context: Context,
    problem: Path = Argument(..., metavar="PROBLEM", help="Folder of the robot, or a robot file."),
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
        None, metavar="FILE.csv", help="Poses in order, expected figures beside; default: plan.csv."
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
    min_distance: float = Option(0.0, min=0, max=1, help="Least distance of poses, in joint ranges."),
    target_mm: float | None = Option(None, min=0, help="Wanted accuracy; prints how many poses are enough for it."),
    order: bool = Option(True, "--order/--no-order", help="Order the poses for short travel."),
    wires: int | None = Option(
        None, min=1, max=4, help="Plan for so many draw wires, and their ends, not for positions."
    ),
    sockets: int | None = Option(
        None, min=1, max=30, help="Plan for the tool's ball in so many sockets, not for positions."
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
    from casadical.project.planning import circumstances_of, places_of, plan_problem, planned_with

    given = {"--isolability": isolability, "--iso9283": iso9283, "--touches": touches}
    given[f"--camera of a {'folder' if problem.is_dir() else 'robot file'}"] = camera
    o.refuse_of_others(context, next((mode for mode, asked in given.items() if asked), CALIBRATION_MODE), MODE_OPTIONS)
    if isolability:
        from casadical.project.diagnosis import effects_named, isolability_of, read_campaigns

        console = t.wrapped(quiet, None if sys.stdout.isatty() else t.TABLE_WIDTH_WITHOUT_TERMINAL)
        answers = []
        for campaign in read_campaigns(problem, poses, readings_only=True):
            shows = isolability_of(campaign, effects_named(effects))
            answers.append(shows.to_json(campaign.name))
            title = Words(f"{campaign.title}, {sum(map(len, campaign.sets))} poses", "title")
            t.tell(console, title, *shows.blocks())
            console.print()
        t.save(t.with_json({}, json_file, answers), console)
        t.suggest(console, "for poses that distinguish effects", "plan", problem, "-n", 60)
        return
    if iso9283:
        from casadical.project.planning import iso9283_plan

        console = t.wrapped(quiet)
        with t.working(quiet, "poses of the standard"):
            words, table = iso9283_plan(problem, cube_mm, room, seed)
        t.tell(console, *words)
        out = out or Path("iso9283.csv")
        t.save({out: table.to_csv(index=False)}, console)
        t.suggest(console, "when it was measured", "verify", "RESULTS", out, "--iso9283")
        return
    if touches:
        from casadical.fleet.touches import plan_touches

        console = t.wrapped(quiet)
        with t.working(quiet, "choosing touches"):
            table = plan_touches(problem, touches, noise_mm=noise_mm, room=room, seed=seed)
        console.print(
            f"{touches} touches that tell most about zeros, tool and foot. Touch them every day in "
            "the frame of the calibration, put x_mm, y_mm, z_mm into a copy whose name has the day "
            "(2026-03-14.csv), and have the copies verified."
        )
        t.save({out or Path("touches.csv"): table.to_csv(index=False)}, console)
        t.suggest(console, "when they were touched", "verify", problem, "DAY.csv", "--touches")
        return
    if camera:
        from casadical.project.calibration import calibrate
        from casadical.project.planning import stations_ahead

        console = t.wrapped(quiet)
        with t.working(quiet, "choosing stations"):
            found = calibrate(problem).identification if problem.is_dir() else None
            sigma = 1e-3 * (1.0 if noise_mm is None else noise_mm)
            stations = stations_ahead(found or problem, n or 25, view, sigma, room, seed)
        t.tell(console, *stations.blocks())
        out = out or Path("stations.csv")
        texts = {out: stations.table.to_csv(index=False)}
        t.save(t.with_json(texts, json_file, stations.to_json()), console)
        when = "when the poses of the board are in columns next to these readings"
        t.suggest(console, when, "calibrate", problem, out)
        return
    carried = o.carried_prior(prior, prior_effects, frozen=False)
    asked: dict[str, Any] = {"joint_noise_urad": joint_noise_urad, "min_distance": min_distance}
    asked |= {"noise_mm": noise_mm, "target_mm": target_mm, "order": order, "seed": seed}
    asked["room"] = room
    asked["effects"] = effects.split(",") if effects else ()
    asked["circumstances"] = circumstances_of(payloads, every_payload, both_approaches, repeats)
    asked["places"] = places_of(wires, sockets, places, known_places)
    out = out if n is None else out or Path("plan.csv")
    console = t.wrapped(quiet)
    with t.working(quiet, "choosing poses", steps=t.PLAN) as show:
        planned = plan_problem(problem, n, measured, carried, show=show, **asked)
    note = Words(planned_with(problem, measured, prior), "note")
    t.print_result(console, [*planned.blocks(), note], details)
    t.save(t.with_json(planned.files(out) if out else {}, json_file, planned.to_json()), console)
    if out:
        tables = (*([measured] if measured else []), out)
        when = "when what was measured is in columns next to these readings"
        t.suggest(console, when, "calibrate", problem, *tables)
    else:
        enough = planned.forecast.stop()
        what = "as many as you can measure" if enough is None else "so many"
        t.suggest(console, f"to choose {what}", *sys.argv[1:], "-n", enough or 100)
