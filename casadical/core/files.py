"""Atomic writing of files: each is written under a hidden name in its folder, then renamed.

All files of one call are on disk before the first rename. A folder that was made for the outputs of
a command is written as a hidden folder and appears by one rename. Code and data that are loaded from
the user's private cache folder must not be writable by others.
"""

import csv
import io
import json
import os
import re
import secrets
import shutil
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import platformdirs

from casadical.core.basics import InputError, shown

try:
    import fcntl
except ImportError:  # a system without flock: nothing is locked there
    fcntl = None  # type: ignore[assignment]

# Output folders that this thread or task has locked, by real path, and whether it made each.
_claimed: ContextVar[Mapping[Path, bool]] = ContextVar("claimed", default={})  # noqa: B039 never changed


def json_text(data: Any) -> str:
    """Return plain data as the text of a JSON file. Raises ValueError for NaN and infinity."""
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows of cells as the text of a CSV file, with commas and line feeds."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def write_whole(path: Path, text: str) -> None:
    """Write one file as `write_together` does. Raises InputError if it cannot be written there."""
    write_together({path: text})


def write_together(contents: Mapping[Path, str | bytes]) -> None:
    """Write several files, text as UTF-8; if one cannot be written to disk, none appears.

    A symbolic link is followed; devices and pipes are written into before the files appear. If one
    of several renames fails, the error names the files that have appeared.

    Raises InputError: two outputs of one name, a folder as a file, no space, no permission.
    """
    written: list[str] = []
    path = Path()
    files: dict[Path, bytes] = {}
    streams: dict[Path, bytes] = {}
    renames: dict[Path, Path] = {}  # hidden name of each target
    try:
        with ExitStack() as stack:
            for path, content in contents.items():
                real = real_path(path)
                if path.is_dir():
                    raise InputError(f"{path}: is a folder; name a file")
                stream = own_stream(path) is not None or (path.exists() and not path.is_file())
                if real in files:
                    raise InputError(
                        f"{path}: two outputs have this name, and nothing was written; give each a file of its own"
                    )
                blob = content.encode() if isinstance(content, str) else content
                (streams if stream else files)[path if stream else real] = blob
            for target, blob in files.items():
                home = next((f for f in _claimed.get() if f in target.parents), None)
                path = home or target
                if home and (home in renames or (_claimed.get()[home] and not any(home.iterdir()))):
                    if home not in renames:
                        renames[home] = home.with_name(f".casadical-{secrets.token_hex(8)}")
                        stack.callback(shutil.rmtree, renames[home], ignore_errors=True)
                    hidden = renames[home] / target.relative_to(home)
                else:
                    hidden = target.with_name(f".casadical-{secrets.token_hex(8)}")
                    renames[target] = hidden
                    stack.callback(hidden.unlink, missing_ok=True)
                hidden.parent.mkdir(parents=True, exist_ok=True)
                with hidden.open("xb") as file:
                    file.write(blob)
                    file.flush()
                    os.fsync(file.fileno())
                if target.exists():
                    hidden.chmod(stat.S_IMODE(target.stat().st_mode))
            for path, blob in streams.items():
                number = own_stream(path)  # opened again, a file would be written from its beginning
                sys.stdout.flush()
                # A pipe that nobody reads is an OSError.
                flags = os.O_WRONLY | getattr(os, "O_NONBLOCK", 0)
                handle = os.open(path, flags) if number is None else os.dup(number)
                with os.fdopen(handle, "wb") as file:
                    os.set_blocking(handle, True)
                    file.write(blob)
            for path, hidden in renames.items():
                if hidden.is_dir():
                    path.rmdir()
                hidden.replace(path)
                written.append(path.name)
    except (OSError, ValueError, RuntimeError) as error:  # a NUL in a name, a loop of links
        raise _failure(path, error, written) from error


@contextmanager
def claimed(folders: Iterable[str | Path]) -> Iterator[None]:
    """Lock folders of outputs against other processes in the block; make those that are missing.

    A folder that was made for this and is empty at the end is removed. Raises InputError: another
    process writes to one of them, or it cannot be made.
    """

    def remove_empty(folder: Path) -> None:
        """Remove a folder if it is empty."""
        with suppress(OSError):
            folder.rmdir()

    with ExitStack() as stack:
        claims = dict(_claimed.get())
        for folder in map(Path, folders):
            try:
                real = real_path(folder)
                if real in claims:
                    continue
                new = [p for p in (real, *real.parents) if not p.exists()]
                real.mkdir(parents=True, exist_ok=True)
                for made in reversed(new):
                    stack.callback(remove_empty, made)
                handle = os.open(real, os.O_RDONLY)
                stack.callback(os.close, handle)
                if not locked(handle):
                    raise InputError(
                        f"{folder}: another casadical is writing to this folder; wait for it, or name another folder"
                    )
                claims[real] = bool(new)
            except (OSError, ValueError, RuntimeError) as error:
                raise _failure(folder, error) from error
        before = _claimed.set(claims)
        stack.callback(_claimed.reset, before)
        yield


