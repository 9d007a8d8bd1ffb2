"""Compile the C of an export and call it from Python on arrays of joints."""

import ctypes
import hashlib
import shutil
import tempfile
from contextlib import suppress
from functools import partialmethod
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from casadical.core.basics import Array, CasadicalError, InputError
from casadical.core.files import private_folder, write_whole
from casadical.core.reading import read_bytes
from casadical.core.subprocesses import COMPILE_SECONDS, TRIAL_SECONDS, run_within, tried
from casadical.export.c.c_source import filled, template
from casadical.export.c.coefficients import NUMPY_TYPE, Real

# Compiler options under which an export must compile without warnings.
WARNING_FLAGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


def compilers() -> list[str]:
    """Return the commands gcc and clang where installed, or else cc; none without a C compiler."""
    return [*filter(version_of, ("gcc", "clang"))] or [*filter(version_of, ("cc",))]


def version_of(compiler: str) -> str:
    """Return the first line of a compiler's `--version`; "" where its command fails."""
    if shutil.which(compiler) is None:
        return ""
    run = run_within([compiler, "--version"], TRIAL_SECONDS)
    return run.stdout.splitlines()[0] if run and run.returncode == 0 and run.stdout else ""


class Shape(BaseModel):
    """Name, real type, joints and output sizes of an export, as needed to call it.

    name : prefix of its C functions
    real : type of its numbers, "float" or "double"
    joints : number of joints
    outputs : number of outputs of each function by its name
    units : "rad" or "m" of each joint's reading; empty: all rad
    """

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    # a prefix that is safe in paths, too
    name: str = Field(pattern="^[a-z][a-z0-9_]{0,23}$")
    real: Real
    joints: int = Field(ge=1, le=100)
    outputs: dict[
        Annotated[str, Field(pattern="^(network|curves|forward|correct)$")],
        Annotated[int, Field(ge=1, le=100)],
    ]
    units: list[Literal["rad", "m"]] = []

    @model_validator(mode="after")
    def _of_each_joint(self) -> Self:
        """Check that `units` is empty or has a unit for each joint. Raises ValueError."""
        if self.units and len(self.units) != self.joints:
            raise ValueError(f"{len(self.units)} units of {self.joints} joints")
        return self


class Manifest(BaseModel):
    """Those entries of an export's manifest.json that are read back.

    kernel : name, type and sizes of the C
    files : SHA-256 of each file by its name
    figures : accuracy figures of the export by name, see `write.accuracy`
    """

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True, allow_inf_nan=False)

    kernel: Shape
    files: dict[str, str]
    figures: dict[str, float] = {}

    @staticmethod
    def read(export: Path) -> "Manifest":
        """Return the manifest of an export folder. Raises InputError: it is missing or damaged."""
        path = export / "manifest.json"
        if not path.is_file():
            raise InputError(f"{export} has no manifest.json; give a folder that `casadical export c` wrote")
        try:
            return Manifest.model_validate_json(read_bytes(path))
        except ValidationError as error:
            fault = error.errors()[0]
            place = ".".join(map(str, fault["loc"])) or "the file"
            raise InputError(f"{path} is damaged ({place}: {fault['msg']}); export again") from None


class Kernel:
    """Functions of a compiled export, called on arrays; made by :func:`load` or :func:`build`.

    Calls are re-entrant, as the C is.

    shape : name, real type, joints and output sizes
    """

    def __init__(self, shape: Shape, library: Path) -> None:
        self.shape = shape
        self._library = ctypes.CDLL(str(library))

    def rows(self, function: str, q: Array) -> tuple[Array, Array]:
        """Return values, (k, outputs), and status, (k,), of a function at k rows of joints.

        The values are of network a position correction [mm], of curves true angles less readings
        [rad], of correct corrections to add to the joints [rad or m], of forward the calibrated
        position [m], with the rotation's columns where the export has them; they are zero where the
        status, a `casadical.export.Status`, is NOT_FINITE.

        function : "network", "curves", "forward" or "correct", as the export has it
        q : joints, shape (k, n) [rad or m], converted to the kernel's real type
        Raises InputError: the export has no such function, or q another number of joints.
        """
        shape = self.shape
        if function not in shape.outputs:
            raise InputError(f"the export {shape.name!r} has no function {function!r}; it has {sorted(shape.outputs)}")
        table = np.ascontiguousarray(q, NUMPY_TYPE[shape.real])
        if table.ndim != 2 or table.shape[1] != shape.joints:
            raise InputError(
                f"joints have shape {table.shape}; expected (rows, {shape.joints}) in rad, or m of a linear joint"
            )
        out = np.empty((len(table), shape.outputs[function]), table.dtype)
        status = np.empty(len(table), np.int32)
        call = getattr(self._library, f"{shape.name}_{function}_rows")
        call(_pointer(table), ctypes.c_uint64(len(table)), _pointer(out), _pointer(status))
        return out, status

    # Arguments, results and errors of these four are those of `rows`.
    network = partialmethod(rows, "network")
    curves = partialmethod(rows, "curves")
    forward = partialmethod(rows, "forward")
    correct = partialmethod(rows, "correct")

    def steps(self, q: Array, enable: Array) -> tuple[Array, Array]:
        """Return corrections, (k, n) [rad or m], and status, (k,), of k calls of the C's `step`.

        They are consecutive controller cycles, starting without a correction, of an export that has
        the function "correct".

        q : commanded joints, shape (k, n) [rad or m]
        enable : whether the correction is on in each cycle, shape (k,)
        """
        table = np.ascontiguousarray(q, NUMPY_TYPE[self.shape.real])
        on = np.ascontiguousarray(enable, np.uint32)
        out, status = np.empty_like(table), np.empty(len(table), np.int32)
        call = getattr(self._library, f"{self.shape.name}_step_rows")
        call(_pointer(table), ctypes.c_uint64(len(table)), _pointer(on), _pointer(out), _pointer(status))
        return out, status

    def self_test(self) -> int:
        """Return the status of the C's own self-test, 0 if it passed."""
        return int(getattr(self._library, f"{self.shape.name}_self_test")())


