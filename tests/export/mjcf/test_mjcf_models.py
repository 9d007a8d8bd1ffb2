"""Exported models in the real MuJoCo against casadical's own positions, and against MuJoCo's own motion to rest."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench import robot as robot_of
from marks import MUJOCO

from casadical.core.basics import ConvergenceError
from casadical.effects import (
    Backlash,
    BaseCompliance,
    CubicStiffness,
    Effect,
    FrameDrift,
    FrictionWindup,
    GearEccentricity,
    GravityCompensator,
    JointScale,
    LinkFlexure,
    MissingCompliance,
    NonlinearStiffness,
    PayloadError,
    SmrOffset,
)
from casadical.export.mjcf.equilibrium import EngineModel, positions
from casadical.export.mjcf.mjcf import mjcf
from casadical.export.mjcf.replay import replay, replay_campaign
from casadical.identification.accuracy import predicted
from casadical.identification.pose_selection import Workspace
from casadical.identification.pose_selection.candidates import draw
from casadical.measurements.measurements import Measurements
from casadical.measurements.reading import read_measurements
from casadical.robot.robot import Robot
from casadical.robot.urdf import new_urdf

pytestmark = MUJOCO
ROOT = Path(__file__).parents[3]
ROBOTS = ("hh800", "kr210", "ur10e")


def as_built(robot: Robot, seed: int = 3) -> Robot:
    """Every length and angle off its drawing, so that parallel axes are not and the loop is no parallelogram."""
    rng = np.random.default_rng(seed)
    size = {"m": 1e-3, "rad": 2e-3}
    groups = ("base", "geometry", "loop", "tool")
    chosen = [p for p in robot.parameters if p.group in groups]
    return robot.with_values({p.name: p.value + rng.normal(0, size[p.unit]) for p in chosen})


def poses(robot: Robot, n: int = 12, seed: int = 5, **conditions: np.ndarray) -> Measurements:
    q = draw(robot, n, Workspace(), np.random.default_rng(seed))
    return Measurements(q=q, kind="position", position=np.zeros((n, 3)), conditions=conditions)


def apart(robot: Robot, m: Measurements) -> np.ndarray:
    return np.linalg.norm(positions(mjcf(robot).text, m) - predicted(robot, m)[0], axis=1)


@pytest.mark.parametrize("name", ROBOTS)
def test_position_and_orientation_are_those_of_the_robot_to_a_nanometre(name: str) -> None:
    robot = as_built(robot_of(name))
    rigid = robot.with_values(dict.fromkeys(robot.parameters.select(["compliance"]), 0.0))
    weightless = re.sub(r'gravity="[^"]*"', 'gravity="0 0 0"', mjcf(rigid).text)
    m = poses(rigid)
    assert np.linalg.norm(positions(weightless, m) - predicted(rigid, m)[0], axis=1).max() < 1e-9
    m, model = poses(rigid, 1), EngineModel(weightless)
    model.rest(m.q[0], np.zeros(robot.n))
    assert np.allclose(model.d.site("measured").xmat.reshape(3, 3), predicted(rigid, m)[1][0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_springs_give_way_as_the_robots_joints_do(name: str) -> None:
    robot = as_built(robot_of(name))
    assert robot.payload
    m = poses(robot, payload_kg=np.tile([0.0, robot.payload.mass], 6))
    rigid = robot.with_values(dict.fromkeys(robot.parameters.select(["compliance"]), 0.0))
    sag = np.linalg.norm(predicted(robot, m)[0] - predicted(rigid, m)[0], axis=1)
    assert sag.max() > 1e-3
    assert apart(robot, m).max() < 5e-7  # the model sinks once under its load, the simulator until it rests


# Effect, values, and how near [m] the counterpart comes.
COUNTERPARTS: list[tuple[Effect, dict[str, float], float]] = [
    (MissingCompliance(6), {"deflection": 2e-4}, 1e-6),
    (BaseCompliance(), {"rx": 6e-5, "ry": 9e-5}, 2e-6),
    (BaseCompliance(None, 0.4), {"rx": 6e-5, "ry": 9e-5}, 2e-6),
    (LinkFlexure(None, 1), {"rx1": 6e-5, "ry1": 9e-5, "rz1": 3e-5}, 2e-6),
    (LinkFlexure(None, 2), {"rx2": 6e-5, "ry2": 9e-5, "rz2": 3e-5}, 1e-6),
    (LinkFlexure(None, 3), {"rx3": 6e-5, "ry3": 9e-5, "rz3": 3e-5}, 1e-6),
    (LinkFlexure(None, 2, spread=True), {"rx2": 6e-5, "ry2": 9e-5, "rz2": 3e-5}, 1e-6),
    (LinkFlexure(None, 3, spread=True), {"rx3": 6e-5, "ry3": 9e-5, "rz3": 3e-5}, 1e-6),
    (PayloadError(), {"mass": 0.06, "x": 0.02, "y": -0.01, "z": 0.03}, 1e-6),
    (JointScale(3), {"k": 1e-4}, 2e-6),
    (FrictionWindup(3), {"constant": 4e-5, "load": 0.0}, 1e-6),
    (GravityCompensator(2, 2.0, 0.5), {"sin": 0.2, "cos": -0.1, "preload": 0.15}, 15e-6),
    (NonlinearStiffness(2, 0.2), {"bend": 6e-5}, 25e-6),
    (CubicStiffness(2), {"bend": 4e-5}, 10e-6),
]


@pytest.mark.parametrize(
    "name", [pytest.param("hh800", marks=pytest.mark.slow), "kr210", pytest.param("ur10e", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(("effect", "values", "near"), COUNTERPARTS, ids=[e.label for e, _, _ in COUNTERPARTS])
def test_an_effect_has_its_counterpart(name: str, effect: Effect, values: dict[str, float], near: float) -> None:
    plain = robot_of(name)
    robot = plain.with_effect(effect).with_values({f"{effect.label}.{k}": v for k, v in values.items()})
    assert plain.payload
    way = {f"approach{i}": np.tile([-1.0, 1.0], 6) for i in range(1, 7)}
    m = poses(robot, payload_kg=np.tile([plain.payload.mass, 0.0], 6), **way)
    stage = replay(robot, m)
    assert not stage.export.left_out
    without = np.linalg.norm(predicted(robot, m)[0] - predicted(plain, m)[0], axis=1)
    assert stage.apart.max() < near
    assert stage.apart.max() < 0.35 * without.max()


@pytest.mark.parametrize("below", [0.0, 1.0])
def test_a_foot_on_a_wall_is_turned_by_the_weight_about_its_own_axes(below: float) -> None:
    plain = robot_of("ur10e")
    T = np.eye(4)
    T[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    wall = replace(plain, base=replace(plain.base, T=T))
    robot = wall.with_effect(BaseCompliance(None, below)).with_values(
        {"base_compliance.rx": 6e-5, "base_compliance.ry": 9e-5}
    )
    m = poses(robot)
    moved = np.linalg.norm(predicted(robot, m)[0] - predicted(wall, m)[0], axis=1)
    assert replay(robot, m).apart.max() < 0.02 * moved.max()


def test_the_spring_of_a_cubic_stiffness_says_how_near_it_comes() -> None:
    """The true deflection, great (c load - bend load^3 / great), is far larger than what the spring misses of it."""
    robot = robot_of("kr210").with_effect(CubicStiffness(3)).with_values({"cubic_stiffness@3.bend": 2e-5})
    (words,) = [text for text in replay(robot, poses(robot)).export.written if text.startswith("cubic_stiffness@3")]
    deflection = robot.joints[2].compliance * robot.torque_scale[2]
    assert deflection > 1e-4
    assert 1e-6 * float(re.findall(r"within ([\d.]+) urad", words)[0]) < 0.02 * deflection


def test_play_lies_on_the_flank_to_which_gravity_pushes() -> None:
    effect = Backlash(3, 0.02, 0.002)
    robot = robot_of("kr210").with_effect(effect).with_values({"backlash@3.half": 8e-5})
    m = poses(robot, 20, **{f"approach{i}": np.tile([-1.0, 1.0], 10) for i in range(1, 7)})
    stage = replay(robot, m)
    assert np.sort(stage.apart)[-3] < 2e-6  # near the change of flank the model's edge is round, a stop's is sharp
    assert "joint3_play" in stage.export.text
    rough = robot_of("kr210").with_effect(Backlash(3, 0.5, 0.002)).with_values({"backlash@3.half": 8e-5})
    named = replace(rough, joints=tuple(replace(row, name=f"axis{i}") for i, row in enumerate(rough.joints)))
    assert 'joint="axis2"' in mjcf(named).text
    np.testing.assert_array_equal(positions(mjcf(named).text, m), positions(mjcf(rough).text, m))


def test_the_stiffness_of_a_coordinate_is_the_slope_of_its_force() -> None:
    effect = CubicStiffness(2)
    (name,) = [p.name for p in effect.parameters()]
    robot = as_built(robot_of("kr210")).with_effect(effect).with_values({name: 6e-5})
    model = EngineModel(re.sub(r'gravity="[^"]*"', 'gravity="0 0 0"', mjcf(robot).text))
    (k,) = np.flatnonzero(model.m.jnt_stiffnesspoly[:, 1])
    x, force = 2e-3, []
    for at in (x - 1e-5, x + 1e-5):
        model.d.qpos[k] = at
        force.append(model._force()[k])
    model.d.qpos[k] = x
    assert 3 * model.m.jnt_stiffnesspoly[k, 1] * x**2 > 0.01 * model.m.jnt_stiffness[k]
    assert model._slope(int(k)) == pytest.approx(-(force[1] - force[0]) / 2e-5, rel=1e-5)


def test_mujocos_own_motion_comes_to_the_same_rest() -> None:
    """Time steps, with soft constraints and stops, from the command's pose on."""
    import mujoco

    effect = Backlash(5, 0.0, 0.002)
    robot = as_built(robot_of("hh800")).with_effect(effect).with_values({"backlash@5.half": 8e-5})
    m = poses(robot, 2, **{f"approach{i}": np.ones(2) for i in range(1, 7)})
    text = mjcf(robot).text
    there = positions(text, m)
    for k in range(2):
        at_rest = EngineModel(text)
        at_rest.rest(m.q[k], np.ones(6))
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.qpos[:] = at_rest.d.qpos
        data.qpos[at_rest.drives] = m.q[k]  # springs let go: the arm has yet to sink, the play to be taken up
        data.qpos[at_rest.play] = 0.0
        data.ctrl[:] = m.q[k]
        mujoco.mj_forward(model, data)
        before = np.linalg.norm(data.site("measured").xpos - there[k])
        mujoco.mj_step(model, data, 1500)
        mujoco.mj_forward(model, data)
        assert before > 1e-4
        assert np.linalg.norm(data.site("measured").xpos - there[k]) < 2e-6


