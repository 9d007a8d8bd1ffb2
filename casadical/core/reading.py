"""Bounded and safe reading of files: opened, decoded and parsed; every fault is an InputError.

Only regular files are opened, and the streams that a shell passes on (/dev/stdin, /dev/fd/N):
reading a FIFO that nobody writes to would block forever. Sizes are checked before parsing. Numbers
and texts that cannot be a quantity or a name are refused with their place in the file.
"""

import codecs
import difflib
import gzip
import io
import json
import math
import os
import re
import stat
import tomllib
import unicodedata
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from casadical.core.basics import InputError, shown
from casadical.core.files import own_stream

# Largest size of a table, a robot program and, by default, any file [bytes]; larger are refused.
MAX_TABLE_BYTES = 500_000_000
# Largest size of a TOML, XML or YAML file, or of a live stream [bytes]; larger ones are refused.
MAX_TEXT_BYTES = 10_000_000
# Largest size of a JSON file [bytes]; larger ones are refused.
MAX_JSON_BYTES = 100_000_000
# Largest size of a zip archive (workbook, npz) after unpacking [bytes]; larger ones are refused.
MAX_UNPACKED_BYTES = 100_000_000
# Largest number of cells of a spreadsheet workbook; larger ones are refused.
MAX_WORKBOOK_CELLS = 300_000
# Largest number of values, rows times columns, of a plain CSV or Parquet table or a joint log;
# larger ones are refused.
MAX_TABLE_NUMBERS = 30_000_000
# Largest number of items of one kind in a file (links, effects, definitions, targets, tables of
# measurements); files with more are refused.
MAX_ITEMS = 1000
# Largest absolute value of a number in a file; greater ones are refused, so that squares and
# products are finite doubles.
LARGEST_NUMBER = 1e100
# Smallest absolute value of a number in a file other than zero; smaller ones are refused.
SMALLEST_NUMBER = 1e-100
# Largest depth of nested tables and lists in a file; files with a greater one are refused.
MAX_NESTING = 50


def missing(path: str | Path, what: str = "file") -> InputError:
    """Return the InputError for a missing file or folder, which suggests similar names."""
    path = Path(path)
    try:
        there = sorted(p.name for p in path.parent.iterdir() if not p.name.startswith("."))[:MAX_ITEMS]
    except (OSError, ValueError):
        return InputError(f"{shown(path)}: no such {what}; there is no folder {shown(path.parent)}")
    of_stem = [name for name in there if path.stem in (name, Path(name).stem)]
    like = [shown(path.parent / name) for name in (difflib.get_close_matches(path.name, there, 3) or of_stem)[:3]]
    meant = f"; did you mean {' or '.join(like)}?" if like and path.stem else ""
    if path.is_symlink():
        meant = "; it is a symbolic link that leads nowhere"
    return InputError(f"{shown(path)}: no such {what}{meant}")


def read_bytes(path: str | Path, most: int = MAX_TABLE_BYTES) -> bytes:
    """Return the content of a file.

    most : largest number of bytes
    Raises InputError: no such file, a folder, a device, a FIFO, more than `most` bytes, or no
    permission.
    """
    path = Path(path)
    with _opening(path):
        streamed = own_stream(path) is not None
        _refuse_special(path, path.stat(), streamed)
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(handle, "rb") as file:
            about = os.fstat(handle)
            _refuse_special(path, about, streamed)
            os.set_blocking(handle, True)
            data = b"" if about.st_size > most else file.read(most + 1)
    if about.st_size > most or len(data) > most:
        raise InputError(f"{shown(path)}: has {max(about.st_size, len(data))} bytes; at most {most} are read: split it")
    return data


def regular(path: str | Path) -> Path:
    """Return the path unchanged if it is that of a regular file, for a library that opens it.

    Raises InputError: no such file, a folder, a device, a FIFO.
    """
    path = Path(path)
    with _opening(path):
        _refuse_special(path, path.stat(), False)
    return path


