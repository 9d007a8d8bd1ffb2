"""Reference results of the exported functions, computed in NumPy on many inputs at once, bit for bit.

Each function follows the C template of the same name, statuses included.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.export.c.c_source import box_share, boxes, command_numbers
from casadical.export.c.chord import prepared_size
from casadical.export.c.coefficients import DTYPE
from casadical.export.c.numpy_evaluation import run
from casadical.export.c.products import Command
from casadical.export.c.tape_program import TapeProgram


class Status(IntEnum):
    """What every exported function returns; where several apply, the highest number wins.

    ABOVE_LIMIT stands in the place of OK.

    Examples
    --------
    >>> casadical.export.Status(0).name
    'OK'
    """

    OK = 0
    CLAMPED = 1
    RATE_LIMITED = 2
    NOT_CONVERGED = 3
    LIMITED = 4
    SINGULAR = 5
    NOT_FINITE = 6
    NULL_ARG = 7
    SELF_TEST_FAILED = 8
    ABOVE_LIMIT = 9


def boxed(q: Array, box: tuple[Array, Array]) -> tuple[Array, Array]:
    """Inputs moved into a box of the same real type, and OK, CLAMPED or NOT_FINITE for each row."""
    T = q.dtype.type
    lower, upper = box[0].astype(T), box[1].astype(T)
    moved = np.zeros(len(q), T)
    with np.errstate(all="ignore"):
        a = np.where(q > lower, q, lower)
        x = np.where(a < upper, a, upper)
        distance = np.where(x < q, q - x, x - q)
        for i in range(q.shape[1]):
            moved = moved + T(box_share(q.shape[1])) * distance[:, i]
    status = np.where(moved > 0, Status.CLAMPED, Status.OK)
    return x, np.where(moved <= np.finfo(T).max, status, Status.NOT_FINITE)


def network(program: TapeProgram, q: Array) -> tuple[Array, Array]:
    """Of the network or the curves: its results, shape (k, m), and status, shape (k,), for joints q, shape (k, n)."""
    assert program.network is not None
    return _values(program, q, program.network.key, "network")


def forward(program: TapeProgram, q: Array) -> tuple[Array, Array]:
    return _values(program, q, "forward", "reach")


def bound(program: TapeProgram, q: Array) -> tuple[Array, Array]:
    """Bound of the error that remains [mm], shape (k, 1), and status."""
    return _values(program, q, "bound", "command")


def _values(program: TapeProgram, q: Array, tape: str, box: str) -> tuple[Array, Array]:
    q = np.ascontiguousarray(q, DTYPE[program.real])
    x, status = boxed(q, boxes(program)[box])
    values, fine = run(program.tapes[tape], x, program.real)
    status = np.where(fine & np.isfinite(values).all(1), status, Status.NOT_FINITE)
    values[status == Status.NOT_FINITE] = 0
    return values, status


def correct(program: TapeProgram, q: Array) -> tuple[Array, Array]:
    """Joint corrections dq, shape (k, n), and status, shape (k,)."""
    assert program.command is not None
    q = np.ascontiguousarray(q, DTYPE[program.real])
    x, status = boxed(q, boxes(program)["command"])
    dq, chord_status = _chord(program, program.command, x)
    bad = status == Status.NOT_FINITE
    dq[bad] = 0
    status = np.where(bad, status, np.maximum(status, chord_status))
    if program.command.limit_mm is not None:
        limit = DTYPE[program.real](command_numbers(program.command).bound_mm)
        mm, known = run(program.tapes["bound"], x, program.real)
        status = np.where((status == Status.OK) & ~(known & (mm[:, 0] <= limit)), Status.ABOVE_LIMIT, status)
    return dq, status


def _limited(v: Array, limit: Any) -> tuple[Array, Array]:
    most = np.zeros(len(v), v.dtype)
    for i in range(v.shape[1]):
        magnitude = np.where(v[:, i] < 0, -v[:, i], v[:, i])
        most = np.where(magnitude > most, magnitude, most)
    beyond = most > limit
    scaled = v * (limit / np.where(beyond, most, limit))[:, None]
    low = np.where(scaled > -limit, scaled, -limit)
    return np.where(low < limit, low, limit), beyond


def _chord(program: TapeProgram, command: Command, x: Array) -> tuple[Array, Array]:
    T, real, numbers = DTYPE[program.real], program.real, command_numbers(command)
    n, end = program.n, prepared_size(command)
    work, fine = run(program.tapes["prepare"], x, real)
    dq = np.zeros_like(x)
    moved = np.zeros((len(x), n + 1), T)
    before = np.full(len(x), np.finfo(T).max, T)
    wrong = work[:, end - 1] - work[:, end - 1]
    with np.errstate(all="ignore"):
        for step in range(command.steps + 1):
            if step > 0:
                before = moved[:, n].copy()
                at = np.hstack([x, dq]) if program.look == "apart" else x + dq
                work[:, end:], fine_now = run(program.tapes[program.look], at, real)
                fine &= fine_now
            moved, fine_now = run(program.tapes["advance"], work, real)
            fine &= fine_now
            wrong = wrong + (moved[:, n] - moved[:, n])
            moved[:, :n], step_clamped = _limited(moved[:, :n], T(numbers.step))
            there, limited = _limited(dq + moved[:, :n], T(numbers.delta))
            taken = (step < command.steps) | (T(9) * moved[:, n] <= before)
            dq = np.where(taken[:, None], there, dq)
        fine &= wrong >= 0
        status = np.where(step_clamped | (moved[:, n] > T(numbers.tolerance2)), Status.NOT_CONVERGED, Status.OK)
        status = np.where(limited, Status.LIMITED, status)
        status = np.where(work[:, end - 1] > T(numbers.weakness), Status.SINGULAR, status)
    dq[~fine] = 0
    return dq, np.where(fine, status, Status.NOT_FINITE)


@dataclass
class StepState:
    """The exported state struct: the correction last given, shape (n,), and the gain."""

    dq: Array
    gain: Any


def started(program: TapeProgram) -> StepState:
    T = DTYPE[program.real]
    return StepState(np.zeros(program.n, T), T(0))


def step(program: TapeProgram, state: StepState, q: Array, enable: bool) -> tuple[Array, Status]:
    """One cycle: the correction for joints q of shape (n,); the state is changed as the C changes it."""
    assert program.command is not None
    T, numbers = DTYPE[program.real], command_numbers(program.command)
    delta, change_limit, ramp = T(numbers.delta), T(numbers.change), T(numbers.ramp)
    want, statuses = correct(program, q[None, :])
    status = Status(int(statuses[0]))
    if not (np.isfinite(state.dq).all() and (abs(state.dq) <= delta).all() and T(0) <= state.gain <= T(1)):
        state.dq, state.gain, status = np.zeros(program.n, T), T(0), Status.NOT_FINITE
    state.gain = min(max(state.gain + (ramp if enable else -ramp), T(0)), T(1))
    change = state.gain * want[0] - state.dq
    if (abs(change) > change_limit).any():
        status = max(status, Status.RATE_LIMITED)
    moved = state.dq + np.clip(change, -change_limit, change_limit)
    state.dq = np.clip(moved, -delta, delta)
    return state.dq.copy(), status
