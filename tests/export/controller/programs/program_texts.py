"""Programs of the four languages written and read by the tests: none of it comes from the package.

Orientations are scipy's, postures are drawn from the plane of the arm, and numbers are found again by patterns.
"""

import re
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from casadical.robot.robot import Robot

TOOLS = ((20.0, -35.0, 210.0, 10.0, 20.0, -30.0), (0.0, 60.0, 150.0, 0.0, -45.0, 5.0))  # x y z mm, roll pitch yaw deg
BASES = ((900.0, -200.0, 150.0, 1.0, -2.0, 35.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
JUNK = {
    "krl": [
        "; PTP {A1 1,A2 2} Größe µ",
        "WAIT SEC 0.5",
        '$OUT[3]=TRUE  ;"{X 1}"',
        "  IF A==2 THEN",
        "",
        "\t$VEL.CP=0.2",
    ],
    "rapid": ["! MoveL p99", "WaitTime 0.5;", 'TPWrite "robtarget p9:=[[1,2,3]]";', "IF a<>2 THEN", "", "\tSet do1;"],
    "urscript": [
        "# movej([1,2])",
        "sleep(0.5)",
        'popup("movel(p[1])")',
        "if (a == 2):",
        "",
        "\tset_digital_out(1, True)",
    ],
    "fanuc": ["  !P[9]{ ;", "  WAIT   .50(sec) ;", "  R[1]=R[1]+1 ;", "  IF R[1]=2,JMP LBL[1] ;", "   ;", "  LBL[2] ;"],
}


# What must be refused by its line, wherever it stands among the motions.
REDEFINED = {
    "krl": ["TOOL_DATA[1]={X 1,Y 2,Z 3,A 0,B 0,C 0}", "BASE_DATA[2]={X 1,Y 2,Z 3,A 0,B 0,C 0}"],
    "rapid": ["t0.tframe.trans.z:=5;", "w1.uframe.trans.x:=5;"],
    "urscript": ["set_tcp(p[0, 0, 0.2, 0, 0, 0])"],
    "fanuc": ["  UTOOL[1]=PR[3] ;", "  UFRAME[2]=PR[4] ;"],
}
OTHER_UNITS = {
    "urscript": ["movej([0, -90, 90, 0, 0, 0])", "movel(p[350, 0, 200, 0, 3.14, 0])"],
    "fanuc": ["P[99]{\n   GP1:\n\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX = 50.000 inch,\tY = 1.000 mm,"
              "\tZ = 1200.000 mm,\n\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg\n};"],
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Point:
    """A target as it was drawn: joints, whether it is written as joints, numbers of tool and base."""

    q: np.ndarray
    joints: bool
    tool: int
    base: int


def matrix(values) -> np.ndarray:
    """Transform [m] of x y z mm, roll pitch yaw deg about fixed axes."""
    T = np.eye(4)
    T[:3, 3] = np.array(values[:3]) / 1e3
    T[:3, :3] = Rotation.from_euler("xyz", values[3:], degrees=True).as_matrix()
    return T


def held(robot: Robot, q: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """Pose of a tool at the end of the last link in the measuring frame, (4, 4), by the robot's own model."""
    p, R = robot.pose(q, robot.parameters.values)
    end = np.eye(4)
    end[:3, 3], end[:3, :3] = p.full()[:, 0], R.full()
    return end @ np.linalg.inv(robot.tool.T) @ tool


def joints_of(robot: Robot, T: np.ndarray, tool: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Joints near to others with which a robot's tool has a pose, by scipy."""

    def off(q):
        now = held(robot, q, tool)
        turn = Rotation.from_matrix(now[:3, :3].T @ T[:3, :3]).as_rotvec()
        return np.concatenate([now[:3, 3] - T[:3, 3], 0.3 * turn])

    found = least_squares(off, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs(found.fun).max() < 1e-9
    return found.x


def sides(q: np.ndarray) -> tuple[bool, bool, bool]:
    """Behind, bent back and wrist negative of the KR 210, from its drawing in the plane of the arm (lengths in mm)."""
    a2, a3 = -q[1], -q[1] - q[2]
    elbow = np.array([350 + 1150 * np.cos(a2), 1150 * np.sin(a2)])
    along, across = np.array([np.cos(a3), np.sin(a3)]), np.array([-np.sin(a3), np.cos(a3)])
    wrist = elbow + 1200 * along + 41 * across
    upper, lower = elbow - [350, 0], wrist - elbow
    return bool(wrist[0] < 0), bool(upper[0] * lower[1] - upper[1] * lower[0] > 0), bool(q[4] < 0)


def quarter(angle: float) -> int:
    return int(np.floor(np.rad2deg(angle) / 90))


def write(language: str, points: list[Point], poses: list[np.ndarray], rng: np.random.Generator, end: str) -> bytes:
    """A program with these targets between lines of other things; poses : of each target in its base, (4, 4) [m]."""
    lines, moves, data = [], [], []
    for k, (point, T) in enumerate(zip(points, poses, strict=True), 1):
        one = WRITERS[language](k, point, T)
        moves += [*one[0], *([rng.choice(JUNK[language])] if rng.random() < 0.5 else [])]
        data += one[1]
    lines = LAYOUT[language](moves, data)
    return (end.join(lines) + end).encode("utf-8")


def loosened(language: str, content: bytes, rng: np.random.Generator) -> bytes:
    """The same program otherwise laid out: order of data, spaces, indents, comments, keywords, external axes."""
    text = content.decode("utf-8")
    end = "\r\n" if "\r\n" in text else "\n"
    lines = text.split(end)
    if language == "fanuc":
        head, _, tail = text.partition(f"/POS{end}")
        points = re.findall(r"P\[.*?};\r?\n", tail, flags=re.S)
        tail = "".join(rng.permutation(points)) + f"/END{end}"
        tail = re.sub(
            r"(GP2:\s+UF : 0, UT : 1,\s+J1=)   100.000", lambda m: f"{m[1]}{rng.uniform(-500, 500):10.3f}", tail
        )
        return f"{head}/POS{end}{re.sub(r' deg', lambda _: ' ' * rng.integers(1, 4) + 'deg', tail)}".encode()
    data = [k for k, line in enumerate(lines) if re.match(r"DECL|CONST", line)]
    for k, line in zip(data, [lines[i] for i in rng.permutation(data)], strict=True):
        lines[k] = line
    comment, known = {"krl": "; c,1", "rapid": "! c,1", "urscript": "# c,1"}[language], set(JUNK[language])
    for k, line in enumerate(lines):
        if not line or line.strip() in {w.strip() for w in known} or line[0] in "%&":
            continue
        line = re.sub(r",(?! )", lambda _: "," + " " * rng.integers(3), line)
        if language == "krl":
            line = re.sub(r"^(DECL E6\w+|PTP|LIN)\b", lambda m: m[0].lower() if rng.random() < 0.5 else m[0], line)
            line = re.sub(r"E1 0.0(?=, *E2)", f"E1 {rng.uniform(-500, 500):.3f}", line)
        if language == "rapid":
            line = re.sub(r"\[9E\+09", f"[{rng.uniform(-500, 500):.2f}", line)
        lines[k] = " " * rng.integers(5) + line + (f" {comment}" if rng.random() < 0.3 else "")
    return end.join(lines).encode("utf-8")


def with_line(language: str, content: bytes, extra: str, rng: np.random.Generator) -> tuple[bytes, int]:
    """The program with one more line somewhere among its motions (or FANUC positions), and the number of that line."""
    lines = content.decode("utf-8").splitlines()
    if extra.startswith("P["):
        at = next(k for k, line in enumerate(lines) if line.startswith("/POS")) + 1
    else:
        motion = re.compile(r"\s*(PTP XP|LIN XP|Move|movej|movel| *\d+:[JL])", re.IGNORECASE)
        moves = [k for k, line in enumerate(lines) if motion.match(line)]
        at = int(rng.choice(moves[1:]))
    number = "" if language != "fanuc" or extra.startswith("P[") else "   0:"
    return ("\n".join([*lines[:at], number + extra, *lines[at:]]) + "\n").encode(), at + 1


def _degrees(q) -> list[str]:
    return [f"{v:.6f}" for v in np.rad2deg(q)]


def _xyz(T) -> list[str]:
    return [f"{v:.4f}" for v in 1e3 * T[:3, 3]]


def krl(k: int, point: Point, T: np.ndarray) -> tuple[list[str], list[str]]:
    frames = f'DECL FDAT FP{k}={{TOOL_NO {point.tool + 1},BASE_NO {point.base + 1},IPO_FRAME #BASE,POINT2[] " "}}'
    outer = "E1 0.0,E2 0.0,E3 0.0"
    if point.joints:
        axes = ",".join(f"A{i} {v}" for i, v in enumerate(_degrees(point.q), 1))
        return [f"PTP XP{k} C_DIS"], [f"DECL E6AXIS XP{k}={{{axes},{outer}}}", frames]
    behind, back, negative = sides(point.q)
    status = behind + 2 * (not back) + 4 * negative
    turn = sum(1 << i for i in range(6) if point.q[i] < 0)
    abc = Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)
    named = zip("XYZABC", [*_xyz(T), *(f"{v:.6f}" for v in abc)], strict=True)
    words = f"S {status},T {turn}" if k % 2 else f"S 'B{status:03b}',T 'B{turn:06b}'"
    text = ",".join(f"{n} {v}" for n, v in named)
    return [f"LIN XP{k}"], [f"DECL E6POS XP{k}={{{text},{words},{outer}}}", frames]


def rapid(k: int, point: Point, T: np.ndarray) -> tuple[list[str], list[str]]:
    frames = f"t{point.tool}\\WObj:=w{point.base};"
    outer = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
    if point.joints:
        value = f"[[{','.join(_degrees(point.q))}],{outer}]"
        return [f"MoveAbsJ j{k}\\NoEOffs, v1000, z50, {frames}"], [f"CONST jointtarget j{k}:={value};"]
    behind, back, negative = sides(point.q)
    words = [quarter(point.q[i]) for i in (0, 3, 5)] + [4 * behind + 2 * back + negative]
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    rot = ",".join(f"{v:.9f}" for v in (w, x, y, z))
    value = f"[[{','.join(_xyz(T))}],[{rot}],[{','.join(map(str, words))}],{outer}]"
    if k % 3 == 0:
        return [f"MoveL {value}, v{k}, fine, {frames}"], []
    return [f"MoveL p{k}, v100\\T:=5, fine, {frames}"], [f"CONST robtarget p{k}:={value};"]


def urscript(k: int, point: Point, T: np.ndarray) -> tuple[list[str], list[str]]:
    joints = ", ".join(f"{v:.9f}" for v in point.q)
    if point.joints:
        return [f"movej([{joints}], a=1.4, v={k}.25)"], []
    vector = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    pose = ", ".join(f"{v:.9f}" for v in (*T[:3, 3], *vector))
    if k % 2:
        return [f"movej(get_inverse_kin(p[{pose}], qnear=[{joints}]), v={k}.25)"], []
    move = f"movel(W{k}_p, a=1.2, v=0.25) # W{k}"
    return [f"movej(get_inverse_kin(W{k}_p, qnear=W{k}_q), a=1)", move], [
        f"global W{k}_p=p[{pose}]",
        f"global W{k}_q=[{joints}]",
    ]


def fanuc(k: int, point: Point, T: np.ndarray) -> tuple[list[str], list[str]]:
    head = [f"P[{k}]{{" if k % 2 else f'P[{k}:"point"]{{', "   GP1:"]
    frames = f"\tUF : {point.base + 1}, UT : {point.tool + 1},"
    tail = ["   GP2:", "\tUF : 0, UT : 1,\t", "\tJ1=   100.000  mm", "};"]
    if point.joints:
        named = [f"J{i}= {v:9.3f} deg" for i, v in enumerate(np.rad2deg(point.q), 1)]
        return [f"J P[{k}] 100% FINE    ;"], [*head, frames + "\t", "\t" + ",\t".join(named[:3]) + ",",
                                              "\t" + ",\t".join(named[3:]), *tail]  # fmt: skip
    behind, back, negative = sides(point.q)
    turns = [int(np.floor((point.q[i] + np.pi) / (2 * np.pi))) for i in (0, 3, 5)]
    letters = f"{'N' if negative else 'F'} {'D' if back else 'U'} {'B' if behind else 'T'}"
    words = ", ".join([letters, *map(str, turns)])
    wpr = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
    place = [f"{n} = {v:9.3f}  mm" for n, v in zip("XYZ", 1e3 * T[:3, 3], strict=True)]
    turn = [f"{n} = {v:9.3f} deg" for n, v in zip("WPR", wpr, strict=True)]
    lines = [f"{frames}\t\tCONFIG : '{words}',", "\t" + ",\t".join(place) + ",", "\t" + ",\t".join(turn)]
    return [f"L P[{k}] 100mm/sec FINE    ;"], [*head, *lines, *tail]


def _zyx(values) -> str:
    return ",".join(f"{n} {v}" for n, v in zip("XYZABC", (*values[:3], *values[:2:-1]), strict=True))


def _wxyz(values) -> str:
    x, y, z, w = Rotation.from_matrix(matrix(values)[:3, :3]).as_quat()
    return f"[[{values[0]},{values[1]},{values[2]}],[{w:.12f},{x:.12f},{y:.12f},{z:.12f}]]"


def _krl_layout(moves, data):
    frames = [f"TOOL_DATA[{k}]={{{_zyx(v)}}}" for k, v in enumerate(TOOLS, 1)]
    frames += [f"BASE_DATA[{k}]={{{_zyx(v)}}}" for k, v in enumerate(BASES, 1)]
    return ["&ACCESS RVP", "&REL 3", "DEFDAT  PROG", *frames, *data, *moves, "ENDDAT"]


def _rapid_layout(moves, data):
    tools = [f"PERS tooldata t{k}:=[TRUE,{_wxyz(v)},[1,[0,0,1],[1,0,0,0],0,0,0]];" for k, v in enumerate(TOOLS)]
    zero = "[[0,0,0],[1,0,0,0]]"
    bases = [f'TASK PERS wobjdata w{k}:=[FALSE,TRUE,"",{_wxyz(v)},{zero}];' for k, v in enumerate(BASES)]
    return [
        "%%%",
        "  VERSION:1",
        "%%%",
        "MODULE PROG",
        *tools,
        *bases,
        *data,
        "PROC main()",
        *moves,
        "ENDPROC",
        "ENDMODULE",
    ]


def _urscript_layout(moves, data):
    vector = Rotation.from_matrix(matrix(TOOLS[0])[:3, :3]).as_rotvec()
    tcp = ", ".join(f"{v:.12f}" for v in (*np.array(TOOLS[0][:3]) / 1e3, *vector))
    return ["def prog():", f"  set_tcp(p[{tcp}])", *(f"  {line}" for line in (*data, *moves)), "end"]


def _fanuc_layout(moves, data):
    numbered = [f"{k:4d}:{line}" for k, line in enumerate(moves, 1)]
    return ["/PROG  PROG", "/ATTR", "/MN", *numbered, "/POS", *data, "/END"]


WRITERS = {"krl": krl, "rapid": rapid, "urscript": urscript, "fanuc": fanuc}
LAYOUT = {"krl": _krl_layout, "rapid": _rapid_layout, "urscript": _urscript_layout, "fanuc": _fanuc_layout}
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"


def read(language: str, content: bytes, k: int, joints: bool) -> list[float]:
    """The numbers of target k, in the order in which they stand."""
    text = content.decode("utf-8")
    if language == "krl":
        inside = re.search(rf"XP{k}={{(.*?)}}", text)[1]
        return [float(v) for v in re.findall(rf"\b(?:[XYZABC]|A\d) ({NUMBER})", inside)]
    if language == "rapid":
        if joints or k % 3:
            start = text.index(f"{'j' if joints else 'p'}{k}:=")
        else:  # every third pose is written in its motion
            start = re.search(rf"MoveL \[\[[^v]*, v{k},", text).start()
        inside = text[text.index("[[", start) :]
        return [float(v) for v in re.findall(NUMBER, inside)[: 6 if joints else 7]]
    if language == "urscript":
        marks = (
            rf"movej\(\[(.*?)\], a=1.4, v={k}\.25",
            rf"in\(p\[(.*?)\], qnear=\[.*?\]\), v={k}\.25",
            rf"W{k}_p=p\[(.*?)\]",
        )
        return [float(v) for v in re.search(marks[0 if joints else 2 - k % 2], text)[1].split(",")]
    inside = text[re.search(rf"^P\[{k}[:\]]", text, re.MULTILINE).start() :]
    names = r"J\d" if joints else "[XYZWPR]"
    return [float(v) for v in re.findall(rf"\b{names}\s*=\s*({NUMBER})", inside)[:6]]


def pose_of(language: str, values: list[float]) -> np.ndarray:
    """The transform [m] that a target's numbers mean."""
    if language == "krl":
        return matrix([*values[:3], *values[:2:-1]])
    if language == "fanuc":
        return matrix(values)
    T = np.eye(4)
    if language == "rapid":
        w, x, y, z = values[3:]
        T[:3, 3], T[:3, :3] = np.array(values[:3]) / 1e3, Rotation.from_quat([x, y, z, w]).as_matrix()
    else:
        T[:3, 3], T[:3, :3] = values[:3], Rotation.from_rotvec(values[3:]).as_matrix()
    return T
