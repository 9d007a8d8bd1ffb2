"""The command line as one tree of commands, each from its own module."""

from typing import Annotated, Any

from typer import Exit, Option, Typer, echo
from typer.core import TyperGroup

from casadical import __version__
from casadical.cli.calibrate import calibrate, check
from casadical.cli.correct import correct
from casadical.cli.diagnose import diagnose
from casadical.cli.export import export_c, export_model
from casadical.cli.fleet import compare, fleet
from casadical.cli.measure import measure
from casadical.cli.new import new
from casadical.cli.outputs import guarded
from casadical.cli.plan import plan
from casadical.cli.verify import certificate, verify
from casadical.cli.withheld import withheld_make, withheld_predict, withheld_robot, withheld_score


class RobotFirst(TyperGroup):
    """A command group whose first word may be a robot, which then goes to its command `robot`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the command `robot` before a first word that is no command."""
        own = bool(args) and args[0] not in (*self.commands, "--help", "-h")
        return super().parse_args(ctx, ["robot", *args] if own else args)


app = Typer(
    name="casadical",
    no_args_is_help=True,
    rich_markup_mode=None,  # brackets in helps are units
    help=(
        "Calibrate robots from measured poses.\n\n"
        "A PROBLEM_DIR is a folder with problem.toml, a robot file (TOML or URDF) and measurements (CSV, there or "
        "where problem.toml says). Start with an example, or with your own robot and table:\n\n"
        "    casadical new arm --example; casadical calibrate arm --out results\n\n"
        "    casadical new arm --urdf robot.urdf --data measured.csv"
    ),
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
withheld_app = Typer(
    cls=RobotFirst,
    no_args_is_help=True,
    help="Blind check of the diagnosis on campaigns of another physics engine, whose hidden effects are in a key. "
    "`casadical withheld ROBOT.toml` checks a robot of your own.",
)
export_app = Typer(
    no_args_is_help=True,
    help="Turn a calibrated robot into code for its controller, or into a model for another program.",
)


def _version(wanted: bool) -> None:
    """Print the version and stop, if it is wanted."""
    if wanted:
        echo(f"casadical {__version__}")
        raise Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        Option("--version", callback=_version, is_eager=True, help="Print the version and stop."),
    ] = False,
) -> None:
    """Define the options of `casadical` without a command."""


for command in (
    *(new, measure, check, calibrate, verify, compare),
    *(fleet, diagnose, plan, correct, certificate),
):
    # Parameters that name outputs, in addition to those that do so in all commands.
    outputs = {"new": ("folder",), "verify": ("update", "chart")}.get(command.__name__, ())
    app.command()(guarded(command, also=outputs))
export_app.command("c")(guarded(export_c))
export_app.command("model")(guarded(export_model))
for withheld_command in (withheld_robot, withheld_make, withheld_predict, withheld_score):
    name = withheld_command.__name__.removeprefix("withheld_")
    withheld_app.command(name)(guarded(withheld_command, also=("key",) if name == "make" else ()))
app.add_typer(export_app, name="export")
app.add_typer(withheld_app, name="withheld")
