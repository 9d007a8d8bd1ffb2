"""Arguments and options that several commands share, in the same words."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Context, Option

from casadical.core.basics import InputError, shown

if TYPE_CHECKING:
    from casadical.project.problem import Carried

Reference = Annotated[
    Path | None,
    Option(
        "--reference",
        metavar="LOG",
        help="With joint logs: a log of the same arm in health on another day; what differs from it "
        "by more than a day's friction is a cause.",
    ),
]
DriveFile = Annotated[
    Path | None,
    Option(
        "--drive",
        metavar="FILE.toml",
        help="With joint logs: what is known of the drives, a table [drive]; default: that of the "
        "robot file, or drive.toml next to it.",
    ),
]


def _completion_of(module: str, name: str, *, listed: bool = False) -> Callable[[str], list[str]]:
    """Return a function for the shell that completes a word of an option.

    The possible words are those of `casadical.MODULE.NAME`, a function or a constant.

    listed : whether the option is a list by commas, of which the last word is completed
    """

    def complete(incomplete: str) -> list[str]:
        """Return the completions of what was typed so far."""
        names = getattr(import_module(f"casadical.{module}"), name)
        words: Iterable[str] = names() if callable(names) else names
        before, comma, last = incomplete.rpartition(",") if listed else ("", "", incomplete)
        return [f"{before}{comma}{word}" for word in words if word.lower().startswith(last.lower())]

    return complete


methods = _completion_of("project.problem_file", "all_methods")  # --method
losses = _completion_of("identification.residuals", "ALL_LOSSES")  # --loss
languages = _completion_of("export.c.write", "CONTROLLER_LANGUAGES", listed=True)  # export c --language
forms = _completion_of("export.model_file", "MODEL_FORMS")  # export model --to
effects = _completion_of("diagnosis.candidates", "all_effects", listed=True)  # --effects

Nominal = Annotated[
    Path | None,
    Option(
        metavar="NOMINAL",
        help="The controller's model of the robot, taken as rigid: the robot file or URDF from before the "
        "calibration, or the problem folder. What the calibrated robot differs from it is corrected.",
    ),
]
Compensator = Annotated[
    Path | None,
    Option(metavar="NET.json", help="A trained compensator, as `casadical calibrate --out` writes it."),
]
Payload = Annotated[
    float | None,
    Option(metavar="KG", min=0, max=1e5, help="Mass on the flange; default: that of the file."),
]
LeaveOut = Annotated[
    bool,
    Option(
        "--leave-out",
        help="Leave out effects of the robot that cannot be written there; otherwise they are "
        "refused, with what would be lost in millimetres.",
    ),
]
Tool = Annotated[
    str,
    Option(
        metavar="shared|own",
        help="shared: nominal and real robot have the calibrated file's tool. own: each has its own "
        "file's, for a measured point that is the controller's tool centre point.",
    ),
]
What = Annotated[
    str,
    Option(
        "--correct",
        metavar="position|pose",
        help="What the real tool reaches: the nominal tool's position by the least change of the joints, or its "
        "orientation too, as far as the joints reach it.",
    ),
]
Room = Annotated[
    Path | None,
    Option(
        metavar="FILE.toml",
        help="Where poses may lie: limits, floor, boxes, tracker; see docs/plan.md.",
    ),
]
Seed = Annotated[int, Option(min=0, help="Seed of everything random.")]
Steps = Annotated[int | None, Option(min=1, max=10, help="Least-squares steps of the correction; default: 2.")]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print errors only.")]
Json = Annotated[
    Path | None,
    Option(
        "--json",
        metavar="FILE",
        help="Write all figures as JSON; with several inputs, a list or a table of them.",
    ),
]


def _with_report(path: Path | None) -> Path | None:
    """Return the path of --report unchanged, after a check that plotly is installed."""
    if path:
        from casadical.core.reporting.page import require

        require()
    return path


Report = Annotated[
    Path | None,
    Option(
        "--report",
        metavar="FILE.html",
        callback=_with_report,
        help="Write an HTML report in one file (needs plotly).",
    ),
]


def robot_of(path: Path) -> Path:
    """Return the last method's robot file in a folder of results, or any other path unchanged."""
    if (path / "result.json").is_file() and not (path / "problem.toml").exists():
        from casadical.project.problem_file import result_in

        return result_in(path)
    return path


