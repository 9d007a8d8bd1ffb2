"""What is written can be read again, whatever names and numbers it holds; else nothing is written."""

import json
import shutil
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from casadical.blind_check.protocol import json_line, read_answers
from casadical.core.basics import InputError
from casadical.core.files import json_text, write_together, write_whole
from casadical.core.reading import load_toml, read_bytes
from casadical.export.mjcf.mjcf import mjcf
from casadical.measurements.columns import Columns
from casadical.measurements.raw_table import read_table
from casadical.project.new import new_problem
from casadical.project.problem import read_problem
from casadical.robot.robot_file import read_robot, robot_from, to_toml
from casadical.robot.urdf import new_urdf

ROOT = Path(__file__).parents[2]
ARM = read_robot(ROOT / "problems" / "ur10" / "robot.toml")
ANY = st.text(max_size=40)  # control characters and lone surrogates among them
NUMBER = st.floats(allow_nan=True, allow_infinity=True)
often = settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
seldom = settings(often, max_examples=12)


@often
@given(name=ANY, note=ANY, comment=ANY, a=NUMBER, alpha=NUMBER)
def test_robot_files(name: str, note: str, comment: str, a: float, alpha: float) -> None:
    first, *rest = ARM.joints
    try:
        robot = replace(ARM, name=name, notes=(note,), joints=(replace(first, a=a, alpha=alpha), *rest))
        text = to_toml(robot, comment)
    except InputError:
        return
    again = robot_from(tomllib.loads(text), "again")
    assert (again.name, again.notes) == (name, (note,))
    assert [again.joints[0].a, again.joints[0].alpha] == pytest.approx([a, alpha], rel=1e-12, abs=0)
    text.encode()


@often
@given(name=st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=40))
def test_simulator_models(name: str) -> None:
    robot = replace(ARM, name=name)
    ET.fromstring(new_urdf(robot))
    ET.fromstring(mjcf(robot).text)


@often
@given(data=st.recursive(NUMBER | ANY | st.none() | st.booleans() | st.integers(), st.lists, max_leaves=8))
def test_json(tmp_path_factory: pytest.TempPathFactory, data: object) -> None:
    path = tmp_path_factory.getbasetemp() / "any.json"
    try:
        text = json_text(data)
    except ValueError:
        return  # not a number, which is refused
    write_whole(path, text)
    assert json.loads(read_bytes(path)) == data


@often
@given(contents=st.dictionaries(st.text(min_size=1, max_size=30), ANY, max_size=4))
def test_files_of_any_name(tmp_path_factory: pytest.TempPathFactory, contents: dict[str, str]) -> None:
    folder = tmp_path_factory.getbasetemp() / "any"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        write_together({folder / name: text for name, text in contents.items()})
    except InputError:
        assert list(folder.iterdir()) == []
        return
    for name, text in contents.items():
        assert read_bytes(folder / name) == text.encode()


@often
@given(names=st.lists(ANY, min_size=1, max_size=3, unique=True), gap=st.floats(0, 1e300))
def test_answers(tmp_path_factory: pytest.TempPathFactory, names: list[str], gap: float) -> None:
    path = tmp_path_factory.getbasetemp() / "answers.jsonl"
    lines = [json_line({"key_sha256": "0" * 64, "by": "test"})]
    for name in names:
        lines.append(json_line({"campaign": name, "verdict": "none", "posterior": {"none": gap}}))
    path.write_text("".join(lines))
    found = read_answers(path)[1]
    usable = [name for name in names if name.isprintable()]
    assert {name: found[name].probabilities["none"] for name in usable} == dict.fromkeys(usable, gap)


@often
@given(rows=st.lists(st.tuples(*[st.floats(-1e99, 1e99)] * 3), min_size=1, max_size=5))
def test_tables(tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, ...]]) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    head = "q1_deg,x_mm,temperature"
    path.write_text("\n".join([head, *(",".join(map(repr, row)) for row in rows)]) + "\n")
    columns = Columns.of_file(read_table(path))
    found = np.stack([columns.column(name) for name in head.split(",")], axis=1)
    np.testing.assert_allclose(found, rows, rtol=1e-15, atol=0)


@seldom
@given(name=st.text(min_size=1, max_size=30))
def test_new_problems(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    place = tmp_path_factory.mktemp("new")
    try:
        new_problem(place / name)
    except InputError:
        assert list(place.iterdir()) == []
        return
    load_toml(place / name / "problem.toml")
    read_problem(place / name)
