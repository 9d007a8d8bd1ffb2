"""Files around the C: CMake, pkg-config, and CasADi's own C of the same functions as an independent cross-check."""

import casadi
import numpy as np

from casadical.export.c.c_files import SCHEMA, Label
from casadical.export.c.emit import filled, template
from casadical.export.c.tape_program import TapeProgram


def cmake(label: Label) -> str:
    """CMakeLists.txt: a static library, the example, the self-test under ctest, install with pkg-config."""
    return filled(template("CMakeLists.txt"), {"name": label.name, "schema": str(SCHEMA)})


def pkg_config(label: Label) -> str:
    """NAME.pc.in, which CMake fills with the prefix."""
    kept = {key: f"@{key}@" for key in ("CMAKE_INSTALL_PREFIX", "CMAKE_INSTALL_LIBDIR", "CMAKE_INSTALL_INCLUDEDIR")}
    return filled(template("pkg_config.pc.in"), kept | {"name": label.name, "schema": str(SCHEMA)})


def cross_check(program: TapeProgram, label: Label) -> str:
    """C by CasADi's own code generator (double, with math.h): a second way from the same functions to numbers."""
    generator = casadi.CodeGenerator(f"{label.name}_casadi", {"with_header": False})
    found = {} if program.network is None else {"network": program.network.function}
    if program.command is not None:
        found |= {"nominal": program.command.nominal, "calibrated": program.command.calibrated}
    for key, function in found.items():
        q = [casadi.SX.sym("q", program.n)]
        generator.add(casadi.Function(f"{label.name}_casadi_{key}", q, function.call(q)))
    return str(generator.dump())


def box_middle(program: TapeProgram) -> list[float]:
    """The middle of the box of joints, where the FMU and the structured text start."""
    return [float(v) for v in np.mean([program.product.lower, program.product.upper], axis=0)]
