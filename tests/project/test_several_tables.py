"""Several tables of one kind and robot: every one of them counts in the figures, whichever is named last; synthetic."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from command_line import main

from casadical import InputError, calibrate, report
from casadical.core.reporting.result import plain_text
from casadical.effects import WireDrift
from casadical.identification.accuracy import Accuracy, errors, predicted, summarise
from casadical.measurements.measurements import unmeasured
from casadical.project.acceptance.verification import promised_rms, verify
from casadical.project.calibration import Calibration
from casadical.project.outcome import before_in_words, report_blocks
from casadical.robot.robot_file import read_robot, to_toml

ROBOT = Path(__file__).parents[2] / "problems" / "planar" / "robot.toml"
# Far ends of the wires [m], and the noise of each [m].
WIRES = {"left.csv": ((2, 0, 0.3), 2e-5), "coarse.csv": ((-1, 1.5, 0.8), 4e-4), "right.csv": ((-1, -1.5, 1.4), 2e-5)}


@pytest.fixture(scope="module")
def wires(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The same 60 poses by three wires to known places; one wire is twenty times as coarse, one row of it is off."""
    folder, rng = tmp_path_factory.mktemp("wires"), np.random.default_rng(0)
    nominal = read_robot(ROBOT)
    q = rng.uniform(-2.5, 2.5, (60, 2))
    p = predicted(nominal.with_values({"a1": nominal.parameters["a1"].value + 1e-3}), unmeasured(q))[0]
    for name, (place, noise) in WIRES.items():
        length = 1e3 * (np.linalg.norm(p - place, axis=1) + rng.normal(0, noise, 60))
        table = pd.DataFrame(np.rad2deg(q), columns=["q1_deg", "q2_deg"]).assign(distance_mm=length)
        if name == "right.csv":
            table.loc[7, "distance_mm"] += 5
        table.assign(**dict(zip(("to_x_mm", "to_y_mm", "to_z_mm"), 1e3 * np.array(place), strict=True))).to_csv(
            folder / name, index=False
        )
    return [folder / name for name in WIRES]


@pytest.fixture(scope="module")
def calibrated(wires: list[Path]) -> Calibration:
    return calibrate(ROBOT, tables=wires)


def test_the_figures_are_over_all_tables_in_any_order(calibrated: Calibration, wires: list[Path]) -> None:
    left, coarse, right = wires
    other = calibrate(ROBOT, tables=[coarse, right, left])
    of_all = calibrated.accuracies["KM"]["report/distance"]["calibrated"]
    assert of_all.rms == pytest.approx(other.accuracies["KM"]["report/distance"]["calibrated"].rms, rel=1e-4)
    e = np.concatenate([errors(calibrated.robot, m) for m in calibrated.problem.sets["report"]])
    assert of_all.n == len(e) == 54
    assert of_all.rms == pytest.approx(float(np.sqrt(np.mean(e**2))))
    single = [calibrated.accuracies["KM"][f"report/distance/{name}"]["calibrated"] for name in WIRES]
    assert single[1].rms > 5 * single[0].rms
    printed = plain_text(calibrated.brief())
    assert "On 54 poses that were held out" in printed
    for name in WIRES:
        assert f"after KM, {name}" in printed


def test_errors_of_distances_are_not_called_those_of_positions(calibrated: Calibration) -> None:
    assert "mean error of distance falls" in (text := plain_text(calibrated.blocks()))
    assert "position error" not in text
    page = report([calibrated])
    assert "there is no map" in page
    assert 'data-name="errors/report' in page


def test_the_promise_is_over_all_tables(calibrated: Calibration, tmp_path: Path) -> None:
    calibrated.write(tmp_path)
    expected = calibrated.accuracies["KM"]["report/distance"]["calibrated"].rms
    assert promised_rms(tmp_path / "KM.robot.toml", "distance")[0] == pytest.approx(expected)
    stated = json.loads((tmp_path / "result.json").read_text())
    assert set(stated["methods"]["KM"]["sets"]) == set(stated["kinds"])


def test_a_row_that_is_left_out_is_named_with_its_file(calibrated: Calibration) -> None:
    assert "as in a spreadsheet): right.csv row 9 (" in " ".join(plain_text(calibrated.brief()).split())


