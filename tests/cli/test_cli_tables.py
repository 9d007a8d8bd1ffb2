"""Every command that reads measured poses takes a table beside a robot file, and by a folder's own names and kinds."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import ROOT, run

from casadical.identification.accuracy import predicted
from casadical.measurements.measurements import unmeasured
from casadical.robot.robot_file import read_robot

ROBOT = ROOT / "problems" / "planar" / "robot.toml"
# Names of the file, and what problem.toml says of them.
READINGS = 'q1_deg = "turn", q2_deg = "bend"'
NAMED = {
    "position": f'columns = {{ {READINGS}, x_mm = "east", y_mm = "north", z_mm = "up" }}',
    "distance": f'kind = "distance"\ncolumns = {{ {READINGS}, distance_mm = "L" }}',
}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables that only a problem.toml explains, a folder for each kind, and ours.csv under our own names; synthetic."""
    folder = tmp_path_factory.mktemp("tables")
    rng = np.random.default_rng(0)
    nominal = read_robot(ROBOT)
    real = nominal.with_values({"a1": nominal.parameters["a1"].value + 1e-3})
    q = rng.uniform(-2.5, 2.5, (60, 2))
    p = predicted(real, unmeasured(q))[0] + rng.normal(0, 2e-5, (60, 3))
    readings = pd.DataFrame(np.rad2deg(q), columns=["turn", "bend"])
    positions = readings.assign(east=1e3 * p[:, 0], north=1e3 * p[:, 1], up=1e3 * p[:, 2])
    places = np.array([[2, 0, 0.3], [-1, 1.5, 0.8], [-1, -1.5, 1.4]])[np.arange(60) % 3]
    length = np.linalg.norm(p - places, axis=1) + rng.normal(0, 2e-5, 60)
    distances = readings.assign(L=1e3 * length, **{f"to_{c}_mm": 1e3 * places[:, k] for k, c in enumerate("xyz")})
    for kind, table in (("position", positions), ("distance", distances)):
        home = folder / kind
        home.mkdir()
        table.to_csv(home / "own.csv", index=False)
        (home / "robot.toml").write_text(ROBOT.read_text())
        text = f'casadical = 1\ntitle = "{kind}"\nmethods = ["KM"]\n[[measurements]]\nfile = "own.csv"\n{NAMED[kind]}\n'
        (home / "problem.toml").write_text(text)
        table[: -len(table) // 10].to_csv(folder / f"{kind}.csv", index=False)
    ours = positions.set_axis(["q1_deg", "q2_deg", "x_mm", "y_mm", "z_mm"], axis=1)
    ours.to_csv(folder / "ours.csv", index=False)
    assert run("calibrate", folder / "position", "--out", folder / "results", "-q").returncode == 0
    assert run("calibrate", folder / "distance", "--out", folder / "by-wires", "-q").returncode == 0
    return folder


# Command lines by their subject, of a robot (a folder or a file) and a table.
COMMANDS = {
    "check": "check {robot} {table}",
    "calibrate": "calibrate {robot} {table}",
    "diagnose": "diagnose {robot} {table} --no-laws --effects backlash",
    "plan": "plan {robot} --measured {table} -n 2 --no-order --out {out}",
    "isolability": "plan {robot} {table} --isolability --for backlash",
    "compare": "compare results/KM.robot.toml {table} --robot {robot}",
    "export": "export model {robot} --campaign {table} --effects backlash --out {out}.xml",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_table_and_a_robot_file_are_enough(measured: Path, tmp_path: Path, command: str) -> None:
    words = COMMANDS[command].format(robot=ROBOT, table="ours.csv", out=tmp_path / "out")
    done = run(*words.split(), folder=measured)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(("results", "table"), [("results", "position"), ("by-wires", "distance")])
def test_a_check_later_reads_the_kind_that_was_calibrated(measured: Path, results: str, table: str) -> None:
    done = run("verify", f"{results}/KM.robot.toml", f"{table}.csv", folder=measured)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "STILL VALID" in done.stdout


def test_a_promise_of_another_kind_is_not_taken(measured: Path) -> None:
    table = pd.read_csv(measured / "distance.csv").rename(columns={"L": "distance_mm"})
    table.rename(columns={"turn": "q1_deg", "bend": "q2_deg"}).to_csv(measured / "ours-by-wires.csv", index=False)
    done = run("verify", "results/KM.robot.toml", "ours-by-wires.csv", folder=measured)
    assert done.returncode == 2
    assert "--promised-mm" in done.stderr
