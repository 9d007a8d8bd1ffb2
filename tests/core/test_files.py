"""Files appear whole or not at all, and nothing else in their folder is touched."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from casadical.core.basics import InputError
from casadical.core.files import appending, claimed, write_together, write_whole
from casadical.core.reading import MAX_TABLE_BYTES, read_bytes

ROOT = Path(__file__).parents[2]


KILLED_WHILE_WRITING = """
import os, signal, sys
from pathlib import Path
from casadical.core import files
folder, calls = Path(sys.argv[1]), [int(sys.argv[2])]
def killing(function):
    def call(*given, **also):
        calls[0] -= 1
        if not calls[0]:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*given, **also)
    return call
os.fsync = killing(os.fsync)
Path.replace = killing(Path.replace)
with files.claimed([folder]):
    files.write_together({folder / "a": "new" * 9, folder / "b": "new" * 9})
"""


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize(("call", "left"), [(1, "old"), (2, "old"), (3, "old"), (9, "new")])
def test_a_killed_process_leaves_whole_files(tmp_path: Path, call: int, left: str, before: bool) -> None:
    """Calls 1 and 2 are those that put the two files on disk, call 3 is the first rename."""
    folder = tmp_path / "results"
    if before:
        folder.mkdir()
        for name in ("a", "b", "mine"):
            (folder / name).write_text("old" * 9)
    done = subprocess.run([sys.executable, "-c", KILLED_WHILE_WRITING, str(folder), str(call)], cwd=ROOT, check=False)
    assert done.returncode == (0 if left == "new" else -9)
    there = {p.name: p.read_text() for p in folder.iterdir() if not p.name.startswith(".")} if folder.exists() else {}
    expected = {"a": left * 9, "b": left * 9} if before or left == "new" else {}
    assert there == expected | ({"mine": "old" * 9} if before else {})


def test_a_new_folder_appears_as_one(tmp_path: Path) -> None:
    """While its files are written, the folder that was made for them is empty."""
    seen = []
    fsync = os.fsync
    folder = tmp_path / "deep" / "results"

    def watching(handle: int) -> None:
        seen.append([p.name for p in folder.iterdir()])
        fsync(handle)

    with pytest.MonkeyPatch.context() as patch, claimed([folder]):
        patch.setattr(os, "fsync", watching)
        write_together({folder / "a": "1", folder / "programs" / "b": "2"})
    assert seen == [[], []]
    assert sorted(p.name for p in folder.rglob("*")) == ["a", "b", "programs"]
    assert [p.name for p in folder.parent.iterdir()] == ["results"]


def test_another_writer_of_a_folder_is_told(tmp_path: Path) -> None:
    code = f"from casadical.core.files import claimed\nwith claimed([{str(tmp_path / 'a')!r}]): pass"
    with claimed([tmp_path / "a"]):
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "another casadical is writing to this folder" in done.stderr
    assert not (tmp_path / "a").exists(), "a folder that stayed empty is removed"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False).returncode == 0


def test_foreign_files_modes_and_links_of_a_folder_stay(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    (folder / "deep" / "er").mkdir(parents=True)
    (folder / "deep" / "er" / "notes").write_text("mine")
    (folder / "link").symlink_to("deep/er/notes")
    (folder / "a.json").write_text("before")
    (folder / "a.json").chmod(0o640)
    folder.chmod(0o750)
    with claimed([folder]):
        write_together({folder / "a.json": "after", folder / "new" / "b": b"b"})
    assert (folder / "a.json").read_text() == "after"
    assert stat.S_IMODE((folder / "a.json").stat().st_mode) == 0o640
    assert stat.S_IMODE(folder.stat().st_mode) == 0o750
    assert (folder / "link").is_symlink()
    assert (folder / "link").read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["results"]


def test_a_link_is_followed_and_a_pipe_is_written_into(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("before")
    (tmp_path / "link").symlink_to("real")
    write_whole(tmp_path / "link", "after")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "after"
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_whole(tmp_path / "pipe", "through")
    assert os.read(reader, 99) == b"through"
    os.close(reader)
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_is_said_and_nothing_is_changed(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("before")
    new, told = (
        tmp_path / "new" / "results",
        "/dev/full: cannot be written: No space left on device; nothing was written",
    )
    with pytest.raises(InputError, match=told), claimed([new]):
        write_together({tmp_path / "a": "after", new / "b": "x", Path("/dev/full"): "x"})
    assert (tmp_path / "a").read_text() == "before"
    assert stat.S_ISCHR(Path("/dev/full").stat().st_mode)
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("a\0b", "embedded null byte"),
        ("x" * 5000, "File name too long"),
        ("loop", "Too many levels"),
        ("", "is a folder"),
    ],
)
def test_names_that_cannot_be(tmp_path: Path, name: str, told: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match=told):
        write_whole(tmp_path / name, "text")
    with pytest.raises(InputError):
        read_bytes(tmp_path / name)


def test_two_outputs_of_one_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two outputs have this name"):
        write_together({tmp_path / "a": "1", tmp_path / "b" / ".." / "a": "2"})
    assert list(tmp_path.iterdir()) == []


def test_a_device_and_a_file_that_is_too_large_are_not_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a device"):
        read_bytes(Path("/dev/zero"))
    with (tmp_path / "large").open("wb") as file:
        file.truncate(MAX_TABLE_BYTES + 1)
    with pytest.raises(InputError, match="at most"):
        read_bytes(tmp_path / "large")


def test_lines_are_added_behind_what_is_whole_by_one_process(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    path.write_bytes(b"one\ntw")
    with appending(path, 4) as add:
        add("two\n")
        with pytest.raises(InputError, match="another casadical"), appending(path, 0):
            pass
    assert path.read_bytes() == b"one\ntwo\n"


def test_what_is_appended_stands_in_folders_that_were_missing(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "log.txt"
    with appending(path, 0) as append:
        append("one\n")
        append("two\n")
    with appending(path, 4) as append:
        append("three\n")
    assert path.read_text() == "one\nthree\n"
