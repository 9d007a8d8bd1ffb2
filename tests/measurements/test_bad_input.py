"""A table of bad inputs: each is refused with an InputError that says where, what, and what is allowed."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest

from casadical import (
    Body,
    FourBar,
    InputError,
    Joint,
    Measurements,
    Placement,
    Robot,
    from_table,
    identify,
    read_measurements,
)
from casadical.core.basics import FaultsError
from casadical.core.transforms import frame
from casadical.identification.plausibility import check_against
from casadical.measurements.columns import Source

N = 24
ARM = Robot(
    "arm",
    (
        Joint(d=0.4, lower=-2, upper=2),
        Joint(alpha=np.pi / 2, a=0.1, lower=-2, upper=2),
        Joint(a=0.5, lower=-2, upper=2),
    ),
    base=Placement(np.eye(4), "pose"),
    tool=Placement(frame(np.eye(3), np.array([0.4, 0.1, 0.05])), "position"),
)
LADEN = replace(ARM, joints=tuple(replace(joint, body=Body(5.0, np.zeros(3))) for joint in ARM.joints))
LOOPED = replace(ARM, loops=(FourBar(driven=3, carrier=2, crank=0.3, coupler=0.35, rocker=0.3),))


def table(**columns):
    """A good table of positions, with the given columns in place of its own (None takes one out)."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.5, 1.5, (N, 3))
    p = ARM.position.map(N)(q.T, ARM.parameters.values).full().T + 2e-5 * rng.normal(size=(N, 3))
    good = {f"q{i + 1}_deg": np.rad2deg(q[:, i]) for i in range(3)} | {
        f"{c}_mm": 1e3 * p[:, k] for k, c in enumerate("xyz")
    }
    return pd.DataFrame({k: v for k, v in (good | columns).items() if v is not None})


def changed(column, row, value):
    """The good table with one cell changed; row counts as in a file, the header being row 1."""
    t = table().astype(object)
    t.loc[row - 2, column] = value
    return t


def without_positions(**columns):
    return table(x_mm=None, y_mm=None, z_mm=None, **columns)


def read(t, joints=3, **options):
    return from_table(t, joints, source="bad.csv", **options)


def file(tmp_path, content):
    path = tmp_path / "bad.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_measurements(path, 3)


def check(t, robot=ARM, **options):
    check_against(robot, read(t, **options))


GOOD = read(table())
PAIRS = {"pose": range(1, N + 1), "other_pose": [*range(2, N + 1), 1], "distance_mm": np.linspace(200, 700, N)}
ANGLES = {"rx_deg": np.zeros(N), "ry_deg": np.zeros(N), "rz_deg": np.zeros(N)}
IDENTITY = {f"R{i}{j}": np.full(N, float(i == j)) for i in range(3) for j in range(3)}
QUATERNION = {"qw": np.ones(N), "qx": np.zeros(N), "qy": np.zeros(N), "qz": np.zeros(N)}


@dataclass(frozen=True)
class Bad:
    """What is done, and the pieces that the message must hold."""

    what: str
    act: Callable
    says: tuple[str, ...]


