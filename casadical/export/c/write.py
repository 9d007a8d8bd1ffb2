"""Write an export: every file is made in memory, compiled and compared before it is written to the folder.

It is compared with the NumPy reference bit for bit, and with CasADi's doubles in micrometres.
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
from casadical.core.telling.blocks import Words
from casadical.core.telling.plain import WRITTEN, Key
from casadical.core.telling.plain import written as named
from casadical.core.telling.result import Result
from casadical.export.c.c_language import comparison_inputs, functions, inside
from casadical.export.c.c_source import SCHEMA
from casadical.export.c.coefficients import Real
from casadical.export.c.kernel import WARNINGS, Compiler, Shape, build, compilers, remember
from casadical.export.c.language import NAME, Label
from casadical.export.c.products import Product, mapped
from casadical.export.c.reference import Status
from casadical.export.c.registry import written_in
from casadical.export.c.tape_program import Operations, TapeProgram, operations, tape_program


@dataclass(frozen=True)
class Comparison:
    """One function of the C, as one compiler made it, against the NumPy reference."""

    function: str
    compiler: str
    vectors: int
    outputs: int
    different: int  # outputs or statuses that are not the same bits

    def __str__(self) -> str:
        verdict = "identical bits" if self.different == 0 else f"{self.different} DIFFERENT"
        return f"{self.function}: {self.vectors} vectors, {self.outputs} outputs, {verdict} ({self.compiler})"


def shape_of(program: TapeProgram, name: str) -> Shape:
    sizes = {key: program.n if key == "correct" else len(program.tapes[key].outputs) for key in functions(program)}
    return Shape(name, program.real, program.n, sizes, program.product.units)


def compared(
    program: TapeProgram, name: str, files: dict[str, bytes], installed: list[Compiler], count: int
) -> list[Comparison]:
    """Compile with each compiler and compare every function on ``count`` vectors; the self-test is one vector."""
    if not installed:
        return []
    q = comparison_inputs(program, count)
    results: list[Comparison] = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(len(installed)) as pool:
        sources = [Path(folder) / file for file in (f"{name}.h", f"{name}.c", f"{name}_self_test.c")]
        for source in sources:
            source.write_bytes(files[source.name])
        shape = shape_of(program, name)
        kernels = [pool.submit(build, shape, sources[1:], Path(folder), compiler, WARNINGS) for compiler in installed]
        # The compilers work in processes of their own meanwhile.
        expected = {key: compute(program, q) for key, compute in functions(program).items()}
        for compiler, built in zip(installed, kernels, strict=True):
            kernel = built.result()
            results.append(Comparison("self_test", compiler.version, 1, 1, int(kernel.self_test() != Status.OK)))
            for key, (out, status) in expected.items():
                mine, my_status = kernel.rows(key, q)
                different = int((_bits(mine) != _bits(out)).sum() + (my_status != status).sum())
                results.append(Comparison(key, compiler.version, count, out.size, different))
    return results


def _bits(values: Array) -> Array:
    return np.ascontiguousarray(values).view(np.uint32 if values.dtype == np.float32 else np.uint64)


def accuracy(program: TapeProgram, count: int = 10_000) -> dict[str, float]:
    """Figures of this model, from the reference arithmetic and CasADi's doubles on joints inside the box.

    Largest errors of the network [um], of the joints' curves [urad] and of the forward kinematics [um]; for curves,
    what is left if a controller commands q - curves(q) [urad], and if it calls twice, q - curves(q - curves(q)); for a
    command, the tool's error before the correction [um], what remains of it over the poses with status OK [um], and
    their share; for poses also what remains of the orientation [urad], and the share of singular ones, which count in
    the first share only. Joints at which the model has no value (a four-bar that cannot close) count in this share
    only, not in the share of those where the correction converged. Of tables their bytes and the bound of their error,
    before rounding [urad].
    """
    q = inside(program, count)
    figures: dict[str, float] = {}
    exact = q.astype(np.float64)
    for key, compute in functions(program).items():
        values, status = compute(program, q)
        known = status != Status.NOT_FINITE
        if program.network is not None and key == program.network.key:
            function = program.network.function
            error = abs(values - mapped(function, exact))[known].max()
            if key == "curves":
                figures["curves_error_urad"] = 1e6 * float(error)
                once = exact - values
                for word, command in (("once", once), ("twice", exact - mapped(function, once))):
                    rest = command + mapped(function, command) - exact
                    figures[f"rest_{word}_urad"] = 1e6 * float(abs(rest).max())
            else:
                figures["network_error_um"] = 1e3 * float(error)
        if key == "forward" and program.command is not None:
            error = abs(values - mapped(program.command.calibrated, exact))[known, :3].max()
            figures["forward_error_um"] = 1e6 * float(error)
        if key == "correct" and program.command is not None:
            real, wanted = program.command.calibrated, mapped(program.command.nominal, exact)
            moved, before = mapped(real, exact + values), np.linalg.norm((mapped(real, exact) - wanted)[:, :3], axis=1)
            fine = status == Status.OK
            rest = np.linalg.norm(moved[:, :3] - wanted[:, :3], axis=1)[fine]
            figures |= {"start_error_um_mean": 1e6 * float(before[known].mean()), "share_ok": float(fine.mean())}
            if moved.shape[1] > 3:  # of poses many are singular; a correction that says so has not failed to converge
                known = known & (status != Status.SINGULAR)
                figures["share_singular"] = float((status == Status.SINGULAR).mean())
                turned = np.linalg.norm(moved[:, 3:] - wanted[:, 3:], axis=1)[fine] / np.sqrt(2)  # small angles
                figures |= _median_and_worst("rest_urad", turned, 1e6)
            figures["share_converged"] = float(fine[known].mean()) if known.any() else 0.0
            figures |= _median_and_worst("rest_um", rest, 1e6)
    nodes = {node.table: node for tape in program.tapes.values() for node in tape.nodes if node.table}
    if nodes:
        figures["table_bytes"] = q.itemsize * sum(map(len, nodes))
        figures["table_error_urad_at_most"] = 1e6 * max(node.value for node in nodes.values())
    return {key: float(f"{value:.3g}") for key, value in figures.items()}


def _median_and_worst(name: str, values: Array, unit: float = 1.0) -> dict[str, float]:
    if not values.size:
        return {}
    return {f"{name}_median": unit * float(np.median(values)), f"{name}_worst": unit * float(values.max())}


# Share of the poses in its box at which a verified correction converges, where the model has a value.
LEAST_CONVERGED = 0.9


@dataclass(frozen=True)
class Export(Result):
    """A written export.

    written : names of its files; comparisons : of the compiled C; figures : of this model; operations : of a call
    about : what it was made from and what it leaves out, in words
    """

    kept_as: ClassVar[str] = "export"

    derived: ClassVar[tuple[Key, ...]] = (Key("verified"), Key("operations", "operations.count"))

    folder: Path = field(metadata=WRITTEN)
    written: tuple[str, ...] = field(metadata=named("files"))
    comparisons: tuple[Comparison, ...]
    figures: dict[str, float] = field(metadata=WRITTEN)
    operations: Operations
    about: tuple[str, ...] = ()

    @property
    def verified(self) -> bool:
        """Whether a compiler was there, its C gave the reference's bits, and a correction converges in its box."""
        return bool(self.comparisons) and self.converges

    @property
    def converges(self) -> bool:
        """Whether a correction has status OK at nine of ten poses in its box; true where nothing is corrected."""
        return self.figures.get("share_converged", 1.0) >= LEAST_CONVERGED

    def blocks(self) -> list[Words]:
        """Whether it is verified, every comparison, the figures of this model, and the operations of a call."""
        head = "verified: compiled, and the same bits as the reference"
        if not self.converges:
            head = (
                f"UNVERIFIED: the correction converges at {100 * self.figures['share_converged']:.3g} % of the poses "
                f"in its box, {100 * LEAST_CONVERGED:g} % are needed; other poses are refused, with their status"
            )
        elif not self.comparisons:
            head = "UNVERIFIED: no C compiler found (gcc, clang, cc); install one and export again"
        lines = [*map(str, self.comparisons), *(f"{key}: {value:g}" for key, value in self.figures.items())]
        lines += [self.operations.text(), f"{len(self.written)} files in {self.folder}"]
        lines += ["precondition: the controller's own absolute-accuracy option is off"]
        return [*map(Words, self.about), Words(head, "verdict"), *map(Words, lines)]


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
    """Turn a network, curves or a command into C99 with everything an integrator needs, compiled and compared.

    product : a network, curves or a command
    folder : made when missing; what is in it already stays
    name : prefix of the C functions and files: a lower-case C identifier of at most 24 characters
    real : type of its numbers
    model_sha256 : hash of the model, for the header
    data_sha256 : hash of the data, for the header
    languages : which to write besides the C, by name; default: all of this package (`structured_text`)
    vectors : joint vectors on which the compiled C is compared with the reference
    overwrite : replace files that this function did not write, or that were changed since
    also : further files that appear with them or not at all, from what this function gives back
    Raises InputError: a name, type or function cannot be used, or a file is in the way; CasadicalError: the C does not
        compile without warnings, or gives other bits than the reference; nothing was written.

    Examples
    --------
    >>> command = casadical.export.command_of(casadical.export.Sources(found.robot, robot))
    >>> export = casadical.export.write_c(command, "command", name="arm", vectors=100)
    >>> "arm.c" in export.written, "arm.st" in export.written
    (True, True)
    """
    label = _checked_label(name, real, model_sha256, data_sha256)
    folder = Path(folder)
    program = tape_program(product, real)
    blobs = written_in(program, label, languages)
    _check_nothing_in_the_way(folder, [*blobs, "manifest.json"], overwrite)
    installed = compilers()
    comparisons = compared(program, name, blobs, installed, vectors)
    wrong = [str(c) for c in comparisons if c.different]
    if wrong:
        raise CasadicalError("the compiled C differs from its reference; nothing was written:\n" + "\n".join(wrong))
    figures = accuracy(program)
    made = Export(folder, tuple(sorted([*blobs, "manifest.json"])), tuple(comparisons), figures, operations(program))
    blobs["manifest.json"] = _manifest(program, label, blobs, made)
    with claimed([folder]):
        write_together({**{folder / key: blob for key, blob in blobs.items()}, **also(made)})
    remember(blobs["manifest.json"])
    return made


