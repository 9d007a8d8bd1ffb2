"""C99: header, source, self-test and example, CMake and pkg-config, and CasADi's own C of the same functions."""

import casadi

from casadical.export.c.c_source import SCHEMA, header, source
from casadical.export.c.emit import filled, template
from casadical.export.c.language import Label, Language
from casadical.export.c.self_test import example_source, self_test_source
from casadical.export.c.tape_program import TapeProgram


class C99(Language):
    """The language that is compiled and compared; every export has it."""

    name = "c"

    def files(self, program: TapeProgram, label: Label) -> dict[str, str]:
        """What `write_c` compiles, and what an integrator needs around it."""
        name = label.name
        values = {"name": name, "schema": str(SCHEMA)}
        return {
            f"{name}.h": header(program, label),
            f"{name}.c": source(program, label),
            f"{name}_self_test.c": self_test_source(program, label),
            f"{name}_example.c": example_source(program, label),
            "CMakeLists.txt": filled(template("CMakeLists.txt"), values),
            f"{name}.pc.in": filled(template("pkg_config.pc.in"), values | _FILLED_BY_CMAKE),
            f"cross_check/{name}_casadi.c": other_source(program, label),
        }


_FILLED_BY_CMAKE = {
    key: f"@{key}@" for key in ("CMAKE_INSTALL_PREFIX", "CMAKE_INSTALL_LIBDIR", "CMAKE_INSTALL_INCLUDEDIR")
}


def other_source(program: TapeProgram, label: Label) -> str:
    """C by CasADi's own code generator (double, with math.h): a second way from the same functions to numbers."""
    generator = casadi.CodeGenerator(f"{label.name}_casadi", {"with_header": False})
    functions = {} if program.network is None else {program.network.key: program.network.function}
    if program.command is not None:
        functions |= {"nominal": program.command.nominal, "calibrated": program.command.calibrated}
    for key, function in functions.items():
        q = [casadi.SX.sym("q", program.n)]
        generator.add(casadi.Function(f"{label.name}_casadi_{key}", q, function.call(q)))
    return str(generator.dump())
