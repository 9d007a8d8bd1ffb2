"""The tapes of a product: what every controller language writes."""

from dataclasses import dataclass

import numpy as np

from casadical.core.basics import Array
from casadical.export.c.chord import advance, apart, prepare
from casadical.export.c.coefficients import DTYPE, Real
from casadical.export.c.intervals import bounds, without_needless_guards
from casadical.export.c.products import Command, NetworkFunction, Product
from casadical.export.c.tape import Tape, tape_of


@dataclass(frozen=True)
class TapeProgram:
    """A product ready to be written: its tapes by name.

    network_bounds : least and greatest value of each of the network's outputs
    """

    product: Product
    real: Real
    tapes: dict[str, Tape]
    network_bounds: tuple[tuple[float, float], ...]  # of its unit, hold for every input

    @property
    def n(self) -> int:
        return len(self.product.lower)

    @property
    def command(self) -> Command | None:
        return self.product if isinstance(self.product, Command) else None

    @property
    def look(self) -> str:
        """The tape that a command's steps look at the robot with."""
        return "apart" if "apart" in self.tapes else "forward"

    @property
    def network(self) -> NetworkFunction | None:
        """The network or the curves alone, or the network beside a command."""
        return self.product.network if isinstance(self.product, Command) else self.product


@dataclass(frozen=True)
class Operations:
    """How often each kind of operation occurs in a call: the same ones in every call."""

    of: str  # what is called
    count: dict[str, int]

    def text(self) -> str:
        words = [f"{self.count[kind]} {kind}" for kind in sorted(self.count, key=lambda k: -self.count[k])]
        return f"Operations of {self.of}, the same in every call: {', '.join(words)}."


_KINDS = {"add": "additions", "sub": "additions", "mul": "multiplications", "div": "divisions"}
_KINDS |= {op: op for op in ("sincos", "sqrt", "exp", "tansig", "atan2", "periodic")}
_FREE = ("input", "const", "sin", "cos")


def operations(program: TapeProgram) -> Operations:
    """Operations of one correction, or of the network or the curves alone."""
    key = program.network.key if program.network is not None else ""
    calls = {key: 1}
    if program.command is not None:
        key, steps = "correct", program.command.steps
        calls = {"prepare": 1, program.look: steps, "advance": steps + 1}
        calls |= {"bound": 1} if program.command.limit_mm is not None else {}
    count: dict[str, int] = {}
    for tape, times in calls.items():
        for node in program.tapes[tape].nodes:
            if times and node.op == "weighted_sum":
                for kind, more in (("multiplications", 0), ("additions", -1)):
                    count[kind] = count.get(kind, 0) + times * (len(node.args) + more)
            elif times and node.op not in _FREE:
                kind = _KINDS.get(node.op, "choices")
                count[kind] = count.get(kind, 0) + times
    return Operations(key, count)


def tape_program(product: Product, real: Real) -> TapeProgram:
    """Tapes of a product: `network` or `curves`; of a command `forward`, `prepare`, `advance`, perhaps those and
    `bound`.
    """
    tapes: dict[str, Tape] = {}
    network = product if isinstance(product, NetworkFunction) else product.network
    network_bounds: list[tuple[float, float]] = []
    if network is not None:
        lower, upper = _rounded(network.lower, real), _rounded(network.upper, real)
        tape = without_needless_guards(tape_of(network.function), lower, upper, real)
        intervals = bounds(tape, lower, upper, real)
        tapes[network.key], network_bounds = tape, [intervals[o] for o in tape.outputs]
    if isinstance(product, Command):
        tapes |= _command_tapes(product, real)
    return TapeProgram(product, real, tapes, tuple(network_bounds))


def _rounded(bound: Array, real: Real) -> Array:
    return bound.astype(DTYPE[real]).astype(np.float64)


def _command_tapes(command: Command, real: Real) -> dict[str, Tape]:
    reach = 1.001 * command.limits.delta_rad  # joints and corrections are added in the real type, and rounded
    boxes: dict[str, tuple[Array, Array]] = {
        "forward": (_rounded(command.lower, real) - reach, _rounded(command.upper, real) + reach),
        "prepare": (_rounded(command.lower, real), _rounded(command.upper, real)),
    }
    tapes = {"forward": tape_of(command.calibrated), "prepare": tape_of(prepare(command))}
    if command.difference is not None:
        ends = [
            np.append(box, np.full(len(box), sign * reach)) for box, sign in zip(boxes["prepare"], (-1, 1), strict=True)
        ]
        boxes["apart"], tapes["apart"] = (ends[0], ends[1]), tape_of(apart(command))
    if command.bound is not None:
        boxes["bound"], tapes["bound"] = boxes["prepare"], tape_of(command.bound)
    tapes = {key: without_needless_guards(tape, *boxes[key], real) for key, tape in tapes.items()}
    step = tape_of(advance(command))
    anything = np.full(step.n_in, np.inf)
    return tapes | {"advance": without_needless_guards(step, -anything, anything, real)}
