"""The commands `casadical verify` and `casadical certificate`: acceptance of a calibrated robot."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import Argument, Context, Exit, Option

from casadical.cli import terminal as t
from casadical.cli.options import Details, Effects, Json, Quiet, Report, refuse_of_others
from casadical.core.basics import InputError
from casadical.core.reporting.result import shortened

if TYPE_CHECKING:
    from casadical.project.acceptance.iso9283 import Iso9283
    from casadical.project.acceptance.verification import Verification

# Mode of the command -> names of its parameters, in addition to robot, tables and quiet; the first
# mode that is given is taken.
MODE_OPTIONS = {
    "--mujoco": ("mujoco", "effects", "seed", "out", "json_file"),
    "--touches": (
        *("touches", "tolerance_mm", "noise_mm", "fleet", "update", "chart", "report_file", "seed"),
        "json_file",
    ),
    "--iso9283": ("iso9283", "details", "json_file"),
    "a check of some ten poses": ("promised_mm", "details", "json_file"),
}


def verify(
    context: Context,
    robot: Path = Argument(
        ...,
        metavar="ROBOT.toml",
        help="A calibrated robot, as `casadical calibrate --out` writes it, or that folder (the "
        "method that counts); with --mujoco a problem folder or the robot file of the "
        "drawing.",
    ),
    tables: list[Path] | None = Argument(
        None,
        metavar="TEN.csv...",
        help="Some ten poses measured later, in any usual form; several count together. With "
        "--mujoco campaigns, each for itself; default: the tables of the problem folder.",
    ),
    promised_mm: float | None = Option(
        None,
        min=0.0,
        metavar="MM",
        help="Promised rms position error as the instrument reads it, its noise included; "
        "default: of the held-out poses, from result.json or diagnosis.json next to the "
        "robot file.",
    ),
    mujoco: bool = Option(
        False,
        "--mujoco",
        help="Replay measured poses in MuJoCo instead: with the nominal robot, the calibrated "
        "one, and that with the diagnosed causes. Two thirds of the poses are fitted, the "
        "others replayed.",
    ),
    iso9283: bool = Option(
        False,
        "--iso9283",
        help="The table is a test by ISO 9283, as `casadical plan --iso9283` plans it: AP, RP, "
        "variation with the approach, drift.",
    ),
    touches: bool = Option(
        False,
        "--touches",
        help="The tables are points touched in the frame of the calibration, one a day, as "
        "`plan --touches N` plans them: say whether the robot is valid on the last day, "
        "and what moved.",
    ),
    tolerance_mm: float | None = Option(
        None, min=0, help="With --touches: allowed rms error; default: twice the stated one."
    ),
    noise_mm: float | None = Option(None, min=0, help="With --touches: noise of a coordinate, one sigma."),
    fleet: Path | None = Option(
        None,
        metavar="FILE.json",
        help="With --touches: output of `fleet --json`; its changes count.",
    ),
    update: Path | None = Option(
        None,
        metavar="ROBOT.toml",
        help="With --touches: write the corrected robot if it is better.",
    ),
    chart: Path | None = Option(None, metavar="FILE.csv", help="With --touches: a row a day, with control limits."),
    report_file: Report = None,
    effects: Effects = None,
    seed: int | None = Option(
        None, min=0, help="Of the poses' split (--mujoco), of the draws (--touches); default: 0."
    ),
    out: Path | None = Option(
        None,
        metavar="DIR",
        help="With --mujoco: folder of models, CAMPAIGN.STAGE.xml (0: nominal).",
    ),
    details: Details = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Check with a few poses whether a calibrated robot still is as accurate as it was, or replay poses in MuJoCo.

    Base and tool are fitted again, because the instrument stands elsewhere. The rms error is
    compared with that of the held-out poses of the calibration. The replay needs MuJoCo: pip
    install 'casadical[mujoco]'.

    With --touches five points touched in the frame of the calibration say the same every day.

    Example: casadical verify results/KM.robot.toml ten.csv

    Exit codes: 0 still valid, or replayed, 2 bad input, 3 no optimum found, 5 no longer valid, 70 a
    bug in casadical.
    """
    given = (mujoco, touches, iso9283, True)
    refuse_of_others(context, next(mode for mode, own in zip(MODE_OPTIONS, given, strict=True) if own), MODE_OPTIONS)
    if mujoco:
        _replay(robot, tables, effects, seed or 0, out, json_file, quiet)
        return
    if not tables:
        which = "of each day; `casadical plan --touches 5` says which" if touches else "of some ten measured later"
        raise InputError(f"which poses? give a table {which}")
    if touches:
        count = str(tables[0])
        if count.isdecimal() and not tables[0].exists():
            raise InputError(f"--touches judges tables of days; casadical plan {robot} --touches {count} plans points")
        from casadical.fleet.touches import judge_touches

        asked: dict[str, Any] = {"noise_mm": noise_mm, "fleet": fleet, "seed": seed or 0}
        asked["tolerance_mm"] = tolerance_mm

        console = t.wrapped(quiet)
        with t.working(quiet, "what changed", tables[-1].name):
            judged = replace(judge_touches(robot, tables, **asked), update=update)
        t.tell(console, *judged.blocks())
        texts: dict[Path, str] = {chart: judged.chart_csv()} if chart else {}
        if update and judged.better:
            texts[update] = judged.updated_text()
        elif update:
            console.print(f"{update} is not written: {judged.why_not_updated}")
        if report_file:
            texts[report_file] = t.html([judged.page()])
        t.save(t.with_json(texts, json_file, judged.to_json()), console)
        if judged.verdict != "valid":
            raise Exit(t.EXIT_NOT_VALID)
        return
    from casadical.project.acceptance import verification

    console = t.wrapped(quiet)
    with t.working(quiet, "fitting base and tool", tables[0].name):
        checked: Iso9283 | Verification = (
            verification.iso9283(robot, tables) if iso9283 else verification.verify(robot, tables, promised_mm)
        )
    t.print_result(console, checked.blocks(), details)
    t.save(t.with_json({}, json_file, checked.to_json()), console)
    if iso9283:
        folder = robot if robot.is_dir() else robot.parent
        t.suggest(console, "to put it into a certificate", "certificate", folder, "--iso9283", tables[0])
    if isinstance(checked, verification.Verification) and not checked.valid:
        raise Exit(t.EXIT_NOT_VALID)


