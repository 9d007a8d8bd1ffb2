"""Files of a check that are kept for good may be packed by xz; what is hashed and read is their content."""

from __future__ import annotations

import lzma
from pathlib import Path

from casadical.core.errors import InputError

PACKED = ".xz"


def stored(path: Path) -> Path:
    """The file itself, or the packed one beside it where that alone is there."""
    beside = path.with_name(path.name + PACKED)
    return beside if beside.is_file() and not path.exists() else path


def content(path: Path) -> bytes:
    """What a file holds, unpacked where its name ends in .xz. Raises InputError: not a whole xz file; and OSError."""
    data = path.read_bytes()
    if path.suffix != PACKED:
        return data
    try:
        return lzma.decompress(data)
    except lzma.LZMAError as error:
        raise InputError(f"{path}: not a whole xz file: {error}; fetch it again") from None


def pack(path: Path) -> Path:
    """Put the packed file in the place of a file; the same content gives the same bytes."""
    packed = path.with_name(path.name + PACKED)
    packed.write_bytes(lzma.compress(path.read_bytes(), preset=9 | lzma.PRESET_EXTREME))
    path.unlink()
    return packed
