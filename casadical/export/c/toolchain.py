"""The C compilers of this machine, and a shared library made with one of them."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from casadical.core.errors import CasadicalError
from casadical.core.subprocesses import COMPILE_SECONDS, TRIAL_SECONDS, finished, tried

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


@dataclass(frozen=True)
class Compiler:
    """A compiler by its command and the first line of its version."""

    command: str
    version: str


def compilers() -> list[Compiler]:
    """gcc and clang where installed, else cc; an empty list on a machine without a C compiler."""
    found = [Compiler(name, version) for name in ("gcc", "clang") if (version := _version(name))]
    if not found and (version := _version("cc")):
        found = [Compiler("cc", version)]
    return found


def _version(command: str) -> str:
    if shutil.which(command) is None:
        return ""
    run = finished([command, "--version"], TRIAL_SECONDS)
    return run.stdout.splitlines()[0] if run and run.returncode == 0 and run.stdout else ""


def shared_library(
    compiler: Compiler, sources: list[Path], library: Path, flags: tuple[str, ...] = ("-O2", *WARNINGS)
) -> None:
    """Compile C99 sources to a shared library.

    Raises CasadicalError: the compiler reports an error or a warning (its output is in the message), does not end, or
    what it made cannot be loaded; it is loaded in a process of its own first.
    """
    command = [compiler.command, "-std=c99", "-fPIC", "-shared", *flags, *map(str, sources), "-o", str(library)]
    run = finished(command, COMPILE_SECONDS)
    if run is None:
        raise CasadicalError(f"{compiler.version} was stopped after {COMPILE_SECONDS:g} s with {sources[0].name}")
    if run.returncode != 0:
        raise CasadicalError(f"{compiler.version} does not compile {sources[0].name}:\n{run.stderr[:2000]}")
    if tried("import ctypes, sys; ctypes.CDLL(sys.argv[1])", str(library)) is None:
        raise CasadicalError(
            f"{compiler.version} made of {sources[0].name} what cannot be loaded; use another compiler"
        )
