"""Files are written completely or not at all."""

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from casadical.core.errors import InputError


def json_text(data: Any) -> str:
    """Plain data as the text of a JSON file. Raises ValueError for NaN and infinity, which JSON does not have."""
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def write_whole(path: Path, text: str) -> None:
    """Write text to a temporary file beside the target and rename it, so that no half-written file is ever seen.

    Raises InputError if it cannot be written there.
    """
    write_together({path: text})


def write_together(contents: Mapping[Path, str | bytes]) -> None:
    """Write several files, text as UTF-8: all of them or, if one cannot be written, none. Raises InputError."""
    scratch: dict[Path, Path] = {}
    try:
        for path, content in contents.items():
            if path.is_dir():
                raise InputError(f"{path}: is a folder; name a file")
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
            scratch[path] = Path(name)
            with os.fdopen(handle, "wb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
            Path(name).chmod(0o666 & ~_umask())
        for path, temporary in scratch.items():
            temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}; nothing was written") from error
    finally:
        for temporary in scratch.values():
            temporary.unlink(missing_ok=True)


def _umask() -> int:
    """The process's umask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
