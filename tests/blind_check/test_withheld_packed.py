"""What is kept for good may be packed: the same content, the same hash, the same score."""

from __future__ import annotations

import lzma
import shutil

import pytest

from casadical.blind_check.packed import content, pack
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


def test_packing_says_nothing_of_when_it_was_done(small, tmp_path) -> None:
    found = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        shutil.copy(small.answers, tmp_path / name / "bic.jsonl")
        found.append(pack(tmp_path / name / "bic.jsonl").read_bytes())
    assert found[0] == found[1]
    assert lzma.decompress(found[0]) == small.answers.read_bytes()


def test_a_torn_file_is_named(small, tmp_path) -> None:
    shutil.copy(small.answers, tmp_path / "bic.jsonl")
    torn = pack(tmp_path / "bic.jsonl")
    torn.write_bytes(torn.read_bytes()[:-50])
    with pytest.raises(InputError, match=r"bic.jsonl.xz: not a whole xz file: .*; fetch it again"):
        content(torn)