def _checked_label(name: str, real: str, model_sha256: str, data_sha256: str) -> Label:
    if not re.fullmatch(NAME, name):
        raise InputError(f"{name!r} cannot prefix C functions; use 1 to 24 of a-z, 0-9, _, beginning with a letter")
    if real not in ("float", "double"):
        raise InputError(f"real type {real!r}; it must be 'float' or 'double'")
    for value in (model_sha256, data_sha256):
        if not re.fullmatch(r"[0-9a-f]{64}|not given", value):
            raise InputError(f"{value!r} is no sha256; give 64 hexadecimal digits in lower case, or leave it out")
    return Label(name, model_sha256, data_sha256)


def _check_nothing_in_the_way(folder: Path, names: list[str], overwrite: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give a folder")
    if overwrite:
        return
    ours = _written_before(folder)
    for key in names:
        path = folder / key
        if path.exists() and ours.get(key) != _sha256(read_bytes(path)):
            raise InputError(
                f"{path} is in the way: it was not written by this export, or was changed since; "
                "give another folder, or overwrite=True (--overwrite)"
            )


def _written_before(folder: Path) -> dict[str, str]:
    """Hashes of the files that an earlier export wrote into the folder; the manifest's own among them."""
    path = folder / "manifest.json"
    try:
        blob = read_bytes(path)
        manifest: dict[str, Any] = json_of(blob, str(path))
        files = dict(manifest["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return files | {"manifest.json": _sha256(blob)} if manifest.get("written_by") == "casadical" else {}


def _sha256(blob: bytes) -> str:
    return hashlib.sha256(blob).hexdigest()


def _manifest(program: TapeProgram, label: Label, blobs: dict[str, bytes], made: Export) -> bytes:
    content = {
        "written_by": "casadical",
        "schema": SCHEMA,
        "product": "command" if program.network is None or program.command else program.network.key,
        "model_sha256": label.model_sha256,
        "data_sha256": label.data_sha256,
        "kernel": vars(shape_of(program, label.name)),
        "files": {key: _sha256(blob) for key, blob in sorted(blobs.items())},
        "verified": made.verified,
        "comparisons": [vars(c) for c in made.comparisons],
        "figures": made.figures,
        "operations": made.operations.count,
        "limits": vars(program.command.limits) if program.command else {},
    }
    return (json.dumps(content, indent=2) + "\n").encode()
