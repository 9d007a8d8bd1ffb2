"""The command `casadical verify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from casadical.cli.options import Effects, Json, Quiet, effects_of
from casadical.cli.progress import DIAGNOSIS, working
from casadical.cli.terminal import NOT_VALID, keep, keep_json, plain, with_json, wrapped
from casadical.core.errors import InputError
from casadical.core.telling.terminal import terminal

Robot = Annotated[
    Path,
    typer.Argument(
        metavar="ROBOT.toml",
        help="A calibrated robot, as `casadical calibrate --out` writes it, or that folder (the method that counts); "
        "with --mujoco a problem folder or the robot file of the drawing.",
    ),
]
Tables = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="TEN.csv...",
        help="Some ten poses measured later, in any usual form; several count together. With --mujoco campaigns, each "
        "for itself; default: the tables of the problem folder.",
    ),
]
Promised = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        metavar="MM",
        help="Promised rms position error as the instrument reads it, its noise included; default: of the held-out "
        "poses, from result.json or diagnosis.json beside the robot file.",
    ),
]
Mujoco = Annotated[
    bool,
    typer.Option(
        "--mujoco",
        help="Replay measured poses in MuJoCo instead: with the nominal robot, the calibrated one, and that with the "
        "diagnosed causes. Two thirds of the poses are fitted, the others replayed.",
    ),
]
Iso9283 = Annotated[
    bool,
    typer.Option(
        "--iso9283",
        help="The table is a test by ISO 9283, as `casadical plan --iso9283` plans it: AP, RP, variation with the "
        "approach, drift.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="With --mujoco: write the models here, CAMPAIGN.STAGE.xml (0 is the nominal one)."
    ),
]
Split = Annotated[int | None, typer.Option(min=0, help="With --mujoco: seed of the split of the poses; default: 0.")]


def verify(
    robot: Robot,
    tables: Tables = None,
    promised_mm: Promised = None,
    mujoco: Mujoco = False,
    iso9283: Iso9283 = False,
    effects: Effects = None,
    seed: Split = None,
    out: Out = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Check with a few poses whether a calibrated robot still is as accurate as it was, or replay poses in MuJoCo.

    Base and tool are fitted again, because the instrument stands elsewhere. The rms error is compared with that of the
    held-out poses of the calibration. The replay needs MuJoCo: pip install 'casadical[mujoco]'.

    Example: casadical verify results/KM.robot.toml ten.csv

    Exit codes: 0 still valid, or replayed, 2 bad input, 3 no optimum found, 5 no longer valid, 70 a bug in casadical.
    """
    if mujoco:
        if promised_mm is not None:
            raise InputError("--promised-mm has no part in a replay with --mujoco; remove it")
        _replay(robot, tables, effects, seed or 0, out, json_file, quiet)
        return
    for option, value in (("--effects", effects), ("--seed", seed), ("--out", out)):
        if value is not None:
            raise InputError(f"{option} is of a replay; give --mujoco, too, or remove it")
    if not tables:
        raise InputError("which poses? give a table of some ten that were measured later")
    from casadical.project import verification

    console = wrapped(quiet)
    if iso9283:
        found = verification.iso9283(robot, tables)
        console.print(terminal(found.blocks()))
        keep_json(json_file, found.to_json(), console)
        return
    with working(quiet, "fitting base and tool", tables[0].name):
        checked = verification.verify(robot, tables, promised_mm)
    console.print(terminal(checked.blocks()))
    keep_json(json_file, checked.to_json(), console)
    if not checked.valid:
        raise typer.Exit(NOT_VALID)


def _replay(
    problem: Path,
    tables: list[Path] | None,
    effects: str | None,
    seed: int,
    out: Path | None,
    json_file: Path | None,
    quiet: bool,
) -> None:
    from casadical.export.mjcf.equilibrium import load_mujoco
    from casadical.export.mjcf.replay import replay_campaign
    from casadical.project.diagnosis import read_campaigns

    load_mujoco()
    console = plain(quiet)
    answers = []
    texts: dict[Path, str] = {}
    for campaign in read_campaigns(problem, tables):
        with working(quiet, "diagnosing", campaign.name, DIAGNOSIS) as show:
            replayed = replay_campaign(campaign.robot, campaign.sets[0], effects_of(effects), seed=seed, show=show)
        console.print(f"{campaign.title}, held-out poses replayed in MuJoCo")
        console.print(terminal(replayed.blocks()))
        answers.append({"campaign": campaign.name, **replayed.to_json()})
        if out:
            texts |= {out / f"{campaign.name}.{k}.xml": s.export.text for k, s in enumerate(replayed.stages)}
    keep(with_json(texts, json_file, answers), console)
