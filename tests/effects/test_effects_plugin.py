"""An effect from another package, found by its entry point alone: no line of casadical knows it."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bench import robot
from plugin_site import installed, run, run_here

from casadical.effects.plugins import effects_by_name

NAME = "ur10e"
MODULE = '''
from dataclasses import dataclass
import casadi as ca
from casadical.effects import Effect, setting

@dataclass(frozen=True)
class Cable(Effect):
    """A cable pulls the joint towards its middle, stiffly at the ends of its range."""

    power: float = setting(3.0, (2.0, 3.0))

    name = "toy_cable"
    signature = "a pull that grows towards the ends of the range"
    physics = "A loop of cable is shortest in the middle of its range."

    def sizes(self):
        return {"pull": (20e-6, "rad")}

    def angle(self, context, q):
        return -self.value(context, "pull") * ca.sign(q) * ca.fabs(q) ** self.power
'''


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as an installer leaves it: a module and its metadata."""
    point = "toy_cable = toy_effects:Cable"
    return installed(tmp_path_factory.mktemp("site"), "casadical.effects", point, MODULE)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Joint 5 turned by what the cable does, worked out here, and noise."""
    r, rng = robot(NAME), np.random.default_rng(3)
    lower, upper = np.array([(max(j.lower, -2.0), min(j.upper, 2.0)) for j in r.joints]).T
    q = rng.uniform(lower, upper, (60, 6))
    moved = q.copy()
    moved[:, 4] -= 60e-6 * q[:, 4] ** 3
    p = r.position.map(60)(moved.T, r.parameters.values).full().T + rng.normal(0, 15e-6, (60, 3))
    table = pd.DataFrame(np.rad2deg(q), columns=[f"q{i}_deg" for i in range(1, 7)])
    table[["x_mm", "y_mm", "z_mm"]] = 1e3 * p
    file = tmp_path_factory.mktemp("campaign") / "cable.csv"
    table.to_csv(file, index=False)
    return file


@pytest.mark.slow
def test_a_plug_in_is_diagnosed_by_its_name(site: Path, campaign: Path, tmp_path: Path) -> None:
    kept = tmp_path / "answer.json"
    chosen = "toy_cable,backlash,gear_eccentricity"
    done = run(site, "diagnose", f"problems/{NAME}", campaign, "--no-laws", "--effects", chosen, "--json", kept)
    assert (done.returncode, done.stderr) == (0, "")
    (cause,) = json.loads(kept.read_text())["causes"]
    assert (cause["effect"], cause["joint"]) == ("toy_cable", 5)
    pull = cause["parameters"]["pull"]
    assert abs(pull["value"] - 60e-6) < 4 * pull["std_error"] + 3e-6
    assert cause["settings"][0]["power"] == pytest.approx(3, abs=0.2)
    assert "a pull that grows towards the ends" in " ".join(done.stdout.split())


KEEP = """
import sys
from casadical import diagnose, read_campaign_robot, read_measurements, read_robot, write_robot
from casadical.identification.accuracy import predicted

m = read_measurements(sys.argv[1], 6)
whole = diagnose(read_campaign_robot("problems/ur10e"), m, ["toy_cable"], laws=False).apply()
write_robot(whole, sys.argv[2])
again = read_robot(sys.argv[2])
assert [type(e).__module__ for e in again.effects] == ["toy_effects"]
assert abs(predicted(again, m)[0] - predicted(whole, m)[0]).max() < 1e-12
assert again.knowledge.std_errors["toy_cable@5.pull"] > 0
"""


@pytest.mark.slow
def test_a_plug_in_is_kept_in_a_robot_file_and_exported(site: Path, campaign: Path, tmp_path, monkeypatch) -> None:
    kept, model, folder = tmp_path / "kept.toml", tmp_path / "a.xml", tmp_path / "c"
    done = run(site, campaign, kept, program=KEEP)
    assert (done.returncode, done.stderr) == (0, "")
    assert 'name = "toy_cable"' in kept.read_text()
    refused = run_here(monkeypatch, effects_by_name, site, "export", "model", kept, "--out", model)
    assert refused.returncode == 2
    assert "toy_cable@5: no counterpart in MuJoCo; lost without it: 0." in " ".join(refused.stderr.split())
    given = ("export", "model", kept, "--out", model, "--leave-out")
    assert run_here(monkeypatch, effects_by_name, site, *given).returncode == 0
    given = ("export", "c", kept, "--nominal", f"problems/{NAME}/robot.toml", "--out", folder)
    written = run_here(monkeypatch, effects_by_name, site, *given)
    assert (written.returncode, written.stderr) == (0, "")
    assert "LEFT OUT" not in written.stdout
    monkeypatch.undo()  # the folder is no longer on the path
    gone = run_here(monkeypatch, effects_by_name, tmp_path, *given, "--overwrite")
    assert gone.returncode == 2
    assert "effect[1].no effect 'toy_cable' is installed" in " ".join(gone.stderr.split())


def test_without_the_package_its_name_is_unknown(campaign: Path, tmp_path: Path, monkeypatch) -> None:
    words = ("diagnose", f"problems/{NAME}", campaign, "--effects", "toy_cable")
    done = run_here(monkeypatch, effects_by_name, tmp_path, *words)
    assert done.returncode == 2
    assert "no effect 'toy_cable'" in done.stderr


@pytest.mark.parametrize(
    ("module", "message"),
    [
        ("raise RuntimeError('broken')", "cannot be loaded (RuntimeError('broken'))"),
        ("Cable = 3", "is 3; it must be a subclass"),
        (MODULE.replace('"toy_cable"', '"backlash"'), "its class is named 'backlash'; both need the same name"),
    ],
)
def test_a_faulty_plug_in_is_named(campaign: Path, tmp_path: Path, monkeypatch, module: str, message: str) -> None:
    bad = installed(tmp_path, "casadical.effects", "bad = bad_effects:Cable", module)
    words = ("diagnose", f"problems/{NAME}", campaign, "--effects", "backlash")
    done = run_here(monkeypatch, effects_by_name, bad, *words)
    assert done.returncode == 2
    assert "plug-in bad = 'bad_effects:Cable' of bad-effects" in done.stderr
    assert message in " ".join(done.stderr.split())
