"""The command `casadical new`."""

from pathlib import Path
from typing import TYPE_CHECKING

from typer import Abort, Argument, Context, Option, echo, prompt

from casadical.cli.options import Json, Quiet, refuse_of_others
from casadical.cli.terminal import print_written, suggest, tell, with_json, wrapped
from casadical.core.basics import InputError

if TYPE_CHECKING:
    from casadical.project.new import Question
    from casadical.project.problem import Problem


# Name, in messages, of the mode in which the user gives no robot.
EXAMPLE = "an example (--example, or no robot)"


def new(
    context: Context,
    folder: Path = Argument(..., metavar="DIR", help="The new folder; nothing is overwritten."),
    urdf: Path | None = Option(None, metavar="FILE", help="Take the robot from this URDF."),
    base_link: str | None = Option(None, metavar="LINK", help="First link of the arm in the URDF; default: its root."),
    tip_link: str | None = Option(
        None, metavar="LINK", help="Last link; default: the only moving end, or before a gripper."
    ),
    dh: Path | None = Option(
        None,
        metavar="FILE.csv",
        help="Take the robot from this table, one row per joint: a_mm, alpha_deg, d_mm, theta_deg, ...; or from "
        "the YAML of a UR arm's kinematics.",
    ),
    convention: str | None = Option(
        None, metavar="WORD", help="Convention of DH rows: modified (Craig; default) or standard."
    ),
    data: list[Path] | None = Option(
        None,
        metavar="FILE",
        help="Measured poses: CSV or text in any usual form, .xlsx, .mat, .npy or .npz, headings in five "
        "languages; a ROS bag with joint states and poses of a board; several files are joined by a column that they "
        "share, by time, or by the order of their rows; default: synthetic ones, marked as such.",
    ),
    headings: str | None = Option(
        None,
        metavar="NAMES",
        help="Headings of the columns, separated by commas, where the table has none: q1_deg,...,x_mm,...",
    ),
    eye_in_hand: bool = Option(
        False, "--eye-in-hand", help="The camera that measured is on the robot; default: as the poses look."
    ),
    eye_to_base: bool = Option(False, "--eye-to-base", help="The camera stands still and sees a target on the robot."),
    intrinsics: str | None = Option(
        None,
        metavar="FX,FY,CX,CY[,K1,K2,P1,P2,K3]",
        help="Of the camera, where the table has corners in its images: focal lengths and principal point [px], and "
        "OpenCV's coefficients of distortion.",
    ),
    example: bool = Option(
        False, "--example", help="An example arm with made-up poses, as is written without a robot."
    ),
    yes: bool = Option(False, "--yes", "-y", help="Take the most probable answer to every question on the table."),
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Write a commented problem folder that runs: from a URDF, a DH table, or as an example.

    What was understood of the measured poses is printed as a table and stored as `columns` in
    problem.toml. What the table does not tell is asked.

    Example: casadical new arm --dh dh.csv --data messung.csv

    Exit codes: 0 written, 2 bad input (then nothing was written), 70 a bug in casadical.
    """
    from casadical.project.new import new_problem

    # Parameters that only one kind of robot has.
    robot_options = {
        EXAMPLE: ("example",),
        "--urdf": ("urdf", "base_link", "tip_link", "data", "headings", "eye_in_hand", "eye_to_base", "intrinsics"),
        "--dh": ("dh", "convention", "data", "headings", "eye_in_hand", "eye_to_base", "intrinsics"),
    }
    refuse_of_others(context, EXAMPLE if example or not (urdf or dh) else "--urdf" if urdf else "--dh", robot_options)
    if eye_in_hand and eye_to_base:
        raise InputError("--eye-in-hand and --eye-to-base: a camera is in one place; give one of them")
    console = wrapped(quiet)

    def answer(problem: "Problem", files: list[Path]) -> dict[Path, str]:
        about = {"problem": problem.folder.name, "robot": problem.robot.name, "data": problem.data}
        return with_json({}, json_file, about | {"files": [str(path) for path in files]})

    problem = new_problem(
        folder,
        urdf=urdf,
        base_link=base_link,
        tip_link=tip_link,
        dh=dh,
        convention=convention or "modified",
        data=data,
        headings=headings or "",
        camera="in hand" if eye_in_hand else "to base" if eye_to_base else "",
        intrinsics=intrinsics or "",
        ask=None if yes else _ask,
        show=lambda block: tell(console, block),
        also=answer,
    )
    files = ", ".join(sorted(p.name for p in folder.iterdir() if p.is_file()))
    console.print(f"{folder}: {problem.robot.name}, {problem.robot.n} joints, {problem.origin}", soft_wrap=True)
    console.print(f"wrote {files} in {folder}", soft_wrap=True)
    suggest(console, "to look for slips before a calibration", "check", folder)
    print_written(json_file, console)


def _ask(question: "Question") -> str:
    """Return the choice of a question that the user types. Raises InputError without an answer."""
    choices = list(question.choices)
    for k, words in enumerate(choices, 1):
        echo(f"  {k}: {words}", err=True)
    number = 0
    while not 1 <= number <= len(choices):
        try:
            number = int(prompt(question.text, default=1, type=int, err=True))
        except Abort:
            raise InputError(
                f"{question.text} Nobody answered; --yes takes the first choice ({choices[0]}), or "
                "name the columns with their units in the file"
            ) from None
    return choices[number - 1]
