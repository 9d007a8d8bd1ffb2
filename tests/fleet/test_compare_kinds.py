"""What changed, from what no tracker measured: wires to known places, a wire to an unknown one, full poses."""

from dataclasses import replace

import numpy as np
import pytest
from lives import as_built, changed, measured
from marks import slow
from scipy.spatial.transform import Rotation

from casadical import Measurements, Robot
from casadical.core.basics import Array
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import estimate
from casadical.identification.accuracy import predicted

ANCHORS = np.array([[1.5, 0.5, 0.2], [-1.0, 1.6, 0.4], [0.4, -1.7, 1.2]])
NOISE, TURNED = 3e-5, 6e-4


@pytest.fixture(scope="module")
def arm() -> tuple[Robot, Robot]:
    return as_built(np.random.default_rng(3))


def wires(robot: Robot, seed: int, *, known: bool) -> list[Measurements]:
    """Distances to three places, a table for each; 100 poses."""
    m = measured(robot, seed, 100)
    p, _ = predicted(robot, m)
    rng = np.random.default_rng(seed)
    return [wire(m.q, p, a, rng, known=known) for a in ANCHORS]


def wire(q: Array, p: Array, anchor: Array, rng: np.random.Generator, *, known: bool) -> Measurements:
    distance = np.linalg.norm(p - anchor, axis=1) + NOISE * rng.normal(size=len(p))
    target = np.tile(anchor, (len(p), 1)) if known else None
    return Measurements(q=q, kind="distance", distance=distance, target=target, source=f"wire at {anchor}")


def poses(robot: Robot, seed: int) -> list[Measurements]:
    """Positions and orientations, to 0.1 mrad."""
    m = measured(robot, seed, 40)
    p, R = predicted(robot, m)
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(1e-4 * rng.normal(size=(len(p), 3))).as_matrix()
    noisy = p + NOISE * rng.normal(size=p.shape)
    return [replace(m, kind="pose", position=noisy, orientation=R @ turn)]


@pytest.mark.parametrize("kind", [*slow("wires"), "a wire to an unknown place", "poses"])
def test_a_joint_that_turned_is_named_and_nothing_else(arm: tuple[Robot, Robot], kind: str) -> None:
    robot, built = arm

    def told(truth: Robot, seed: int) -> list[Measurements]:
        return poses(truth, seed) if kind == "poses" else wires(truth, seed, known=kind == "wires")

    before, again = (estimate((robot, told(built, seed)), str(seed)) for seed in (11, 12))
    after = estimate((robot, told(changed(built, theta3=TURNED), 13)), "after")
    same = compare([before, again])
    assert not same.changed
    # A wire to an unknown place tells nothing of where the base stands.
    assert ("base" in dict(same.placements)) == (kind != "a wire to an unknown place")
    (change,) = compare([before, after]).changes
    assert change.cause.label == "joint_zero@3"
    (amount,) = change.amounts
    assert abs(amount.value - np.rad2deg(TURNED)) < 4 * amount.std_error
