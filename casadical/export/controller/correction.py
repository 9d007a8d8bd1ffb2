"""Correct joint targets, by a model or by the compiled C of an export.

A target is corrected in all joints or in none: unless its status is one of `CORRECTED_STATUSES`, it
remains unchanged.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from casadical.core.basics import Array, CasadicalError, InputError
from casadical.export.c.kernel import load
from casadical.export.c.products import Command, mapped
from casadical.export.c.reference import Status
from casadical.export.c.reference import correct as reference_correct
from casadical.export.c.tape_program import tape_program

# Statuses of targets that are corrected.
CORRECTED_STATUSES = (Status.OK.name, "POSITION_ONLY")

# Reason, in words, why a target with this status is not corrected.
STATUS_MEANINGS = {
    Status.CLAMPED.name: "outside the joint ranges of the model",
    "LEAVES_BOX": "the corrected targets would be outside the joint ranges of the model",
    Status.NOT_CONVERGED.name: "an error above the tolerance would remain",
    Status.LIMITED.name: "the correction would exceed its limit",
    Status.SINGULAR.name: "near a pose in which the tool cannot move in some direction",
    Status.NOT_FINITE.name: "the model has no value there; a four-bar cannot close, for instance",
}


@dataclass(frozen=True, eq=False)
class Corrector:
    """A function that corrects joint targets: the compiled C of an export, or a model.

    joints : number of joints
    correct : function of joint targets, shape (k, joints) [rad or m], that returns corrections to
        add, of the same shape and unit, and a `Status` of each target, shape (k,)
    position : function of joint targets that returns the calibrated tool's positions in the robot's
        own base frame, shape (k, 3) [m]
    fallback : corrector of the position alone, for targets whose pose cannot be corrected; None:
        these targets remain unchanged
    units : "rad" or "m" of each joint's reading; empty: all rad
    """

    joints: int
    correct: Callable[[Array], tuple[Array, Array]]
    position: Callable[[Array], Array]
    fallback: "Corrector | None" = None
    units: tuple[str, ...] = ()


def kernel_corrector(folder: Path, *, trust: bool = False) -> Corrector:
    """Return the corrector that calls the C in an export folder, which is compiled here.

    trust : whether the C of a folder that was not exported here is compiled and run, as of `load`
    Raises InputError: as of `load`, or the folder holds no correction of a command.
    """
    try:
        kernel = load(folder, trust=trust)
    except InputError:
        raise
    except CasadicalError as error:
        raise InputError(f"{folder}: {error}; or give the robot file in place of the folder") from None
    if "correct" not in kernel.shape.outputs:
        raise InputError(f"{folder}: holds no correction of a command; export with --what command")

    def rows(function: str, q: Array) -> tuple[Array, Array]:
        """Return values of an exported function at joints q as doubles, and statuses."""
        values, status = kernel.rows(function, q)
        return np.asarray(values, dtype=float), status

    shape = kernel.shape
    return Corrector(
        shape.joints,
        lambda q: rows("correct", q),
        lambda q: rows("forward", q)[0][:, :3],
        units=tuple(shape.units),
    )


def model_corrector(command: Command, fallback: Corrector | None = None) -> Corrector:
    """Return the corrector that evaluates a command in NumPy, with the bits of the exported C.

    command : correction of joint commands, evaluated in double
    fallback : as of `Corrector`

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
        fallback,
        command.units,
    )


def corrected_joints(corrector: Corrector, q: Array) -> tuple[Array, tuple[str, ...]]:
    """Return corrected joint targets, shape (k, n) [rad or m], and the name of each one's status.

    Targets whose status is none of `CORRECTED_STATUSES` are returned unchanged. The names are those
    of `Status`, LEAVES_BOX (corrected joints outside the box) and POSITION_ONLY (by the fallback).

    q : joint targets, shape (k, n) [rad or m]
    """
    dq, status = corrector.correct(q)
    names = [Status(int(s)).name for s in status]
    beyond = corrector.correct(q + dq)[1] == Status.CLAMPED
    names = ["LEAVES_BOX" if b and n == Status.OK.name else n for b, n in zip(beyond, names, strict=True)]
    fine = np.array([n == Status.OK.name for n in names])
    new = np.where(fine[:, None], q + dq, q)
    if corrector.fallback is not None and not fine.all():
        other, reached = corrected_joints(corrector.fallback, q[~fine])
        for k, joints, name in zip(np.flatnonzero(~fine), other, reached, strict=True):
            if name in CORRECTED_STATUSES:
                new[k], names[k] = joints, "POSITION_ONLY"
    return new, tuple(names)


def position_only(status: tuple[str, ...]) -> str:
    """Return a remark on the number of targets corrected in position only; "" if there are none.

    status : name of each target's status
    """
    count = status.count("POSITION_ONLY")
    return f" ({count} in position only, near poses in which the orientation cannot be corrected)" if count else ""
