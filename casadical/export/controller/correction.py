"""An offline program with corrected joint targets, and how far joints and tool move.

A row is corrected in all joints or in none: with a status other than OK it keeps its targets, and the summary lists it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from casadical.core.arrays import Array
from casadical.core.errors import CasadicalError, InputError
from casadical.export.c.kernel import load
from casadical.export.c.products import Command, mapped
from casadical.export.c.reference import Status
from casadical.export.c.reference import bound as reference_bound
from casadical.export.c.reference import correct as reference_correct
from casadical.export.c.tape_program import tape_program
from casadical.export.controller.offline_program import Program

LEAVES_BOX = "LEAVES_BOX"
POSITION_ONLY = "POSITION_ONLY"
FINE = (Status.OK.name, POSITION_ONLY)  # statuses of what is corrected
SHOWN = 20  # rows that a summary lists

MEANINGS = {
    Status.CLAMPED.name: "outside the joint ranges of the model",
    LEAVES_BOX: "the corrected targets would be outside the joint ranges of the model",
    Status.NOT_CONVERGED.name: "an error above the tolerance would remain",
    Status.LIMITED.name: "the correction would exceed its limit",
    Status.ABOVE_LIMIT.name: "the bound of the error that remains is above the limit that was asked for",
    Status.SINGULAR.name: "near a pose in which the tool cannot move in some direction",
    Status.NOT_FINITE.name: "the model has no value there; a four-bar cannot close, for instance",
}


@dataclass(frozen=True, eq=False)
class Corrector:
    """A way to correct joint targets: the compiled C of an export, or a model.

    joints : number of joints
    correct : q, shape (k, joints) [rad or m] -> corrections of the same shape, and status, shape (k,)
    position : q -> calibrated tool positions [m], shape (k, 3)
    target : q -> nominal tool positions [m], shape (k, 3); None where it is not known
    bound : q -> below it 95 % of the errors are that remain [mm], shape (k,); None where it is not known
    fallback : of the position alone, for targets whose pose cannot be corrected; None: they are refused
    units : "rad" or "m" of each joint's reading; none: all rad
    """

    joints: int
    correct: Callable[[Array], tuple[Array, Array]]
    position: Callable[[Array], Array]
    target: Callable[[Array], Array] | None = None
    bound: Callable[[Array], Array] | None = None
    fallback: "Corrector | None" = None
    units: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Corrected:
    r"""A corrected program.

    program : as it was read
    q : Array, shape (rows, joints) [rad or m]: corrected targets; refused rows keep theirs
    status : name of each row's status
    moved_mm : Array, shape (rows,): how far the correction moves the real tool
    rest_mm : Array | None, shape (rows, 2): distance of the real tool from the nominal one, before and after; None: not
        known
    bound_mm : Array | None, shape (rows,): below it 95 % of the errors are that remain; None: not known
    """

    program: Program
    q: Array
    status: tuple[str, ...]
    moved_mm: Array
    rest_mm: Array | None
    bound_mm: Array | None = None

    @property
    def fine(self) -> Array:
        """Which rows were corrected, boolean, shape (rows,)."""
        return np.array([s in FINE for s in self.status])

    def to_csv(self) -> str:
        """The program's table with the new targets and a status for each row."""
        return self.program.text(self.q, self.fine, self.status, self.bound_mm)

    def report(self) -> str:
        """The number of corrected rows, refused rows with their reasons, and how far joints and tool move."""
        return "\n".join([*_refused(self), *_moved(self)])

    def to_json(self) -> dict[str, Any]:
        """The summary as plain data: rows, refused ones by line of the file, how far the tool moves [mm]."""
        refused = {str(self.program.line[k]): self.status[k] for k in np.flatnonzero(~self.fine)}
        moved = self.moved_mm[self.fine]
        found: dict[str, Any] = {"rows": len(self.status), "corrected": int(self.fine.sum()), "refused": refused}
        if len(moved):
            found["moved_mm"] = {"mean": float(moved.mean()), "max": float(moved.max())}
        if self.rest_mm is not None and len(moved):
            before, after = self.rest_mm[self.fine].max(axis=0)
            found["off_nominal_mm_max"] = {"before": float(before), "after": float(after)}
        if self.bound_mm is not None and len(moved):
            bound = self.bound_mm[self.fine]
            found["bound_mm"] = {"mean": float(bound.mean()), "max": float(bound.max())}
        return found


def kernel_corrector(folder: Path, *, trust: bool = False) -> Corrector:
    """Correction by the C in an export folder, compiled here.

    folder : that `write_c` wrote
    trust : as of `casadical.export.c.kernel.load`
    Returns callable on arrays
    Raises InputError: no such export, or there is no compiler.
    """
    try:
        kernel = load(folder, trust=trust)
    except InputError:
        raise
    except CasadicalError as error:
        raise InputError(f"{folder}: {error}; or give the robot file in place of the folder") from None
    if "correct" not in kernel.shape.outputs:
        raise InputError(f"{folder}: holds no correction of a command; export with --what command")

    def position(q: Array) -> Array:
        return np.asarray(kernel.forward(q)[0], dtype=float)[:, :3]

    def correct(q: Array) -> tuple[Array, Array]:
        dq, status = kernel.correct(q)
        return np.asarray(dq, dtype=float), status

    def bound(q: Array) -> Array:
        return np.asarray(kernel.bound(q)[0], dtype=float)[:, 0]

    shape = kernel.shape
    return Corrector(
        shape.joints, correct, position, bound=bound if "bound" in shape.outputs else None, units=tuple(shape.units)
    )


