"""Arguments and options that several commands have, in the same words."""

from pathlib import Path
from typing import Annotated

import typer

from casadical.cli import completion as words

Nominal = Annotated[
    Path | None,
    typer.Option(
        metavar="NOMINAL.toml", help="The controller's model of the robot: the robot file from before the calibration."
    ),
]
Compensator = Annotated[
    Path | None,
    typer.Option(metavar="NET.json", help="A trained compensator, as `casadical calibrate --out` writes it."),
]
Payload = Annotated[
    float | None, typer.Option(metavar="KG", help="Mass on the flange; default: as the robot file declares.")
]
LeaveOut = Annotated[
    bool,
    typer.Option(
        "--leave-out",
        help="Leave out effects of the robot that cannot be written there; otherwise they are refused, with what "
        "would be lost in millimetres.",
    ),
]
Tool = Annotated[
    str,
    typer.Option(
        metavar="shared|own",
        help="shared: nominal and real robot have the calibrated file's tool. own: each has its own file's, for a "
        "measured point that is the controller's tool centre point.",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write all figures as JSON; with several inputs, a list or a table of them."
    ),
]
Report = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE.html", help="Write an HTML report in one file (needs plotly and jinja2)."),
]
Problems = Annotated[list[Path], typer.Argument(metavar="PROBLEM_DIR...", help="One or more problem folders.")]
Problem = Annotated[Path, typer.Argument(metavar="PROBLEM_DIR", help="Folder with the robot, or a robot file.")]
Campaigns = Annotated[list[Path], typer.Argument(metavar="CAMPAIGN.csv...", help="Measured positions.")]
Effects = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        autocompletion=words.effects,
        help="standard (the default), extended, or only these: names (backlash) or labels (backlash@5), by commas.",
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace FILE if it is there.")]
