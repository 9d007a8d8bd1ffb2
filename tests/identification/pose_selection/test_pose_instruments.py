"""Plans for wires and sockets: what they promise against identifications, where anchors go, and the command."""

import inspect
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from arms import elbow, planar, readings
from command_line import main

from casadical import InputError, identify, write_robot
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection import Noise, Workspace, candidates, forecast, place_instrument
from casadical.identification.pose_selection.candidates import expected, poses_at_places
from casadical.identification.pose_selection.instruments import Instrument, best_places, usual_places
from casadical.identification.pose_selection.planning import Places
from casadical.identification.pose_selection.pose_search import select_poses, select_with_places
from casadical.measurements.measurements import unmeasured

SIGMA = 5e-5
ANCHORS = np.array([[1.8, 0.3, 0.0], [-0.9, 1.6, 1.2], [-0.6, -1.7, 0.6]])
LINE = np.array([[2.0, y, 0.3] for y in (-1.0, 0.0, 1.0, 0.5)])
SOCKETS = np.array([[0.5, 0.4, 0.2], [-0.5, 0.4, 0.7], [0.4, -0.6, 0.5]])


@pytest.fixture(scope="module")
def robot():
    return elbow()


def plan(robot, instrument, n=40):
    return select_poses(robot, None, n, noise=Noise(SIGMA), instrument=instrument, pool=150, restarts=1)


@pytest.mark.parametrize(
    "instrument",
    [
        Instrument("wires", ANCHORS),
        Instrument("wires", ANCHORS, surveyed=True),
        Instrument("wires", ANCHORS[:1]),
        Instrument("sockets", SOCKETS),
    ],
    ids=["three wires", "known places", "one wire", "sockets"],
)
def test_expected_standard_errors_are_those_that_an_identification_reports(robot, instrument) -> None:
    chosen = plan(robot, instrument, 60)
    rng, sets = np.random.default_rng(0), []
    for m in instrument.sets(chosen.m):
        if m.distance is None:
            sets.append(replace(m, sigma=SIGMA, separation_sigma=SIGMA))
        else:
            sets.append(replace(m, distance=m.distance + rng.normal(0, SIGMA, len(m)), sigma=SIGMA))
    # Of sockets the readings are moved a little, so that something is left.
    for k, m in enumerate(sets):
        if m.distance is None:
            sets[k] = replace(m, q=np.clip(m.q + rng.normal(0, 1e-5, m.q.shape), -2.6, 2.6))
    found = identify(robot, sets, priors=False)
    assert found.names == chosen.names
    ratio = found.standard_errors / np.sqrt(found.variance) / chosen.standard_errors
    np.testing.assert_allclose(ratio, 1.0, rtol=0.02)
    base = [name for name in chosen.names if name.startswith("base_")]
    assert len(base) == (6 if instrument.surveyed else 0)


def test_the_forecast_is_that_of_the_poses_chosen(robot) -> None:
    instrument = Instrument("wires", ANCHORS)
    ahead = forecast(robot, 40, noise=Noise(SIGMA), pool=150, instrument=instrument)
    assert ahead.error[-1] == pytest.approx(plan(robot, instrument).accuracy, rel=0.15)
    assert (np.diff(ahead.error) <= 0).all()


def test_places_are_not_chosen_in_a_line_where_others_are_offered(robot) -> None:
    found = place_instrument(robot, "wires", np.concatenate([LINE, ANCHORS[1:]]), 3, noise=Noise(SIGMA))
    spread = np.linalg.svd(found.places - found.places.mean(axis=0), compute_uv=False)
    assert spread[1] > 0.3 * spread[0]


def test_of_many_places_no_exchange_of_one_makes_the_set_better() -> None:
    """So many that not all sets are tried."""
    arm, noise, names = planar(), Noise(SIGMA), ["a1", "theta1", "theta2"]
    places = np.random.default_rng(0).uniform(-2, 2, (60, 3))
    m = expected(arm, readings(arm, 12, 0), {}, "test")

    def variance(which) -> float:
        rows = Instrument("wires", places[list(which)], surveyed=True).rows(arm, names, m, noise).reshape(-1, 3)
        return float(np.trace(np.linalg.inv(rows.T @ rows)))

    best = best_places(arm, Instrument("wires", places, surveyed=True), 3, names, m, noise, np.eye(3))
    others = [{*best} - {i} | {k} for i in best for k in range(60)]
    assert variance(best) <= 1.002 * min(variance(other) for other in others if len(other) == 3)


def test_readings_that_hold_the_tool_in_a_socket_are_as_many_as_asked_for(robot) -> None:
    q, which = poses_at_places(robot, SOCKETS, 90, Workspace(), np.random.default_rng(0))
    assert np.bincount(which.astype(int)).tolist() == [30, 30, 30]
    np.testing.assert_allclose(expected(robot, q, {}, "test").position, SOCKETS[which.astype(int)], atol=1e-6)