def test_an_effect_of_the_measurement_is_added_to_what_mujoco_finds() -> None:
    robot = robot_of("ur10e").with_effect(SmrOffset())
    robot = robot.with_values({"smr_offset.along": 2e-5, "smr_offset.across": -3e-5})
    stage = replay(robot, poses(robot))
    assert stage.export.left_out == ("smr_offset: an effect of the measurement, not of the robot",)
    assert stage.apart.max() < 5e-7


def test_what_has_no_counterpart_is_said() -> None:
    robot = robot_of("ur10e").with_effect(GearEccentricity(5), FrameDrift(), Backlash(2))
    robot = robot.with_values({"backlash@2.half": -1e-5})
    made = mjcf(robot)
    text = "\n".join(made.left_out)
    assert "gear_eccentricity@5: no counterpart in MuJoCo" in text
    assert "frame_drift: an effect of the measurement" in text
    assert "backlash@2: no counterpart, for its value" in text
    assert all(line in made.text for line in made.left_out)


def test_a_loop_that_cannot_close_is_refused() -> None:
    robot = robot_of("hh800").with_values({"L4": 1.59})
    m = replace(poses(robot, 1), q=np.deg2rad([[0, 90, 270, 0, 0, 0]]))  # the crank away from the rocker's pin
    with pytest.raises(ConvergenceError, match="does not close"):
        positions(mjcf(robot).text, m)


