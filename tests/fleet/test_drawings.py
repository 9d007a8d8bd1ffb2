"""What is written into a robot file where its drawing is wrong, and drawings that are corrected one robot at a time."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import main
from fleet_plants import ROOT, planar

from casadical import read_robot
from casadical.fleet.hierarchy import Common, Drawing, drawings_of, near, nearly_one
from casadical.fleet.store import add, one_robot, type_of
from casadical.project.problem import read_problem


def common(names: tuple[str, ...], mean: list[float], scale: list[float]) -> Common:
    k = len(names)
    return Common("t", "arm", 9, names, np.array(mean), np.full(k, 0.01), np.full(k, 0.1), np.array(scale), np.eye(k))


def said(file: Path, found: Common, *, standard: bool | None = False) -> list[str]:
    drawing = Drawing("arm", 9, read_robot(file), standard)
    return [drawing.correction(found, name) for name in found.names]


def test_what_to_write_and_where() -> None:
    names = ("d4", "a2", "alpha1", "theta3", "c1", "gear.k", "tool_x")
    found = common(names, [-0.3, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0], [1e-3] * 4 + [1e-7, 1.0, 1e-3])
    assert said(ROOT / "problems/kr210/robot.toml", found) == [
        "[[joint]] 4: d_mm = 1199.70 (drawn 1200)",
        "[[joint]] 3: a_mm = 1150.50 (drawn 1150)",
        "[[joint]] 2: alpha_deg = -89.9427 (drawn -90)",
        "[[joint]] 3: theta_deg = -89.9427 (drawn -90)",
        "[[joint]] 1: stiffness_Nm_per_rad = 2310000 (drawn 3e+06)",
        "",
        "",
    ]
    assert said(ROOT / "problems/kr210/robot.toml", found, standard=None) == [""] * 7  # a URDF has no rows


def test_a_file_corrected_as_is_said_has_the_value_that_was_found(tmp_path: Path) -> None:
    """Also in standard rows, whose a and alpha belong to the joint before."""
    drawn = tmp_path / "robot.toml"
    rows = 3 * "[[joint]]\na_mm = 300\nalpha_deg = 90\nd_mm = 50\nstiffness_Nm_per_rad = 20000\n"
    drawn.write_text(f'casadical = 1\nname = "arm"\nconvention = "standard"\n{rows}')
    found = common(("a1", "alpha2", "d3", "c2"), [0.3, 1.0, -2.0, 1.0], [1e-3] * 3 + [1e-6])
    for k, words in enumerate(said(drawn, found, standard=True)):
        row, number = words.removeprefix("[[joint]] ").split(": ")
        key, value = number.split(" (")[0].split(" = ")
        parts = drawn.read_text().split("[[joint]]")
        lines = parts[int(row)].splitlines()
        parts[int(row)] = "\n".join(f"{key} = {value}" if line.startswith(key) else line for line in lines) + "\n"
        (tmp_path / "new.toml").write_text("[[joint]]".join(parts))
        new, old = (read_robot(tmp_path / name).parameters[found.names[k]].value for name in ("new.toml", "robot.toml"))
        assert new - old == pytest.approx(found.mean[k] * found.scale[k], rel=0.03)


def test_a_type_that_is_corrected_one_by_one_is_said_and_another_arm_is_not(tmp_path: Path) -> None:
    rows = []
    for k, a1 in enumerate((400, 400, 400.3, 430)):
        folder = planar(tmp_path / f"arm{k}", k)
        file = folder / "robot.toml"
        file.write_text(file.read_text().replace("a_mm = 400", f"a_mm = {a1}"))
        rows.append({"folder": str(folder), "type": type_of(read_problem(folder)), "type_name": "arm"})
    found = drawings_of(pd.DataFrame(rows))
    assert len(found) == 3
    kinds = [row["type"] for row in rows]
    assert list(nearly_one(found)) == [
        f"types arm, drawing {kinds[0]} (2 robots), and arm, drawing {kinds[2]} (1 robot), differ only in a1 (400 and "
        "400.3 mm): corrected one by one? Then correct all of them"
    ]
    shutil.rmtree(tmp_path / "arm2")  # a drawing that cannot be read is left aside
    assert list(nearly_one(drawings_of(pd.DataFrame(rows)))) == []


def test_what_robots_corrected_before_have_is_said_so_that_all_become_one_type(tmp_path: Path) -> None:
    """Also a stiffness and an angle; what would be a fault is not taken, nor what another arm has."""
    names, text = ("a1", "c1", "alpha1"), (ROOT / "problems/kr210/robot.toml").read_text()
    found = common(names, [0.43, 0.5, 1.0], [1e-3, 1e-7, 1e-3])
    drawings = {}
    for kind, a1 in (("drawn", 350.0), ("two", 350.4), ("fault", 350.5), ("another", 390.43)):
        file = tmp_path / f"{kind}.toml"
        stiff, angle = ("2601234", "-89.9427001") if kind == "two" else ("3000000", "-90")
        lines = text.replace("a_mm = 350", f"a_mm = {a1}", 1).replace("alpha_deg = -90", f"alpha_deg = {angle}", 1)
        file.write_text(lines.replace("stiffness_Nm_per_rad = 3000000", f"stiffness_Nm_per_rad = {stiff}", 1))
        drawings[kind] = Drawing("arm", 2, read_robot(file), False)
    assert [len(near(drawings, kind)) for kind in ("drawn", "another")] == [2, 0]
    assert [drawings["drawn"].correction(found, name, near(drawings, "drawn")) for name in names] == [
        "[[joint]] 2: a_mm = 350.4 (drawn 350; 2 robots so)",
        "[[joint]] 1: stiffness_Nm_per_rad = 2601234 (drawn 3e+06; 2 robots so)",
        "[[joint]] 2: alpha_deg = -89.9427001 (drawn -90; 2 robots so)",
    ]
    del drawings["two"]
    assert drawings["drawn"].correction(found, "a1", near(drawings, "drawn")).startswith("[[joint]] 2: a_mm = 350.43 (")


def test_the_command_says_what_it_took_and_which_priors_are_old(tmp_path: Path, monkeypatch, capsys) -> None:
    folder, store, priors = planar(tmp_path / "plant" / "arm", 0), tmp_path / "fleet.parquet", tmp_path / "priors"
    add(store, one_robot(str(folder), False))
    priors.mkdir()
    for name in ("0123456789ab.robot.toml", "my.robot.toml"):
        shutil.copy(folder / "robot.toml", priors / name)
    options = ("--store", store, "--no-diagnose", "--priors", priors, "--json", tmp_path / "fleet.json")
    assert main(monkeypatch, "fleet", folder.parent, *options) == 0
    words = capsys.readouterr().out.replace("\n", " ")
    assert "0 computed now, 1 from the store." in words
    assert "priors/0123456789ab.robot.toml: of no type of this fleet with five robots; not written now." in words
    assert "my.robot.toml" not in words
    assert sorted(p.name for p in priors.iterdir()) == ["0123456789ab.robot.toml", "my.robot.toml"]
    assert json.loads((tmp_path / "fleet.json").read_text())["computed"] == 0
