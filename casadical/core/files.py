"""Files are written completely or not at all, and so are the files of a claimed folder, whenever the process ends.

A file is written under a hidden name beside its target and then renamed. The files of a claimed folder are written into
a new folder beside it, into which its other files are linked, and the two folders change places by one system call.
Where a folder cannot be moved, and for files that belong together in a folder that is not claimed, a journal lists the
renames to come; who reads or writes there next finishes what a killed process left (`settle`).

Hidden names begin with `PREFIX`. Their writer holds a lock on them, so that those of a killed one can be removed.
"""

import csv
import io
import json
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from casadical.core.basics import InputError, shown
from casadical.core.file_locks import Lock, exchange, exchange_works

PREFIX = ".casadical-"
_FILE, _FOLDER, _JOURNAL = ".part", ".folder", ".journal"
# A folder with more entries than these is not built again; its files are renamed one by one.
_MOST_LINKS = 1000

# Real paths of the folders that this thread or task has claimed.
_claimed: ContextVar[tuple[Path, ...]] = ContextVar("claimed", default=())


def json_text(data: Any) -> str:
    """Plain data as the text of a JSON file. Raises ValueError for NaN and infinity, which JSON does not have."""
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Rows as the text of a CSV file, with commas and lines that end as everywhere."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def write_whole(path: Path, text: str) -> None:
    """Write one file as `write_together` does. Raises InputError if it cannot be written there."""
    write_together({path: text})


def write_together(contents: Mapping[Path, str | bytes]) -> None:
    """Write several files, text as UTF-8: all of them or, if one cannot be written, none.

    Those of a claimed folder appear as one. A symbolic link is followed; devices and pipes are written into.

    Raises InputError: two outputs of one name, a folder in place of a file, no space, no permission.
    """
    written: list[str] = []
    path = Path()
    try:
        with ExitStack() as stack:
            files: dict[Path, bytes] = {}
            streams: dict[Path, bytes] = {}
            for path, content in contents.items():
                _sort(path, content.encode() if isinstance(content, str) else content, files, streams)
            steps = []
            for home, part in _by_home(files).items():
                path = home if home in _claimed.get() else next(iter(part))
                steps.append(_prepared(home, part, stack))
            for path, blob in streams.items():
                _into(path, blob)
            for step in steps:
                path = step.folder
                step.commit(written)
    except (OSError, ValueError, RuntimeError) as error:  # the last two: a NUL in a name, a loop of links
        raise _failure(path, error, written) from error


@contextmanager
def claimed(folders: Iterable[str | Path]) -> Iterator[None]:
    """Folders whose files appear as one: made where they are not there, and locked against other processes.

    A folder that was made for this and is empty at the end is removed. Raises InputError: another process writes to
    one of them, or it cannot be made.
    """
    with ExitStack() as stack:
        held = list(_claimed.get())
        for folder in map(Path, folders):
            try:
                real = real_path(folder)
                if real not in held:
                    _lock_folder(folder, real, stack)
                    held.append(real)
            except (OSError, ValueError, RuntimeError) as error:
                raise _failure(folder, error) from error
        before = _claimed.set(tuple(held))
        stack.callback(_claimed.reset, before)
        yield


@contextmanager
def appending(path: Path, start: int) -> Iterator[Callable[[str], None]]:
    """A file that lines are added to, each on disk before the next; what lies behind byte `start` is cut off first.

    Raises InputError: another process adds to it, or it cannot be written.
    """
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+b", buffering=0))
            if not Lock.keep(file.fileno(), wait=False):
                raise InputError(f"{shown(path)}: another casadical is writing to this file; wait for it")
            file.truncate(start)
            file.seek(start)
        except (OSError, ValueError) as error:
            raise _failure(path, error) from error

        def add(line: str) -> None:
            try:
                file.write(line.encode())
                os.fsync(file.fileno())
            except OSError as error:
                raise _failure(path, error, ["the lines before it"]) from error

        yield add


def settle(folder: Path) -> None:
    """Finish the renames that a killed process left undone in a folder. Raises OSError where that is not permitted."""
    for journal in sorted(folder.glob(f"{PREFIX}*{_JOURNAL}")):
        with suppress(FileNotFoundError), Lock(journal) as lock:
            lock.wait()  # for a process that is not killed but at work
            with suppress(ValueError, TypeError, RecursionError):  # no journal that casadical wrote
                _redo(folder, json.loads(journal.read_bytes() if journal.is_file() else "[]"))
            journal.unlink()


def real_path(path: Path) -> Path:
    """The path with its links followed. Raises OSError, ValueError or RuntimeError for one that cannot be."""
    with suppress(FileNotFoundError):
        path.stat()  # says what is wrong with a path, which `resolve` does not
    return path.resolve()


