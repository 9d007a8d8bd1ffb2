"""Files that nobody should write: each is refused at once, in words, by the one gate that all readers share."""

import io
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from casadical import read_robot, read_urdf
from casadical.core.basics import InputError
from casadical.core.reading import (
    MAX_JSON_BYTES,
    MAX_NESTING,
    MAX_TEXT_BYTES,
    MAX_UNPACKED_BYTES,
    MAX_WORKBOOK_CELLS,
    json_of,
    load_json,
    load_toml,
    read_bytes,
    read_text,
    read_xml,
)
from casadical.measurements.raw_table import read_table

ROOT = Path(__file__).parents[2]
READERS: list[Callable[[Path], object]] = [
    read_bytes,
    read_text,
    load_toml,
    load_json,
    read_xml,
    read_table,
    read_robot,
]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("pipe", "is a pipe or a socket"),
        ("folder", "Is a directory"),
        ("zero", "is a device"),
        ("none", "no such file"),
        ("away/none", "no such file; there is no folder .*away"),
        ("loop", "Too many levels"),
        ("a\0b", "cannot be read"),
    ],
)
def test_only_regular_files_are_opened(tmp_path: Path, read: Callable[[Path], object], name: str, why: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match=why):
        read(tmp_path / name)


@pytest.mark.parametrize("stream", ["/dev/stdin", "/dev/fd/0"])
def test_what_a_shell_hands_over_is_read(stream: str) -> None:
    code = f"from casadical.core.reading import read_text; print(read_text({stream!r}))"
    done = subprocess.run([sys.executable, "-c", code], input="told", text=True, capture_output=True, cwd=ROOT)
    assert done.stdout == "told\n", done.stderr


@pytest.mark.parametrize(
    ("read", "most"), [(load_toml, MAX_TEXT_BYTES), (read_xml, MAX_TEXT_BYTES), (load_json, MAX_JSON_BYTES)]
)
def test_sizes_are_looked_at_before_the_content(tmp_path: Path, read: Callable[[Path], object], most: int) -> None:
    with (tmp_path / "large").open("wb") as file:
        file.truncate(most + 1)
    with pytest.raises(InputError, match=f"at most {most} are read"):
        read(tmp_path / "large")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('{"a": ' + "1" * 5000 + "}", "an integer of 5000 digits"),
        ('{"a": NaN}', "no finite number"),
        ('{"a": 1e999}', "no finite number"),
        ('{"a": ' + "[" * 200 + "]" * 200 + "}", "nested too deeply"),
        ('{"a": ' * 100_000, "nested too deeply"),
        ("[1]", "holds a list"),
        ("null", "holds null; a JSON object is expected"),
        ("\ud800", "not valid JSON"),
        (b"\xff\xfe\x00\x81", "not valid JSON"),
    ],
)
def test_json_beyond_the_bounds(text: str | bytes, why: str) -> None:
    with pytest.raises(InputError, match=f"it.json: .*{why}"):
        json_of(text, "it.json")


def test_json_within_the_bounds_is_read() -> None:
    data = {"a": [1, 2.5, None], "deep": json.loads("[" * (MAX_NESTING - 1) + "]" * (MAX_NESTING - 1))}
    assert json_of(json.dumps(data), "it.json") == data


URDF = '<robot name="{name}"><link name="a"/></robot>'


