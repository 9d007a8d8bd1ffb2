"""Options of the commands that put a calibrated robot on a controller: which files it is made from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Nominal = Annotated[
    Path | None,
    typer.Option(
        metavar="NOMINAL.toml", help="The robot as its controller computes it: the file from before the calibration."
    ),
]
Compensator = Annotated[
    Path | None, typer.Option(metavar="NET.json", help="A trained compensator, as save_compensator writes it.")
]
Payload = Annotated[
    float | None, typer.Option(metavar="KG", help="Mass on the flange; default: as the robot file declares.")
]
Tool = Annotated[
    str,
    typer.Option(
        metavar="shared|own",
        help="shared: nominal and real robot carry the calibrated file's tool. own: each its file's, for a measured "
        "point that is the controller's tool centre point.",
    ),
]