TABLES = [
    # files
    Bad("no such file", lambda tmp: read_measurements(tmp / "none.csv", 3), ("none.csv", "no such file")),
    Bad("empty file", lambda tmp: file(tmp, ""), ("bad.csv", "not a readable CSV")),
    Bad("ragged rows", lambda tmp: file(tmp, "a,b\n1,2\n1,2,3,4\n"), ("bad.csv", "row 3 has 4 cells", "2")),
    Bad("a quote without end", lambda tmp: file(tmp, 'q1_deg,q2_deg\n1,2\n"3,4\n'),
        ("bad.csv", "row 3", "correct its quotes")),
    Bad("not text", lambda tmp: file(tmp, b"a,b\n\xff\xfe\x00\x81,2\n"), ("bad.csv", "not a readable CSV")),
    Bad("header only", lambda tmp: file(tmp, "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm\n"), ("bad.csv", "no rows")),
    # columns
    Bad("a joint missing", lambda _: read(table(q2_deg=None)), ("bad.csv", "q2_deg or q2_rad is missing", "q3_deg")),
    Bad("too many joints", lambda _: read(table(q4_deg=np.zeros(N))), ("'q4_deg'", "only 3 joints")),
    Bad("one joint, two units", lambda _: read(table(q1_rad=np.zeros(N))), ("q1_deg and q1_rad", "keep one")),
    Bad("joint without unit", lambda _: read(table(q1_deg=None, q1=np.zeros(N))),
        ("q1_deg or q1_rad is missing", "q1")),
    Bad("nothing observed", lambda _: read(without_positions()), ("no observation", "x_mm", "distance_mm", "point")),
    Bad("a coordinate missing", lambda _: read(table(y_mm=None)), ("y_mm or y_m is missing", "x_mm")),
    Bad("a coordinate, two units", lambda _: read(table(x_m=np.zeros(N))), ("x_mm and x_m", "keep one")),
    Bad("renamed from nothing", lambda _: read(table(), columns={"x_mm": "X"}), ("'X'", "'x_mm'", "is missing")),
    Bad("unknown kind", lambda _: read(table(), kind="velocity"), ("'velocity'", "allowed: pose, corners")),
    Bad("no joints", lambda _: read(table(), 0), ("joints 0", "allowed")),
    # cells
    Bad("a word", lambda _: read(changed("y_mm", 5, "12,7")), ("row 5", "'y_mm'", "'12,7'", "not a finite number")),
    Bad("truth values", lambda tmp: file(tmp, table(q1_deg=np.arange(N) % 2 == 0).to_csv(index=False)),
        ("row 2", "'q1_deg'", "True is not a finite number")),
    Bad("truth values times a factor", lambda _: read(table(z_mm=None, up=np.ones(N, bool)),
        columns={"z_mm": Source("up", times=1e3)}), ("row 2", "'z_mm'", "not a finite number")),
    Bad("an empty cell", lambda _: read(changed("q3_deg", 9, np.nan)), ("row 9", "'q3_deg'", "an empty cell")),
    Bad("a direction that is none", lambda _: read(table(approach2=np.full(N, 0.5))),
        ("row 2", "'approach2'", "0.5 is not possible", "allowed: -1 or 1")),
    Bad("kelvin", lambda _: read(table(temperature_degC=np.full(N, 293.0))),
        ("row 2", "'temperature_degC'", "293 is not possible", "-273.15 to 200")),
    Bad("a negative weight", lambda _: read(table(weight=[1.0] * 7 + [-2] + [1.0] * (N - 8))),
        ("row 9", "'weight'", "-2", "zero or more")),
    Bad("no weight at all", lambda _: read(table(weight=np.zeros(N))), ("'weight'", "zero in every row")),
    Bad("sigma of zero", lambda _: read(table(), sigma_mm=0.0), ("sigma is 0", "positive")),
    # units
    Bad("degrees as radians", lambda _: read(table(q2_rad=table().q2_deg, q2_deg=None)),
        ("'q2_rad'", "turns", "degrees?", "q2_deg")),
    Bad("radians as degrees",
        lambda _: read(table(**{c: np.deg2rad(table()[c]) for c in ("q1_deg", "q2_deg", "q3_deg")})),
        ("no joint moves by more than", "radians?", "q1_rad")),
    Bad("one pose again and again", lambda _: read(table(q1_deg=np.ones(N), q2_deg=np.ones(N), q3_deg=np.ones(N))),
        ("no joint moves by more than 0.00 deg", "measure poses that differ")),
    Bad("grams as kilograms", lambda _: check(table(payload_kg=np.full(N, 2000.0)), LADEN),
        ("row 2", "'payload_kg'", "2000 kg is too heavy", "up to 150, of an arm of 15 kg", "grams?")),
    Bad("far too many turns", lambda _: read(changed("q1_deg", 4, 4000.0)),
        ("row 4", "'q1_deg'", "4000 deg", "11.1 turns")),
    Bad("millimetres as metres", lambda _: check(table().rename(columns=lambda c: c.replace("_mm", "_m"))),
        ("bad.csv", "spread over", "the robot reaches", "millimetres?", "x_mm")),
    Bad("pair distances in metres as mm",
        lambda _: check(without_positions(**PAIRS | {"distance_mm": PAIRS["distance_mm"] / 1e3})),
        ("bad.csv", "distances up to", "the robot, which reaches", "distance_m?")),
    Bad("distances in mm as metres", lambda _: check(without_positions(distance_m=np.linspace(200, 700, N))),
        ("bad.csv", "distances up to 700 m", "distance_mm?")),
    # orientations
    Bad("no rotation", lambda _: read(table(**IDENTITY | {"R11": np.full(N, 0.9)})),
        ("row 2", "'R00' to 'R22'", "orthonormal")),
    Bad("quaternion too long", lambda _: read(table(**QUATERNION | {"qx": np.r_[np.zeros(N - 1), 1.0]})),
        (f"row {N + 1}", "1.414", "unit quaternions")),
    Bad("an angle missing", lambda _: read(table(**{**ANGLES, "ry_deg": None})), ("ry_deg or ry_rad is missing",)),
    # distances and contacts
    Bad("a negative distance", lambda _: read(without_positions(distance_mm=np.r_[np.full(N - 1, 300), -4.0])),
        (f"row {N + 1}", "'distance'", "-4 mm", "positive")),
    Bad("other pose nowhere", lambda _: read(without_positions(**PAIRS | {"other_pose": [*range(2, N + 1), 99]})),
        (f"row {N + 1}", "'other_pose'", "99 is no pose", "allowed")),
    Bad("other pose the same", lambda _: read(without_positions(**PAIRS | {"other_pose": [*range(2, N + 1), N]})),
        (f"row {N + 1}", "'other_pose'", "24 is that pose itself")),
    Bad("a pose's number twice", lambda _: read(without_positions(**PAIRS | {"pose": [1, *range(1, N)]})),
        ("row 2", "'pose'", "1 occurs again in row 3")),
    Bad("no point named", lambda _: read(without_positions(), kind="contact"), ("'point' is missing", "touches")),
    Bad("a point's name empty", lambda _: read(without_positions(point=["A"] * 9 + [None] + ["B"] * (N - 10))),
        ("row 11", "'point' is empty")),
    Bad("every point touched once", lambda _: read(without_positions(point=[f"P{k}" for k in range(N)])),
        ("'point'", "no point is touched twice")),
    Bad("a separation to nowhere",
        lambda _: read(without_positions(point=["A", "B"] * 12)).with_separations([("A", "C", 0.1)]),
        ("'A' - 'C'", "no pose touches 'C'", "A, B")),
    Bad("a separation of nothing",
        lambda _: read(without_positions(point=["A", "B"] * 12)).with_separations([("A", "B", 0.0)]),
        ("'A' - 'B'", "0 mm", "positive")),
    # against the robot
    Bad("another robot's joints", lambda _: check(table(q3_deg=None), joints=2),
        ("2 joint columns", "arm has 3 joints")),
    Bad("out of range", lambda _: check(changed("q2_deg", 8, 130.0)),
        ("row 8", "'q2': 130 deg", "[-114.592, 114.592]")),
    Bad("an open loop", lambda _: check(table(), LOOPED), ("row", "four-bar cannot close", "signs and zeros")),
    # splits
    Bad("a set of nothing", lambda _: GOOD.split({"identify": 0.5, "report": 0}),
        ("cannot be taken", "positive sizes")),
    # arguments of Measurements and identify
    Bad("lengths differ", lambda _: replace(GOOD, position=GOOD.position[:5]),
        ("position has shape (5, 3)", "(24, 3)")),
    Bad("flat readings", lambda _: Measurements(q=np.zeros(5), kind="position"),
        ("q has shape (5,)", "(poses, joints)")),
    Bad("nothing measured", lambda _: Measurements(q=np.zeros((5, 3)), kind="pose"), ("kind 'pose' needs position",)),
    Bad("not a number inside", lambda _: replace(GOOD, q=GOOD.q * np.nan), ("row 2", "q is", "finite")),
    Bad("no pose chosen", lambda _: GOOD[np.zeros(N, bool)], ("no poses",)),
    Bad("too few numbers", lambda _: identify(ARM, GOOD[:5]),
        ("15 numbers were measured", "unknown", "fewer parameters")),
    Bad("no measurements", lambda _: identify(ARM, []), ("an empty list", "from_table")),
    Bad("a table, not measurements", lambda _: identify(ARM, [table()]), ("DataFrame", "from_table")),
    Bad("unknown parameter", lambda _: identify(ARM, GOOD, ["theta9"]), ("'theta9'", "groups:", "theta3")),
    Bad("nothing free", lambda _: identify(ARM, GOOD, []), ("chooses no parameter of arm", "groups:")),
    Bad("unknown loss", lambda _: identify(ARM, GOOD, loss="cauchy"), ("'cauchy'", "linear, huber, soft_l1")),
    Bad("unknown method", lambda _: identify(ARM, GOOD, method="XM"), ("'XM'", "KM, SKCM")),
    # robots
    Bad("limits turned round", lambda _: Robot("r", (Joint(lower=1, upper=-1),)), ("joint 1", "[1, -1]", "below")),
    Bad("negative compliance", lambda _: Robot("r", (Joint(compliance=-1e-6),)), ("joint 1", "-1e-06", "zero or more")),
    Bad("unknown joint", lambda _: Robot("r", (Joint(kind="ball"),)), ("'ball'", "revolute, prismatic")),
    Bad("a loop backwards", lambda _: replace(ARM, loops=(FourBar(2, 3, 0.3, 0.5, 0.3),)),
        ("carrier = 3", "driven = 2", "before")),
    Bad("no such value", lambda _: ARM.with_values({"a7": 0.1}), ("'a7'", "there are", "a1")),
]  # fmt: skip