@contextmanager
def appending(path: Path, start: int) -> Iterator[Callable[[str], None]]:
    """Yield a function that appends a text to a file and returns when it is on disk.

    start : number of bytes to which the file, made if it is missing, is cut first
    Raises InputError: another process appends to it, or it cannot be written.
    """
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            file = stack.enter_context(os.fdopen(handle, "r+b", buffering=0))
            if not locked(handle):
                raise InputError(f"{shown(path)}: another casadical is writing to this file; wait for it")
            file.truncate(start)
            file.seek(start)
        except (OSError, ValueError) as error:
            raise _failure(path, error) from error

        def add(line: str) -> None:
            """Append a text and write it to disk. Raises InputError: it cannot be written."""
            try:
                file.write(line.encode())
                os.fsync(handle)
            except OSError as error:
                raise _failure(path, error, ["the lines before it"]) from error

        yield add


def locked(handle: int) -> bool:
    """Lock an open file or folder until it is closed; return whether this was possible.

    Where the system has no locks, it is True.

    handle : file descriptor
    """
    if fcntl is not None:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
    return True


def real_path(path: Path) -> Path:
    """Return the absolute path with symbolic links resolved; the file itself may be missing.

    Raises OSError, ValueError or RuntimeError: it cannot be followed, as a loop of links.
    """
    with suppress(FileNotFoundError):
        path.stat()  # says what is wrong with a path, which `resolve` does not
    return path.resolve()


def own_stream(path: Path) -> int | None:
    """Return the file descriptor that a path such as /dev/stdout or /dev/fd/3 denotes, or None."""
    match = re.fullmatch(r"/dev/(std(?:in|out|err))|/(?:dev|proc/self)/fd/(\d+)", os.path.abspath(path))
    if not match:
        return None
    return int(match[2]) if match[2] else ("stdin", "stdout", "stderr").index(match[1])


def _failure(path: Path, error: Exception, written: Sequence[str] = ()) -> InputError:
    """Return the InputError of a failed write, with the names of files written so far.

    An InputError is returned unchanged.
    """
    if isinstance(error, InputError):
        return error
    so_far = f"written so far: {', '.join(written)}" if written else "nothing was written"
    why = getattr(error, "strerror", None) or error
    return InputError(f"{shown(path)}: cannot be written: {why}; {so_far}")


def private_folder(name: str = "") -> Path | None:
    """Return casadical's cache folder, or a folder in it, which is made if it is missing.

    It is the folder `casadical` in that of the variable CASADICAL_CACHE, whose mode is unchanged,
    else in the user's cache folder. Its mode is made 0700; if others could write to it, the cached
    files in it are removed. None is returned where it cannot be made, is a link,
    or belongs to another user, and where the user has no home folder.

    name : folder in the cache folder; empty: the cache folder itself
    """
    try:
        given = os.environ.get("CASADICAL_CACHE")
        folder = Path(given, "casadical") if given else Path(platformdirs.user_cache_dir("casadical"))
        if not (given or folder.is_absolute()):  # no home: "~" was not expanded
            return None
        for place in (folder, folder / name) if name else (folder,):
            place.mkdir(parents=True, exist_ok=True, mode=0o700)
            if not _own(place):
                return None
        return folder / name
    except (OSError, RuntimeError, ValueError):  # no permission, a NUL in its name
        return None


def _own(folder: Path) -> bool:
    """Return whether a path is a folder of the user and no link; then set its mode to 0700.

    If others could write to it, the cached libraries, JSON files and compiled templates in it are
    removed. On Windows, which has no such owners, every folder counts as the user's and is
    unchanged.
    """
    about = folder.lstat()
    if not stat.S_ISDIR(about.st_mode):
        return False
    if not hasattr(os, "geteuid"):
        return True
    if about.st_uid != os.geteuid():
        return False
    if stat.S_IMODE(about.st_mode) != 0o700:
        folder.chmod(0o700)
    if about.st_mode & 0o022:  # others could write: what looks like ours may not be
        for path in folder.iterdir():
            if re.fullmatch(r".*-[0-9a-f]{32,40}\.(so|json|jinja)", path.name):
                path.unlink()
    return True
