"""CasADi functions compiled by the machine's C compiler, if there is one, and cached for the user.

A library is loaded only if its content has the hash in its name; it gets that name after a separate
process has loaded it and its outputs have agreed with CasADi's. In every doubtful case the library
is built again, or CasADi evaluates the function.
"""

import ctypes
import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casadical.core import sx_instructions
from casadical.core.basics import Array
from casadical.core.cache_folder import private_folder
from casadical.core.subprocesses import COMPILE_SECONDS, run_within, tried
from casadical.core.sx_instructions import OPERATIONS, SxInstructions

# C text before each function: type of two numbers, and CasADi's operations that C lacks.
_C_PRELUDE = """\
#include <math.h>

typedef double real __attribute__((vector_size(16)));
#define BOTH(x) ((real){(x), (x)})
#define ONE(f, a) ((real){f((a)[0]), f((a)[1])})
#define TWO(f, a, b) ((real){f((a)[0], (b)[0]), f((a)[1], (b)[1])})

static inline double sign(double a) { return a < 0 ? -1 : a > 0 ? 1 : a; }
static inline double not_(double a) { return a == 0; }
static inline double lt(double a, double b) { return a < b; }
static inline double le(double a, double b) { return a <= b; }
static inline double eq(double a, double b) { return a == b; }
static inline double ne(double a, double b) { return a != b; }
static inline double and_(double a, double b) { return a != 0 && b != 0; }
static inline double or_(double a, double b) { return a != 0 || b != 0; }
static inline double if_else_zero(double a, double b) { return a != 0 ? b : 0; }
"""


def source(f: ca.Function) -> str | None:
    """Return the C source of a CasADi function for n points; None for unsupported operations.

    Its signature is `void name(long long n, const double *const *in, double *const *out)`. The
    points in the first input, and the results of all points in each output, are contiguous.

    f : dense SX function; its first input differs between points, the others are shared by all
    """
    lines = []
    for name, operands, results, constant in SxInstructions.read(f).instructions:
        if name == "output":
            k, place, value = *results, f"a{operands[0]}"
            lines.append(f"out{k}[{place}] = {value}[0]; out{k}[{place} + more * {f.nnz_out(k)}] = {value}[1];")
            continue
        if name == "input":
            k, place = operands
            value = f"(real){{p0[{place}], p1[{place}]}}" if k == 0 else f"BOTH(in{k}[{place}])"
        elif name == "const":
            value = f"BOTH({_number(constant)})"
        elif name in OPERATIONS:
            value = OPERATIONS[name].c.format(*(f"a{j}" for j in operands))
        else:
            return None
        lines.append(f"a{results[0]} = {value};")
    rows = f.nnz_in(0)
    shared = [f"const double *restrict in{j} = in[{j}];" for j in range(1, f.n_in())]
    outputs = [f"double *restrict out{j} = out[{j}] + i * {f.nnz_out(j)};" for j in range(f.n_out())]
    inside = [f"const double *p0 = in[0] + i * {rows}, *p1 = p0 + more * {rows};", *outputs, *lines]
    return "\n".join(
        (
            _C_PRELUDE,
            f"void {f.name()}(long long n, const double *const *in, double *const *out)",
            "{",
            f"    real {', '.join(f'a{k}' for k in range(max(1, f.sz_w())))};",
            *(f"    {line}" for line in shared),
            "    for (long long i = 0; i < n; i += 2) {",
            "        const long long more = i + 1 < n; /* the last of an odd number is computed twice */",
            *(f"        {line}" for line in inside),
            "    }",
            "}",
            "",
        )
    )


def _number(value: float) -> str:
    """Return a number as a C literal, exact to the bit."""
    return value.hex() if math.isfinite(value) else "NAN" if math.isnan(value) else f"{'-' * (value < 0)}INFINITY"


# Compiler flags; fused multiply-add is switched off so that the results are those of CasADi.
COMPILER_FLAGS = ("-O2", "-ffp-contract=off", "-fPIC", "-shared")
# Number of points at which a newly built library is compared with the CasADi function. It is odd,
# so that a last point without a partner is tested, too, as the code computes points in pairs.
TRIAL_POINTS = 3
# Python script that prints the outputs of a library's function at some points, run in a separate
# process.
_TRIAL_SCRIPT = """
import ctypes, json, sys
n, given, sizes = json.loads(sys.argv[3])
ins, outs = [(ctypes.c_double * len(v))(*v) for v in given], [(ctypes.c_double * k)() for k in sizes]
pointers = [(ctypes.c_void_p * len(a))(*map(ctypes.addressof, a)) for a in (ins, outs)]
getattr(ctypes.CDLL(sys.argv[1]), sys.argv[2])(ctypes.c_longlong(n), *pointers)
print(json.dumps([[x.hex() for x in out] for out in outs]))
"""