@pytest.mark.parametrize("codec", ["shift_jis", "utf-7", "utf-99", "idna", "hex", "utf-32", "base64", "\xff"])
def test_codecs_that_no_robot_is_written_in(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(f'<?xml version="1.0" encoding="{codec}"?>{URDF.format(name="arm")}', "latin-1")
    with pytest.raises(InputError, match=r"arm.urdf: malformed XML: encoding .*; allowed: utf-8"):
        read_urdf(path)


@pytest.mark.parametrize("codec", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1", "windows-1252"])
def test_codecs_that_robots_are_written_in(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(f'<?xml version="1.0" encoding="{codec}"?>\n{URDF.format(name="Größe")}', codec)
    assert read_xml(path).strip() == URDF.format(name="Größe").encode()


@pytest.mark.parametrize(
    "text",
    [
        '<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>' + URDF.format(name="&b;"),
        '<!DOCTYPE robot SYSTEM "file:///etc/passwd">' + URDF.format(name="x"),
        "<robot>" + "<link>" * 5000 + "</link>" * 5000 + "</robot>",
        "<robot",
        "\0",
        "",
    ],
)
def test_xml_that_is_no_robot(tmp_path: Path, text: str) -> None:
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(InputError, match=r"arm.urdf: malformed XML"):
        read_urdf(tmp_path / "arm.urdf")


def workbook(path: Path, sheet: str, **parts: str) -> Path:
    """A workbook with this XML in its sheet; parts : in place of others, by the end of their names"""
    openpyxl = pytest.importorskip("openpyxl")
    book, plain = openpyxl.Workbook(), io.BytesIO()
    book.active["A1"] = 1
    book.save(plain)
    with zipfile.ZipFile(plain) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            text = old.read(name).decode()
            if name.endswith("sheet1.xml"):
                head = '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main">'
                text = f"{head}<sheetData>{sheet}</sheetData></worksheet>"
            new.writestr(name, parts.get(Path(name).stem, text))
    return path


def refuse_workbook(path: Path, why: str) -> None:
    with pytest.raises(InputError, match=f"book.xlsx: .*{why}"):
        read_table(path)


def test_workbooks_with_more_than_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    rows = "<row/>" * (MAX_WORKBOOK_CELLS + 1)
    refuse_workbook(workbook(path, rows), f"has more than {MAX_WORKBOOK_CELLS} cells")
    assert path.stat().st_size < 100_000
    last = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>'
    refuse_workbook(workbook(path, last), f"has more than {MAX_WORKBOOK_CELLS} cells")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("xl/sheet.xml", "w") as cell:
        for _ in range(MAX_UNPACKED_BYTES // 1_000_000 + 1):
            cell.write(bytes(1_000_000))
    refuse_workbook(path, "when unpacked; at most")


@pytest.mark.parametrize("rows", ["<row/>", "<x:row><x:c/></x:row>", '<row r="1"><c r="A1"><v>1</v></c></row>'])
def test_cells_of_a_workbook_are_counted_before_it_is_opened(tmp_path, monkeypatch, rows) -> None:
    path = workbook(tmp_path / "book.xlsx", rows * (MAX_WORKBOOK_CELLS + 1))
    monkeypatch.setattr("openpyxl.load_workbook", None)
    refuse_workbook(path, f"has more than {MAX_WORKBOOK_CELLS} cells; save what was measured as CSV")


def test_workbooks_that_are_damaged(tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    refuse_workbook(workbook(path, "<row><c>"), "not a readable workbook")
    refuse_workbook(workbook(path, "", workbook="<a"), "not a readable workbook")
    refuse_workbook(workbook(path, "", styles="<styleSheet/><"), "not a readable workbook")
    whole = bytearray(workbook(path, '<row r="1"><c r="A1"><v>1</v></c></row>').read_bytes())
    flags, method = 6, 8
    for offset, value in ((flags, 1), (method, 99)):  # encrypted; compressed in a way that nobody knows
        broken = bytearray(whole)
        for mark, more in ((b"PK\x03\x04", 0), (b"PK\x01\x02", 2)):
            place = -1
            while (place := broken.find(mark, place + 1)) >= 0:
                broken[place + offset + more] = value
        path.write_bytes(broken)
        refuse_workbook(path, "not a readable workbook")
    for place in range(40, len(whole), 97):
        broken = bytearray(whole)
        broken[place] ^= 0xFF
        path.write_bytes(broken)
        with suppress(InputError):
            read_table(path)


def test_a_link_that_leads_nowhere_is_said_so(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").symlink_to("moved.csv")
    with pytest.raises(InputError, match=r"poses\.csv: no such file; it is a symbolic link that leads nowhere"):
        read_bytes(tmp_path / "poses.csv")


def test_a_message_tells_fifty_faults_and_how_many_more(tmp_path) -> None:
    path = tmp_path / "many.toml"
    path.write_text('casadical = 1\nname = "a"\n' + "[[joint]]\nlenght_mm = 1\n" * 60)
    with pytest.raises(InputError) as told:
        read_robot(path)
    lines = str(told.value).splitlines()
    assert lines[0].endswith("many.toml: 60 faults")
    assert len(lines) == 52
    assert lines[-1] == "  and 10 more"