Details = Annotated[bool, Option("--details", help="Print all figures, parameters and findings.")]
Problems = Annotated[
    list[Path],
    Argument(
        metavar="PROBLEM_DIR...",
        help="Problem folders. Tables after one (CSV) take the place of its own; a robot file needs them.",
    ),
]
Problem = Annotated[
    Path,
    Argument(
        metavar="PROBLEM_DIR",
        callback=robot_of,
        help="Folder with the robot, a robot file, or a folder of results.",
    ),
]
Campaigns = Annotated[
    list[Path] | None,
    Argument(
        metavar="CAMPAIGN.csv...",
        help="Measured poses, of any kind; default: the tables of the problem folder.",
    ),
]
Effects = Annotated[
    str | None,
    Option(
        metavar="NAMES",
        autocompletion=effects,
        help="standard (the default), extended, or only these, by commas: names (backlash), labels "
        "(backlash@5), effect files (law.effect.toml, as diagnose --laws writes it, or one "
        "that defines effects).",
    ),
]
Prior = Annotated[
    Path | None,
    Option(
        metavar="ROBOT.toml",
        help="This robot as another campaign found it, with effects and covariance: its effects are "
        "put into the model, with their values and covariance as a prior; base and tool are "
        "fitted again.",
    ),
]
PriorEffects = Annotated[
    str | None,
    Option(
        metavar="NAMES",
        help="What of it is taken, by commas: effects (the default: those that do not follow the "
        "time of their campaign), names or labels of single ones, all (geometry and compliance "
        "too).",
    ),
]
Frozen = Annotated[
    bool,
    Option(
        "--frozen",
        help="Hold the prior's effects at their values; refused for readings outside of the ranges that it covers.",
    ),
]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace FILE if it is there.")]


def refuse_of_others(context: Context, mode: str, modes: Mapping[str, Sequence[str]]) -> None:
    """Check that no parameter of another mode of the command was given. Raises InputError.

    mode : name of the mode that runs, in words
    modes : name of a mode -> parameters that are allowed in it, of those that not all modes have
    """
    for parameter in context.command.params:
        theirs = [other for other, names in modes.items() if parameter.name in names]
        source = context.get_parameter_source(parameter.name or "")
        if theirs and mode not in theirs and source is not None and source.name == "COMMANDLINE":
            name = parameter.opts[0]
            name = name if name.startswith("-") else name.upper()
            if name in theirs:
                raise InputError(f"{name}: not together with {mode}; leave one of the two out")
            raise InputError(f"{name}: is for {' or '.join(theirs)}, not for {mode}; leave it out")


def refuse_taken(out: Path, overwrite: bool) -> None:
    """Check that a file is new or may be overwritten. Raises InputError."""
    if out.exists() and not overwrite:
        raise InputError(f"{out} is there already; give another file, or --overwrite")


def need(given: object, other: object, words: str) -> None:
    """Check that an option is not given without another one that it needs. Raises InputError."""
    if given and not other:
        raise InputError(words)


def problems_of(paths: Sequence[Path]) -> dict[str, tuple[Path, list[Path]]]:
    """Return name of a result -> problem folder or robot file, and the tables given after it.

    paths : as typed, tables after their folder or file. The name is that of the first table, else
    of the folder. Raises InputError for tables without a robot, a robot file without tables, and a
    name given twice.
    """
    given: list[tuple[Path, list[Path]]] = []
    for path in map(robot_of, paths):
        if path.is_dir() or path.suffix in ("", ".toml", ".urdf"):
            given.append((path, []))
        elif given:
            given[-1][1].append(path)
        else:
            raise InputError(f"{shown(path)}: whose poses? give a problem folder or a robot file before the table")
    by_name: dict[str, tuple[Path, list[Path]]] = {}
    for source, tables in given:
        if source.is_file() and not tables:
            raise InputError(f"{shown(source)}: is a robot alone; give its measured poses after it: POSES.csv")
        name = tables[0].stem if tables else source.resolve().name
        if name in by_name:
            raise InputError(f"{shown(source)}: a second problem of the name {name!r}; give them one after the other")
        by_name[name] = source, tables
    return by_name


def carried_prior(prior: Path | None, parts: str | None, frozen: bool) -> "Carried":
    """Return a function that takes parts of a robot file over into a robot.

    It returns that robot and the prior of the parts' parameters; without a file, the robot
    unchanged and None.

    prior : the file; parts : comma-separated names, None for "effects" (see `carry_over`)
    frozen : whether the values are fixed
    Raises InputError: parts or frozen without a file, or a file that cannot be read.
    """
    from casadical.project.problem import carried_from, nothing_carried

    if prior is None:
        if parts is not None or frozen:
            raise InputError(f"--{'frozen' if frozen else 'prior-effects'}: needs the robot file that --prior names")
        return nothing_carried
    return carried_from(prior, [name.strip() for name in (parts or "effects").split(",")], frozen)
