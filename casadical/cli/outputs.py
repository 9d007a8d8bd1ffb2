"""Protection of files: a command's outputs are checked, its folders claimed, before it works.

An output must be no input, no file of others, no name that is given twice, and nothing that another
command writes at the same time.
"""

import json
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from fnmatch import fnmatch
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import Any

from casadical.core.basics import InputError, shown
from casadical.core.files import claimed, own_stream, real_path
from casadical.core.reading import load_toml, number_fault, read_bytes, text_fault


def guarded(command: Callable[..., Any], also: Sequence[str] = ()) -> Callable[..., Any]:
    """Return a command that first checks its arguments and claims the folders that it will write.

    Its InputErrors are joined with the faults of its input files (see `every_fault`).

    command : function with the parameters of the command line
    also : names of parameters that are outputs of this command alone
    """
    # Parameters of commands that name outputs; every other path parameter is an input.
    output_parameters = ("out", "json_file", "report_file", "measure_next", "figure", "priors")
    outputs = {*output_parameters, *also}
    metavars = {n: getattr(p.default, "metavar", None) for n, p in signature(command).parameters.items()}
    folders = {name for name, metavar in metavars.items() if (metavar or "").startswith("DIR")}

    @wraps(command)
    def run(**given: Any) -> Any:
        """Check the outputs, claim their folders, then run the command with its parameters."""
        _refuse_unusable(given, outputs)
        paths = {name: value for name, value in given.items() if isinstance(value, Path)}
        inputs = [path for name, path in paths.items() if name not in outputs]
        inputs += [p for v in given.values() if isinstance(v, list) for p in v if isinstance(p, Path)]
        into = [paths[name] for name in outputs if name in paths and name in folders]
        files = [paths[name] for name in outputs if name in paths and name not in folders]
        _check(files, into, inputs, given.get("overwrite"))
        with claimed(into):
            try:
                return command(**given)
            except InputError as error:
                from casadical.project.faults import every_fault

                # Names of the commands that leave out rows with a cell that is no number.
                later = command.__name__ in ("verify", "compare", "measure")
                others = (given.get("room"), given.get("store"))
                judged = [path for path in inputs if path not in others and command.__name__ != "new"]
                raise every_fault(error, judged, later=later) from None

    return run


def _refuse_unusable(given: Mapping[str, Any], outputs: Collection[str]) -> None:
    """Check that numbers, texts and paths of options are usable. Raises InputError."""
    for name, value in given.items():
        for one in value if isinstance(value, list) else [value]:
            fault = ""
            if one == Path() and "" in sys.argv and "." not in sys.argv:
                raise InputError("a path is empty, '': name the file or folder, or . for the one that you are in")
            if isinstance(one, Path) and name not in outputs:
                real = _real(one, "read")
                if real.is_char_device() or real.is_block_device():
                    raise InputError(f"{shown(one)}: is a device; name a file")
            if isinstance(one, str):
                fault = text_fault(one) if one or "" not in sys.argv else "is empty; give a value, or leave it out"
            elif isinstance(one, int | float):
                fault = number_fault(one)
            if fault:
                raise InputError(f"--{name.replace('_', '-')} {shown(one)}: {fault}")


def _check(files: Sequence[Path], folders: Sequence[Path], inputs: Sequence[Path], overwrite: bool | None) -> None:
    """Check that no output replaces an input, another output, or a file not by casadical.

    overwrite : whether foreign files may be replaced; None: the command has no such option
    """
    read = {real: path for path in inputs for real in _inputs(path)}
    taken: dict[Path, Path] = {}
    within = {_real(folder) for folder in folders}
    for path in (*folders, *files):
        real = _real(path)
        if real in taken:
            raise InputError(f"{shown(path)}: two outputs have this name; give each a name of its own")
        if real in read:
            raise InputError(f"{shown(path)}: is an input of this command and is not replaced; name another file")
        taken[real] = path
    for path in files:
        if path.suffix == "" and path.is_dir():
            raise InputError(f"{shown(path)}: is a folder; name a file")
        if _real(path).parent in within and _of_a_set(path.name):
            raise InputError(f"{shown(path)}: a file of this name is among those of --out; name another one")
        if not overwrite and path.is_file() and own_stream(path) is None:
            _refuse_foreign(path, "move this one away" if overwrite is None else "give --overwrite")
    for real, path in read.items():
        if real.parent in within and _of_a_set(real.name) and path.is_file():
            raise InputError(f"{shown(path)}: is an input, and --out may replace it; name another folder")
    for folder in folders:
        if folder.is_dir():
            for path in sorted(folder.iterdir()):
                if path.name in ("result.json", "diagnosis.json") and path.is_file():
                    _refuse_foreign(path)


