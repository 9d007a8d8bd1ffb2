"""The command `casadical replay`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from casadical.cli.options import Campaigns, Effects, Json, Problem, Quiet
from casadical.cli.progress import DIAGNOSIS, working
from casadical.cli.terminal import keep, keep_json, plain


def replay(
    problem: Problem,
    campaigns: Campaigns = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write the models here, CAMPAIGN.STAGE.xml (0 is the nominal one)."),
    ] = None,
    effects: Effects = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the split: two thirds of the poses are fitted, the others replayed.")
    ] = 0,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Replay measured poses in MuJoCo: with the nominal robot, the calibrated one, and that with the diagnosed effect.

    Needs MuJoCo: pip install 'casadical[mujoco]'.

    Example: casadical replay problems/hh800 CAMPAIGN.csv --effects backlash --out models

    Exit codes: 0 done, 2 bad input, 3 no optimum found, 70 a bug in casadical.
    """
    from casadical.export.mjcf.equilibrium import load_mujoco
    from casadical.export.mjcf.replay import replay_campaign
    from casadical.project.diagnosis import read_campaigns

    load_mujoco()
    console = plain(quiet)
    answers: list[dict[str, Any]] = []
    texts: dict[Path, str] = {}
    for campaign in read_campaigns(problem, campaigns):
        (m,), name = campaign.sets, campaign.name
        chosen = effects.split(",") if effects else "standard"
        with working(quiet, "diagnosing", name, DIAGNOSIS) as show:
            found = replay_campaign(campaign.robot, m, chosen, seed=seed, show=show)
        console.print(f"{campaign.title}, held-out poses replayed in MuJoCo")
        console.print(found.table.to_string(index=False, float_format=lambda v: f"{v:.4f}"))
        for text in found.stages[-1].export.left_out:
            console.print(f"LEFT OUT {text}")
        answers.append({"campaign": name, **found.to_json()})
        if out:
            texts |= {out / f"{name}.{k}.xml": s.export.text for k, s in enumerate(found.stages)}
    keep(texts, console)
    keep_json(json_file, answers, console)
