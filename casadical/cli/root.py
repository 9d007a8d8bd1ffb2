"""The command line as one tree: each command from its own module."""

from typing import Annotated

import typer

from casadical import __version__
from casadical.cli.calibrate import calibrate
from casadical.cli.check import check
from casadical.cli.compare import compare
from casadical.cli.correct import correct
from casadical.cli.diagnose import diagnose
from casadical.cli.discover import discover
from casadical.cli.export import export_app
from casadical.cli.fleet import fleet
from casadical.cli.new import new
from casadical.cli.outputs import guarded
from casadical.cli.plan import plan
from casadical.cli.replay import replay
from casadical.cli.verify import verify
from casadical.cli.withheld import withheld_app

app = typer.Typer(
    name="casadical",
    help=(
        "Calibrate robots from measured poses.\n\n"
        "A PROBLEM_DIR is a folder with problem.toml, a robot file (TOML or URDF) and measurements (CSV, there or "
        "where problem.toml says). Start with one of the folders in problems/, for example:\n\n"
        "    casadical calibrate problems/ur10 --out results/ur10"
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


for command in (new, check, calibrate, verify, compare, fleet, diagnose, discover, plan, replay, correct):
    app.command()(guarded(command, also=("folder",) if command is new else ()))
app.add_typer(export_app, name="export")
app.add_typer(withheld_app, name="withheld")