def _of_a_set(name: str) -> bool:
    """Return whether a file of this name may be written into a folder of outputs (--out DIR)."""
    # Patterns of file names in a folder of outputs, which no other output and no input may have.
    output_file_patterns = (
        *("result.json", "*.robot.toml", "*.robot.urdf", "*.parameters.csv", "*.compensator.json"),
        *("manifest.json", "diagnosis.json", "diagnosis.txt", "discovery.json", "discovery.txt"),
        *("*.effect.toml", "*.covariance.npz"),
    )
    return any(fnmatch(name, pattern) for pattern in output_file_patterns)


def _real(path: Path, done: str = "written") -> Path:
    """Return the real path of an output or input. Raises InputError where it cannot be resolved."""
    try:
        return real_path(path)
    except (OSError, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{shown(path)}: cannot be {done}: {reason}; nothing was written") from None


def _inputs(path: Path) -> Iterator[Path]:
    """Yield the real paths of an input and, for a folder, of the files in it that are read."""
    with suppress(OSError, ValueError, RuntimeError):
        real = real_path(path)
        yield real
        if not real.is_dir():
            return
        always = (
            *("robot.toml", "*.robot.toml", "*.covariance.npz", "result.json"),
            *("withheld.json", "key.json", "manifest.json"),
        )
        yield from (p.resolve() for name in always for p in real.glob(name))
        problem = real / "problem.toml"
        if problem.is_file():
            yield problem
            named = [real / text for text in _texts(load_toml(problem))]
            yield from (p.resolve() for p in (*named, *real.glob("campaigns/*")) if p.is_file())
        else:
            for folder in real.glob("*/problem.toml"):
                yield from _inputs(folder.parent)


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts in a nested value of a TOML file."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _texts(inner)


def _refuse_foreign(path: Path, remedy: str = "move this one away") -> None:
    """Check that an existing file is an output of casadical, or empty. Raises InputError if not."""
    try:
        text = read_bytes(path).decode("utf-8", "replace")
    except OSError as error:
        raise InputError(f"{shown(path)}: is there and cannot be read: {error.strerror}; name another file") from None
    if text.strip() and not _is_output(path, text):
        text = "is there and was not written by casadical, or was changed since; name another file"
        raise InputError(f"{shown(path)}: {text}, or {remedy}")


def _is_output(path: Path, text: str) -> bool:
    """Return whether a file may be replaced as an earlier output of casadical.

    JSON is recognised by its keys, other text by the word casadical. A PNG, and a CSV with several
    columns, counts as an output unless the latter has positions that are measured.
    """
    # Sets of keys by which each kind of JSON that `--json` writes is recognised.
    json_signatures = (
        *({"problem", "robot"}, {"campaign"}, {"forecast"}, {"targets", "corrected"}),
        *({"folder", "files", "verified"}, {"file", "robot", "left_out"}, {"withheld", "not_drawn"}),
        *({"key_sha256"}, {"answers", "by"}, {"by", "figures"}, {"changed", "changes", "campaigns"}),
        *({"fleet", "robots", "types"}, {"robot", "fields", "readings"}, {"certificate", "decision"}),
        *({"dAP_mm", "poses"}, {"touches", "verdict"}, {"log", "verdict", "ranking"}),
    )
    if text.lstrip().startswith(("{", "[")):
        try:
            data = json.loads(text)
        except (ValueError, RecursionError):
            return False
        tables = [data, *(data if isinstance(data, list) else data.values())]
        return any(isinstance(t, dict) and any(names <= t.keys() for names in json_signatures) for t in tables)
    # Columns by which a CSV is recognised as measurements, which are never overwritten.
    position_columns = {"x_mm", "x_m", "y_mm", "y_m", "z_mm", "z_m"}
    if path.suffix == ".csv":
        header, *rows = (line.strip().split(",") for line in text.splitlines())
        n = len(position_columns & {*header})  # which stand last and are empty in poses to measure
        last = position_columns >= {*header[len(header) - n :]}
        return len(header) > 1 and last and all(row[len(row) - n :] == n * [""] for row in rows)
    return "casadical" in text or text.startswith("\ufffdPNG")
