"""What the operating system has for files and Python has not: locks that end with their process, folders exchanged.

And the user's own folder for what is kept between runs: nobody else may have written what is loaded from there.

Of the libraries for this, filelock locks a file of its own beside the one that is meant, and would leave it in users'
folders; none exchanges two folders or finishes what a killed process began.
"""

import ctypes
import os
import re
import stat
from pathlib import Path
from typing import Self

import platformdirs

try:
    import fcntl
except ImportError:  # a system without flock: nothing is locked there
    fcntl = None  # type: ignore[assignment]

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # of renameat2(2)


class Lock:
    """A file or folder locked until the `with`, or the process, ends. Raises OSError if it cannot be opened."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._handle)

    @staticmethod
    def keep(handle: int, *, wait: bool = True) -> bool:
        """Lock an open file; whether that was possible. Without `wait` it is not while another process has it."""
        if fcntl is not None:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                return False
            except OSError:  # a file system without locks
                return True
        return True

    def wait(self) -> None:
        """Lock it; wait while another process has it."""
        self.keep(self._handle)

    def taken(self) -> bool:
        """Whether it could be locked at once, and still is what the path names."""
        return self.keep(self._handle, wait=False) and os.path.samestat(os.fstat(self._handle), self._path.stat())


def exchange(one: Path, other: Path) -> None:
    """Let two paths change places in one step. Raises OSError, also where the system cannot do that."""
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        raise OSError(0, "this system cannot exchange two folders")
    if call(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def exchange_works(folder: Path) -> bool:
    """Whether the file system of an empty folder can exchange two folders: tried with two new ones."""
    one, other = folder / "1", folder / "2"
    one.mkdir()
    other.mkdir()
    try:
        exchange(one, other)
    except OSError:
        return False
    finally:
        one.rmdir()
        other.rmdir()
    return True


_KEPT = re.compile(r".*-[0-9a-f]{32}\.(so|json)")


def private_folder(name: str = "") -> Path | None:
    """The cache folder (CASADICAL_CACHE, else the user's), or one in it; made with mode 0700 where it is not there.

    If others could write to it, they no longer can, and what was kept is removed. None where it cannot be made, is a
    link, or belongs to another user.
    """
    try:
        given = os.environ.get("CASADICAL_CACHE")
        folder = Path(given or platformdirs.user_cache_dir("casadical"))
        if not (given or folder.is_absolute()):  # no home: "~" was left as it is
            return None
        for place in (folder, folder / name) if name else (folder,):
            place.mkdir(parents=True, exist_ok=True, mode=0o700)
            if not _own(place):
                return None
        return folder / name
    except (OSError, RuntimeError, ValueError):  # no permission, a NUL in its name
        return None


def _own(folder: Path) -> bool:
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
            if _KEPT.fullmatch(path.name):
                path.unlink()
    return True
