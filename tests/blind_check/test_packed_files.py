"""What is kept for good may be packed: the same content, the same hash, the same score."""

import lzma
import shutil
from pathlib import Path

import pytest

from casadical.blind_check.protocol import content
from casadical.blind_check.scoring import score
from casadical.core.errors import InputError


def test_packed_files_score_as_the_plain_ones(small, tmp_path) -> None:
    shutil.copytree(small.key, tmp_path / "key")
    shutil.copy(small.answers, tmp_path / "bic.jsonl")
    plain = score(small.folder, small.key, small.answers).as_json()
    packed = [pack(path) for path in (tmp_path / "key" / "key.json", tmp_path / "bic.jsonl")]
    assert [path.name for path in packed] == ["key.json.xz", "bic.jsonl.xz"]
    # By the plain name or by their own.
    for key, answers in ((tmp_path / "key", tmp_path / "bic.jsonl"), packed):
        assert score(small.folder, key, answers).as_json() == plain


def pack(path: Path) -> Path:
    """The file in the place of which there is then a packed one, as by `xz`."""
    packed = path.with_name(path.name + ".xz")
    packed.write_bytes(lzma.compress(path.read_bytes()))
    path.unlink()
    return packed


def test_a_torn_file_is_named(small, tmp_path) -> None:
    shutil.copy(small.answers, tmp_path / "bic.jsonl")
    torn = pack(tmp_path / "bic.jsonl")
    torn.write_bytes(torn.read_bytes()[:-50])
    with pytest.raises(InputError, match=r"bic.jsonl.xz: not a whole xz file: .*; fetch it again"):
        content(torn)
