"""The figures carry the numbers they claim, by other ways of computing them."""

import json
import re
import sys

import numpy as np
import pytest

from casadical import plot
from casadical.core.basics import InputError
from casadical.core.reporting.drawing import COLOURS, draw
from casadical.core.reporting.page import require, safe_json
from casadical.identification.figures import most_correlated, residual_quantiles
from casadical.identification.pose_errors import (
    ModelErrors,
    PoseErrors,
    error_distribution,
    errors_by_pose,
    round_factor,
    skeleton,
    workspace,
)
from casadical.identification.result import LeftOut


@pytest.fixture(scope="module")
def figures(hh800):
    return plot(hh800)


def trace(figure, name):
    return next(t for t in figure.data if t.name == name)


def test_errors_of_each_pose_average_to_the_error_table(hh800, figures) -> None:
    for name in ("report", "identify"):
        for method in ("KM", "SKCM"):
            y = np.array(trace(figures[f"errors/{name}"], method).customdata)
            assert y.mean() == pytest.approx(1e3 * hh800.accuracies[method][name]["calibrated"].mean, abs=1e-5)
    # A refused network is drawn as it was trained: its mean is that of its own report, not that of SKCM.
    refused = [r for r in hh800.networks.results.values() if r.compensator and not r.helps]
    assert refused
    for r in refused:
        y = np.array(trace(figures["errors/report"], f"{r.method}, refused").customdata)
        assert y.mean() == pytest.approx(r.compensator.validation.after.mean_mm, abs=1e-5)


def test_vectors_are_as_long_as_their_errors_times_the_factor_in_the_legend(figures) -> None:
    figure = figures["workspace"]
    lines = next(t for t in figure.data if t.mode == "lines" and t.name.startswith("SKCM"))
    factor = float(lines.name.split("drawn ")[1].split(" ")[0])
    tips = next(t for t in figure.data if t.mode == "markers" and t.name == lines.name)
    ends = np.stack([lines.x, lines.y, lines.z], axis=1).reshape(-1, 3, 3)
    drawn = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert 1e3 * drawn / factor == pytest.approx(np.array(tips.customdata)[:, 1], abs=1e-4)


def test_the_skeleton_ends_at_the_measured_point_and_keeps_its_links(hh800) -> None:
    robot = hh800.robot
    a, b = (skeleton(robot, q) for q in hh800.problem.sets["report"][0].q[:2])
    lengths = [np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (a, b)]
    # The last stretch, to the tool, bends by the joints' compliance, fractions of a millimetre.
    assert lengths[0] == pytest.approx(lengths[1], abs=2e-3)


@pytest.mark.parametrize(("factor", "rounded"), [(0.3, 1), (1, 1), (9.9, 5), (730, 500), (2000, 2000), (1e6, 1e6)])
def test_factors_are_round_and_never_greater(factor, rounded) -> None:
    assert round_factor(factor) == rounded


def test_shares_and_probabilities_sum_to_one(diagnosis, details) -> None:
    figures = plot(diagnosis, more=details)
    assert sum(figures["where/joints"].data[0].x) == pytest.approx(100, abs=1e-3)
    assert sum(figures["causes/1"].data[0].x) == pytest.approx(1, abs=0.02)  # those beyond the first eight are left out
    bars = figures["gap"].data[0].x
    assert bars[0] == pytest.approx(1e3 * diagnosis.gap.without_outliers)
    assert bars[-1] == pytest.approx(1e3 * diagnosis.gap.floor)
    held_out = [np.mean(t.customdata) for t in figures["errors"].data[:2]]
    assert held_out == pytest.approx([1e3 * diagnosis.gap.without_outliers, 1e3 * diagnosis.gap.after], abs=1e-5)


def test_curves_are_drawn_with_their_bands(diagnosis, details, curves) -> None:
    figures = plot(diagnosis, more=details)
    angles = figures["curves/angles"]
    drawn = [t for t in angles.data if t.name == "curve"]
    assert len(drawn) == 6
    second = curves[1]
    assert np.array(drawn[1].y) == pytest.approx(1e6 * second.value, abs=0.06)
    assert np.array(drawn[1].customdata) == pytest.approx(1.96e6 * second.error, abs=0.6)
    covered = [t for t in angles.data if t.name == "angles with readings"][1]
    x = [v for v in covered.x if v is not None]
    assert (min(x), max(x)) == pytest.approx((-np.rad2deg(2), np.rad2deg(2)), abs=2)
    words = {a.text for a in angles.layout.annotations}
    assert {"joint 2: 100 %", "joint 6: not seen", "reading [deg]", "error [urad]"} <= words


def test_many_poses_are_thinned_and_said_to_be() -> None:
    n = 3000
    rng = np.random.default_rng(0)
    error = rng.normal(size=(n, 3)) * 1e-4
    models = (ModelErrors("SKCM", np.linalg.norm(error, axis=1), error),)
    poses = PoseErrors("report", True, np.arange(n) + 2, np.zeros((n, 6)), rng.uniform(-1, 1, (n, 3)), models)
    figure = draw(errors_by_pose(poses))
    assert len(figure.data[0].y) == 400
    assert "400 of 3000 drawn" in figure.layout.xaxis.title.text
    assert set(figure.data[0].x) <= set(poses.row)
    assert draw(error_distribution(poses)).data[0].x[-1] == pytest.approx(
        1e3 * models[0].length.max(), abs=1e-5
    )  # of all
    assert len(draw(workspace(poses)).to_json()) < 400_000
    np.testing.assert_array_equal(poses.thinned(2).models[0].vector, error[[0, -1]])
    assert made_up().thinned(2).models[0].vector is None