@pytest.mark.parametrize("bad", TABLES, ids=[b.what for b in TABLES])
def test_refused_with_words(bad, tmp_path):
    with pytest.raises(InputError) as refused:
        bad.act(tmp_path)
    message = str(refused.value)
    missing = [piece for piece in bad.says if piece not in message]
    assert not missing, f"{message!r} lacks {missing}"


def test_the_good_ones_pass():
    """Each bad table is bad for its one change alone."""
    check_against(ARM, GOOD)
    assert {read(table(**columns)).kind for columns in (ANGLES, IDENTITY, QUATERNION)} == {"pose"}
    check(without_positions(**PAIRS))
    check(without_positions(distance_mm=np.linspace(200, 700, N)))
    check(without_positions(point=["A", "B"] * 12))
    check(table(payload_kg=np.linspace(0, 3, N), remark=["fine"] * N, empty=[None] * N))
    assert identify(ARM, GOOD, ["kinematic"]).is_optimal()
    assert len(TABLES) >= 30
    assert len({b.what for b in TABLES}) == len(TABLES)


def test_every_fault_of_cells_and_of_limits_is_told_at_once():
    """Each column's faults are one, with all rows, the worst reading first."""
    words = changed("q1_deg", 4, "lost").assign(q3_deg=lambda t: [*t.q3_deg[:-1], None], payload_kg=-1.0)
    with pytest.raises(FaultsError) as refused:
        read(words)
    assert [(f.rows[0], f.column, f.value) for f in refused.value.faults] == [
        (4, "q1_deg", "'lost'"), (N + 1, "q3_deg", "an empty cell or n/a"), (2, "payload_kg", "-1"),
    ]  # fmt: skip
    far = table().assign(q1_deg=[130.0, 10, 150, *[20.0] * (N - 3)], q3_deg=[*[5.0] * (N - 1), -120.0])
    with pytest.raises(FaultsError) as refused:
        check(far)
    first, second = refused.value.faults
    assert (first.rows, first.column, first.value) == ((4, 2), "q1", "150 deg")
    assert (second.rows, second.column, second.allowed) == ((N + 1,), "q3", "[-114.592, 114.592] deg")
    assert pickle.loads(pickle.dumps(refused.value)).faults == (first, second)


@pytest.mark.parametrize("end", [-2.0, 2.0])
def test_a_reading_beyond_either_end_is_refused_and_one_at_the_end_is_not(end: float) -> None:
    """A file's digits may round a reading past its limit; a robot sent to the limit stops a little beyond it."""
    good = from_table(table(), joints=3)
    q = good.q.copy()
    q[5, 1] = end * (1 + 0.8e-3)
    check_against(ARM, replace(good[5:6], q=q[5:6]))
    q[5, 1] = end * 1.0015
    with pytest.raises(InputError, match=r"'q2': .*outside of the joint's range"):
        check_against(ARM, replace(good[5:6], q=q[5:6]))
