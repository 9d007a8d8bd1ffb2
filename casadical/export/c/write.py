"""Write an export's C files after they were compiled and compared with their references.

The compiled C must equal the NumPy reference bit for bit; its accuracy against CasADi's doubles is
reported in micrometres.
"""

import hashlib
import json
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from casadical.core.basics import Array, CasadicalError, InputError
from casadical.core.files import claimed, write_together
from casadical.core.reading import json_of, read_bytes
from casadical.core.reporting.blocks import Block
from casadical.core.reporting.plain import WRITTEN, Key
from casadical.core.reporting.plain import written as named
from casadical.core.reporting.result import Result
from casadical.export.c.c_source import FILES_SCHEMA, c_files, comparison_inputs, functions, inside
from casadical.export.c.coefficients import Real
from casadical.export.c.kernel import WARNING_FLAGS, Shape, build, compilers, remember, version_of
from casadical.export.c.products import Command, Product, mapped
from casadical.export.c.reference import Status
from casadical.export.c.structured_text import structured_text
from casadical.export.c.tape_program import Operations, TapeProgram, operations, tape_program

# Function that returns the texts of a program's files by file name, by target language.
CONTROLLER_LANGUAGES: dict[str, Callable[[TapeProgram], dict[str, str]]] = {
    "c": c_files,
    "structured_text": lambda program: {f"{program.name}.st": structured_text(program)},
}


@dataclass(frozen=True)
class Comparison:
    """Comparison of one function of the C, built by one compiler, with the NumPy reference.

    function : name of the function
    compiler : version text of the compiler
    vectors : number of vectors of joints
    outputs : number of output numbers that were compared
    different : number of outputs and statuses whose bits differ
    """

    function: str
    compiler: str
    vectors: int
    outputs: int
    different: int

    def __str__(self) -> str:
        verdict = "identical bits" if self.different == 0 else f"{self.different} DIFFERENT"
        head = f"{self.function}: {self.vectors} vectors, {self.outputs} outputs"
        return f"{head}, {verdict} ({self.compiler})"


def shape_of(program: TapeProgram) -> Shape:
    """Return name, real type, units and sizes of inputs and outputs of a program, for `Kernel`."""
    sizes = {key: program.n if key == "correct" else len(program.tapes[key].outputs) for key in functions(program)}
    units: Any = list(program.product.units)
    return Shape(name=program.name, real=program.real, joints=program.n, outputs=sizes, units=units)


def compared(program: TapeProgram, files: Mapping[str, bytes], installed: list[str], count: int) -> list[Comparison]:
    """Return comparisons of the compiled files with the reference, one per function and compiler.

    The self-test counts as a function with one vector. There are none without a compiler.

    files : contents by file name; installed : commands of compilers; count : number of vectors of joints
    Raises CasadicalError: a file does not compile without warnings, or cannot be loaded.
    """
    if not installed:
        return []
    q, name, shape = comparison_inputs(program, count), program.name, shape_of(program)
    results: list[Comparison] = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(len(installed)) as pool:
        sources = [Path(folder) / f"{name}{ending}" for ending in (".h", ".c", "_self_test.c")]
        for source in sources:
            source.write_bytes(files[source.name])
        kernels = [
            pool.submit(build, shape, sources[1:], Path(folder), compiler, WARNING_FLAGS) for compiler in installed
        ]
        # The compilers run in other processes meanwhile.
        expected = {key: compute(program, q) for key, compute in functions(program).items()}
        for compiler, built in zip(installed, kernels, strict=True):
            kernel, version = built.result(), version_of(compiler)
            failed = int(kernel.self_test() != Status.OK)
            results.append(Comparison("self_test", version, 1, 1, failed))
            for key, (out, status) in expected.items():
                mine, my_status = kernel.rows(key, q)
                different = int((_bits(mine) != _bits(out)).sum() + (my_status != status).sum())
                results.append(Comparison(key, version, count, out.size, different))
    return results


def _bits(values: Array) -> Array:
    """Return an array of reals as integers with the same bits."""
    return np.ascontiguousarray(values).view(np.uint32 if values.dtype == np.float32 else np.uint64)