def _sort(path: Path, blob: bytes, files: dict[Path, bytes], streams: dict[Path, bytes]) -> None:
    real = real_path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if own_stream(path) is not None or (path.exists() and not path.is_file()):
        streams[path] = blob
        return
    if real in files:
        raise InputError(f"{path}: two outputs have this name, and nothing was written; give each a file of its own")
    files[real] = blob


def own_stream(path: Path) -> int | None:
    """The descriptor that a name such as /dev/stdout stands for, which may be a file that a shell opened; else None."""
    match = re.fullmatch(r"/dev/(std(?:in|out|err))|/(?:dev|proc/self)/fd/(\d+)", os.path.abspath(path))
    return (int(match[2]) if match[2] else ("stdin", "stdout", "stderr").index(match[1])) if match else None


def _into(path: Path, blob: bytes) -> None:
    """Write into a device or a pipe; one that nobody reads from is an error, no waiting."""
    number = own_stream(path)  # opened again, a file would be written from its beginning
    sys.stdout.flush()
    handle = os.open(path, os.O_WRONLY | getattr(os, "O_NONBLOCK", 0)) if number is None else os.dup(number)
    with os.fdopen(handle, "wb") as file:
        os.set_blocking(handle, True)
        file.write(blob)


def _by_home(files: Mapping[Path, bytes]) -> dict[Path, dict[Path, bytes]]:
    """Files by the claimed folder that they are in, else by their folder."""
    by_home: dict[Path, dict[Path, bytes]] = {}
    for path, blob in files.items():
        home = next((f for f in _claimed.get() if f in path.parents), path.parent)
        by_home.setdefault(home, {})[path] = blob
    return by_home


def _failure(path: Path, error: Exception, written: Sequence[str] = ()) -> InputError:
    if isinstance(error, InputError):
        return error
    so_far = f"written so far: {', '.join(written)}" if written else "nothing was written"
    return InputError(f"{shown(path)}: cannot be written: {getattr(error, 'strerror', None) or error}; {so_far}")


def _lock_folder(folder: Path, real: Path, stack: ExitStack) -> None:
    new = [p for p in (real, *real.parents) if not p.exists()]
    real.mkdir(parents=True, exist_ok=True)
    for made in reversed(new):
        stack.callback(_remove_empty, made)
    lock = stack.enter_context(Lock(real))
    if not lock.taken():
        raise InputError(f"{folder}: another casadical is writing to this folder; wait for it, or name another folder")


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _prepared(home: Path, contents: Mapping[Path, bytes], stack: ExitStack) -> "_Renames | _Exchange":
    """Everything on disk under hidden names, so that what is left to do is to rename."""
    for folder in {home, *(path.parent for path in contents)}:
        folder.mkdir(parents=True, exist_ok=True)
        settle(folder)
        _sweep(folder)
    if home in _claimed.get() and _movable(home):
        _sweep(home.parent)
        made = _hidden_folder(home.parent, stack)
        if exchange_works(made):
            return _Exchange(home, made, contents)
    return _Renames(home, contents, stack)


class _Renames:
    """Files under hidden names in their folders, each to be renamed; by a journal where a folder gets several."""

    def __init__(self, folder: Path, contents: Mapping[Path, bytes], stack: ExitStack) -> None:
        self.folder = folder
        self.hidden: dict[Path, Path] = {}
        self.journals: dict[Path, Path] = {}
        for path, blob in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            self.hidden[path] = _hidden_file(path.parent, blob, _mode(path), stack)
        for parent in dict.fromkeys(path.parent for path in contents):
            listed = [(h.name, p.name) for p, h in self.hidden.items() if p.parent == parent]
            if len(listed) > 1:
                self.journals[parent] = _hidden_file(parent, json.dumps(listed).encode(), 0o600, stack)

    def commit(self, written: list[str]) -> None:
        with ExitStack() as stack:
            for hidden in self.journals.values():
                journal = hidden.replace(hidden.with_suffix(_JOURNAL))
                stack.callback(journal.unlink, missing_ok=True)
            for path, hidden in self.hidden.items():
                hidden.replace(path)
                written.append(path.name)
            for parent in dict.fromkeys(path.parent for path in self.hidden):
                _sync(parent)


def _redo(folder: Path, listed: Any) -> None:
    """The renames that a journal lists, as far as they were not done."""
    for hidden, name in listed:
        if str(hidden).startswith(PREFIX) and all(Path(one).name == one for one in (hidden, name)):
            with suppress(FileNotFoundError):
                (folder / hidden).replace(folder / name)


