"""The C compilers of this machine, and a shared library made with one of them."""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from casadical.core.errors import CasadicalError

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
    run = subprocess.run([command, "--version"], capture_output=True, text=True, check=False)
    return run.stdout.splitlines()[0] if run.returncode == 0 and run.stdout else ""


def shared_library(
    compiler: Compiler, sources: list[Path], library: Path, flags: tuple[str, ...] = ("-O2", *WARNINGS)
) -> None:
    """Compile C99 sources to a shared library.

    Raises CasadicalError: the compiler reports an error or a warning; its output is in the message.
    """
    command = [compiler.command, "-std=c99", "-fPIC", "-shared", *flags, *map(str, sources), "-o", str(library)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if run.returncode != 0:
        raise CasadicalError(f"{compiler.version} does not compile {sources[0].name}:\n{run.stderr[:2000]}")
