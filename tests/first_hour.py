"""Tables as new users bring them: made up by plain numpy, with nothing of casadical in them."""

import io
from pathlib import Path
from typing import Any

import numpy as np

# A six-axis arm that is not among the project's: modified DH rows alpha [deg], a [mm], d [mm], theta [deg].
ROWS = np.array(
    [
        [0, 0, 486.5, 0],
        [-90, 150, 0, -90],
        [0, 700, 0, 0],
        [-90, 110, 678.8, 0],
        [90, 0, 0, 0],
        [-90, 0, 135, 0],
    ],
    dtype=float,
)
LIMITS = np.array([[-165, 165], [-90, 130], [-150, 60], [-180, 180], [-115, 115], [-250, 250]], dtype=float)
DH = "joint,alpha_deg,a_mm,d_mm,theta_deg,lower_deg,upper_deg\n" + "".join(
    f"{k},{alpha:g},{a:g},{d:g},{theta:g},{low:g},{high:g}\n"
    for k, ((alpha, a, d, theta), (low, high)) in enumerate(zip(ROWS, LIMITS, strict=True), 1)
)
TOOL = np.array([62.0, -35.0, 148.0])


def urdf() -> str:
    """The arm as a URDF without masses, its flange as the tip: Rx(alpha) Tx(a) Tz(d) Rz(theta) before each joint."""
    parts, parent = [], "base"
    for k, ((alpha, a, d, theta), (low, high)) in enumerate(zip(ROWS, LIMITS, strict=True), 1):
        ca, sa, ct, st = (f(np.deg2rad(v)) for v in (alpha, theta) for f in (np.cos, np.sin))
        R = np.array([[ct, -st, 0], [st * ca, ct * ca, -sa], [st * sa, ct * sa, ca]])
        rpy = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0]), np.arctan2(R[1, 0], R[0, 0])
        xyz = np.array([a, -sa * d, ca * d]) / 1e3
        parts.append(
            f'<link name="link{k}"/><joint name="joint{k}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="{" ".join(map(repr, map(float, xyz)))}" '
            f'rpy="{" ".join(map(repr, map(float, rpy)))}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{np.deg2rad(low)}" upper="{np.deg2rad(high)}" effort="1" velocity="1"/></joint>'
        )
        parent = f"link{k}"
    return f'<robot name="first_hour"><link name="base"/>{"".join(parts)}</robot>\n'