def accuracy(program: TapeProgram, count: int = 10_000) -> dict[str, float]:
    """Return figures on a program's accuracy by name: its reference against CasADi's doubles.

    network_error_um, curves_error_urad and forward_error_um are largest errors at random joints;
    rest_once_urad and rest_twice_urad are the largest that remain if a controller commands q -
    curves(q), and q - curves(q - curves(q)). table_bytes and table_error_urad_at_most are the size
    of the tables and the bound of their error before rounding. For commands see `_of_command`.

    count : number of random joint vectors within the box
    Returns the figures that apply to the product, rounded to three digits
    """
    q = inside(program, count)
    figures: dict[str, float] = {}
    exact = q.astype(np.float64)
    for key, compute in functions(program).items():
        values, status = compute(program, q)
        has_value = status != Status.NOT_FINITE
        if program.network is not None and key == program.network.key:
            function = program.network.function
            error = float(abs(values - mapped(function, exact))[has_value].max())
            if key == "curves":
                figures["curves_error_urad"] = 1e6 * error
                once = exact - values
                twice = exact - mapped(function, once)
                for word, command in (("once", once), ("twice", twice)):
                    rest = command + mapped(function, command) - exact
                    figures[f"rest_{word}_urad"] = 1e6 * float(abs(rest).max())
            else:
                figures["network_error_um"] = 1e3 * error
        if key == "forward" and program.command is not None:
            error = abs(values - mapped(program.command.calibrated, exact))[has_value, :3].max()
            figures["forward_error_um"] = 1e6 * float(error)
        if key == "correct" and program.command is not None:
            figures |= _of_command(program.command, exact, values, status)
    nodes = {node.table: node for tape in program.tapes.values() for node in tape.nodes if node.table}
    if nodes:
        figures["table_bytes"] = q.itemsize * sum(map(len, nodes))
        figures["table_error_urad_at_most"] = 1e6 * max(node.value for node in nodes.values())
    return {key: float(f"{value:.3g}") for key, value in figures.items()}


def _of_command(command: Command, q: Array, dq: Array, status: Array) -> dict[str, float]:
    """Return figures of corrections dq at readings q by name, each of shape (k, n) [rad or m].

    They are the tool's mean error before the correction (start_error_um_mean), median and worst of
    the remaining error at poses with status OK (rest_um_.., for poses also rest_urad_..), and the
    fractions of readings with status OK, of all (share_ok) and of those that count
    (share_converged), and for poses of singular ones (share_singular). Readings at which the model
    has no value (a four-bar that cannot close) do not count for share_converged; nor do singular
    poses where the orientation is corrected.

    status : status of each reading, shape (k,)
    """
    has_value, fine = status != Status.NOT_FINITE, status == Status.OK
    wanted, real = mapped(command.nominal, q), command.calibrated
    moved = mapped(real, q + dq)
    before = np.linalg.norm((mapped(real, q) - wanted)[:, :3], axis=1)
    rest = np.linalg.norm(moved[:, :3] - wanted[:, :3], axis=1)[fine]
    start = 1e6 * float(before[has_value].mean())
    figures = {"start_error_um_mean": start, "share_ok": float(fine.mean())}
    parts = {"rest_um": rest}
    if moved.shape[1] > 3:
        # Many poses are singular; a correction that reports this has not failed to converge.
        has_value = has_value & (status != Status.SINGULAR)
        figures["share_singular"] = float((status == Status.SINGULAR).mean())
        turned = np.linalg.norm(moved[:, 3:] - wanted[:, 3:], axis=1)[fine]
        parts = {"rest_urad": turned / np.sqrt(2), **parts}  # small angles
    for name, values in parts.items():
        if name == "rest_um":
            figures["share_converged"] = float(fine[has_value].mean()) if has_value.any() else 0.0
        if values.size:
            figures[f"{name}_median"] = 1e6 * float(np.median(values))
            figures[f"{name}_worst"] = 1e6 * float(values.max())
    return figures


# Smallest share of poses in the joint box with status OK, 0 to 1, from which on a correction counts
# as verified: `share_converged` of `_of_command`.
MIN_SHARE_CONVERGED = 0.9


@dataclass(frozen=True)
class Export(Result):
    """A C export that was written to a folder.

    folder : folder to which it was written
    written : names of its files
    comparisons : comparisons of the compiled C with the reference, one per function and compiler
    figures : accuracy figures of this model by name, see `accuracy`
    operations : numbers of operations of one call
    about : sentences on what it was made from and what it omits; `write_c` states none
    """

    file_stem: ClassVar[str] = "export"
    report: ClassVar[str] = "export.j2"

    derived: ClassVar[tuple[Key, ...]] = (Key("verified"), Key("operations", "operations.count"))

    folder: Path = field(metadata=WRITTEN)
    written: tuple[str, ...] = field(metadata=named("files"))
    comparisons: tuple[Comparison, ...]
    figures: dict[str, float] = field(metadata=WRITTEN)
    operations: Operations
    about: tuple[str, ...] = ()

    @property
    def verified(self) -> bool:
        """Return whether compiled C equals the reference, and the correction `converges`."""
        return bool(self.comparisons) and self.converges

    @property
    def converges(self) -> bool:
        """Return whether the correction converges at `MIN_SHARE_CONVERGED` of the poses or more.

        It is True for a network and for curves.
        """
        return self.figures.get("share_converged", 1.0) >= MIN_SHARE_CONVERGED

    def blocks(self) -> list[Block]:
        """Return the report of the export: verdict, comparisons and figures."""
        return self._report_blocks(least=MIN_SHARE_CONVERGED)


