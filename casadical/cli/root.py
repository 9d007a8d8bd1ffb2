"""The command line as one tree: each command from its own module."""

import re
from typing import Annotated, Any

from typer import Exit, Option, Typer, echo
from typer.core import TyperCommand, TyperGroup

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
from casadical.cli.terminal import BAD_INPUT
from casadical.cli.verify import certificate, verify
from casadical.cli.withheld import withheld_make, withheld_predict, withheld_robot, withheld_score
from casadical.core.basics import InputError

# What commands of earlier versions are called now.
MOVED = {
    "discover": "diagnose PROBLEM_DIR CAMPAIGN.csv --laws",
    "replay": "verify PROBLEM_DIR CAMPAIGN.csv --mujoco",
    "export mjcf": "export model ROBOT.toml --to mjcf",
    "export urdf": "export model ROBOT.toml --to urdf",
    "export driver": "export model ROBOT.toml --to ur|standard_dh|modified_dh|xacro",
}

# Outputs of commands beside those that have the same name everywhere.
OUTPUTS = {"new": ("folder",), "verify": ("update", "chart", "poses")}

_TYPE = re.compile(r" <([^>]*)>")


class Command(TyperCommand):
    """A command whose help leaves the width to the words: without the types that click adds to what is given."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        records = [(p.param_type_name, p.get_help_record(ctx)) for p in self.get_params(ctx)]
        records = [(of, (_TYPE.sub(lambda t: " N" if "range" in t[1] else "", r[0]), r[1])) for of, r in records if r]
        for kind in ("argument", "option"):
            if shown := [record for of, record in records if of == kind]:
                with formatter.section(f"{kind.title()}s"):
                    formatter.write_dl(shown, col_max=24)


class Commands(TyperGroup):
    """A group that tells the new name of a command that moved, and lists each command with its whole sentence."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Without a command the help goes to standard output; click's would go to standard error."""
        if not args and not ctx.resilient_parsing:
            echo(ctx.get_help())
            raise Exit(BAD_INPUT)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """In place of click's, which cuts the sentences."""
        commands = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.get_short_help_str(limit=200)) for name, command in commands if command])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Raises InputError for an earlier name."""
        old = " ".join([*ctx.command_path.split()[1:], args[0]])
        if old in MOVED:
            raise InputError(f"{old} is now: casadical {MOVED[old]}")
        return super().resolve_command(ctx, args)


class RobotFirst(Commands):
    """A group whose first word may be a robot, for its default command."""

    default = "robot"

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """What to run: a command, or the check of the robot that is named."""
        own = bool(args) and args[0] not in (*self.commands, "--help", "-h")
        return super().parse_args(ctx, [self.default, *args] if own else args)


def _group(name: str | None = None, cls: type[Commands] = Commands, **settings: Any) -> Typer:
    return Typer(name=name, cls=cls, no_args_is_help=True, rich_markup_mode=None, **settings)


app = _group(
    "casadical",
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
withheld_app = _group(
    cls=RobotFirst,
    help="Blind check of the diagnosis on campaigns of another physics engine, whose hidden effects are kept in a key. "
    "`casadical withheld ROBOT.toml` checks a robot of your own.",
)
export_app = _group(help="Turn a calibrated robot into code for its controller, or into a model for another program.")


def _version(wanted: bool) -> None:
    if wanted:
        echo(f"casadical {__version__}")
        raise Exit


@app.callback()
def _root(
    version: Annotated[
        bool, Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


for command in (new, measure, check, calibrate, verify, compare, fleet, diagnose, plan, correct, certificate):
    app.command(cls=Command)(guarded(command, also=OUTPUTS.get(command.__name__, ())))
export_app.command("c", cls=Command)(guarded(export_c))
export_app.command("model", cls=Command)(guarded(export_model))
for of_round in (withheld_robot, withheld_make, withheld_predict, withheld_score):
    name = of_round.__name__.removeprefix("withheld_")
    withheld_app.command(name, cls=Command)(guarded(of_round, also=("key",) if name == "make" else ()))
app.add_typer(export_app, name="export")
app.add_typer(withheld_app, name="withheld")