def _pointer(array: Array) -> ctypes.c_void_p:
    """Return the address of an array's data for ctypes."""
    return ctypes.c_void_p(array.ctypes.data)


def build(shape: Shape, sources: list[Path], folder: Path, compiler: str, flags: tuple[str, ...] = ()) -> Kernel:
    """Compile an export's sources and the loops over rows into a new shared library, and load it.

    The library is loaded in a separate process first.

    sources : C files of the export; folder : folder of the library
    compiler : its command; flags : additional flags of it
    Raises CasadicalError: the compiler reports an error or, by its flags, a warning (its output is
    in the message), does not end, or its library cannot be loaded.
    """
    how = hashlib.sha256(" ".join(flags).encode()).hexdigest()[:8]
    library = folder / f"{shape.name}_{Path(compiler).name}_{how}.so"
    wrapper = library.with_suffix(".c")  # one per compiler, as compilers run concurrently
    values = {"name": shape.name, "n": str(shape.joints)}
    rows = [f'#include "{shape.name}.h"\n']  # functions that call the exported ones for each row
    for function, size in shape.outputs.items():
        rows.append(filled(template("rows.c"), values | {"function": function, "size": str(size)}))
    if "correct" in shape.outputs:
        rows.append(filled(template("rows_step.c"), values))
    wrapper.write_text("".join(rows), encoding="utf-8")
    usual = ["-std=c99", "-fPIC", "-shared", "-O2", f"-I{sources[0].parent}"]
    files = map(str, (*sources, wrapper))
    run = run_within([compiler, *usual, *flags, *files, "-o", str(library)], COMPILE_SECONDS)
    if run is None:
        raise CasadicalError(f"{version_of(compiler)} was stopped after {COMPILE_SECONDS:g} s with {sources[0].name}")
    if run.returncode != 0:
        raise CasadicalError(f"{version_of(compiler)} does not compile {sources[0].name}:\n{run.stderr[:2000]}")
    if tried("import ctypes, sys; ctypes.CDLL(sys.argv[1])", str(library)) is None:
        raise CasadicalError(
            f"{version_of(compiler)} made of {sources[0].name} what cannot be loaded; use another compiler"
        )
    return Kernel(shape, library)


def load(export: str | Path, *, trust: bool = False) -> Kernel:
    """Compile the C of an export folder, load it, and return its functions for arrays.

    export : folder that `write_c` wrote
    trust : whether the C of a folder that this user did not export on this machine is compiled and
        run too
    Raises InputError: the folder has no manifest, is not trusted, or a source is not the one that
        was written; CasadicalError: there is no C compiler, it fails, or the compiled code fails
        its self-test.

    Examples
    --------
    >>> x = ca.SX.sym("q", 2)
    >>> function = ca.Function("curves", [x], [1e-4 * ca.sin(x)], ["q"], ["dq"])
    >>> from casadical.export.c.products import CurveFunction
    >>> curves = CurveFunction(function, np.full(2, -3.0), np.full(2, 3.0))
    >>> export = casadical.export.write_c(curves, "curves1", name="arm", vectors=100, languages=())
    >>> casadical.export.load("curves1").self_test()
    0
    """
    export = Path(export)
    manifest = Manifest.read(export)
    own, code = private_folder("exports"), hashlib.sha256(read_bytes(export / "manifest.json")).hexdigest()
    if not trust and (own is None or not (own / code).is_file()):
        raise InputError(
            f"{export}: was not exported here by you, and its C would be compiled and run; read "
            "it, and give --trust (trust=True), or export again from the robot file"
        )
    shape, contents = manifest.kernel, {}
    for name in (f"{shape.name}.h", f"{shape.name}.c", f"{shape.name}_self_test.c"):
        blob = read_bytes(export / name) if (export / name).is_file() else b""
        digest = hashlib.sha256(blob).hexdigest() if blob else "missing"
        if digest != manifest.files.get(name):
            raise InputError(f"{export / name} is not the file that was exported (sha256 {digest[:12]}); export again")
        contents[name] = blob
    available = compilers()
    if not available:
        raise CasadicalError("no C compiler found (gcc, clang or cc); install one, for example: apt-get install gcc")
    with tempfile.TemporaryDirectory() as temporary:  # a loaded library outlives its file
        # The checked contents are compiled, even if the folder changes meanwhile.
        for name, blob in contents.items():
            (Path(temporary) / name).write_bytes(blob)
        sources = [Path(temporary) / name for name in list(contents)[1:]]
        kernel = build(shape, sources, Path(temporary), available[0])
        if kernel.self_test() != 0:
            raise CasadicalError(f"{shape.name} fails its self-test when compiled with {version_of(available[0])}")
    return kernel


def remember(manifest: bytes) -> None:
    """Record in the user's private folder that an export with this manifest was written here.

    manifest : content of its manifest.json
    """
    folder = private_folder("exports")
    if folder is not None:
        with suppress(InputError):  # without the record `correct` asks for --trust
            write_whole(folder / hashlib.sha256(manifest).hexdigest(), "")
