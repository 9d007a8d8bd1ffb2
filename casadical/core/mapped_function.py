"""CasADi functions called with numpy arrays, without a copy through lists, at one point or at many.

For many points, expressions of the shared inputs are computed once, the others for each point. The
machine's C compiler compiles them, if there is one, into libraries cached for the user. A library
is loaded only if its content has the hash in its name; it gets that name after a separate process
has loaded it and its outputs have agreed with CasADi's. In every doubtful case the library is built
again, or CasADi evaluates the function.
"""

import ctypes
import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casadical.core import sx_instructions
from casadical.core.basics import Array
from casadical.core.files import private_folder
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
            value = OPERATIONS[name][1].format(*(f"a{j}" for j in operands))
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


# A CasADi function that is called with arrays and returns those of its outputs.
ArrayFunction = Callable[..., list[Array]]


def _machine_code(function: ca.Function, library: Path) -> ArrayFunction:
    """Return a compiled CasADi function that is called with arrays of many points.

    Its first input differs between the points, shape (a, n), all others are shared. Outputs at n
    points are side by side, shape (rows, columns n) each. Another number of values is a ValueError.

    function : CasADi function with the name, inputs and outputs of the compiled one
    library : file of the shared library
    """
    code = getattr(ctypes.CDLL(str(library)), function.name())
    inputs = [function.numel_in(k) for k in range(function.n_in())]
    outputs = [function.size_out(k) for k in range(function.n_out())]

    def called(points: Array, *shared: Array) -> list[Array]:
        """Return the outputs at n points."""
        n = points.shape[1]
        given = [np.asfortranarray(points, dtype=float), *(np.ascontiguousarray(s, dtype=float) for s in shared)]
        if [g.size for g in given] != [n * inputs[0], *inputs[1:]]:
            raise ValueError(f"inputs have shapes {[g.shape for g in given]}, expected {inputs}")
        results = [np.empty((rows, columns * n), order="F") for rows, columns in outputs]
        code(ctypes.c_longlong(n), _pointers(given), _pointers(results))
        return results

    return called


def _pointers(arrays: Sequence[Array]) -> Any:
    """Return a C array of pointers to the memory of numpy arrays."""
    return (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))


def compiler() -> str | None:
    """Return the path of the first C compiler found of $CC, gcc, clang and cc; None: none is."""
    names = filter(None, (os.environ.get("CC"), "gcc", "clang", "cc"))
    return next(filter(None, map(shutil.which, names)), None)


def compiled(function: ca.Function, *, make: bool = True) -> ArrayFunction | None:
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
    library = None
    for cached in sorted(folder.glob(f"{stem}-*.so")):
        if cached.name == _library_name(stem, cached):
            library = cached
            break
        cached.unlink(missing_ok=True)  # its content has changed
    if library is None and make and (code := source(function)) is not None:
        library = _built_library(folder, stem, cc, code, function)
    return None if library is None else _machine_code(function, library)


def _library_name(stem: str, library: Path) -> str:
    """Return the name STEM-HASH.so of a library's file, with the hash of its content."""
    return f"{stem}-{hashlib.sha256(library.read_bytes()).hexdigest()[:32]}.so"


def _built_library(folder: Path, stem: str, cc: str, text: str, function: ca.Function) -> Path | None:
    """Build a library in a folder; return its path, or None where it fails to compile or its test."""
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


# Number of points that one mapped function has evaluated before a library compiled earlier is
# looked up in the cache. Evaluating them takes about as long as the lookup, so that waiting costs
# at most twice the optimum (the ski rental problem).
LIBRARY_LOOKUP_POINTS = 500
# Number of points that one mapped function has evaluated before a library is compiled for it.
# Evaluating them takes about as long as the compilation, whatever the function: CasADi takes 2.6 ns
# per instruction and point, gcc half a millisecond per instruction. One solve of a few hundred or
# thousand poses stays below.
COMPILATION_POINTS = 200_000
# Largest number of points that are evaluated at a time; mapping over more of them takes longer.
MAX_CHUNK_POINTS = 1024


