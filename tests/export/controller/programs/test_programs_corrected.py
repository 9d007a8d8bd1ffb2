"""Random programs are written, corrected and read back: the real tool ends where the nominal one's would.

What the controller does with the new numbers is computed here: a pose is solved with the nominal robot by scipy, near
to the joints that the target was drawn with. Both robots stand in the measuring frame; the instrument's place is taken
off by Kabsch's method.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from controller_arms import nominal_path, planted, poses, rigid_motion
from program_texts import BASES, TOOLS, Point, held, joints_of, matrix, pose_of, read, write

from casadical.core.reporting.result import plain_text
from casadical.export.controller.commands import Sources
from casadical.export.controller.programs.correction import Cell
from casadical.export.controller.programs.program import corrected_program, read_target_program
from casadical.export.controller.programs.rapid import Rapid
from casadical.export.controller.programs.target import Given
from casadical.robot.robot_file import read_robot

SUFFIX = {"krl": ".dat", "rapid": ".mod", "urscript": ".script", "fanuc": ".ls"}
# Of the numbers as they are written; FANUC has three decimals, which at 3 m are 26 um for each of six joints.
ROUNDING = {"krl": 1e-6, "rapid": 1e-6, "urscript": 1e-7, "fanuc": 150e-6}


@pytest.fixture(scope="module")
def cells():
    """Real and nominal robot and the cell by language: the KR 210 has configurations, the UR10 has not."""
    made = {}
    for name in ("kr210", "ur10"):
        real, nominal = planted(name), read_robot(nominal_path(name))
        for pose in (False, True):
            cell = Cell(Sources(real, nominal), steps=3, orientation=pose)
            for language in ("krl", "rapid", "fanuc") if name == "kr210" else ("urscript",):
                made[language, pose] = real, _rigid(nominal), cell
    return made


def _rigid(robot):
    return replace(robot, joints=tuple(replace(j, compliance=None) for j in robot.joints))


def drawn(language, robot, count, seed):
    """Targets, and their poses in their bases, by the nominal robot in its own base frame."""
    rng = np.random.default_rng(seed)
    only = language == "urscript"
    points = [
        Point(q, bool(rng.random() < 0.4), 0 if only else int(rng.integers(2)), 1 if only else int(rng.integers(2)))
        for q in poses(robot, count, seed)
    ]
    to_own = np.linalg.inv(robot.base.T)
    poses_in_base = [
        np.linalg.inv(matrix(BASES[p.base])) @ to_own @ held(robot, p.q, matrix(TOOLS[p.tool])) for p in points
    ]
    return points, poses_in_base


@pytest.mark.parametrize(("end", "pose"), [("\n", False), pytest.param("\r\n", True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("language", list(SUFFIX))
def test_the_real_tool_ends_where_the_nominal_one_would(language, end, pose, cells, tmp_path):
    real, nominal, cell = cells[language, pose]
    points, in_base = drawn(language, nominal, 24, seed=7 if end == "\n" else 8)
    path = tmp_path / f"prog{SUFFIX[language]}"
    content = write(language, points, in_base, np.random.default_rng(3), end)
    path.write_bytes(content)
    given = Given(
        {str(k): matrix(v) for k, v in enumerate(TOOLS, 1)}, {str(k): matrix(v) for k, v in enumerate(BASES, 1)}
    )
    program = read_target_program(path, given if language == "fanuc" else Given(), 6)
    result = corrected_program(program, cell)
    new = result.content()
    told = dict(re.findall(r"^(before|after) \[[mu]m\] +(\S+)", plain_text(result.blocks()), re.M))
    off = np.mean([r.off_mm for r in result.results if r.fine], axis=0)
    assert [float(told["before"]), 1e-3 * float(told["after"])] == pytest.approx(off, abs=1e-4)
    assert len(result.results) == len(points)
    fine = [r.fine for r in sorted(result.results, key=lambda r: r.target.line)]
    assert np.mean(fine) > 0.8
    wanted, before, after = [], [], []
    for k, (point, T) in enumerate(zip(points, in_base, strict=True), 1):
        old, values = (read(language, c, k, point.joints) for c in (content, new))
        tool = matrix(TOOLS[point.tool])
        if point.joints:
            q = np.array(values) * (1 if language == "urscript" else np.pi / 180)
        else:
            base = nominal.base.T @ matrix(BASES[point.base])
            assert np.allclose(pose_of(language, old), T, atol=2e-5)
            q = joints_of(nominal, base @ pose_of(language, values), tool, point.q)
        changed = np.abs(q - point.q).max()
        if changed < 2e-5:  # a target that is left, but for the rounding in the program
            continue
        wanted.append(held(nominal, point.q, tool))
        before.append(held(real, point.q, tool))
        after.append(held(real, q, tool))
    assert len(wanted) >= sum(fine) - 1
    w, b, a = (np.array(x) for x in (wanted, before, after))
    assert rigid_motion(w[:, :3, 3], b[:, :3, 3])[2].mean() > 3e-4
    R, _, rest = rigid_motion(w[:, :3, 3], a[:, :3, 3])
    assert rest.max() < 20e-6 + ROUNDING[language]
    turned = np.linalg.norm(a[:, :3, :3] - R @ w[:, :3, :3], axis=(1, 2)) / np.sqrt(2)
    oriented = sum(r.status == "OK" for r in result.results) if pose else 0
    assert sum(turned < 1e-4 + ROUNDING[language]) >= oriented - 1
    assert oriented >= 0.5 * len(points) * pose
    assert pose or np.median(turned) > 2e-4 + ROUNDING[language]
    outside(language, content, new)


def outside(language, content, new):
    """Every character that is not of a number is the same, line by line, and lines without targets are the same."""
    number = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|'B[01]+'"
    assert re.sub(number, b"0", content) == re.sub(number, b"0", new)
    old_lines, new_lines = content.splitlines(), new.splitlines()
    assert len(old_lines) == len(new_lines)
    targets = {"krl": rb"XP\d+=", "rapid": rb"target|MoveL \[", "urscript": rb"p\[|movej\(\[", "fanuc": rb"^\t"}
    for old, now in zip(old_lines, new_lines, strict=True):
        if not re.search(targets[language], old):
            assert old == now


def test_of_two_equal_quaternions_that_of_the_old_sign_is_written() -> None:
    for sign in (1.0, -1.0):
        assert Rapid().values(np.eye(4), sign * np.ones(7))[3:].tolist() == [sign, 0, 0, 0]
