"""Tables in the forms that people have: every one is read as the poses that were measured."""

from collections.abc import Callable
from pathlib import Path

import first_hour
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from casadical.project.new import new_problem
from casadical.project.problem import read_campaign, read_problem

ROWS = 30


def poses() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Readings [deg], positions [mm] and orientations (n, 3, 3) of a tool, by plain numpy."""
    q, p = first_hour.measured(ROWS)
    tips = [first_hour.measured(ROWS, tool=first_hour.TOOL + 1000 * e, noise=0.0)[1] for e in np.eye(3)]
    R = np.stack([(tip - first_hour.measured(ROWS, noise=0.0)[1]) / 1000 for tip in tips], axis=2)
    return q, p, R @ Rotation.from_euler("xyz", [70, -40, 130], degrees=True).as_matrix()


Q, P, R = poses()
# Homogeneous matrices (n, 4, 4) [mm], and those of 3x4 numbers.
T = np.zeros((ROWS, 4, 4))
T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, P, 1
J = [f"j{k}" for k in range(1, 7)]
NUMBERS = np.random.default_rng(3).permutation(np.arange(100, 100 + ROWS))[:, None]
QUATERNION = Rotation.from_matrix(R).as_quat()


def indices(name: str, rows: int, columns: int, first: int = 0) -> list[str]:
    return [name.format(i, j) for i in range(first, first + rows) for j in range(first, first + columns)]


def grid(names: list[str], values: np.ndarray) -> str:
    return pd.DataFrame(np.hstack([Q, values.reshape(ROWS, -1)]), columns=[*J, *names]).to_csv(index=False)


def bare(*parts: np.ndarray, sep: str = ",") -> str:
    return pd.DataFrame(np.hstack([part.reshape(ROWS, -1) for part in parts])).to_csv(
        sep=sep, index=False, header=False
    )


def motive(*lines: str, still: bool = False) -> str:
    """A table of Motive: lines of groups, rigid bodies one beside the other, readings behind them."""
    stand = np.hstack([np.tile([0.1, 0.2, 0.3, 0.927], (ROWS, 1)), np.tile([50.0, 60, 70], (ROWS, 1))])
    bodies = [stand + np.random.default_rng(4).normal(0, 1e-4, stand.shape)] * still + [np.hstack([QUATERNION, P])]
    table = np.hstack([np.arange(ROWS)[:, None], *(np.hstack([b, np.full((ROWS, 1), 0.2)]) for b in bodies), Q])
    heads = [*lines, "Frame," + "X,Y,Z,W,X,Y,Z,," * len(bodies) + ",".join(f"J{k}" for k in range(1, 7))]
    return "\n".join([*heads, pd.DataFrame(table).to_csv(index=False, header=False)])


GROUPS = "Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,"
FORMS: dict[str, Callable[[], str]] = {
    "T03": lambda: grid(indices("T{}{}", 4, 4), T),
    "r14": lambda: grid(indices("r{}{}", 3, 4, 1), T[:, :3]),
    "M_1_4": lambda: grid(indices("M_{}_{}", 4, 4, 1), T),
    "T[0,3]": lambda: grid([f'"{n}"'.strip('"') for n in indices("T[{},{}]", 3, 4)], T[:, :3]),
    "base_T_tip.03": lambda: grid(indices("base_T_tip.{}{}", 4, 4), T),
    "transposed": lambda: grid(indices("H{}{}", 4, 4), T.transpose(0, 2, 1)),
    "4x3": lambda: grid(indices("m{}{}", 4, 3), T.transpose(0, 2, 1)[:, :, :3]),
    "noap": lambda: grid([f"{c}{x}" for c in "noap" for x in "xyz"], T[:, :3].transpose(0, 2, 1)),
    "m0 to m15": lambda: grid([f"m{k}" for k in range(16)], T),
    "pose1 to pose12 by columns": lambda: grid([f"pose{k}" for k in range(1, 13)], T[:, :3].transpose(0, 2, 1)),
    "rotation, then position": lambda: grid([f"pose{k}" for k in range(1, 13)], np.hstack([R.reshape(-1, 9), P])),
    "bare: 4x4": lambda: bare(Q, T),
    "bare: radians, 3x4 in front": lambda: bare(T[:, :3], np.deg2rad(Q)),
    "bare: 4x4 by columns, numbered": lambda: bare(NUMBERS, Q, T.transpose(0, 2, 1), sep="\t"),
    "bare: numbers, readings, positions": lambda: bare(NUMBERS, Q, P),
    "bare: positions in m, readings": lambda: bare(P / 1e3, Q, sep=" "),
    "bare: positions, quaternions, readings": lambda: bare(P, QUATERNION, Q),
    "bare: readings, positions, rotation vectors": lambda: bare(Q, P / 1e3, Rotation.from_matrix(R).as_rotvec()),
    "bare: readings, positions, a deviation": lambda: bare(Q, P, NUMBERS / 7.0),
    "Motive, two lines": lambda: motive("," + GROUPS),
    "Motive, a heading a group": lambda: motive(",Rotation,,,,Position,,,Mean Marker Error,"),
    "Motive, six lines, two bodies": lambda: motive(
        "Format Version,1.23,Take Name,Take 1,Rotation Type,Quaternion,Length Units,Millimeters",
        "",
        "Type" + ",Rigid Body" * 16,
        "Name" + ",Stand" * 8 + ",Gripper" * 8,
        "ID" + ",A1F0" * 8 + ",B2E7" * 8,
        "," + 2 * GROUPS,
        still=True,
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_form_is_read_as_it_was_measured(form: str, tmp_path: Path) -> None:
    (tmp_path / "dh.csv").write_text(first_hour.DH)
    (tmp_path / "table.csv").write_text(FORMS[form]())
    arm = tmp_path / "arm"
    new_problem(
        arm, dh=tmp_path / "dh.csv", data=tmp_path / "table.csv", ask=lambda question: pytest.fail(question.text)
    )
    m = read_campaign(arm, arm / "poses.csv", read_problem(arm).robot)
    np.testing.assert_allclose(np.rad2deg(m.q), Q, atol=1e-4)
    assert m.position is not None
    np.testing.assert_allclose(1e3 * m.position, P, atol=1e-3)
    if "positions," in form.replace("positions, a", "") or "position" not in form:
        assert m.orientation is not None
        np.testing.assert_allclose(m.orientation, R, atol=1e-5)
