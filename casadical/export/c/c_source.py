"""The text of the exported header and source: templates filled with a program's tapes, box and limits."""

from collections.abc import Sequence
from textwrap import wrap

import numpy as np

from casadical.core.basics import Array
from casadical.export.c.chord import pose_size, prepared_size, residual_size
from casadical.export.c.coefficients import COEFFICIENTS, DTYPE, Real, literal
from casadical.export.c.emit import elementary_functions, filled, kernel, template
from casadical.export.c.language import Label
from casadical.export.c.products import Command, Product
from casadical.export.c.tape_program import TapeProgram

SCHEMA = 1
# FLT_EVAL_METHOD where the type keeps its own precision.
_METHODS = {"float": (0, 16, 32), "double": (0, 1, 16, 32, 64)}


def header(program: TapeProgram, label: Label) -> str:
    """Text of NAME.h."""
    values = common_values(program, label)
    command, network = program.command, program.network
    parts = [template("network.h")] if network else []
    parts += [template("command.h")] if command else []
    values["prototypes"] = "".join(filled(part, values) for part in parts).rstrip("\n") + "\n"
    values["defines"] = filled(_COMMAND_DEFINES, values) if command else ""
    values["command_statuses"] = filled(_COMMAND_STATUSES, values) if command else ""
    values["not_finite_output"] = "; zeros are written"
    values["title"] = network.title if network and not command else "correction of joint commands"
    return filled(template("header.h"), values)


def source(program: TapeProgram, label: Label) -> str:
    """Text of NAME.c."""
    values = common_values(program, label)
    texts = [filled(template("network.c"), values)] if program.network else []
    if program.command:
        texts.append(filled(template("command.c"), values))
    values["functions"] = "".join(texts)
    values["elementary"] = elementary_functions(list(program.tapes.values()), label.name, program.real)
    values["kernels"] = "\n".join(
        kernel(tape, label.name, f"{name}_values", program.real) for name, tape in sorted(program.tapes.items())
    )
    return filled(template("source.c"), values)


_COMMAND_DEFINES = """
/* Largest correction of a joint [rad or m], and its largest change in one call of @name@_step */
#define @NAME@_DELTA_LIMIT @delta_decimal@
#define @NAME@_CHANGE_LIMIT @change_decimal@
"""
_COMMAND_STATUSES = """\
 *   RATE_LIMITED   the correction is on its way, as fast as it may change
 *   NOT_CONVERGED  more than @tolerance_mm@ mm remained before the last step; the correction is the best so far
 *   LIMITED        the correction is at its limit, all joints scaled alike
 *   SINGULAR       the arm can hardly move its tool in some direction; the correction is damped and within its limit
"""


def common_values(program: TapeProgram, label: Label) -> dict[str, str]:
    """Placeholders that every template may use."""
    real, command = program.real, program.command
    c = COEFFICIENTS[real]
    values = vars(label) | {
        "NAME": label.name.upper(),
        "real": real,
        "schema": str(SCHEMA),
        "bits": "binary32" if real == "float" else "binary64",
        "n": str(program.n),
        "steps": str(command.steps if command else 0),
        "box": _box_text(program.product),
        "joint_units": joint_units(program.product),
        "notes": _notes(command.notes) if command else "",
        "wider": " && ".join(f"(FLT_EVAL_METHOD != {m})" for m in _METHODS[real]),
        "MANT_DIG": "FLT_MANT_DIG" if real == "float" else "DBL_MANT_DIG",
        "mant_dig": "24" if real == "float" else "53",
        "0": literal(0.0, real),
        "1": literal(1.0, real),
        "9": literal(9.0, real),
        "share": literal(box_share(program.n), real),
        "largest": literal(c.largest, real),
    }
    values |= {f"box_table:{key}": _table(pair, real) for key, pair in boxes(program).items()}
    if program.network is not None:
        network = program.network
        values |= {"function": network.key, "out": network.out, "unit": network.unit, "what": network.title}
        values["n_out"] = str(len(program.network_bounds))
        values["network_bounds"] = "".join(
            f" *   {network.out}[{i}]  {low:.9g} to {high:.9g}\n"
            for i, (low, high) in enumerate(program.network_bounds)
        )
    return values | (_command_values(command, program, real) if command else {})