def buffered(f: ca.Function) -> ArrayFunction:
    """Return a CasADi function of dense inputs and outputs that is called many times with arrays.

    Its outputs are new arrays of two axes, each in its own shape; CasADi's work memory is reused in
    the next call. An argument with fewer columns than the input is repeated side by side, as by
    CasADi. Another number of arguments, or of values of one, is a ValueError.
    """
    name, idle = f.name(), list[Any]()
    inputs = [f.size_in(k) for k in range(f.n_in())]
    outputs = [f.size_out(k) for k in range(f.n_out())]

    def called(*arguments: Array) -> list[Array]:
        """Return the outputs for one argument per input."""
        try:  # a buffer serves one call at a time: another thread takes another one
            buffer, trigger = idle.pop()
        except IndexError:
            buffer, trigger = f.buffer()
        arrays: list[Any] = []
        for k, (argument, (rows, columns)) in enumerate(zip(arguments, inputs, strict=True)):
            values = np.asarray(argument, dtype=float)
            values = values.reshape(rows, -1, order="F") if rows * columns else np.zeros((0, 0))
            if values.size and values.shape[1] != columns:
                values = np.tile(values, columns // values.shape[1])
            if values.size != rows * columns:
                raise ValueError(f"{name}: input {k} has shape {np.shape(argument)}, expected {(rows, columns)}")
            arrays.append(np.asfortranarray(values))
            if values.size:
                buffer.set_arg(k, _view(arrays[-1]))
        results = [np.empty(size, order="F") for size in outputs]
        for k, r in enumerate(results):
            if r.size:
                buffer.set_res(k, _view(r))
        trigger()
        idle.append((buffer, trigger))
        return results

    return called


def call(f: ca.Function, *arguments: Array) -> list[Array]:
    """Return the outputs of a CasADi function that is called once, as arrays; see `buffered`."""
    return buffered(f)(*arguments)


def _view(values: Array) -> Any:
    """Return a flat view of the memory of a column-major array."""
    return memoryview(values.reshape(-1, order="F"))  # type: ignore[arg-type]


class MappedFunction:
    """A function of one point that is evaluated at many points in chunks.

    The graph does not grow with the number of points. Expressions of the shared inputs only, a
    third of a robot's model, are computed once a call, common subexpressions once a point. The
    other operations are unchanged, and so is every bit of CasADi's results.

    name : name of the CasADi function
    point : symbols whose values differ between the points, shape (a,)
    shared : symbols whose values are the same for all points, shape (b,)
    outputs : expressions of both
    evaluated : number of points evaluated so far
    """

    def __init__(self, name: str, point: ca.SX, shared: ca.SX, outputs: Sequence[ca.SX]) -> None:
        whole = ca.cse([ca.densify(output) for output in outputs])
        each, symbols, once = ca.extract_parametric(whole, shared, {})
        self._shared = buffered(ca.Function(name + "_once", [shared], [ca.vertcat(ca.SX(0, 1), *once)]))
        self._each = ca.Function(name, [point, shared, ca.vertcat(ca.SX(0, 1), *symbols)], each)
        outputs_of_each = sum(self._each.nnz_out(k) for k in range(self._each.n_out()))
        # Up to 400 000 numbers at a time are computed: Jacobians then fit the processor's cache.
        self._chunk = min(MAX_CHUNK_POINTS, max(64, 400_000 // max(outputs_of_each, 1)))
        self._mapped: dict[int, ArrayFunction] = {}
        self.evaluated = self._tried = 0
        self._machine_code: ArrayFunction | None = None

    @property
    def is_compiled(self) -> bool:
        """Return whether a compiled library evaluates the function, not CasADi."""
        return self._machine_code is not None

    def __call__(self, points: Array, shared: Array) -> list[Array]:
        """Return the outputs at n points side by side, shape (rows, columns n) each.

        points : shape (a, n); shared : shape (b,)
        """
        n = points.shape[1]
        self.evaluated += n
        # Machine code is used once the points that were evaluated pay for it.
        for make, threshold in ((False, LIBRARY_LOOKUP_POINTS), (True, COMPILATION_POINTS))[self._tried :]:
            if self._machine_code is None and self.evaluated >= threshold:
                self.compile(make=make)
                self._tried += 1
        (once,) = self._shared(shared)
        if self._machine_code:
            return self._machine_code(points, shared, once)
        if n <= self._chunk:
            return self._over(n)(points, shared, once)
        sizes = [self._each.size_out(k) for k in range(self._each.n_out())]
        outputs = [np.empty((rows, columns * n), order="F") for rows, columns in sizes]
        for start in range(0, n, self._chunk):
            some = points[:, start : start + self._chunk]
            parts = self._over(some.shape[1])(some, shared, once)
            for out, part, (_, columns) in zip(outputs, parts, sizes, strict=True):
                out[:, columns * start : columns * start + part.shape[1]] = part
        return outputs

    def _over(self, n: int) -> ArrayFunction:
        """Return the CasADi function mapped over n points, from the cache if it is there."""
        if n not in self._mapped:
            # A function of n points is cached for each of at most 64 values of n; at the next one
            # the cache is emptied.
            if len(self._mapped) >= 64:
                self._mapped.clear()
            self._mapped[n] = buffered(self._each.map("points", "serial", n, [1, 2], []))
        return self._mapped[n]

    def compile(self, *, make: bool = True) -> None:
        """Switch to a compiled library, if one is in the cache or can be built.

        make : whether it is built if the cache has none
        """
        self._machine_code = compiled(self._each, make=make)
