"""Several tables of one kind and robot: every one of them counts in the figures, whichever is named last; synthetic."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from casadical import calibrate
from casadical.core.blocks import plain_text
from casadical.identification.accuracy import Accuracy, errors, predicted, summarise
from casadical.measurements.measurements import unmeasured
from casadical.project.calibration import Calibration
from casadical.project.outcome import methods_worse
from casadical.project.verification import promised_rms
from casadical.robot.robot_file import read_robot

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


def test_the_promise_is_over_all_tables(calibrated: Calibration, tmp_path: Path) -> None:
    calibrated.write(tmp_path)
    expected = calibrated.accuracies["KM"]["report/distance"]["calibrated"].rms
    assert promised_rms(tmp_path / "KM.robot.toml", "distance") == pytest.approx(expected)
    stated = json.loads((tmp_path / "result.json").read_text())
    assert set(stated["methods"]["KM"]["sets"]) == set(stated["kinds"])


def test_a_row_that_is_left_out_is_named_with_its_file(calibrated: Calibration) -> None:
    assert "Left out as outliers: right.csv row 9 (" in " ".join(plain_text(calibrated.brief()).split())


def test_a_method_worse_than_the_before_of_the_table_is_named() -> None:
    """KM starts from a rigid robot; the robot as given bends, and with base and tool fitted is better than KM's."""

    def states(placed: float, calibrated: float) -> dict[str, Accuracy]:
        e = np.linspace(0.5, 1.5, 108)
        return {"placed": summarise(1e-3 * placed * e), "calibrated": summarise(1e-3 * calibrated * e)}

    found = {"KM": {"report": states(1.2, 0.83)}, "SKCM": {"report": states(0.6, 0.1)}}
    (said,) = methods_worse(found)
    assert said.text.startswith("KM makes held-out poses worse: 0.830 mm, 0.600 mm before")
    assert not list(methods_worse(found | {"KM": {"report": states(1.2, 0.6)}}))