def write_c(
    product: Product,
    folder: str | Path,
    *,
    name: str,
    real: Real = "double",
    model_sha256: str = "not given",
    data_sha256: str = "not given",
    languages: Iterable[str] | None = None,
    vectors: int = 100_000,
    overwrite: bool = False,
    also: Callable[[Export], Mapping[Path, str]] = lambda _: {},
) -> Export:
    """Write a network, curves or a command as C99, with everything that an integrator needs.

    product : network, curves or command; without a C compiler it is written unverified
    folder : folder of the files, made when missing; other files in it stay
    name : prefix of the C functions and files: a lower-case C identifier of at most 24 characters
    real : type of its numbers, "float" or "double"
    model_sha256, data_sha256 : SHA-256 of the model and of the data, for the header
    languages : names of languages that are written besides the C; None: all (`structured_text`)
    vectors : number of joint vectors on which the compiled C is compared with the reference
    overwrite : whether files are replaced that no export wrote, or that were changed since
    also : function that returns, from the export, texts of additional files by path, which are
        written together with it or not at all
    Raises InputError: a name, type or function cannot be used, or a file is in the way;
        CasadicalError: the C does not compile without warnings, or gives other bits than the
        reference; nothing was written.

    Examples
    --------
    >>> command = casadical.export.command_of(casadical.export.Sources(found.robot, robot))
    >>> export = casadical.export.write_c(command, "command", name="arm", vectors=100)
    >>> "arm.c" in export.written, "arm.st" in export.written
    (True, True)
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,23}", name):
        allowed = "use 1 to 24 of a-z, 0-9, _, beginning with a letter"
        raise InputError(f"{name!r} cannot prefix C functions; {allowed}")
    if real not in ("float", "double"):
        raise InputError(f"real type {real!r}; it must be 'float' or 'double'")
    for value in (model_sha256, data_sha256):
        if not re.fullmatch(r"[0-9a-f]{64}|not given", value):
            allowed = "give 64 hexadecimal digits in lower case, or leave it out"
            raise InputError(f"{value!r} is no sha256; {allowed}")
    for language in (chosen := tuple(CONTROLLER_LANGUAGES if languages is None else languages)):
        if language not in CONTROLLER_LANGUAGES:
            raise InputError(f"language {language!r} is unknown; allowed: {', '.join(CONTROLLER_LANGUAGES)}")
    folder = Path(folder)
    program = tape_program(product, real, name, model_sha256, data_sha256)
    texts: dict[str, str] = {}
    for language in dict.fromkeys(("c", *chosen)):
        texts |= CONTROLLER_LANGUAGES[language](program)
    blobs = {file: text.encode() for file, text in texts.items()}
    _check_nothing_in_the_way(folder, [*blobs, "manifest.json"], overwrite)
    comparisons = compared(program, blobs, compilers(), vectors)
    if wrong := [str(c) for c in comparisons if c.different]:
        lines = "\n".join(wrong)
        raise CasadicalError(f"the compiled C differs from its reference; nothing was written:\n{lines}")
    written = tuple(sorted([*blobs, "manifest.json"]))
    figures, counted = accuracy(program), operations(program)
    made = Export(folder, written, tuple(comparisons), figures, counted)
    blobs["manifest.json"] = _manifest(program, blobs, made)
    with claimed([folder]):
        write_together({**{folder / key: blob for key, blob in blobs.items()}, **also(made)})
    remember(blobs["manifest.json"])
    return made


def _check_nothing_in_the_way(folder: Path, names: list[str], overwrite: bool) -> None:
    """Check that no existing file would be overwritten that no export wrote or that was changed.

    overwrite : whether such files may be overwritten
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give a folder")
    if overwrite:
        return
    ours: dict[str, str] = {}
    try:
        blob = read_bytes(folder / "manifest.json")
        manifest: dict[str, Any] = json_of(blob, str(folder / "manifest.json"))
        if manifest.get("written_by") == "casadical":
            ours = {**manifest["files"], "manifest.json": hashlib.sha256(blob).hexdigest()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass  # without a readable manifest no file there counts as an export's
    for key in names:
        path = folder / key
        if path.exists() and ours.get(key) != hashlib.sha256(read_bytes(path)).hexdigest():
            raise InputError(
                f"{path} is in the way: it was not written by this export, or was changed since; "
                "give another folder, or overwrite=True (--overwrite)"
            )


def _manifest(program: TapeProgram, blobs: Mapping[str, bytes], made: Export) -> bytes:
    """Return the content of manifest.json: hashes, comparisons, figures, limits, notes."""
    alone = None if program.command else program.network
    content = {
        "written_by": "casadical",
        "schema": FILES_SCHEMA,
        "product": "command" if alone is None else alone.key,
        "model_sha256": program.model_sha256,
        "data_sha256": program.data_sha256,
        "kernel": shape_of(program).model_dump(),
        "files": {key: hashlib.sha256(blob).hexdigest() for key, blob in sorted(blobs.items())},
        "verified": made.verified,
        "comparisons": [vars(c) for c in made.comparisons],
        "figures": made.figures,
        "operations": made.operations.count,
        "limits": vars(program.command.limits) if program.command else {},
        "notes": program.command.notes if program.command else (),
    }
    return (json.dumps(content, indent=2) + "\n").encode()
