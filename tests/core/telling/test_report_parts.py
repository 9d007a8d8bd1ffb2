"""Parts of a report that need no diagnosis: bars, tiles, grids, colours, names of files."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from casadical.core.telling.blocks import mm
from casadical.core.telling.drawing import COLOURS, draw
from casadical.core.telling.figure import Axis
from casadical.diagnosis.figures import curve_figure, gap_course
from casadical.diagnosis.joint_curves import JointCurves
from casadical.identification.figures import intervals
from casadical.identification.pose_errors import MODEL_STYLES
from casadical.project.calibration_page import NETWORK_STYLES
from casadical.project.telling import campaign_files

pytest.importorskip("plotly", reason="plotly is not installed (extra report)")


def test_bars_of_an_interval_go_from_low_to_high() -> None:
    figure = draw(intervals("n", "t", Axis("x"), ["a", "b"], [0.5, 2.0], [0.4, 2.0], [0.75, 2.5], ["", ""], "%{x}"))
    bars = figure.data[0].error_x
    assert list(bars.arrayminus) == pytest.approx([0.1, 0.0])
    assert list(bars.array) == pytest.approx([0.25, 0.5])


def test_models_are_drawn_in_the_colours_of_a_light_page() -> None:
    assert {colour for colour, _, _ in (*NETWORK_STYLES, *MODEL_STYLES.values())} <= set(COLOURS)
    assert len(set(NETWORK_STYLES)) == len(NETWORK_STYLES)


def test_the_tiles_are_the_figures_of_the_held_out_poses(calibrated: Any) -> None:
    planar = calibrated("planar")
    states = planar.accuracies["KM"]
    held_out = next(name for name in states if name.startswith("report"))
    after, before = states[held_out]["calibrated"], states[held_out]["placed"]
    shown = {tile.label: tile.value for tile in planar.page().tiles}
    assert shown == {
        "Mean error before": mm(before.mean),
        "Mean error after KM": mm(after.mean),
        "95 % of the poses below": mm(after.p95),
        "Largest error": mm(after.max),
    }
    assert "training" not in planar.figures()  # no networks, no figure of their training


@pytest.mark.parametrize(("joints", "rows"), [(1, 1), (2, 1), (3, 2), (6, 3)])
def test_a_grid_has_a_place_for_every_joint(curves: JointCurves, joints: int, rows: int) -> None:
    unseen = tuple(replace(c, lost=0.0) for c in curves.joints[:joints])
    figure = draw(curve_figure(replace(curves, joints=unseen)))
    titles = [a.text for a in figure.layout.annotations if a.text.startswith("joint")]
    assert titles == [f"joint {k}: not seen" for k in range(1, joints + 1)]
    assert len(figure._grid_ref) == rows


def test_the_course_of_the_gap_ends_at_the_floor_in_millimetres() -> None:
    course = pd.DataFrame([("base", 0.2, 0.18, 0.22)], columns=["model", "gap_mm", "low_mm", "high_mm"])
    d: Any = SimpleNamespace(course=course, gap=SimpleNamespace(floor=5e-5), effects=lambda: ())
    bars = gap_course(d).series[0]
    np.testing.assert_allclose(bars.x, [0.2, 0.05])


def test_a_diagnosis_names_the_files_that_it_read(tmp_path: Path) -> None:
    said = 'casadical = 1\ntitle = "a"\nrobot = "arm.toml"\ncampaign_robot = "real.toml"\n'
    (tmp_path / "problem.toml").write_text(said)
    campaign = tmp_path / "a.csv"
    names = campaign_files(tmp_path, [campaign])
    assert [Path(p).name for p in names] == ["problem.toml", "real.toml", "a.csv"]
    assert Path(names[1]).resolve() == (tmp_path / "real.toml").resolve()
