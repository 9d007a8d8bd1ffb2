"""The user's private cache folder; code and data loaded from it must not be writable by others."""

import os
import re
import stat
from pathlib import Path

import platformdirs


def private_folder(name: str = "") -> Path | None:
    """Return casadical's cache folder, or a folder in it, which is made if it is missing.

    It is the folder `casadical` in that of the variable CASADICAL_CACHE, whose mode is unchanged,
    else in the user's cache folder. Its mode is made 0700; if others could write to it, the cached
    libraries and JSON files in it are removed. None is returned where it cannot be made, is a link,
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

    If others could write to it, the cached libraries and JSON files in it are removed. On Windows,
    which has no such owners, every folder counts as the user's and is unchanged.
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
            if re.fullmatch(r".*-[0-9a-f]{32}\.(so|json)", path.name):
                path.unlink()
    return True
