"""CasADi functions compiled with the machine's C compiler, where there is one; kept in the user's own cache.

A library is used only if its content has the hash in its name; it gets that name after it was loaded in a process of
its own and gave there what CasADi gives. Where anything is in doubt, the library is made again, or the function is used
as it is.
"""

import hashlib
import json
import os
import shutil
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

from casadical.core.files import PREFIX
from casadical.core.private_folder import private_folder
from casadical.core.subprocesses import COMPILE_SECONDS, finished, tried

FLAGS = ("-O2", "-ffp-contract=off", "-fPIC", "-shared")
# Prints the outputs of a compiled function at one point; run in a process of its own.
_TRIAL = """
import json, sys, casadi
f = casadi.external(sys.argv[1], sys.argv[2])
out = f.call([casadi.DM(v).reshape(f.sparsity_in(k).shape) for k, v in enumerate(json.loads(sys.argv[3]))])
print(json.dumps([[x.hex() for x in casadi.densify(o).nonzeros()] for o in out]))
"""


def compiler() -> str | None:
    """Path of the C compiler that is used: $CC, gcc, clang or cc; None where there is none."""
    return next(
        (path for name in (os.environ.get("CC"), "gcc", "clang", "cc") if name and (path := shutil.which(name))), None
    )


def compiled(function: ca.Function, *, make: bool = True) -> ca.Function:
    """The same function as machine code, or unchanged where there is no C compiler or no cache of one's own.

    make : whether a library that is not there is made
    The library's name holds the hash of source and flags, so that it is compiled once per machine and never stale, and
    the hash of its own content.
    """
    cc, folder = compiler(), private_folder()
    if cc is None or folder is None:
        return function
    generator = ca.CodeGenerator("kernel.c")
    generator.add(function)
    source = generator.dump()
    digest = hashlib.sha256("\n".join((source, cc, *FLAGS)).encode()).hexdigest()[:32]
    stem = f"{function.name()}-{digest}"
    library = _kept(folder, stem) or (_made(folder, stem, cc, source, function) if make else None)
    return function if library is None else ca.external(function.name(), str(library))


def _kept(folder: Path, stem: str) -> Path | None:
    """The library of a name, if its content is what it was; a damaged one is removed."""
    for library in sorted(folder.glob(f"{stem}-*.so")):
        if library.name == _name(stem, library):
            return library
        library.unlink(missing_ok=True)
    return None


def _name(stem: str, library: Path) -> str:
    return f"{stem}-{hashlib.sha256(library.read_bytes()).hexdigest()[:32]}.so"


def _made(folder: Path, stem: str, cc: str, source: str, function: ca.Function) -> Path | None:
    """A new library, which appears whole or not at all; None where the compiler fails or it does not compute right."""
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=PREFIX) as scratch:
            code, made = Path(scratch) / "kernel.c", Path(scratch) / "kernel.so"
            code.write_text(source, encoding="utf-8")
            done = finished([cc, *FLAGS, "-o", str(made), str(code), "-lm"], COMPILE_SECONDS)
            if done is None or done.returncode or not made.is_file() or not _right(function, made):
                return None
            return made.replace(folder / _name(stem, made))
    except OSError:
        return None


def _right(function: ca.Function, library: Path) -> bool:
    """Whether a library, in a process of its own, computes what the function does."""
    point = [[0.1 + 0.07 * k for k in range(function.numel_in(i))] for i in range(function.n_in())]
    shapes = [function.size_in(i) for i in range(function.n_in())]
    expected = function.call([ca.DM(v).reshape(s) for v, s in zip(point, shapes, strict=True)])
    printed = tried(_TRIAL, function.name(), str(library), json.dumps(point), modules=True)
    try:
        found = [[float.fromhex(x) for x in out] for out in json.loads(printed or "")]
        wanted = [ca.densify(out).nonzeros() for out in expected]
        return len(found) == len(wanted) and all(
            len(a) == len(b) and np.allclose(a, b, rtol=1e-9, atol=1e-12, equal_nan=True)
            for a, b in zip(found, wanted, strict=True)
        )
    except (ValueError, TypeError, AttributeError):
        return False