@contextmanager
def _opening(path: Path) -> Iterator[None]:
    """Raise an InputError in place of a system error of the block, which opens a file."""
    try:
        yield
    except FileNotFoundError:
        raise missing(path) from None
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as error:  # a NUL in its name, a loop of links
        raise InputError(f"{shown(path)}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def unpacked(data: bytes, source: str) -> bytes:
    """Return the content of gzip data, and other data unchanged; source : name for messages.

    Raises InputError: damaged, or more than `MAX_TABLE_BYTES` after unpacking.
    """
    if not data.startswith(b"\x1f\x8b"):
        return data
    with foreign(f"{source}: not a readable gzip file"):
        content = gzip.GzipFile(fileobj=io.BytesIO(data)).read(MAX_TABLE_BYTES + 1)
    if len(content) > MAX_TABLE_BYTES:
        raise InputError(f"{source}: has more than {MAX_TABLE_BYTES} bytes when unpacked; split it")
    return content


def _refuse_special(path: Path, about: os.stat_result, streamed: bool) -> None:
    """Check that a path is not a device, a folder, a pipe or a socket.

    streamed : whether it is a stream of this process, maybe a pipe
    """
    if stat.S_ISCHR(about.st_mode) or stat.S_ISBLK(about.st_mode):
        raise InputError(f"{shown(path)}: is a device; name a file")
    if stat.S_ISDIR(about.st_mode):
        raise InputError(f"{shown(path)}: cannot be read: Is a directory")
    if not (streamed or stat.S_ISREG(about.st_mode)):
        raise InputError(f"{shown(path)}: is a pipe or a socket; name a file, or /dev/stdin")


def read_text(path: str | Path, most: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a UTF-8 file.

    most : largest number of bytes
    Raises InputError as `read_bytes` does, and for bytes that are not UTF-8.
    """
    try:
        return read_bytes(path, most).decode()
    except UnicodeDecodeError:
        raise InputError(f"{shown(path)}: not a text file in UTF-8") from None


def load_toml(path: str | Path) -> dict[str, Any]:
    """Return the tables of a TOML file. Raises InputError: no TOML, no UTF-8, or unreadable."""
    data = read_bytes(path, MAX_TEXT_BYTES)
    try:
        if data.startswith((codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise ValueError("it begins with a mark of the byte order; save it as UTF-8 without one (BOM)")
        return tomllib.loads(data.decode())
    except (ValueError, RecursionError) as error:  # of TOML, its encoding, or an integer of thousands of digits
        why = "nested too deeply" if isinstance(error, RecursionError) else str(error).partition("; use sys.")[0]
        if isinstance(error, UnicodeDecodeError):
            row = data.count(b"\n", 0, error.start) + 1
            why = f"row {row} holds the byte {data[error.start]:#04x}, which is not UTF-8; save it as UTF-8"
        raise InputError(f"{shown(path)}: not valid TOML: {why}") from None


def load_json(path: str | Path) -> Any:
    """Return the object in a JSON file as a dictionary; errors as of `read_bytes`, `json_of`."""
    return json_of(read_bytes(path, MAX_JSON_BYTES), shown(path))


def json_of(text: bytes | str, source: str, kind: Any = dict) -> Any:
    """Return the value of a JSON text as plain data.

    kind : type that the value must have, by default an object (dict); object: any
    Raises InputError: no JSON, another type, too deeply nested, or numbers that are not finite or
    have more than 100 digits.
    """
    try:
        data = json.loads(text, parse_int=_integer, parse_float=_finite, parse_constant=_finite)
    except (ValueError, RecursionError) as error:
        why = "nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(f"{source}: not valid JSON: {why}") from None
    if not isinstance(data, kind):
        wanted = "list" if kind is list else "object"
        found = {dict: "an object", list: "a list", str: "a text", type(None): "null"}.get(type(data), str(data)[:30])
        raise InputError(f"{source}: holds {found}; a JSON {wanted} is expected")
    level, row = 0, [data] if isinstance(data, dict | list) else []
    while row := [v for c in row for v in (c.values() if isinstance(c, dict) else c) if isinstance(v, dict | list)]:
        level += 1
        if level > MAX_NESTING:
            raise InputError(f"{source}: not valid JSON: nested too deeply")
    return data


def _integer(text: str) -> int:
    """Return the integer of a JSON number. Raises ValueError for more than 100 digits."""
    if len(text) > 100:
        raise ValueError(f"an integer of {len(text)} digits; allowed: up to 100")
    return int(text)


def _finite(text: str) -> float:
    """Return the value of a JSON number. Raises ValueError for one that is not finite."""
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text[:30]} is no finite number")
    return value


def read_xml(path: str | Path) -> bytes:
    """Return the content of an XML file as UTF-8 bytes without its XML declaration.

    Raises InputError: not XML's text, an encoding that is not read, or a document type (entities).
    """
    data = read_bytes(path, MAX_TEXT_BYTES)
    # Pattern of the encoding that the declaration of an XML file states.
    xml_encoding = re.compile(rb"^\s*<\?xml[^>]*?encoding\s*=\s*[\"']([^\"']*)[\"'][^>]*\?>")
    declared = xml_encoding.match(data)
    marks = (
        name
        for mark, name in ((codecs.BOM_UTF8, "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
        if data.startswith(mark)
    )
    name = next(marks, declared[1].decode("ascii", "replace").lower() if declared else "utf-8")
    # Names of the encodings in which XML files are read.
    xml_encodings_read = ("utf-8", "utf-8-sig", "utf-16", "us-ascii", "ascii", "iso-8859-1", "latin-1", "windows-1252")
    if name not in xml_encodings_read:
        raise InputError(
            f"{shown(path)}: malformed XML: encoding {name[:30]!r}; allowed: {', '.join(xml_encodings_read)}"
        )
    with foreign(f"{shown(path)}: malformed XML"):
        text = data.decode(name)
        if "<!DOCTYPE" in text:
            raise ValueError("it defines a document type, which no robot needs; take <!DOCTYPE ...> out")
        return re.sub(r"^\s*<\?xml[^>]*\?>", "", text).encode()


@contextmanager
def foreign(what: str, remedy: str = "") -> Iterator[None]:
    """Convert whatever a library raises for a damaged file in the block to an InputError.

    Raises InputError.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        lines = [] if _of_python(error) else str(error).strip().splitlines()
        text = re.sub(r": \(.*,\)$", "", lines[0]).rstrip(".:") if lines else "damaged, or of an unknown form"
        raise InputError(f"{what}: {shown(text)}{remedy and '; '}{remedy}") from None


def _of_python(error: BaseException | None) -> bool:
    """Return whether an error, or its cause, is about code (types, indices) and helps no user."""
    if error is None:
        return False
    explained = type(error) is ValueError or isinstance(error, OSError | EOFError)
    code = type(error).__module__ in ("builtins", "struct") and not explained
    return code or _of_python(error.__cause__ or error.__context__)


def archive_of(data: bytes, source: str) -> io.BytesIO:
    """Return the unchanged bytes of a zip archive as a stream; source : name for messages.

    Raises InputError: damaged, or more than `MAX_UNPACKED_BYTES` after unpacking.
    """
    with foreign(f"{source}: not a readable workbook"), zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > MAX_UNPACKED_BYTES:
        raise InputError(f"{source}: has {size} bytes when unpacked; at most {MAX_UNPACKED_BYTES} are read: split it")
    return io.BytesIO(data)


def number_fault(value: float) -> str:
    """Return as text what is allowed in place of a number of a file; empty for a usable one."""
    if not -LARGEST_NUMBER <= value <= LARGEST_NUMBER:  # also an integer that is no double, and what is not a number
        return f"allowed: finite numbers up to {LARGEST_NUMBER:g}"
    return f"allowed: zero, or at least {SMALLEST_NUMBER:g}" if 0 < abs(value) < SMALLEST_NUMBER else ""


def text_fault(text: str) -> str:
    """Return as text what is wrong with a name or title of a file; empty for a usable one."""
    if len(text) > 10_000:
        return f"has {len(text)} characters; allowed: up to 10000"
    bad = next((c for c in text if unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t"), None)
    return "" if bad is None else f"holds the control character {bad!a}; remove it"


def unusable(value: Any, place: str = "", depth: int = 0) -> Iterator[tuple[str, str]]:
    """Yield (place, fault) of each unusable number or text in nested tables and lists, as text.

    Floats that are not finite are left to the schema.
    place : place of the value itself; depth : number of tables and lists around it
    """
    if depth > MAX_NESTING:
        yield place[:60], "is nested too deeply"
    elif isinstance(value, dict):
        for key, inner in value.items():
            fault = text_fault(key)
            if fault:
                yield f"{place} key {ascii(key)[:60]}".strip(), fault
            yield from unusable(inner, f"{place}.{key}".lstrip("."), depth + 1)
    elif isinstance(value, list):
        if all(type(inner) is float and SMALLEST_NUMBER <= abs(inner) <= LARGEST_NUMBER for inner in value):
            return  # thousands of numbers, of a covariance
        for k, inner in enumerate(value, 1):
            yield from unusable(inner, f"{place}[{k}]", depth + 1)
    elif isinstance(value, str) and text_fault(value):
        yield f"{place} = {ascii(value)[:60]}", text_fault(value)
    elif isinstance(value, float) and not math.isfinite(value):
        return  # the schema says so, with all else that is wrong
    elif isinstance(value, int | float) and not isinstance(value, bool) and number_fault(value):
        yield f"{place} = {_short(value)}", number_fault(value)


def _short(value: float) -> str:
    """Return a number as text for a message."""
    if isinstance(value, int) and abs(value) > LARGEST_NUMBER:
        return f"an integer of {value.bit_length()} bits"
    return f"{value:g}" if isinstance(value, float) and math.isfinite(value) else str(value)