def positions(q: np.ndarray, rows: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """Positions, shape (n, 3) [mm], for readings q, shape (n, 6) [deg], by modified DH rows.

    tool : shape (3,) or (n, 3) [mm]
    """
    found = []
    for reading, point in zip(q, np.broadcast_to(tool, (len(q), 3)), strict=True):
        T = np.eye(4)
        for (alpha, a, d, theta), angle in zip(rows, reading, strict=True):
            ca, sa = np.cos(np.deg2rad(alpha)), np.sin(np.deg2rad(alpha))
            ct, st = np.cos(np.deg2rad(theta + angle)), np.sin(np.deg2rad(theta + angle))
            T = T @ np.array(
                [[ct, -st, 0, a], [st * ca, ct * ca, -sa, -sa * d], [st * sa, ct * sa, ca, ca * d], [0, 0, 0, 1]]
            )
        found.append((T @ [*point, 1.0])[:3])
    return np.array(found)


def measured(n: int = 90, seed: int = 0, tool: np.ndarray = TOOL, noise: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """Readings [deg] and tracker positions [mm] of an arm that departs from its drawing by some tenths."""
    rng = np.random.default_rng(seed)
    rng.normal(size=ROWS.shape)  # drawn by `_seen`
    q = np.round(rng.uniform(0.8 * LIMITS[:, 0], 0.8 * LIMITS[:, 1], (n, 6)), 4)
    return q, _seen(q, tool, seed) + rng.normal(0, noise, (n, 3))


def _seen(q: np.ndarray, tool: np.ndarray, seed: int) -> np.ndarray:
    """Positions in the tracker's frame, without noise."""
    rows = ROWS + np.random.default_rng(seed).normal(0, 1, ROWS.shape) * [0.03, 0.4, 0.4, 0.04]
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return positions(q, rows, tool) @ turn.T + [2400.0, -900.0, 310.0]


NEST = np.array([[62.0, -35.0, 148.0], [-60.0, 20.0, 150.0], [10.0, 90.0, 120.0]])


def nested(poses: int = 25, seed: int = 0, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three reflectors at every pose, readings that differ by 0.002 deg: readings, positions, and which reflector."""
    rng = np.random.default_rng(seed)
    base, _ = measured(poses, seed)
    which = np.concatenate([rng.permutation(3) for _ in range(poses)])
    q = np.round(np.repeat(base, 3, axis=0) + rng.uniform(-0.002, 0.002, (3 * poses, 6)), 4)
    return q, _seen(q, NEST[which], seed) + rng.normal(0, noise, q[:, :3].shape), which


def table(
    names: list[str],
    q: np.ndarray,
    p: np.ndarray,
    separator: str = ",",
    decimal: str = ".",
    first: str = "",
    top: str = "",
) -> str:
    """Text of a table: a first column that counts under the name `first`, then readings, then positions."""
    lines = [top + separator.join([first, *names] if first else names)]
    for k, row in enumerate(np.column_stack([q, p]), 1):
        cells = [f"{value:.4f}".replace(".", decimal) for value in row]
        lines.append(separator.join([str(k), *cells] if first else cells))
    return "\n".join(lines) + "\n"


def _german(q: np.ndarray, p: np.ndarray) -> bytes:
    names = [f"Achse {k} [°]" for k in range(1, 7)] + [f"Messwert {c} [mm]" for c in "XYZ"]
    top = "Protokoll Lasertracker\nDatum;21.11.2026\n\n"
    return table(names, q, p, ";", ",", "Punkt Nr.", top).replace("\n", "\r\n").encode("cp1252")


def _german_units(q: np.ndarray, p: np.ndarray) -> bytes:
    names = [f"Gelenkwinkel {k}" for k in range(1, 7)] + [f"Ist {c}" for c in "XYZ"] + [f"Soll {c}" for c in "XYZ"]
    lines = table(names, q, np.column_stack([p, np.round(p)]), ";", ",").splitlines()
    return "\n".join([lines[0], ";".join(["Grad"] * 6 + ["mm"] * 6), *lines[1:]]).encode("utf-16")


def _chinese(q: np.ndarray, p: np.ndarray) -> bytes:
    names = [f"关节{k}角度(度)" for k in range(1, 7)] + [f"{c}坐标(毫米)" for c in "XYZ"]
    return table(names, q, p, first="序号").encode("gb18030")


def _japanese(q: np.ndarray, p: np.ndarray) -> bytes:
    names = [f"第{k}軸(度)" for k in range(1, 7)] + [f"{c}座標 実測値(mm)" for c in "XYZ"]
    return table(names, q, p, "\t", first="番号").encode("cp932")


def _french(q: np.ndarray, p: np.ndarray) -> bytes:
    names = [f"Axe {k} (degrés)" for k in range(1, 7)] + [f"Coordonnée {c} mesurée (mm)" for c in "XYZ"]
    return table(names, q, p, ";", ",").encode("cp1252")


def _italian(q: np.ndarray, p: np.ndarray) -> bytes:
    """A language that is not known: the numbers of the joints tell which columns are the readings."""
    names = [f"Asse {k} [gradi]" for k in range(1, 7)] + [f"Misurato {c} [mm]" for c in "XYZ"]
    return table(names, q, p, ";", ",").encode("cp1252")


def _spatial_analyzer(q: np.ndarray, p: np.ndarray) -> bytes:
    """Comments with the units and the headings, collection, group and point, lengths in inches."""
    lines = ["// Spatial Analyzer export", "// Units: Inches", "// Active frame: A::World"]
    lines.append("// Collection, Group, Point, X, Y, Z, " + ", ".join(f"J{k} (deg)" for k in range(1, 7)))
    for k, (reading, point) in enumerate(zip(q, p, strict=True), 1):
        values = [*(f"{v / 25.4:.6f}" for v in point), *(f"{v:.4f}" for v in reading)]
        lines.append(", ".join(["A", "Robot", f"p{k}", *values]))
    return ("\n".join(lines) + "\n").encode()


def _polyworks(q: np.ndarray, p: np.ndarray) -> bytes:
    """Groups of columns over their names, nominal and measured and deviation, and a last line that is no row."""
    lines = ["Object Name\tNominal\t\t\tMeasured\t\t\tDeviation\t\t\tRobot" + "\t" * 5]
    lines.append("\t".join(["", *"XYZ", *"XYZ", *"XYZ", *(f"A{k}" for k in range(1, 7))]))
    for k, (reading, point) in enumerate(zip(q, p, strict=True), 1):
        nominal = np.round(point)
        cells = [f"{v:.4f}" for v in (*nominal, *point, *(point - nominal), *reading)]
        lines.append("\t".join([f"point {k}", *cells]))
    return ("\n".join([*lines, "End of report"]) + "\n").encode()


def _workbook(q: np.ndarray, p: np.ndarray) -> bytes:
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "Notes"
    sheet.append(["Measured by two people"])
    sheet = book.create_sheet("Poses")
    sheet.append(["Campaign 7"])
    sheet.append([])
    sheet.append([*(f"Joint {k} [rad]" for k in range(1, 7)), *(f"{c} [m]" for c in "xyz")])
    for row in np.column_stack([np.deg2rad(q), p / 1e3]):
        sheet.append([float(v) for v in row])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def _researcher(q: np.ndarray, p: np.ndarray) -> bytes:
    """As numpy.savetxt writes it: blanks, joints from 0 on, radians and metres that nothing states."""
    out = io.StringIO()
    names = [f"joint_{k}" for k in range(6)] + list("xyz")
    np.savetxt(out, np.column_stack([np.deg2rad(q), p / 1e3]), header=" ".join(names))
    return out.getvalue().encode()


def _no_headings(q: np.ndarray, p: np.ndarray) -> bytes:
    return "\n".join(table(["-"], q, p).splitlines()[1:]).encode()


TABLES = {
    "messung.csv": _german,
    "einheiten.csv": _german_units,
    "chinese.csv": _chinese,
    "japanese.txt": _japanese,
    "mesures.csv": _french,
    "misure.csv": _italian,
    "spatial_analyzer.txt": _spatial_analyzer,
    "polyworks.txt": _polyworks,
    "poses.xlsx": _workbook,
    "researcher.txt": _researcher,
    "no_headings.csv": _no_headings,
}


def given(folder: Path, table: Any) -> dict[str, Path]:
    """The arm's DH table and a table of poses, a text or a data frame, as files; arguments of `new_problem`."""
    (folder / "dh.csv").write_text(DH)
    (folder / "table.csv").write_text(table if isinstance(table, str) else table.to_csv(index=False))
    return {"dh": folder / "dh.csv", "data": folder / "table.csv"}


def write(folder: Path, name: str, q: np.ndarray, p: np.ndarray) -> Path:
    """One of the tables as a file, beside the arm's DH table."""
    (folder / "dh.csv").write_text(DH)
    (folder / name).write_bytes(TABLES[name](q, p))
    return folder / name