def made_up(n: int = 60, **changes: object) -> PoseErrors:
    """Errors of a model ten times as good as the one before, in the rows of a file whose order means nothing."""
    rng = np.random.default_rng(1)
    before = np.abs(rng.normal(1e-3, 1e-4, n))
    models = (ModelErrors("before", before), ModelErrors("SKCM", 0.1 * before))
    given = {"source": "data/arm.csv", "models": models, **changes}
    return PoseErrors("report", True, np.arange(n) + 2, np.zeros((n, 6)), None, **given)


def test_far_poses_neither_set_the_scale_nor_vanish() -> None:
    after = np.full(60, 1e-4)
    after[[7, 30]] = 9e-3
    out = (LeftOut("data/arm.csv", 99, 0.2),)
    figure = draw(errors_by_pose(made_up(models=(ModelErrors("SKCM", after),), left_out=out)))
    top = figure.layout.yaxis.range[1]
    assert top < 1.0
    points, crosses = figure.data
    assert [k for k, s in enumerate(points.marker.symbol) if s.startswith("triangle")] == [7, 30]
    assert points.customdata[7] == pytest.approx(9.0)
    assert max(points.y) <= top
    assert "rows 9, 32" in figure.layout.annotations[0].text
    assert (crosses.name, list(crosses.x), crosses.customdata[0]) == ("left out as outlier", [99], pytest.approx(200))
    assert crosses.y[0] <= top
    assert figure.layout.xaxis.range[1] > 99


def test_quantiles_of_normal_noise_lie_in_their_band_and_a_wrong_row_does_not() -> None:
    noise = np.random.default_rng(3).normal(size=(400, 3))
    for residuals in (noise, np.where(noise > 2.2, 9.0, noise)):
        band, points = residual_quantiles(residuals).series
        half = len(band.x) // 2
        high, low = np.array(band.y[:half]), np.array(band.y[half:])[::-1]
        inside = (points.y <= high) & (points.y >= low)
        assert inside.mean() > 0.95
        assert inside[-1] == (residuals is noise)
    # About the middle one of n normal numbers: 1.96 roots of pi / (2 n) on either side.
    assert (high - low)[half // 2] == pytest.approx(2 * 1.96 * np.sqrt(np.pi / 2 / noise.size), rel=0.01)
    assert max(points.y) == 9.0


def test_ellipses_are_those_of_the_covariance(hh800, figures) -> None:
    result = hh800.identification
    names = most_correlated(result)
    assert 2 <= len(names) <= 4
    joint = np.array([result.names.index(n) for n in names[:2]])
    C = result.covariance[np.ix_(joint, joint)] / np.outer(*[result.standard_errors[joint]] * 2)
    ellipse = np.stack([figures["fit/pairs"].data[0].x, figures["fit/pairs"].data[0].y])
    distance = (ellipse * np.linalg.solve(C, ellipse)).sum(axis=0)
    assert distance == pytest.approx(5.991, rel=0.05)  # chi squared, two degrees of freedom, 95 %
    told = [note for note in figures["fit/pairs"].layout.annotations if re.fullmatch(r"[+-]\d\.\d\d", note.text)]
    assert len(told) == len(names) * (len(names) - 1) / 2
    assert all((note.x < 0.5) == note.text.startswith("+") for note in told)  # where the ellipse is not


def test_the_coverage_has_every_reading_between_the_limits(hh800, figures) -> None:
    (m,) = hh800.problem.sets["report"]
    ticks = trace(figures["fit/coverage"], "Held-out poses")
    assert len(ticks.x) == m.q.size
    second = hh800.robot.joints[1]
    share = (m.q[:, 1] - second.lower) / (second.upper - second.lower)
    assert np.array(ticks.x).reshape(m.q.shape)[:, 1] == pytest.approx(100 * share, abs=0.01)
    assert figures["fit/coverage"].layout.xaxis.tickvals[::4] == (0, 100)  # the limits


def test_no_tag_gets_out_of_a_figure_and_no_nan_into_it() -> None:
    text = safe_json({"a": "</script><b>", "x": [float("nan"), 1.0]})
    assert "<" not in text
    assert "[null,1.0]" in text


def test_without_plotly_the_message_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(InputError, match=r"needs plotly.*pip install 'casadical\[report\]'"):
        require()


def test_dark_changes_every_colour_and_no_number(hh800, figures) -> None:
    figure = figures["errors/report"]
    night = plot(hh800, "errors/report", dark=True)
    assert night.layout.paper_bgcolor == COLOURS["paper"][1]
    y, same = (json.loads(f.to_json())["data"][0]["y"] for f in (figure, night))
    assert y == same
    lights = {light for light, _ in COLOURS.values()}
    assert not [c for c in lights if c in night.to_json()]
