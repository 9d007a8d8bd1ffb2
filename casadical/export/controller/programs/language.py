"""Base class of the controllers' program languages, each a module listed in `PROGRAM_LANGUAGES`."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from casadical.core.basics import M_PER_MM, Array, InputError, errors_of
from casadical.core.transforms import frame, from_rpy, to_rpy
from casadical.export.controller.programs.target import RAD_PER_DEG, Given, Target


class ProgramLanguage(ABC):
    """A controller's programming language: how programs are read and their targets written.

    Derived classes have no constructor arguments.

    name : name of the language in messages
    suffixes : suffixes of its files, in lower case, with their dot
    units : factor of each number of a pose to SI
    pose : numbers of a pose, in words
    place : word for a target's position in the file, such as "line"
    report_beside : whether a report is written next to a corrected program
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[float, ...]] = (M_PER_MM, M_PER_MM, M_PER_MM, RAD_PER_DEG, RAD_PER_DEG, RAD_PER_DEG)
    pose: ClassVar[str]
    place: ClassVar[str] = "line"
    report_beside: ClassVar[bool] = True

    def decoded(self, source: str, content: bytes) -> str:
        """Return a program's bytes as text, one character each. Raises InputError as `text_of`."""
        return text_of(source, content)

    def written(self, source: str, text: str, results: Sequence[Any]) -> bytes:
        """Return the program's bytes with the new texts of its targets; all others are unchanged.

        source : path of the program; text : one character for each byte
        results : correction of each target, as of `CorrectedTarget`
        """
        pieces, end = [], 0
        for number, new in sorted(((n, t) for r in results for n, t in r.changes), key=lambda change: change[0].start):
            pieces += [text[end : number.start], new]
            end = number.stop
        return "".join([*pieces, text[end:]]).encode("latin-1")

    @abstractmethod
    def targets(self, source: str, text: str, given: Given, joints: int) -> list[Target]:
        """Return every target of a program in order, those that must stay unchanged included.

        source : path of the program, for messages; text : one character for each byte
        given : tools, bases and units from outside the program
        joints : number of joints
        Raises InputError that names the line where the program cannot be corrected.
        """

    @abstractmethod
    def matrix(self, values: Array) -> Array:
        """Return the transform, shape (4, 4) [m], of a pose's numbers, shape (k,) [SI].

        Raises InputError: the numbers are no pose, or targets of the language are joints alone.
        """

    @abstractmethod
    def values(self, T: Array, like: Array) -> Array:
        """Return the numbers of a pose, shape (k,) [SI]; of equivalent ones the nearest to `like`.

        T : the pose, shape (4, 4) [m]
        like : numbers of another pose, shape (k,) [SI]
        Raises InputError: targets of the language are joints alone.
        """

    def turns(self, q: Array) -> tuple[int, ...]:
        """Return the turns of joints as the language states them; () if it states none.

        q : joints, shape (n,) [rad or m]
        """
        return ()

    def turns_text(self, target: Target, turns: tuple[int, ...]) -> list[str]:
        """Return the new texts of the words that hold the turns, as many as `target.turn_text`.

        turns : new turns, as of the method `turns`
        """
        return [str(turn) for turn in turns]

    def move_line(self, joints: Sequence[float]) -> str:
        """Return lines of a slow motion to joints [deg or mm]. Raises InputError if it has none."""
        raise InputError(f"{self.name}: has no motion in a line; give krl, rapid, urscript or fanuc")

    def frame(self, where: str, values: Array) -> Array:
        """Return the transform, shape (4, 4) [m], of a tool or base.

        where : beginning of error messages; values : its numbers [SI]
        Raises InputError: they are not finite, or no pose.
        """
        if not np.isfinite(values).all():
            raise InputError(f"{where}: a tool or base needs finite numbers, {self.pose}")
        with errors_of(f"{where}: "):
            return self.matrix(values)

    def transform(self, option: str, text: str) -> Array:
        """Return the transform, shape (4, 4) [m], of a pose in an option of a command.

        option : name of the command's option, for messages
        text : numbers of the pose as the controller shows them, separated by commas
        Raises InputError: they are not as many as `units`, not finite, or no pose.
        """
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != len(self.units) or not np.isfinite(numbers).all():
            raise InputError(f"{option} {text}: give {len(self.units)} numbers with commas, {self.pose}")
        return self.frame(f"{option} {text}", np.array(numbers) * self.units)

    def shown(self, T: Array) -> str:
        """Return a pose, (4, 4) [m], as the text that `transform` reads: numbers and commas."""
        values = self.values(T, np.zeros(len(self.units)))
        return ",".join(f"{round(v / unit, 6) + 0.0:g}" for v, unit in zip(values, self.units, strict=True))


class AngleLanguage(ProgramLanguage):
    """Base class of languages whose poses are x, y, z and three angles about fixed axes.

    order : indices of roll, pitch and yaw among the angles
    """

    order: ClassVar[tuple[int, int, int]]

    def matrix(self, values: Array) -> Array:
        """Return the transform, shape (4, 4) [m], of x, y, z [m] and angles [rad], shape (6,)."""
        return frame(from_rpy(values[3:][list(self.order)]), values[:3])

    def values(self, T: Array, like: Array) -> Array:
        """Return x, y, z [m] and three angles [rad] of a pose, shape (6,).

        Of the equivalent angles they are the nearest to those of `like`.

        T : pose, shape (4, 4) [m]; like : other numbers of this kind, shape (6,) [m, rad]
        """
        roll, pitch, yaw = to_rpy(T[:3, :3])
        flipped = np.array([roll + np.pi, np.pi - pitch, yaw + np.pi])
        wanted = like[3:][list(self.order)]
        turn = 2 * np.pi
        near = [a - turn * np.round((a - wanted) / turn) for a in (np.array([roll, pitch, yaw]), flipped)]
        angles = np.empty(3)
        angles[list(self.order)] = min(near, key=lambda a: float(np.abs(a - wanted).max()))
        return np.concatenate([T[:3, 3], angles])


def text_of(source: str, content: bytes) -> str:
    """Return a program's bytes as text, one character per byte (Latin-1).

    source : name of the program, for messages; content : its bytes
    Raises InputError: a control character other than white space, as in compiled programs.
    """
    for place, byte in enumerate(content):
        if byte < 32 and byte not in b"\t\n\r\f\x1a":
            line = content.count(b"\n", 0, place) + 1
            raise InputError(
                f"{source}: line {line}: byte {byte} is not text; encrypted, compiled and UTF-16 "
                "programs cannot be corrected: give the program as the controller shows it, as text"
            )
    return content.decode("latin-1")