@pytest.mark.slow
def test_chosen_sockets_promise_more_than_others_and_poses_lie_in_them(robot) -> None:
    places = usual_places(robot, "sockets")[::6]
    chosen = select_with_places(robot, 40, "sockets", places, 2, noise=Noise(SIGMA), pool=150, restarts=1)
    near = plan(robot, Instrument("sockets", np.array([[0.5, 0.4, 0.2], [0.45, 0.35, 0.25]])))
    assert chosen.accuracy < near.accuracy
    at = chosen.instrument.places[chosen.m.conditions[candidates.SOCKET_COLUMN].astype(int)]
    np.testing.assert_allclose(expected(robot, chosen.q, {}, "test").position, at, atol=1e-6)
    assert set(chosen.table["point"]) <= {"S1", "S2"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"measured": True}, "plan with the robot file that calibrate --out wrote"),
        ({"instrument": Instrument("sockets", SOCKETS), "among": np.zeros((5, 6))}, "no candidates to be given"),
        ({"instrument": Instrument("sockets", SOCKETS + 9.0)}, "reaches 0 of 3 sockets, and 3 are wanted"),
        ({"n": 8}, "8 poses give 24 numbers, but 2"),
    ],
)
def test_what_cannot_be_planned_is_refused(robot, options, said) -> None:
    given = {"among": None, "n": 30, "instrument": Instrument("wires", ANCHORS), **options}
    if given.pop("measured", None):
        given["measured"] = expected(robot, np.zeros((3, 6)), {}, "measured")
    among, n = given.pop("among"), given.pop("n")
    with pytest.raises(InputError, match=said):
        select_poses(robot, among, n, pool=100, **given)


def command(monkeypatch, tmp_path, *words) -> int:
    write_robot(elbow(), tmp_path / "arm.toml")
    pd.DataFrame(1e3 * np.concatenate([LINE, ANCHORS]), columns=["x_mm", "y_mm", "z_mm"]).to_csv(
        tmp_path / "places.csv", index=False
    )
    return main(monkeypatch, "plan", tmp_path / "arm.toml", "--no-order", *words)


def test_the_command_plans_wires_among_given_places(monkeypatch, tmp_path, capsys) -> None:
    out = tmp_path / "next.csv"
    words = ("-n", 30, "--wires", 2, "--places", tmp_path / "places.csv", "--noise-mm", 0.05, "--out", out)
    assert command(monkeypatch, tmp_path, *words) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "noise of 0.05 mm a distance" in text
    assert "Wires end at (" in text
    places = json.loads((tmp_path / "next.json").read_text())["wires"]
    offered = (1e3 * np.concatenate([LINE, ANCHORS])).round(3).tolist()
    assert len(places) == 2
    assert all(place in offered for place in places)
    np.testing.assert_allclose(pd.read_csv(tmp_path / "next.places.csv").to_numpy(), places, atol=0.06)
    table = pd.read_csv(out)
    assert len(table) == 30
    at = table[[f"nominal_{c}_mm" for c in "xyz"]].to_numpy()
    np.testing.assert_allclose(table["nominal_wire2_mm"], np.linalg.norm(at - places[1], axis=1), atol=0.1)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--wires", 2, "--sockets", 2), "give one of them"),
        (("--known-places",), "are of --wires N or --sockets N"),
        (("--wires", 4, "--places", "none.csv"), "none.csv: no such file"),
    ],
)
def test_options_that_contradict_each_other_are_refused(monkeypatch, tmp_path, capfd, words, said) -> None:
    assert command(monkeypatch, tmp_path, "-n", 30, *words) == 2
    assert said in " ".join(capfd.readouterr().err.split())


def test_usual_places_are_of_the_reach_that_the_joints_allow(robot) -> None:
    """Not of the links' lengths, one added to the other."""
    far = np.linalg.norm(usual_places(robot, "wires")[:, :2], axis=1)
    stiff = replace(robot, joints=tuple(replace(j, lower=-0.1, upper=0.1) for j in robot.joints))
    near = np.linalg.norm(usual_places(stiff, "wires")[:, :2], axis=1)
    at = predicted(robot, unmeasured(readings(robot, 5000, 8), {}, "test"))[0]
    np.testing.assert_allclose(far, 1.5 * np.linalg.norm(at[:, :2], axis=1).max(), rtol=0.03)
    assert (near < 0.95 * far).all()


@pytest.mark.slow
def test_a_folder_of_distances_is_not_planned_as_positions(monkeypatch, tmp_path, capfd) -> None:
    write_robot(elbow(), tmp_path / "robot.toml")
    table = '[[measurements]]\nfile = "wire1.csv"\nkind = "distance"\nsigma_mm = 0.1\n'
    (tmp_path / "problem.toml").write_text(f'casadical = 1\ntitle = "wires"\n\n{table}')
    words = ("plan", tmp_path, "--no-order", "-n", 30)
    assert main(monkeypatch, *words) == 2
    assert "its tables are of kind distance" in " ".join(capfd.readouterr().err.split())
    # The readings of a wire are planned with the noise that the folder declares.
    (tmp_path / "places.csv").write_text("x_mm,y_mm,z_mm\n1800,300,0\n-900,1600,1200\n")
    out = tmp_path / "next.csv"
    assert main(monkeypatch, *words, "--wires", 2, "--places", tmp_path / "places.csv", "--out", out) == 0
    assert "noise of 0.1 mm a distance" in " ".join(capfd.readouterr().out.split())


def test_a_socket_out_of_reach_is_named_with_its_place(robot) -> None:
    far = np.array([[5.0, 0.25, 0.1], [6.0, 0.0, 0.0]])
    with pytest.raises(InputError, match=r"reaches 0 of 2 sockets, and 1 .* socket 1 at \(5000, 250, 100\) mm"):
        candidates.reachable_places(robot, far, 1, Workspace(), np.random.default_rng(0))


@pytest.mark.parametrize("kind", ["wires", "sockets"])
def test_places_that_nobody_says_to_measure_are_unknown(kind: str) -> None:
    given = inspect.signature(select_with_places).parameters["surveyed"].default
    assert Places(kind, 3).surveyed is given is False