def _replay(
    problem: Path,
    tables: list[Path] | None,
    effects: str | None,
    seed: int,
    out: Path | None,
    json_file: Path | None,
    quiet: bool,
) -> None:
    """Replay measured poses of campaigns in MuJoCo, print the errors, and write requested files.

    tables : measured poses, None: the problem's own; effects : as of `effects_named`
    """
    from casadical.export.mjcf.equilibrium import load_mujoco
    from casadical.export.mjcf.replay import replay_campaign
    from casadical.project.diagnosis import effects_named, read_campaigns

    load_mujoco()
    console = t.plain(quiet)
    answers = []
    texts: dict[Path, str] = {}
    for campaign in read_campaigns(problem, tables):
        with t.working(quiet, "diagnosing", campaign.name, t.DIAGNOSIS) as show:
            replayed = replay_campaign(campaign.robot, campaign.sets[0], effects_named(effects), seed=seed, show=show)
        console.print(f"{campaign.title}, held-out poses replayed in MuJoCo")
        t.tell(console, *replayed.blocks())
        answers.append({"campaign": campaign.name, **replayed.to_json()})
        if out:
            texts |= {out / f"{campaign.name}.{k}.xml": s.export.text for k, s in enumerate(replayed.stages)}
    t.save(t.with_json(texts, json_file, answers), console)
    of_campaign = ("--campaign", tables[0]) if tables else ()
    command = ("export", "model", problem, "--out", "arm.xml", *of_campaign)
    t.suggest(console, "to keep it as a model", *command)


def certificate(
    results: Path = Argument(..., metavar="RESULTS", help="Folder that `casadical calibrate --out` wrote."),
    details: Path | None = Option(
        None,
        metavar="FILE.toml",
        help="Issuer, instrument, conditions, tolerance; default: nothing is stated, which the pages say.",
    ),
    out: Path | None = Option(None, metavar="FILE.pdf", help="Two pages (needs fpdf2)."),
    problem: Path | None = Option(
        None, metavar="PROBLEM_DIR", help="What was calibrated; default: as result.json names it."
    ),
    iso9283: Path | None = Option(None, metavar="TABLE.csv", help="A test as `plan` planned it."),
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Print certificate data of a calibration: results with uncertainty, budget, decision; in English or German.

    The uncertainty is that of the rms position error over the held-out poses, by a budget as the
    GUM asks for. These are data for a certificate: no accreditation is stated.

    Example: casadical certificate results --details certificate.toml --out cert.pdf

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    from casadical.project.acceptance.certificate import certificate as certified

    console = t.wrapped(quiet)
    with t.working(quiet, "uncertainty"):
        made = certified(results, details, problem=problem, iso9283=iso9283)
    blocks = made.blocks()
    t.tell(console, *shortened(blocks))
    if not out and not json_file:
        console.print("the whole budget: --out FILE.pdf or --json FILE", style="dim")
    texts: dict[Path, str | bytes] = {out: made.pdf()} if out else {}
    t.save(t.with_json(texts, json_file, made.to_json()), console)
    if out is None:
        t.suggest(console, "to have it as two pages", *sys.argv[1:], "--out", "certificate.pdf")
    else:
        t.suggest(console, "when some ten poses are measured again", "verify", results, "LATER.csv")