class _Exchange:
    """A new folder beside the old one, to change places with it."""

    def __init__(self, folder: Path, made: Path, contents: Mapping[Path, bytes]) -> None:
        self.folder, self.made, self.contents = folder, made, contents
        self.linked = _link_tree(folder, self.made, contents)
        for path, blob in contents.items():
            target = self.made / path.relative_to(folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as file:
                _write(file.fileno(), blob, _mode(path))
        for inner in {self.made, *(self.made / path.relative_to(folder).parent for path in contents)}:
            _sync(inner)
        self.made.chmod(stat.S_IMODE(folder.stat().st_mode))

    def commit(self, written: list[str]) -> None:
        """Let the folders change places; `written` gets the name."""
        if not any(self.folder.iterdir()):
            self.made.replace(self.folder)
        else:
            exchange(self.made, self.folder)
            self._keep_what_came()
            shutil.rmtree(self.made)
        written.append(self.folder.name)
        _sync(self.folder.parent)

    def _keep_what_came(self) -> None:
        """Files that others put into the old folder while the new one was made."""
        for path in _files(self.made):
            name = path.relative_to(self.made)
            if self.linked.get(name) != path.lstat().st_ino and self.folder / name not in self.contents:
                (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
                path.replace(self.folder / name)


def _movable(folder: Path) -> bool:
    """Whether a folder may be exchanged for another: nobody stands in it, it is ours, no mount, and not large."""
    try:
        about, inner = folder.stat(), Path.cwd()
        entries = [e for _, e in zip(range(_MOST_LINKS + 1), folder.rglob("*"), strict=False)]
        devices = {e.lstat().st_dev for e in entries} | {folder.parent.stat().st_dev, about.st_dev}
        ours = (about.st_uid, about.st_gid) == (os.geteuid(), os.getegid())
        in_use = folder == inner or folder in inner.parents or os.path.ismount(folder)
        small = len(devices) == 1 and len(entries) <= _MOST_LINKS
        return ours and small and not in_use and os.access(folder.parent, os.W_OK)
    except (OSError, AttributeError):  # no such permission; a system without user ids
        return False


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())


def _link_tree(folder: Path, made: Path, but: Iterable[Path]) -> dict[Path, int]:
    """Hard links to every file of a folder except some; their names in it, and their inodes."""
    left, linked = set(but), {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        if path.is_dir() and not path.is_symlink():
            (made / name).mkdir(parents=True, exist_ok=True)
            (made / name).chmod(stat.S_IMODE(path.stat().st_mode))
        elif path not in left:
            os.link(path, made / name, follow_symlinks=False)
            linked[name] = path.lstat().st_ino
    return linked


def _hidden_file(folder: Path, blob: bytes, mode: int, stack: ExitStack) -> Path:
    """A new file under a hidden name, on disk; removed at the end of the stack if it still has this name."""
    while True:
        handle, name = tempfile.mkstemp(dir=folder, prefix=PREFIX, suffix=_FILE)
        stack.callback(os.close, handle)
        stack.callback(Path(name).unlink, missing_ok=True)
        Lock.keep(handle)
        if Path(name).exists():  # else `_sweep` was quicker
            _write(handle, blob, mode)
            return Path(name)


def _hidden_folder(parent: Path, stack: ExitStack) -> Path:
    """A new folder under a hidden name; removed at the end of the stack if it still has this name."""
    while True:
        made = Path(tempfile.mkdtemp(dir=parent, prefix=PREFIX, suffix=_FOLDER))
        stack.callback(shutil.rmtree, made, ignore_errors=True)
        with suppress(FileNotFoundError):  # `_sweep` was quicker
            if stack.enter_context(Lock(made)).taken():
                return made


def _sweep(folder: Path) -> None:
    """Remove what killed processes left under hidden names: what nobody has locked."""
    for path in (*folder.glob(f"{PREFIX}*{_FILE}"), *folder.glob(f"{PREFIX}*{_FOLDER}")):
        with suppress(OSError), Lock(path) as lock:
            if lock.taken():
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _write(handle: int, blob: bytes, mode: int) -> None:
    with os.fdopen(os.dup(handle), "wb") as file:
        file.write(blob)
        file.flush()
        os.fchmod(handle, mode)
        os.fsync(handle)


def _sync(folder: Path) -> None:
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _mode(path: Path) -> int:
    """Of the file that is there, else of a new one."""
    if path.exists():
        return stat.S_IMODE(path.stat().st_mode)
    mask = os.umask(0)  # can only be read by setting it
    os.umask(mask)
    return 0o666 & ~mask
