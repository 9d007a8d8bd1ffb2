"""What is written into a robot file where its drawing is wrong."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import main
from fleet_plants import ROOT, planar

from casadical import read_robot
from casadical.fleet.hierarchy import Common, correction
from casadical.fleet.run import add, one_robot


def common(names: tuple[str, ...], mean: list[float], scale: list[float]) -> Common:
    k = len(names)
    return Common("t", "arm", 9, names, np.array(mean), np.full(k, 0.01), np.full(k, 0.1), np.array(scale), np.eye(k))


def said(file: Path, found: Common, *, standard: bool | None = False) -> list[str]:
    return [correction(found, name, read_robot(file), standard) for name in found.names]


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