def model_corrector(command: Command, fallback: Corrector | None = None) -> Corrector:
    """Correction by the export's reference in NumPy: the same bits as the exported double C, without a compiler.

    Parameters
    ----------
    command : Command
        what is corrected
    fallback : Corrector, optional
        as of `Corrector`

    Examples
    --------
    >>> command = casadical.export.command_of(casadical.export.Sources(found.robot, robot))
    >>> corrector = casadical.export.model_corrector(command)
    >>> dq, status = corrector.correct(poses.q[:3])
    >>> dq.shape, status
    ((3, 2), array([0, 0, 5]))
    """
    made = tape_program(command, "double")
    return Corrector(
        made.n,
        lambda q: reference_correct(made, q),
        lambda q: mapped(command.calibrated, q)[:, :3],
        lambda q: mapped(command.nominal, q)[:, :3],
        (lambda q: reference_bound(made, q)[0][:, 0]) if command.bound else None,
        fallback,
        command.units,
    )


def corrected(corrector: Corrector, program: Program) -> Corrected:
    r"""Correct every row of a program independently.

    corrector : model or compiled C
    program : joint targets
    Returns targets, status and what moves
    """
    q, names = corrected_joints(corrector, program.q)
    before, after = corrector.position(program.q), corrector.position(q)
    moved = 1e3 * np.linalg.norm(after - before, axis=1)
    rest = None
    if corrector.target is not None:
        target = corrector.target(program.q)
        rest = 1e3 * np.linalg.norm(np.stack([before, after], axis=1) - target[:, None], axis=2)
    bound = corrector.bound(program.q) if corrector.bound else None
    return Corrected(program, q, names, moved, rest, bound)


def corrected_joints(corrector: Corrector, q: Array) -> tuple[Array, tuple[str, ...]]:
    """Corrected joints, shape (k, n) [rad or m], and the names of the statuses; joints without one of `FINE` stay."""
    dq, status = corrector.correct(q)
    names = [Status(int(s)).name for s in status]
    beyond = corrector.correct(q + dq)[1] == Status.CLAMPED
    names = [LEAVES_BOX if b and n == Status.OK.name else n for b, n in zip(beyond, names, strict=True)]
    fine = np.array([n == Status.OK.name for n in names])
    new = np.where(fine[:, None], q + dq, q)
    if corrector.fallback is not None and not fine.all():
        other, reached = corrected_joints(corrector.fallback, q[~fine])
        for k, joints, name in zip(np.flatnonzero(~fine), other, reached, strict=True):
            if name in FINE:
                new[k], names[k] = joints, POSITION_ONLY
    return new, tuple(names)


def _refused(result: Corrected) -> list[str]:
    """The number of corrected rows, and each refused row with its reason."""
    rows = np.flatnonzero(~result.fine)
    lines = [f"{int(result.fine.sum())} of {len(result.status)} rows corrected{position_only(result.status)}"]
    if len(rows):
        lines[0] += f", {len(rows)} REFUSED and left as they were:"
    for k in rows[:SHOWN]:
        name = result.status[k]
        lines.append(f"  row {result.program.line[k]}: {name}, {MEANINGS[name]}")
    if len(rows) > SHOWN:
        lines.append(f"  and {len(rows) - SHOWN} more; see the status column")
    return lines


def position_only(status: tuple[str, ...]) -> str:
    """How many of the corrected ones are corrected in position only, in words."""
    count = status.count(POSITION_ONLY)
    return f" ({count} in position only, near poses in which the orientation cannot be corrected)" if count else ""


def _moved(result: Corrected) -> list[str]:
    """Mean and largest change of each joint and of the tool, over the corrected rows."""
    fine = result.fine
    if not fine.any():
        return ["nothing moved"]
    change = abs(result.q - result.program.q)[fine]
    lines = [f"{'moved by':<22}{'mean':>10}{'max':>10}"]
    for i, (column, unit) in enumerate(zip(change.T, result.program.units, strict=True), 1):
        word, factor = ("mm", 1e3) if unit in ("_mm", "_m") else ("deg", 180 / np.pi)
        lines.append(mean_and_max(f"joint {i} [{word}]", factor * column))
    lines.append(mean_and_max("tool [mm]", result.moved_mm[fine]))
    if result.rest_mm is not None:
        lines.append("distance of the tool from its nominal position, by the model")
        before, after = result.rest_mm[fine].T
        lines += [mean_and_max("before [mm]", before), mean_and_max("after [um]", 1e3 * after)]
    if result.bound_mm is not None:
        lines.append("95 % of the errors that remain are below, by what was measured (where the tool is alike)")
        lines.append(mean_and_max("bound [mm]", result.bound_mm[fine]))
    return lines


def mean_and_max(label: str, values: Array) -> str:
    """A line of a table of means and greatest values."""
    return f"  {label:<20}{values.mean():>10.4f}{values.max():>10.4f}"