class MachineCode:
    """A compiled CasADi function that is called with arrays of many points.

    Its first input differs between the points, all others are shared.

    function : CasADi function with the name, inputs and outputs of the compiled one
    library : file of the shared library
    """

    def __init__(self, function: ca.Function, library: Path) -> None:
        self._call = getattr(ctypes.CDLL(str(library)), function.name())
        self._inputs = [function.numel_in(k) for k in range(function.n_in())]
        self._outputs = [function.size_out(k) for k in range(function.n_out())]

    def __call__(self, points: Array, *shared: Array) -> list[Array]:
        """Return the outputs at n points side by side, shape (rows, columns n) each.

        points : first input of each point, shape (a, n); shared : the other inputs
        Raises ValueError for another number of values.
        """
        n = points.shape[1]
        given = [np.asfortranarray(points, dtype=float), *(np.ascontiguousarray(s, dtype=float) for s in shared)]
        if [g.size for g in given] != [n * self._inputs[0], *self._inputs[1:]]:
            raise ValueError(f"inputs have shapes {[g.shape for g in given]}, expected {self._inputs} numbers")
        results = [np.empty((rows, columns * n), order="F") for rows, columns in self._outputs]
        self._call(ctypes.c_longlong(n), _pointers(given), _pointers(results))
        return results


def _pointers(arrays: Sequence[Array]) -> Any:
    """Return a C array of pointers to the memory of numpy arrays."""
    return (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))


def compiler() -> str | None:
    """Return the path of the first C compiler found of $CC, gcc, clang and cc; None: none is."""
    names = filter(None, (os.environ.get("CC"), "gcc", "clang", "cc"))
    return next(filter(None, map(shutil.which, names)), None)


def compiled(function: ca.Function, *, make: bool = True) -> MachineCode | None:
    """Return a compiled SX function, from the cache or newly built; None where it has none.

    There is none without a C compiler or a private cache folder, for unsupported operations, where
    a library fails to compile or to pass its test, and without `make` if none is cached. Its name
    has a hash of all that its C source follows from (the function as CasADi serialises it, which
    takes a sixth of the time of the source, and the modules that write the source), of the
    compiler's path and flags, so that it is never stale, and a hash of its content.

    function : dense function whose first input differs between points
    make : whether a library that is not cached is built
    """
    cc, folder = compiler(), private_folder()
    if cc is None or folder is None:
        return None
    key = hashlib.sha256("\n".join((function.serialize(), cc, *COMPILER_FLAGS)).encode())
    for module in (__file__, sx_instructions.__file__):
        key.update(Path(module).read_bytes())
    stem = f"{function.name()}-{key.hexdigest()[:32]}"
    library = _cached_library(folder, stem)
    if library is None and make and (code := source(function)) is not None:
        library = _built_library(folder, stem, cc, code, function)
    return None if library is None else MachineCode(function, library)


def _cached_library(folder: Path, stem: str) -> Path | None:
    """Return the cached library STEM-HASH.so, or None; one whose content has changed is removed."""
    for library in sorted(folder.glob(f"{stem}-*.so")):
        if library.name == _library_name(stem, library):
            return library
        library.unlink(missing_ok=True)
    return None


def _library_name(stem: str, library: Path) -> str:
    """Return the name STEM-HASH.so of a library's file, with the hash of its content."""
    return f"{stem}-{hashlib.sha256(library.read_bytes()).hexdigest()[:32]}.so"


def _built_library(folder: Path, stem: str, cc: str, text: str, function: ca.Function) -> Path | None:
    """Build a library in a folder and return its path; None where it fails to compile or its test.

    stem : begin of its name; cc : path of the C compiler; text : C source
    function : CasADi function with whose outputs those of the library must agree
    """
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".casadical-") as scratch:
            code, made = Path(scratch) / "kernel.c", Path(scratch) / "kernel.so"
            code.write_text(text, encoding="utf-8")
            done = run_within([cc, *COMPILER_FLAGS, "-o", str(made), str(code), "-lm"], COMPILE_SECONDS)
            if done is None or done.returncode or not made.is_file() or not _computes_correctly(function, made):
                return None
            return made.replace(folder / _library_name(stem, made))
    except OSError:
        return None


def _computes_correctly(function: ca.Function, library: Path) -> bool:
    """Return whether a library, run in a separate process, has the outputs of a CasADi function.

    They are compared at `TRIAL_POINTS` points within 1e-9 of the value plus 1e-12.
    """
    sizes = [function.numel_in(i) for i in range(function.n_in())]
    points = np.array([[0.1 + 0.07 * k + 0.01 * j for j in range(TRIAL_POINTS)] for k in range(sizes[0])])
    shared = [0.1 + 0.07 * np.arange(size) for size in sizes[1:]]
    mapped = function.map("points", "serial", TRIAL_POINTS, list(range(1, len(sizes))), [])
    wanted = [out.full() for out in mapped.call([points, *shared])]
    given = [points.ravel(order="F").tolist(), *(s.tolist() for s in shared)]
    task = json.dumps([TRIAL_POINTS, given, [out.size for out in wanted]])
    printed = tried(_TRIAL_SCRIPT, str(library), function.name(), task)
    try:
        values = [np.array([float.fromhex(x) for x in out]) for out in json.loads(printed or "")]
        return len(values) == len(wanted) and all(
            np.allclose(a, b.ravel(order="F"), rtol=1e-9, atol=1e-12, equal_nan=True)
            for a, b in zip(values, wanted, strict=True)
        )
    except (ValueError, TypeError, AttributeError):
        return False