def test_a_method_worse_than_the_before_of_the_table_is_named() -> None:
    """KM starts from a rigid robot, and says so; the robot as given bends, and with frames fitted is better."""
    arm = SimpleNamespace(robot=read_robot(SPATIAL))
    assert before_in_words(arm, {"KM": {}}) == f"rigid, {before_in_words(arm, {'SKCM': {}})}"

    def states(placed: float, calibrated: float) -> dict[str, Accuracy]:
        e = np.linspace(0.5, 1.5, 108)
        return {"placed": summarise(1e-3 * placed * e), "calibrated": summarise(1e-3 * calibrated * e)}

    found = {"KM": {"report": states(1.2, 0.83)}, "SKCM": {"report": states(0.6, 0.1)}}
    (said,) = report_blocks(None, found, block="methods_worse")
    assert said.text.startswith("KM makes held-out poses worse: 0.830 mm, 0.600 mm before")
    assert not report_blocks(None, found | {"KM": {"report": states(1.2, 0.6)}}, block="methods_worse")


SPATIAL = ROBOT.parents[1] / "ur10e" / "robot.toml"
ENDS = np.array([[1.5, 0.2, 0.1], [-0.8, 1.4, 0.3], [-0.7, -1.3, 0.9]])


def later(folder: Path, n: int, seed: int, sigma: float) -> list[Path]:
    """The same n poses of a robot in space by three wires to places that nobody measured."""
    rng, robot = np.random.default_rng(seed), read_robot(SPATIAL)
    low, high = (np.array([getattr(j, side) for j in robot.joints]) for side in ("lower", "upper"))
    q = rng.uniform(np.maximum(low, -2.0), np.minimum(high, 2.0), (n, robot.n))
    p = predicted(robot, unmeasured(q))[0]
    tables = []
    for k, end in enumerate(ENDS):
        table = pd.DataFrame(np.rad2deg(q), columns=[f"q{j + 1}_deg" for j in range(robot.n)])
        table["distance_mm"] = 1e3 * (np.linalg.norm(p - end, axis=1) + rng.normal(0, sigma, n))
        tables.append(folder / f"later{k}.csv")
        table.to_csv(tables[-1], index=False)
    return tables


def test_a_check_takes_several_tables_and_makes_up_for_the_places_it_fits(tmp_path: Path) -> None:
    """Of 21 readings 12 numbers are fitted: without the places' share the variance would be 0.57 of the noise's."""
    found = [verify(SPATIAL, later(tmp_path, 7, seed, 1e-4), promised_mm=0.1) for seed in range(8)]
    assert {f.n for f in found} == {21}
    assert 0.75 < np.mean([(f.found / 1e-4) ** 2 for f in found]) < 1.4
    assert "The tool and the unknown places were fitted again" in " ".join(plain_text(found[0].blocks()).split())


def test_a_wire_does_not_see_the_base(tmp_path: Path) -> None:
    wire = later(tmp_path, 12, 0, 1e-4)[0]
    assert verify(SPATIAL, wire, promised_mm=0.1).n == 12
    pd.read_csv(wire)[:9].to_csv(wire, index=False)
    with pytest.raises(InputError, match="9 poses; the tool has 3 numbers, the points 3: measure 12 or more"):
        verify(SPATIAL, wire, promised_mm=0.1)


def test_what_an_instrument_did_is_left_out_and_said(tmp_path: Path) -> None:
    robot = read_robot(SPATIAL)
    drift = WireDrift()
    (tmp_path / "drift.toml").write_text(to_toml(robot.with_only([drift]), "With what a wire did."))
    found = verify(tmp_path / "drift.toml", later(tmp_path, 8, 0, 1e-4), promised_mm=0.1)
    assert "wire_drift: effects of the calibration's instrument are not in the model" in plain_text(found.blocks())


def test_the_command_takes_several_and_names_the_file_of_a_bad_row(tmp_path, monkeypatch, capfd):
    tables = later(tmp_path, 12, 0, 1e-4)
    bad = pd.read_csv(tables[1])
    bad.loc[3, "distance_mm"] += 5
    bad.to_csv(tables[1], index=False)
    assert main(monkeypatch, "verify", SPATIAL, *tables, "--promised-mm", "0.1", "--json", tmp_path / "v.json") == 5
    assert "Far off: later1.csv row 5 (" in " ".join(capfd.readouterr().out.split())
    assert json.loads((tmp_path / "v.json").read_text())["far"][0]["source"] == "later1.csv"


def test_the_far_ends_that_were_found_stand_in_the_json(tmp_path: Path) -> None:
    """Base and far ends may move together: their distances from each other are what the wires tell."""
    tables = later(tmp_path, 60, 0, 2e-5)
    found = calibrate(SPATIAL, tables=tables, method="KM").to_json()["methods"]["KM"]["unknown_places"]
    assert [place["source"] for place in found] == [table.name for table in tables]
    ends = np.array([place["xyz_mm"] for place in found])
    apart = [np.linalg.norm(e - np.roll(e, 1, axis=0), axis=1) for e in (ends, 1e3 * ENDS)]
    assert apart[0] == pytest.approx(apart[1], abs=5)