class CommandNumbers:
    """A command's limits as the C compares with them: per call, squared where squares are compared."""

    def __init__(self, command: Command) -> None:
        limits = command.limits
        self.delta, self.step = limits.delta_rad, limits.step_rad
        self.change = limits.rate_rad_s * limits.cycle_s
        self.ramp = min(limits.cycle_s / limits.ramp_s, 1.0)
        self.tolerance2 = (1e-3 * limits.tolerance_mm) ** 2
        self.weakness = 1.0 / (limits.singular_m_per_rad**2 + limits.damping**2)


def _command_values(command: Command, program: TapeProgram, real: Real) -> dict[str, str]:
    numbers, n_p, n = CommandNumbers(command), len(program.tapes["forward"].outputs), program.n
    prepared = prepared_size(command)
    pose = "position p [m]" if n_p == 3 else "position p[0..2] [m], then the columns of the rotation matrix"
    integers = {
        "n_p": n_p,
        "n_prepared": prepared,
        "n_work": prepared + pose_size(command),
        "i_weakness": prepared - 1,
        "n_moved": n + 1,
        "i_error": n,
    }
    values = {key: str(value) for key, value in integers.items()}
    values |= {key: repr(getattr(command.limits, key)) for key in ("cycle_s", "ramp_s", "rate_rad_s")}
    return values | {
        "pose_text": pose,
        "freedom": _freedom(command),
        "damping2": f"{command.limits.damping**2:.6g}",
        "step_limit": literal(numbers.step, real),
        "tolerance2": literal(numbers.tolerance2, real),
        "ramp": literal(numbers.ramp, real),
        "weakness_limit": literal(numbers.weakness, real),
        "delta_decimal": _decimal(numbers.delta, real),
        "change_decimal": _decimal(numbers.change, real),
        "tolerance_mm": f"{command.limits.tolerance_mm:.6g}",
    }


def _freedom(command: Command) -> str:
    """What the joints cannot move, in words."""
    moved, turned = command.freedom
    words = [f"in {moved} of 3 directions"] if moved < 3 else []
    if residual_size(command) == 6:
        words += [f"turned in {turned} of 3 directions as near as can be, the position first"] if turned < 3 else []
    return f",\n * {', '.join(words)}: the joints reach no more, and the status is of these" if words else ""


def _decimal(value: float, real: Real) -> str:
    """A constant for the header, where C++ before 17 takes no hexadecimal one; read back it is the same number."""
    return repr(float(DTYPE[real](value))) + ("F" if real == "float" else "")


def joint_units(product: Product) -> str:
    """Of the joints' readings, in words."""
    linear = [f"q[{i}]" for i, unit in enumerate(product.units) if unit == "m"]
    return f"radians, {', '.join(linear)} in metres" if linear else "radians"


def _box_text(product: Product) -> str:
    text = ""
    for i, (low, high, unit) in enumerate(zip(product.lower, product.upper, product.units, strict=True)):
        degrees = f"  ({np.rad2deg(low):.6g} to {np.rad2deg(high):.6g} deg)" if unit == "rad" else " m"
        text += f" *   q[{i}]  {low:.9g} to {high:.9g}{degrees}\n"
    return text


def _notes(notes: Sequence[str]) -> str:
    """Sentences as lines of a comment, which they cannot end."""
    safe = (note.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *") for note in notes)
    lines = [line for note in safe for line in wrap(note, 110, initial_indent="  - ", subsequent_indent="    ")]
    return "".join(f" *{line}\n" for line in (" Notes of the robot file:", *lines)) + " *\n" if notes else ""


def box_share(n: int) -> float:
    """A power of two by which n finite numbers can be multiplied so that their sum is finite."""
    return 2.0 ** -(n - 1).bit_length()


def boxes(program: TapeProgram) -> dict[str, tuple[Array, Array]]:
    """The boxes that inputs are moved into, by what they are for."""
    limits: dict[str, tuple[Array, Array]] = {}
    if program.command is not None:
        lower, upper, reach = program.command.lower, program.command.upper, program.command.limits.delta_rad
        limits |= {"command": (lower, upper), "reach": (lower - reach, upper + reach)}
    if program.network is not None:
        limits["network"] = (program.network.lower, program.network.upper)
    return limits


def _table(pair: tuple[Array, Array], real: Real) -> str:
    rows = ("{ " + ", ".join(literal(float(v), real) for v in side) + " }" for side in pair)
    return "{\n            " + ",\n            ".join(rows) + "\n        }"
