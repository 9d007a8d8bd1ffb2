"""The command `casadical diagnose`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Context, Option

from casadical.cli import options as o
from casadical.cli.terminal import DIAGNOSIS, html, importing, save, suggest, tell, with_json, working, wrapped
from casadical.core.basics import shown
from casadical.core.reporting.blocks import Block, Table
from casadical.core.reporting.result import shortened

if TYPE_CHECKING:
    from rich.console import Console

    from casadical.project.diagnosis import CampaignDiagnosis


# Kind of tables -> names of the parameters that are allowed for it alone.
MODE_OPTIONS = {
    "joint logs": ("reference", "drive", "against"),
    "measured poses": (
        *("together", "laws", "nuisance_masses", "prior", "prior_effects", "frozen"),
        *("measure_next", "next_n", "room", "network", "bootstrap", "seed", "unlisted"),
    ),
}


def diagnose(
    context: Context,
    problem: o.Problem,
    campaigns: o.Campaigns = None,
    reference: o.Reference = None,
    drive: o.DriveFile = None,
    against: list[Path] | None = Option(
        None,
        "--against",
        metavar="FILE",
        help="With joint logs: drive parameters to replay in addition to the fit, and to judge one by one: "
        "an MJCF with actuators, a robot file with [drive], or a CSV table (joint, kp, friction, "
        "damping, armature, delay). Can be given several times.",
    ),
    together: bool = Option(
        False,
        "--together",
        help="The tables are of one robot as it stood, by one or several instruments, and are "
        "diagnosed as one; each has noise of its own.",
    ),
    effects: o.Effects = None,
    laws: bool | None = Option(
        None,
        "--laws/--no-laws",
        help="Search for the law of what no listed effect explains: where it acts, what it "
        "follows, in which form; with --out also discovered.robot.toml, law.effect.toml "
        "(for --effects), discovery.json, discovery.txt. Default: where the verdict is "
        "unknown for more than the size of the noise, and as a rival of all causes that were "
        "found; --no-laws: never.",
    ),
    nuisance_masses: bool = Option(
        False,
        "--nuisance-masses",
        help="Wrong declared masses of links are part of the base model, not a cause that may be named.",
    ),
    prior: o.Prior = None,
    prior_effects: o.PriorEffects = None,
    frozen: o.Frozen = False,
    measure_next: Path | None = Option(
        None, "--next", metavar="FILE", help="Write poses that distinguish leading causes, as CSV."
    ),
    next_n: int = Option(15, min=1, max=1000, help="How many of these poses."),
    room: o.Room = None,
    network: bool = Option(False, "--network", help="Networks without and after causes (slow)."),
    bootstrap: int = Option(
        0,
        min=0,
        max=1_000_000,
        metavar="N",
        help="Draws of noise alone that calibrate whether something is there: 2000.",
    ),
    seed: o.Seed = 0,
    out: Path | None = Option(
        None,
        metavar="DIR",
        help="Write diagnosed.robot.toml, the robot with its causes, for every command that "
        "takes a robot file; diagnosis.json and diagnosis.txt. With several campaigns, a "
        "folder for each.",
    ),
    unlisted: bool = Option(False, "--unlisted", help="With --out: model an unknown cause, too."),
    report_file: o.Report = None,
    json_file: o.Json = None,
    details: o.Details = False,
    quiet: o.Quiet = False,
) -> None:
    """Explain the error that is left: where it lies, which effect causes it, and how far it shrinks with the effect.

    Prints the verdict, the error before and after, and what must be known of them; with --details
    all that was found. Tables of a controller's own log (time_s, command1_rad, q1_rad, current1_A
    ...) are diagnosed as such: why the joints move otherwise than the model.

    Example: casadical diagnose arm CAMPAIGN.csv --details --report report.html

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    with importing():
        from casadical.project.diagnosis import diagnose_campaign, effects_named, read_campaigns, read_logs

    logs = read_logs(problem, campaigns, reference, drive, effects.split(",") if effects else ())
    o.refuse_of_others(context, "joint logs" if logs else "measured poses", MODE_OPTIONS)
    console = wrapped(quiet)
    texts: dict[Path, str | bytes] = {}
    if logs:
        with working(quiet, "diagnosing", f"{len(logs.logs)} logs") as show:
            found = logs.diagnosed(show)
        with working(quiet, "replaying") as show:
            replay = logs.replayed(show, against or [])
        # How large the gap is and what makes it comes before what a usual arm would have; tables end.
        printed: list[Block] = []
        lines_found = 22 if not replay else 1 if found.named else 3
        for result, n_lines in ((replay, 20 + 2 * len(against or [])), (found, lines_found)):
            if result:
                blocks = result.blocks()
                printed += blocks if details else shortened(blocks, n_lines)
                if out:
                    texts |= result.files(out)
        if not details:
            printed.sort(key=lambda block: isinstance(block, Table))
        tell(console, *printed)
        console.print()
        if report_file:
            texts[report_file] = html([logs.page(found, replay)])
        if not details:
            more_by = "--details, --out DIR or --report FILE.html"
            console.print(f"residuals, causes and what the log lacks: {more_by}", style="dim")
        more = {"replay": replay.to_json()} if replay else {}
        figures = [found.to_json() | more] if json_file else []
        save(with_json(texts, json_file, figures), console)
        robot = next((path for path in texts if path.name == "diagnosed.robot.toml"), None)
        if robot:
            suggest(console, "to have a moving model", "export", "model", robot, "--out", "arm.xml")
        elif out is None and found.verdict not in ("ambiguous", "unknown"):
            suggest(console, "to keep what was replayed", *sys.argv[1:], "--out", "diagnosed")
        return
    o.need(room, measure_next, "--room says where the poses of --next may lie; give --next FILE, too")
    o.need(unlisted, out, "--unlisted says what --out writes; give --out DIR, too")
    carried = o.carried_prior(prior, prior_effects, frozen)
    given = read_campaigns(problem, campaigns, carried, together=together, room=room)
    if given[0].own_effects:
        console.print(f"Effects of the robot file are in the model, fixed at their values: {given[0].own_effects}.")
    chosen = effects_named(effects)
    file = measure_next if len(given) == 1 else None
    answers: list[CampaignDiagnosis] = []
    for campaign in given:
        with working(quiet, "diagnosing", campaign.name, DIAGNOSIS) as show:
            name = file.name if file else ""
            diagnosed = diagnose_campaign(
                campaign,
                chosen,
                seed=seed,
                bootstrap=bootstrap,
                masses="nuisance" if nuisance_masses else "candidate",
                laws=laws,
                show=show,
            )
            answer = diagnosed.analysed(poses=next_n, networks=network, file=name, show=show)
            if out:
                show("the robot with its causes")
                texts |= answer.files(out if len(given) == 1 else out / campaign.name, unlisted=unlisted)
        answers.append(answer)
        texts |= _print_diagnosis(answer, details, file, console)
    if report_file:
        from casadical.export.mjcf.replay import replay_blocks

        with working(quiet, "writing the report"):
            texts[report_file] = html([a.page([*replay_blocks(a.diagnosis)]) for a in answers])
    save(
        with_json(texts, json_file, [answer.to_json() for answer in answers] if json_file else []),
        console,
    )
    if len(answers) > 1:
        tables = [a.campaign.tables[0] for a in answers]
        suggest(console, "to learn what changed between them", "compare", problem, *tables)
    else:
        robot = out / "diagnosed.robot.toml" if out else None
        tell(console, answers[0].next_command(sys.argv[1:], robot, file))
    if not details:
        console.print(
            "where it lies, how certain, what remains: --details, --out DIR or --report FILE.html",
            style="dim",
        )


def _print_diagnosis(found: CampaignDiagnosis, details: bool, file: Path | None, console: Console) -> dict[Path, str]:
    """Print a diagnosis, and return path -> text of the table of poses to measure next, or {}.

    details : whether all results are printed; file : of that table, None: it was not asked for
    """
    tell(console, *found.detailed() if details else found.brief())
    if found.searched:
        tell(console, *found.searched.blocks())
    console.print()
    if file is None or found.details.poses is None:
        return {}
    if len(found.details.poses):
        return {file: found.details.poses.to_csv(index=False)}
    console.print(f"{shown(file)}: not written: no listed causes to tell apart", markup=False)
    return {}
