"""Published drive parameters compared with those identified from logs, which may contradict them.

A set of parameters comes from an MJCF with actuators, from the table [drive] of a robot file, or
from a table with a row for each joint. Each set replays the withheld runs as the fit does. For
each parameter the verdict states whether the logs determine it, and if so, whether they contradict
the file.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.drive import read_drive
from casadical.core.reading import foreign, missing, read_text, read_xml
from casadical.core.reporting.blocks import Table
from casadical.diagnosis.motion.response import Response, fitted
from casadical.measurements.logs.log import JointLog
from casadical.robot.robot import Robot

# Names of the parameters of a set in tables and files: gain, dry friction, damping, rotor inertia,
# delay.
PARAMETERS = ("kp", "friction", "damping", "armature", "delay")
# Quantities that logs determine in place of each of them, as shown in tables, in the order of
# `Response.log_values`: friction F, damping b and inertia J divided by the gain.
RATIOS = ("kp [N m/rad]", "F/kp [mrad]", "b/kp [s]", "J/kp [s^2]", "delay [ms]")
UNITS = np.array([1.0, 1e3, 1.0, 1.0, 1e3])  # factors from SI to the units of `RATIOS`
# A quantity counts as determined if the standard deviation of its logarithm is below this, too.
MAX_DETERMINED_SIGMA = 0.5
SMALLEST = 1e-9  # value that replaces smaller ones in logarithms [SI]


@dataclass(frozen=True, eq=False)
class Arbitration:
    """Comparison of a published set of drive parameters with the response identified from logs.

    source : file of the set
    rms : rms of reading minus its replay in the held-out runs, shape (joints,) [rad]
    values : its values of `RATIOS`, shape (joints, 5), NaN where the file gives none
    low, high : 95 % interval identified from the logs, shape (joints, 5)
    verdicts : by joint and ratio "contradicted", "agrees", "not determined", or "" without a value
    """

    source: str
    rms: Array
    values: Array
    low: Array
    high: Array
    verdicts: tuple[tuple[str, ...], ...]

    def count(self, verdict: str) -> int:
        """Return the number of parameters of all joints with this verdict."""
        return sum(row.count(verdict) for row in self.verdicts)

    def plain(self, joints: Sequence[str]) -> dict[str, object]:
        """Return the comparison for JSON, with the keys file, rms_rad and parameters.

        Each parameter has joint, parameter, value, low, high and verdict. joints : their names
        """
        rows = [
            {
                "joint": joint,
                "parameter": name,
                "value": None if np.isnan(self.values[j, k]) else float(self.values[j, k]),
                "low": float(self.low[j, k]),
                "high": float(self.high[j, k]),
                "verdict": self.verdicts[j][k],
            }
            for j, joint in enumerate(joints)
            for k, name in enumerate(RATIOS)
        ]
        return {"file": self.source, "rms_rad": [float(v) for v in self.rms], "parameters": rows}


def read_parameters(path: Path, robot: Robot) -> Mapping[str, Array]:
    """Return the drive parameters in a file by name (`PARAMETERS`), shape (joints,) each [SI].

    They are NaN for joints that the file lacks; a name is missing where a TOML file lacks it. The
    suffix of the file decides: .toml, .xml (MJCF) or else a table. Where no name of a joint fits,
    as many joints as the robot has are taken in their order.

    Raises InputError: a faulty file, or no joint in it that the robot has.
    """
    names, n = [row.name or f"joint{i}" for i, row in enumerate(robot.joints, 1)], robot.n
    if not path.is_file():
        raise missing(path, "file of drive parameters")
    if path.suffix == ".toml":
        drive = read_drive(path, n)
        fields = {"kp": drive.kp, "friction": drive.friction, "damping": drive.damping, "delay": drive.delay}
        given = {k: v for k, v in fields.items() if v is not None}
        made = {k: np.broadcast_to(np.asarray(v, dtype=float), n) for k, v in given.items()}
        rotor = drive.inertia_at_joint(n)
        return made if rotor is None else {**made, "armature": rotor}
    rows = _of_mjcf(path) if path.suffix == ".xml" else _of_table(path)
    named = [name for name in names if name in rows]
    if not named and len(rows) == n:  # other names, the same number: in their order
        rows = dict(zip(names, rows.values(), strict=True))
    elif not named:
        raise InputError(f"{path.name}: joints {', '.join(rows) or 'none'}; the robot has {', '.join(names)}")
    lacking = dict.fromkeys(PARAMETERS, np.nan)
    return {k: np.array([rows.get(name, lacking)[k] for name in names]) for k in PARAMETERS}


def _of_table(path: Path) -> dict[str, Mapping[str, float]]:
    """Return the parameters [SI] in a table by name of the joint. Raises InputError."""
    table = pd.read_csv(StringIO(read_text(path)), comment="#", skipinitialspace=True)
    if "joint" not in table or not {*PARAMETERS} & {*table}:
        raise InputError(f"{path.name}: needs a column joint, and some of {', '.join(PARAMETERS)} in SI units")
    numbers = table.reindex(columns=PARAMETERS).apply(pd.to_numeric, errors="coerce")
    return {str(name): row.to_dict() for name, (_, row) in zip(table["joint"], numbers.iterrows(), strict=True)}


def _of_mjcf(path: Path) -> dict[str, Mapping[str, float]]:
    """Return the parameters [SI] in an MJCF by name of the driven joint.

    Default classes are applied; missing attributes have MuJoCo's defaults: one for kp, gear and
    gainprm, else zero. Damping is NaN where the file gives a ratio. Raises InputError.
    """
    with foreign(f"{path.name}: malformed XML"):
        root = ET.fromstring(read_xml(path))
    defaults: dict[tuple[str, str], dict[str, str]] = {}

    def read_defaults(node: ET.Element, name: str, above: str) -> None:
        """Store the attributes of a default class for each kind of element, with inherited ones."""
        for tag in ("joint", "position", "general"):
            own = node.find(tag)
            inherited = defaults.get((above, tag), {})
            defaults[name, tag] = {**inherited, **({} if own is None else own.attrib)}
        for child in node.findall("default"):
            read_defaults(child, str(child.get("class")), name)

    for node in root.findall("default"):
        read_defaults(node, "main", "")
    joints: dict[str, dict[str, str]] = {}

    def read_bodies(body: ET.Element, inherited: str) -> None:
        """Store the attributes of all joints of a body and below it; inherited : default class."""
        inherited = body.get("childclass", inherited)
        for joint in body.findall("joint"):
            default = defaults.get((joint.get("class", inherited), "joint"), {})
            joints[str(joint.get("name"))] = {**default, **joint.attrib}
        for child in body.findall("body"):
            read_bodies(child, inherited)

    for world in root.findall("worldbody"):
        read_bodies(world, "main")
    rows: dict[str, Mapping[str, float]] = {}
    for node in root.iterfind("actuator/*"):
        actuator = {**defaults.get((node.get("class", "main"), node.tag), {}), **node.attrib}
        joint = joints.get(actuator.get("joint", ""))
        if joint is None or node.tag not in ("position", "general"):
            continue
        gear = float(actuator.get("gear", "1").split()[0])
        bias = [float(word) for word in actuator.get("biasprm", "0 0 0").split()] + [0.0] * 3
        gain = float(actuator.get("gainprm", "1").split()[0])
        kp, kv = (
            (float(actuator.get("kp", "1")), float(actuator.get("kv", "0")))
            if node.tag == "position"
            else (gain, -bias[2])
        )
        rows[actuator["joint"]] = {
            "kp": kp * gear**2,
            "friction": _first(joint, "frictionloss"),
            # By a ratio MuJoCo computes the damping from the inertias of the whole model.
            "damping": np.nan if "dampratio" in actuator else _first(joint, "damping") + kv * gear**2,
            "armature": _first(joint, "armature"),
            "delay": _first(actuator, "delay"),
        }
    if not rows:
        raise InputError(f"{path.name}: no position or general actuator that drives a joint")
    return rows


def _first(attributes: Mapping[str, str], name: str) -> float:
    """Return the first number of an XML attribute; zero if it is missing."""
    return float(attributes.get(name, "0").split()[0])


def with_parameters(response: Response, given: Mapping[str, Array]) -> Response:
    """Return a response with the parameters of a set; those missing there are unchanged.

    given : values by name (`PARAMETERS`), shape (joints,) each [SI], NaN where missing
    """

    def chosen(name: str, own: Array) -> Array:
        """Return the set's values of a parameter, the response's `own` where they are missing."""
        values = given.get(name)
        return own if values is None else np.where(np.isnan(values), own, values)

    armature = chosen("armature", response.armature)
    return replace(
        response,
        gain=chosen("kp", response.gain),
        friction=chosen("friction", response.friction),
        damping=chosen("damping", response.damping),
        delay=chosen("delay", response.delay),
        inertia=response.inertia + armature - response.armature,
    )


def arbitrated(
    robot: Robot, files: Sequence[Path], fit: Sequence[JointLog], runs: Sequence[JointLog], response: Response
) -> Iterator[Arbitration]:
    """Yield the comparison of each file's parameters with the response identified from logs.

    The standard deviation of a logarithm combines its posterior's, half the difference between fits
    to both halves of the runs, if there are several, and, for a delay, that by sampling.
    fit : logs of `response`; runs : held-out runs that are replayed. Raises InputError.
    """
    assert response.log_values is not None
    assert response.log_covariance is not None
    assert response.log_widths is not None
    sets = {path: read_parameters(path, robot) for path in files}
    own, sigma = [run for log in fit for run in log.runs()], np.sqrt(np.einsum("jkk->jk", response.log_covariance))
    if len(own) > 1:
        one, other = (half.log_values for half in fitted(robot, own[::2], own[1::2]))
        assert one is not None
        assert other is not None
        sigma = np.hypot(sigma, np.abs(one - other) / 2)
    sampled = np.zeros_like(sigma)
    # The sampling of the log gives a delay a standard deviation of .15 times between samples.
    sampled[:, -1] = 0.15 * own[0].step / np.maximum(response.delay, SMALLEST)
    sigma = np.hypot(sigma, sampled)
    # A quantity counts as determined if the standard deviation of its logarithm is below half of
    # that of its prior, and below `MAX_DETERMINED_SIGMA`.
    clear = (sigma < np.minimum(0.5 * response.log_widths, MAX_DETERMINED_SIGMA)) & response.moved[:, None]
    # Half-width of the reported 95 % interval, in standard deviations.
    ends = (response.log_values + way * 1.96 * sigma for way in (-1, 1))
    low, high = (np.exp(end) * UNITS for end in ends)
    for path, given in sets.items():
        there = with_parameters(response, given)
        of = np.array([np.isfinite(given.get(name, np.full(robot.n, np.nan))) for name in PARAMETERS]).T
        values = np.column_stack(
            [
                there.gain,
                *(each / there.gain for each in (there.friction, there.damping, there.inertia)),
                there.delay,
            ]
        )
        # The ratios of a set without a gain are those to the gain that the logs show.
        # A value is contradicted if its logarithm is three standard deviations from the identified one.
        off = np.abs(np.log(np.maximum(values, SMALLEST)) - response.log_values) > 3.0 * sigma
        verdict = np.where(clear, np.where(off, "contradicted", "agrees"), "not determined")
        errors = np.concatenate([run.position - there.predicted(run) for run in runs])
        yield Arbitration(
            str(path),
            np.asarray(np.sqrt(np.nanmean(errors**2, axis=0))),
            np.where(of, values * UNITS, np.nan),
            low,
            high,
            tuple(tuple(row) for row in np.where(of, verdict, "").tolist()),
        )


def arbitration_tables(joints: Sequence[str], after: Array, found: Sequence[Arbitration]) -> Iterator[Table]:
    """Yield the tables of the rms replay errors and of the parameters of all files.

    joints : names of the joints; after : rms replay error of the response, (joints,) [rad]
    """
    rows = [("this fit", *(f"{1e3 * v:.3g}" for v in after))]
    rows += [(Path(a.source).name, *(f"{1e3 * v:.3g}" for v in a.rms)) for a in found]
    title = "Parameters of files in the same replay, rms of each joint [mrad]"
    yield Table(title, ("parameters", *joints), rows, frozenset(range(1, 1 + len(joints))))
    marks = {"contradicted": " contradicted", "agrees": " agrees", "not determined": "", "": ""}
    parameters = []
    for j, joint in enumerate(joints):
        for k, name in enumerate(RATIOS):
            verdicts = [f"{a.values[j, k]:.3g}{marks[a.verdicts[j][k]]}" if a.verdicts[j][k] else "" for a in found]
            open_ = any(a.verdicts[j][k] == "not determined" for a in found)
            own = "not determined" if open_ else f"{found[0].low[j, k]:.3g} to {found[0].high[j, k]:.3g}"
            if any(verdicts):
                parameters.append((joint, name, own, *verdicts))
    columns = ("joint", "parameter", "these logs, 95 %", *(Path(a.source).name for a in found))
    yield Table("What these logs say of each parameter", columns, parameters, frozenset({2}))
