"""CasADi functions compiled with the machine's C compiler, where there is one; kept in the user's cache."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import casadi as ca
import platformdirs

FLAGS = ("-O2", "-ffp-contract=off", "-fPIC", "-shared")


def compiler() -> str | None:
    """Path of the C compiler that is used: $CC, gcc, clang or cc; None where there is none."""
    return next(
        (path for name in (os.environ.get("CC"), "gcc", "clang", "cc") if name and (path := shutil.which(name))), None
    )


def cache_folder() -> Path:
    """Where compiled functions and formulas are kept; it may be missing."""
    return Path(os.environ.get("CASADICAL_CACHE") or platformdirs.user_cache_dir("casadical"))


def compiled(function: ca.Function) -> ca.Function:
    """The same function as machine code, or unchanged where no C compiler is found or it fails.

    The library's name holds the hash of source and flags, so that it is compiled once per machine and never stale.
    """
    cc = compiler()
    if cc is None:
        return function
    generator = ca.CodeGenerator("kernel.c")
    generator.add(function)
    source = generator.dump()
    digest = hashlib.sha256("\n".join((source, cc, *FLAGS)).encode()).hexdigest()[:32]
    library = cache_folder() / f"{function.name()}-{digest}.so"
    if not library.exists() and not _compile(cc, source, library):
        return function
    return ca.external(function.name(), str(library))


def _compile(cc: str, source: str, library: Path) -> bool:
    """Whether `library` could be made; it appears whole or not at all."""
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
            code, made = Path(scratch) / "kernel.c", Path(scratch) / "kernel.so"
            code.write_text(source)
            subprocess.run([cc, *FLAGS, "-o", str(made), str(code), "-lm"], check=True, capture_output=True)
            made.replace(library)
    except (OSError, subprocess.CalledProcessError):
        return False
    return True