@pytest.mark.slow
def test_a_campaign_replayed_shows_the_gap_close() -> None:
    """KR 210, whose payload is heavier than declared, from another simulator; poses that were held out."""
    robot = robot_of("kr210")
    m = read_measurements(ROOT / "data" / "campaigns" / "practice" / "kr210-P05.csv", 6)
    found = replay_campaign(robot, m, ["payload_error", "backlash", "gear_eccentricity"])
    table = found.table.set_index("model")
    assert list(table.index) == ["nominal", "geometry and stiffness", "payload_error"]
    assert set(table.n) == {40}
    nominal, geometry, effect = table.mean_mm
    assert nominal > 3 > 0.06 > geometry > 1.3 * effect
    assert table.apart_um.max() < 1


def test_a_new_urdf_reads_back_as_the_same_arm(tmp_path: Path) -> None:
    pytest.importorskip("yourdfpy", reason="the extra urdf is not installed")
    from casadical.robot.urdf import read_urdf

    robot = as_built(robot_of("kr210"))
    rigid = replace(robot, base=replace(robot.base, T=np.eye(4)))
    rigid = rigid.with_values(dict.fromkeys(rigid.parameters.select(["compliance"]), 0.0))
    (tmp_path / "arm.urdf").write_text(new_urdf(rigid))
    back = read_urdf(tmp_path / "arm.urdf", tip_link="measured")
    m = poses(rigid)
    assert np.abs(predicted(back, m)[0] - predicted(rigid, m)[0]).max() < 1e-9
    assert [j.body.mass for j in back.joints if j.body] == pytest.approx([j.body.mass for j in robot.joints if j.body])
