"""The commands `casadical withheld ...`: blind check of an own robot or a published round."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Exit, Option, echo

from casadical.cli.options import Json, Quiet
from casadical.cli.terminal import print_written, save, suggest, tell, with_json, working, wrapped
from casadical.core.basics import InputError, Show

if TYPE_CHECKING:
    from casadical.blind_check.protocol import Manifest


Folder = Annotated[Path, Argument(metavar="DIR", help="Folder with the campaigns.")]
Workers = Annotated[int | None, Option(min=1, max=1000, help="Processes; default: one a core.")]


def _counted(show: Show) -> Callable[[str, int, int], None]:
    """Return a function of campaign, number done and count that shows this progress."""
    return lambda name, done, count: show(f"{done} of {count} ({name})")


def withheld_robot(
    robot: Path = Argument(..., metavar="ROBOT.toml|FOLDER", help="Robot file (TOML or URDF), or a problem folder."),
    poses: str = Option(
        "60",
        metavar="N|TABLE.csv",
        help="Poses of a campaign: a number, or a table of them; what it logs is taken as it is.",
    ),
    noise_um: float = Option(20.0, min=0.01, max=1e5, help="Noise of a measured coordinate [um]."),
    n: int = Option(40, "--n", "-n", min=4, max=10_000, help="Number of campaigns."),
    not_logged: str = Option("", metavar="WORDS", help="Of temperature, payload, approach, time: what you do not log."),
    seed: int | None = Option(None, min=0, help="Of everything drawn; default: a random one."),
    workers: Workers = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """How often would a diagnosis of this robot, with this instrument, be right?

    Makes campaigns of robots as built after the file in MuJoCo, with effects hidden at random,
    diagnoses each from its table alone, and counts: claims that are right, false alarms, and which
    effects are found on this robot.

    Example: casadical withheld robot.toml --poses 60 --noise-um 20 --n 40

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.blind_check.own_robot import check_robot
    from casadical.blind_check.worker_pool import workers as pool
    from casadical.project.problem import read_campaign, read_campaign_robot

    subject = read_campaign_robot(robot)
    given = int(poses) if poses.isdigit() else read_campaign(robot, Path(poses), subject, readings_only=True)
    lacking = [word.strip() for word in not_logged.split(",") if word.strip()]
    with working(quiet, "drawing campaigns") as step, pool(None, workers) as executor:
        how: dict[str, Any] = {"executor": executor, "show": _counted(step)}
        how |= {"poses": given, "noise_um": noise_um, "n": n, "seed": seed, "not_logged": lacking}
        checked = check_robot(subject, **how)
    console = wrapped(quiet)
    tell(console, *checked.blocks())
    save(with_json({}, json_file, checked.to_json()), console)
    if poses.isdigit():
        suggest(console, "to choose these poses", "plan", robot, "-n", poses)
    else:
        command = ("plan", robot, poses, "--isolability")
        suggest(console, "to learn which effects look alike at these poses", *command)


def withheld_make(
    out: Path = Option(..., "--out", metavar="DIR", help="Folder for the campaigns."),
    key: Path | None = Option(None, metavar="DIR", help="Folder for the key, apart; default: DIR with -key behind it."),
    n: int = Option(60, "--n", "-n", min=4, max=10_000, help="Number of campaigns."),
    seed: int | None = Option(None, min=0, help="Of everything drawn; default: a random one, stored in the key."),
    poses: str = Option("40,100,200", metavar="N,N", help="Poses of a campaign, one of these."),
    project: Path = Option(Path(), metavar="DIR", help="Folder with problems/ and data/."),
    workers: Workers = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Write campaigns with hidden effects, and the key to another place; the key's SHA-256 goes with the campaigns.

    A quarter hides nothing, 45 % one effect, 15 % two or three, 15 % one that is on no list; 40,
    100 or 200 poses of three robots; a third lacks a column. With the seed, anyone can
    make the key again.

    Example: casadical withheld make --n 60 --out check --key sealed

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.blind_check.generation import make
    from casadical.blind_check.worker_pool import workers as pool

    try:
        sizes = tuple(int(word) for word in poses.split(","))
    except ValueError:
        raise InputError(f"--poses {poses}: allowed: whole numbers by commas, such as 40,100") from None
    place = key or out.with_name(f"{out.resolve().name}-key")

    def json_output(made: "Manifest") -> dict[Path, str]:
        about = {"campaigns": list(made.campaigns), "folder": str(out), "key": str(place)}
        return with_json({}, json_file, about | {"key_sha256": made.key_sha256})

    with working(quiet, "drawing campaigns") as step, pool(None, workers) as executor:
        show = _counted(step)
        how: dict[str, Any] = {"poses": sizes, "project": project, "executor": executor, "show": show}
        made = make(out, place, n, seed, also=json_output, **how)
    console = wrapped(quiet)
    console.print(f"wrote {len(made.campaigns)} campaigns to {out}, their key to {place}", soft_wrap=True)
    console.print(f"sha256 of the key: {made.key_sha256}", soft_wrap=True)
    print_written(json_file, console)
    suggest(console, "to have them diagnosed", "withheld", "predict", out)


def withheld_predict(
    folder: Folder,
    out: Path | None = Option(
        None, "--out", metavar="FILE", help="Answers in JSON; default: DIR/answers.diagnosis.jsonl."
    ),
    workers: Workers = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Diagnose every campaign from the files in DIR only.

    Answers that are in the file already stay there: a run that was cut goes on where it ended.

    Example: casadical withheld predict check

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.blind_check.prediction import predict
    from casadical.blind_check.worker_pool import workers as pool

    # Exit code after Ctrl-C, as shells have it.
    exit_interrupted = 130
    try:
        with working(quiet, "reading") as step, pool(None, workers) as executor:
            show = _counted(step)
            path = predict(folder, out, executor=executor, show=show)
    except KeyboardInterrupt:
        echo(
            "casadical: interrupted; the answers so far are stored, the same command goes on from there",
            err=True,
        )
        raise Exit(exit_interrupted) from None
    console = wrapped(quiet)
    console.print(f"wrote {path}", soft_wrap=True)
    usual = folder.with_name(f"{folder.resolve().name}-key")
    command = ("withheld", "score", folder, usual if usual.is_dir() else "KEYDIR", path)
    suggest(console, "to count what is right", *command)
    save(with_json({}, json_file, {"answers": str(path), "by": "diagnosis"}), console)


def withheld_score(
    folder: Folder,
    key: Path = Argument(..., metavar="KEYDIR", help="Folder with the key."),
    answers: Path = Argument(..., metavar="ANSWERS", help="File of answers."),
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Open the key, check that it is the one whose hash was published, and count: every figure with its interval.

    Example: casadical withheld score check sealed check/answers.diagnosis.jsonl

    Exit codes: 0 done, 2 bad input, 70 a bug in casadical.
    """
    from casadical.blind_check.scoring import score
    from casadical.core.reporting.result import terminal

    scored = score(folder, key, answers)
    console = wrapped(quiet)
    # Wide tables are for files and wide windows; they are never folded.
    wrapped(quiet, max(console.width, 240)).print(terminal(scored.blocks()), soft_wrap=True)
    save(with_json({}, json_file, scored.to_json()), console)
