"""What a user's own MuJoCo model must do before it is written, and how poses are shared for a replay."""

from pathlib import Path

import numpy as np
import pytest

from casadical.core.errors import InputError
from casadical.core.transforms import frame, from_rpy
from casadical.export import model_file
from casadical.export.mjcf.into_mjcf import refuse_unmoved
from casadical.export.mjcf.replay import PARTS

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra mujoco)")
ROOT = Path(__file__).parents[3]
MODEL = """<mujoco><worldbody><body name="one" pos="0.1 0.2 0.3"><joint name="a"/><geom size="0.1" mass="1"/>
<body name="two" pos="0.4 0 0" quat="0.5 0.5 0.5 0.5"><joint name="b"/><geom size="0.1" mass="1"/></body></body>
</worldbody></mujoco>"""


def test_bodies_that_are_not_at_their_targets_are_refused() -> None:
    spec = mujoco.MjSpec.from_string(MODEL)
    one = frame(np.eye(3), np.array([0.1, 0.2, 0.3]))
    two = one @ frame(from_rpy(np.array([np.pi / 2, 0.0, np.pi / 2])), np.array([0.4, 0.0, 0.0]))
    refuse_unmoved(spec, ["a", "b"], [one, two], "mine.xml")
    off = two.copy()
    off[0, 3] += 1e-3
    with pytest.raises(InputError, match=r"body 'two' does not move to its target \(0\.001 m or rad off\)"):
        refuse_unmoved(spec, ["a", "b"], [one, off], "mine.xml")


def test_springs_that_were_not_asked_for_are_said_to_lack(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(model_file, "into_mjcf", lambda *_: "<mujoco/>")
    robot = ROOT / "problems" / "kr210" / "robot.toml"
    arm = model_file.read_robot(robot)
    assert any(j.compliance for j in arm.joints)
    for springs, said in ((False, ("springs of the joints; --springs adds them",)), (True, ())):
        asked = model_file.OfMjcf(into=tmp_path / "mine.xml", joints="a,b,c,d,e,f", springs=springs)
        made = model_file.into_users(robot, asked, robot, arm)
        assert made.text == "<mujoco/>"
        assert made.left_out == said


def test_two_thirds_of_the_poses_are_fitted_and_the_others_replayed() -> None:
    assert PARTS["identify"] == 2 / 3
    assert 0.99 < sum(PARTS.values()) <= 1
