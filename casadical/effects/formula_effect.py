"""Effects whose formulas are text: their insertion points, names, and contributions to the model.

They are the effects of the package's list, those that a user defines in a file (see `definition`),
and laws: expressions found in data. A `Law` is added at one insertion point as a formula of what is
known at a pose; `casadical diagnose --laws` writes it. A formula is parsed and never executed (see
`formula`).
"""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from casadical.core.basics import InputError
from casadical.core.parts import Arm
from casadical.core.transforms import Symbolic, small_frame, translate
from casadical.effects.base import Context, Effect
from casadical.effects.formula import NUMERIC_FUNCTIONS, Formula, Interval, bounds, parse, refuse_unknown


class Seam(NamedTuple):
    """An insertion point of formulas in the model.

    components : number of components of a formula there, 1 or 3
    unit : unit of the formula's value; numbered : whether it needs the number of a joint or link
    """

    components: int
    unit: str
    numbered: bool = False


# Insertion points of formulas in the model, by the name that a definition or law gives.
SEAMS = {
    "joint": Seam(1, "rad", True),
    "joints": Seam(1, "rad"),
    "tilt": Seam(3, "rad", True),
    "shift": Seam(3, "m", True),
    "base tilt": Seam(3, "rad"),
    "base shift": Seam(3, "m"),
    "tool shift": Seam(3, "m"),
    "beam": Seam(1, "m"),
    "across": Seam(1, "m"),
    "payload": Seam(1, "kg/kg"),
    "tool tilt": Seam(3, "rad"),
    "growth": Seam(1, "m/m"),
    "point": Seam(3, "m"),
    "distance": Seam(1, "m"),
    "energy": Seam(1, "J"),
    "payload shift": Seam(3, "m"),
    "torque": Seam(1, "", True),
    "torques": Seam(1, ""),
    "response": Seam(1, "rad", True),
    "responses": Seam(1, "rad"),
}
# Names of the insertion points of formulas in joint logs: torques and servo position errors.
MOTION_SEAMS = ("torque", "torques", "response", "responses")
# Names of signals of the effect's own joint that a formula in joint logs may use (see `motion`).
MOTION_NAMES = frozenset(
    (
        *("q", "v", "a", "speed", "turned", "slip", "load", "tau", "friction", "drag", "inertia"),
        *("motor", "t", "time", "run", "zero", "mass", "mass_x", "mass_y", "mass_z", "link"),
        *("servo", "command_speed", "command_acceleration", "side", "delayed", "filtered", "wound"),
        *("heat", "rest", "at_limit", "after_limit", "at_speed_limit", "after_speed_limit"),
    )
)
# Pattern of names of signals of any joint, with its number, in formulas in joint logs.
MOTION_NAME_OF_JOINT = re.compile(r"(q|v|speed|slip|load|tau|heat|rest)(\d+)")
# Name of the column by name in a formula, where the two differ.
COLUMN_BY_NAME = {"t": "progress", "payload": "payload_kg", "warmth": "warmth_0s"}
# Pattern of names in formulas whose values are columns, logged or derived.
COLUMN_NAME = re.compile(r"t|payload|warmth|warmth_\d+s|heat\d+_\d+s|approach\d+|move\d+|(memory|play)\d+_\d+mrad")
# Pattern of names in formulas whose values are computed from a pose: variables, loads, moments,
# gravity and flange position (see `ALLOWED_NAMES`).
_POSE_NAME = re.compile(r"(q|tau)(\d+)|m(\d+)[xyz]|[gp][xyz]")
# Pattern of names without number in a formula at "joints"; they stand for each joint's own signal.
JOINT_NAME = re.compile(r"q|tau|approach|move")
# Name in formulas of the sense of the last rotation of an instrument's head about the vertical,
# -1, 0 (none yet) or 1.
HEAD_NAME = "head"
# Direction, in the flange frame, in which a target faces by default: the third axis.
DEFAULT_TARGET_DIRECTION = (0.0, 0.0, 1.0)
# Insertion points whose effects need the position (`station`) of an instrument.
STATION_SEAMS = ("beam", "across")
# Names in formulas of the measured point's coordinates in the measuring frame [m], at the insertion
# points of the measurement.
_POINT_NAMES = ("point_x", "point_y", "point_z")
# Largest number of instruments that measure distances, in all tables of a campaign together.
MAX_DISTANCE_INSTRUMENTS = 4
# Columns of the position of a measured distance's anchor in the measuring frame [m].
ANCHOR_COLUMNS = ("far_x_m", "far_y_m", "far_z_m")
# Columns, one for each distance instrument in the order of tables, that are 1 where it measured the
# distance, else 0.
INSTRUMENT_FLAG_COLUMNS = tuple(f"wire{k}" for k in range(1, MAX_DISTANCE_INSTRUMENTS + 1))
# Mountings of a camera that measures poses: fixed in the measuring frame, or on the flange.
CAMERA_SIDES = ("fixed", "carried")
# Description of the names that formulas may use, for error messages.
ALLOWED_NAMES = (
    "q1 (reading [rad or m]), tau1 (load, share of the joint's peak torque), m1x (moment at a link, share), gx "
    "(gravity in the flange frame, 1 at most), px (flange [m]), t (time, 0 to 1), warmth, warmth_600s [K], payload "
    "[kg], approach1 (-1 or 1), move1 (from the pose before [rad or m]), memory1_300mrad (of motions "
    "so far back, -1 to 1), play1_300mrad (reading of what follows joint 1 with so much play to each side), heat1_600s "
    "(square of tau1, lagged)"
)


@dataclass(frozen=True)
class FormulaEffect(Effect):
    """An effect that adds the values of formulas at some insertion points."""

    @property
    def formulas(self) -> Mapping[str, Formula]:
        """Return the formulas by insertion point (`SEAMS`); their values are added there."""
        raise NotImplementedError

    @property
    def drivers(self) -> tuple[str, ...]:
        """Return the names in its formulas that are neither parameters nor settings."""
        raise NotImplementedError

    def refuse_joints(self, arm: Arm) -> None:
        """Check that the arm has the joints and the payload that the formulas use.

        Raises InputError.
        """
        super().refuse_joints(arm)
        for name in (*self.drivers, *self.conditions):
            numbered = re.fullmatch(  # the first group is the number of a joint or link
                r"(?:q|tau|m|approach|move|memory|play|v|speed|slip|load|heat|rest)(\d+)(?:[xyz]|_\d+(?:mrad|s))?", name
            )
            if numbered and int(numbered[1]) not in (*arm.numbers, *([0] if name[0] == "m" else [])):
                text = next(iter(self.formulas.values())).text
                raise InputError(f"formula {text!r}: {name}; robot {arm.name!r} has joints 1 to {arm.n}")
        if arm.payload is None and (seam := next((s for s in self.formulas if s.startswith("payload")), "")):
            raise InputError(f"{self.name}: seam = {seam!r}; robot {arm.name!r} declares no payload")

    def own_names(self, context: Context) -> dict[str, Symbolic]:
        """Return symbols of parameters and values of settings by their names in the formulas."""
        raise NotImplementedError

    def values_at(self, seam: str, context: Context, more: Mapping[str, Symbolic] | None = None) -> list[Symbolic]:
        """Return a list of the formula's components at an insertion point, one or three.

        It is empty where there is no formula. Their unit is that of `SEAMS`.
        more : values of names that exist at this insertion point only
        """
        formula = self.formulas.get(seam)
        if formula is None:
            return []
        values, moments = self.own_names(context) | dict(more or {}), dict[int, Symbolic]()
        return formula.values({n: values[n] if n in values else variable(context, n, moments) for n in formula.names})

    def energy(self, context: Context) -> Symbolic:
        """Return the potential energy [J] that the effect adds.

        It is the formula "energy" plus the energy of the payload's errors: `payload`, relative
        error of the mass, and `payload shift`, that of the first moment by mass [m].
        """
        payload, T = context.arm.payload, context.frames[-1]
        total: Symbolic = sum(self.values_at("energy", context))
        share, shift = (self.values_at(seam, context) for seam in ("payload", "payload shift"))
        if payload is None or not (share or shift):
            return total
        com, kg = ca.DM(payload.com), context.conditions["payload_kg"]
        if not shift:
            return total + -share[0] * kg * ca.dot(context.gravity, T[:3, :3] @ com + T[:3, 3])
        more = share[0] if share else 0.0
        first_moment = T[:3, :3] @ (more * com + ca.vertcat(*shift)) + more * T[:3, 3]
        return total + -kg * ca.dot(context.gravity, first_moment)

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the change of the joint variables, shape (n,) [rad or m].

        It is the formula "joint" at the effect's own joint, and zero at all others.
        """
        moved = ca.SX.zeros(context.arm.n)
        for value in self.values_at("joint", context):
            assert self.joint is not None
            moved[self.joint - 1] = value
        return moved

    def link(self, number: int, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] inserted behind link `number` (1-based), in its frame.

        It is the growth of every link by the formula "growth", else tilt and shift of the link of
        the effect's joint by their formulas; the identity for all other links.
        """
        if "growth" in self.formulas:
            return grown_link(number, context, self.values_at("growth", context)[0])
        return self._frame("", context) if number == self.joint else ca.SX.eye(4)

    def base(self, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] of the formulas "base tilt" and "base shift".

        It is inserted before the first joint, in the base frame.
        """
        return self._frame("base ", context)

    def tool(self, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] of the formulas "tool tilt" and "tool shift".

        It is inserted between flange and tool, in the flange frame.
        """
        return self._frame("tool ", context)

    def _frame(self, where: str, context: Context) -> Symbolic:
        """Return the transform (4, 4) [m] of the formulas of a shift, a tilt or both.

        where : prefix of the insertion points: "", "base " or "tool "
        """
        shift, tilt = (self.values_at(f"{where}{what}", context) for what in ("shift", "tilt"))
        if tilt:
            return small_frame(*(shift or (0, 0, 0)), *tilt)
        return translate(*shift) if shift else ca.SX.eye(4)

    def measurement(self, point: Symbolic, context: Context) -> Symbolic:
        """Return the point displaced by the formulas of the measurement, shape (3,) [m].

        "point" displaces it as a vector, "distance" away from the anchor, "beam" away from the
        instrument's station, "across" horizontally to the left of the beam.
        point : true measured point, shape (3,) [m]; both are in the measuring frame
        """
        moved, names = point, dict(zip(_POINT_NAMES, ca.vertsplit(point), strict=True))
        if "point" in self.formulas:
            moved = moved + ca.vertcat(*self.values_at("point", context, names))
        for seam in {*STATION_SEAMS, "distance"} & self.formulas.keys():
            far = [context.conditions[c] for c in ANCHOR_COLUMNS] if seam == "distance" else self.station  # type: ignore[attr-defined]
            beam = point - ca.vertcat(*far)
            r = ca.sqrt(ca.sumsqr(beam) + 1e-12)
            of_beam = {"r": r, "azimuth": ca.atan2(beam[1], beam[0])}
            if "incidence" in self.formulas[seam].names:
                mark = np.array(getattr(self, "towards", DEFAULT_TARGET_DIRECTION))
                of_beam["incidence"] = ca.dot(beam, context.frames[-1][:3, :3] @ (mark / np.linalg.norm(mark))) / r
            of_beam |= dict(zip([HEAD_NAME], (context.conditions[c] for c in self.of_head), strict=False))
            aside = ca.vertcat(-beam[1], beam[0], 0) / ca.sqrt(beam[0] ** 2 + beam[1] ** 2 + 1e-12)
            way = aside if seam == "across" else beam / r
            moved = moved + way * self.values_at(seam, context, {**names, **of_beam})[0]
        return moved

    @property
    def of_head(self) -> tuple[str, ...]:
        """Return the column of the head's last rotation in a tuple; () if unused or in `needs`."""
        named = any(HEAD_NAME in f.names for seam, f in self.formulas.items() if seam in STATION_SEAMS)
        if not named or HEAD_NAME in self.needs:
            return ()
        millimetres = "_".join(f"{1e3 * v:.0f}" for v in self.station)  # type: ignore[attr-defined]
        return (f"head_{millimetres}mm".replace("-", "m"),)


def check_formula(text: str, seam: str, own: Collection[str]) -> Formula:
    """Return the formula of a text if its components and names fit its insertion point.

    seam : insertion point (`SEAMS`); own : names of its parameters and settings
    Raises InputError that names the column, what is wrong and what is allowed.
    """
    formula = parse(text, frozenset(own))
    if formula.components != SEAMS[seam].components:
        raise InputError(f"formula {text!r}: seam {seam!r} needs {SEAMS[seam].components} of its components")
    of_joints = "q1 (and v, speed, slip, load, tau, heat, rest) of joint 1"
    allowed = (*own, *((*sorted(MOTION_NAMES), of_joints) if seam in MOTION_SEAMS else (ALLOWED_NAMES,)))
    refuse_unknown(formula, lambda name: name in own or is_variable(name, seam), ", ".join(allowed))
    return formula


def check_values(formula: Formula, parameters: Collection[str], settings: Mapping[str, Any]) -> None:
    """Check that a formula is zero where its parameters are, and finite and bounded elsewhere.

    Values are checked at 200 random points, NaN passing as zero where the parameters are; bounds
    by intervals (see `bounds` and `_range_of`).
    parameters : names of the parameters; settings : values of the settings, by name
    Raises InputError that names the formula.
    """
    ranges = {name: _range_of(name) for name in formula.names} | {n: (float(v), float(v)) for n, v in settings.items()}
    bounds(formula, lambda name: ranges[name])
    rng = np.random.default_rng(0)
    at: dict[str, Any] = {n: rng.uniform(*ranges[n], 200) for n in formula.names if n not in settings} | dict(settings)
    with np.errstate(all="ignore"):
        without = formula.values(at | dict.fromkeys(parameters, np.zeros(200)), NUMERIC_FUNCTIONS)
        values_with = formula.values(at, NUMERIC_FUNCTIONS)
    if any(np.nan_to_num(v).any() for v in without):
        raise InputError(f"formula {formula.text!r}: it must be zero where {', '.join(parameters)} are zero")
    wrong = np.broadcast_to(~np.isfinite(sum(values_with)), 200)
    if wrong.any():
        there = ", ".join(f"{name} = {values[wrong][0]:.3g}" for name, values in at.items() if name not in settings)
        raise InputError(f"formula {formula.text!r}: it is no number where {there}")


# Range [SI] of each variable in checks of formulas, by name without number; t is progress.
_RANGE_BY_NAME = {
    "t": (0.0, 1.0),
    "payload": (0.0, 100.0),
    "warmth": (-100.0, 100.0),
    "r": (0.1, 100.0),
    "g": (-1.0, 1.0),
    "approach": (-1.0, 1.0),
    "memory": (-1.0, 1.0),
    HEAD_NAME: (-1.0, 1.0),
}


def _range_of(name: str) -> Interval:
    """Return the lower and upper value [SI] of a variable with which formulas are checked."""
    usual = (-4.0, 4.0)
    if name in MOTION_NAMES and name not in _RANGE_BY_NAME:
        return usual
    if re.fullmatch(r"heat\d+_\d+s", name):
        return 0.0, usual[1]
    return _RANGE_BY_NAME.get("g" if re.fullmatch("g[xyz]", name) else re.sub(r"\d.*", "", name).rstrip("_"), usual)


def is_variable(name: str, seam: str) -> bool:
    """Return whether a formula at an insertion point may use a name of a signal, a pose or a column.

    Measurements have a range r [m], an azimuth of the beam [rad] and the cosine of its incidence.
    """
    if seam in MOTION_SEAMS:
        return name in MOTION_NAMES or bool(MOTION_NAME_OF_JOINT.fullmatch(name))
    measured = seam in (*STATION_SEAMS, "distance")
    if (
        (measured and name in ("r", "azimuth", "incidence"))
        or (name in _POINT_NAMES and (measured or seam == "point"))
        or (name == HEAD_NAME and seam in STATION_SEAMS)
        or (seam == "joints" and JOINT_NAME.fullmatch(name))
    ):
        return True
    if seam.startswith("payload") and not name.startswith("q") and not COLUMN_NAME.fullmatch(name):
        return False
    # Loads are derived from the energy, so that it cannot depend on them.
    if seam == "energy" and name.startswith("tau"):
        return False
    return bool(COLUMN_NAME.fullmatch(name) or _POSE_NAME.fullmatch(name))


def image_columns(side: str, what: str) -> tuple[str, str, str]:
    """Return the names of the columns of x, y and z [m] of a vector from a camera to its target.

    The vector is in the measuring frame and computed from measured poses. A fixed camera's frame is
    the measuring frame, with its third axis along the optical axis; that of one on the flange is
    the tool frame (see `diagnosis.instrument_columns`).
    side : one of CAMERA_SIDES
    what : "depth", the component along the optical axis, or "radial", the component across it
        multiplied by its squared slope, 4 at most
    """
    x, y, z = (f"{side}_{what}_{c}_m" for c in "xyz")
    return x, y, z


def columns_of(names: Collection[str]) -> list[str]:
    """Return the columns that names in formulas stand for, without names that are no columns."""
    return [COLUMN_BY_NAME.get(n, n) for n in names if COLUMN_NAME.fullmatch(n)]


def variable(context: Context, name: str, moments: dict[int, Symbolic] | None = None) -> Symbolic:
    """Return the value of a pose's or a column's name in a formula (see ALLOWED_NAMES).

    moments : cache by link of the moments of weight, divided by the arm's maximum peak gravity
        torque; new ones are added
    Raises KeyError for a missing column.
    """
    if not _POSE_NAME.fullmatch(name):
        return context.conditions[COLUMN_BY_NAME.get(name, name)]
    axis = "xyz".find(name[-1])
    if name[0] == "g":
        g = ca.DM(context.arm.gravity)
        return (context.frames[-1][:3, :3].T @ context.gravity)[axis] / float(ca.norm_2(g))
    if name[0] == "p":
        return context.frames[-1][axis, 3]
    if name[0] == "m":
        link, composed = int(name[1:-1]), {} if moments is None else moments
        if link not in composed:
            # The moment about the link's origin in the link's frame; of link 0, the pedestal, about
            # the first link's origin in the base frame.
            moment = context.moment(max(link, 1))
            moment = context.frames[link - 1][:3, :3].T @ moment if link else moment
            composed[link] = moment / context.peak_moment
        return composed[link][axis]
    number = int(name.removeprefix("tau").removeprefix("q"))
    return context.load(number) if name.startswith("tau") else context.q[number - 1]


def grown_link(number: int, context: Context, growth: Symbolic) -> Symbolic:
    """Return the translation (4, 4) [m], in its frame, of the end of a link that has grown.

    number : of the link, 1-based; growth : change of its length divided by its length
    """
    before = context.frames[number - 2] if number > 1 else ca.SX.eye(4)
    here = context.frames[number - 1]
    # The vector from the previous link's origin to this one's, in this link's frame.
    along = here[:3, :3].T @ (here[:3, 3] - before[:3, 3])
    moved = ca.SX.eye(4)
    moved[:3, 3] = growth * along
    return moved


@lru_cache(maxsize=1024)
def _refuse_formula(text: str, seam: str, factors: tuple[str, ...]) -> None:
    """Check that a law's formula is allowed and has all its factors. Raises InputError."""
    formula = check_formula(text, seam, factors)
    if unused := [name for name in factors if name not in formula.names]:
        raise InputError(f"formula {text!r}: factor {unused[0]!r} is not in it")
    check_values(formula, factors, {})


@dataclass(frozen=True)
class Law(FormulaEffect):
    """An effect found in data: one expression at one insertion point.

    seam : insertion point, one of SEAMS; joint : number of the joint or link there, 1-based
    formula : text of the formula whose value is added there [unit by SEAMS]; at `joints`, q, tau,
        approach and move are those of each joint
    factors : name of each parameter, a single letter, and its typical size; the formula must be
        zero where all of them are
    station : position of the instrument in the measuring frame [m], for `beam` and `across`, where
        r is the range [m]
    count : number of the arm's joints, for `joints`
    towards : direction in which the target faces, in the flange frame, for `incidence`
    """

    seam: str = "joint"
    formula: str = ""
    factors: tuple[tuple[str, float], ...] = (("a", 30e-6),)
    station: tuple[float, float, float] = (0.0, 0.0, 0.0)
    count: int = 6
    towards: tuple[float, float, float] = DEFAULT_TARGET_DIRECTION

    name: ClassVar[str] = "law"
    on_list: ClassVar[str] = "unknown"
    signature: ClassVar[str] = "a law found in the data"

    def __post_init__(self) -> None:
        allowed = [seam for seam in SEAMS if seam not in MOTION_SEAMS]
        if self.seam not in allowed:
            raise InputError(f"law: seam = {self.seam!r}; allowed: {', '.join(allowed)}")
        numbered = SEAMS[self.seam].numbered
        if numbered != (self.joint is not None):
            raise InputError(f"law: joint {'is missing' if numbered else 'does not belong'} at the seam {self.seam!r}")
        names = [name for name, _ in self.factors]
        if (
            not names
            or len(set(names)) < len(names)
            or not all(re.fullmatch("[a-z]", n) and n not in "tr" for n in names)
        ):
            raise InputError(f"law: factors = {names}; allowed are different single letters, not t or r, one at least")
        if not any(self.towards):
            raise InputError("law: towards = (0, 0, 0) is no direction; the flange's third axis is (0, 0, 1)")
        if not all(0 < size <= 1e3 for _, size in self.factors):
            raise InputError(f"law: factors = {list(self.factors)}; their sizes must be above 0, and 1000 at most")
        _refuse_formula(self.formula, self.seam, tuple(names))

    @classmethod
    def candidates(cls, arm: Arm) -> Iterable[Effect]:
        """Return no candidates: laws are found by `casadical.discover`, or given."""
        return ()

    @property
    def of_measurement(self) -> bool:  # type: ignore[override]
        """Return whether it acts on the instrument's reading rather than on the robot."""
        return self.seam in (*STATION_SEAMS, "distance", "point")

    @property
    def formulas(self) -> Mapping[str, Formula]:
        """Return the law's formula in a dict, by its insertion point."""
        return {self.seam: parse(self.formula)}

    @property
    def place(self) -> str:
        """Return the part of the robot or instrument where the law acts, in words."""
        words = {"joint": "joint {}", "joints": "every joint", "tilt": "tilt of link {}", "shift": "shift of link {}"}
        words["across"] = "the beam's side"
        return words.get(self.seam, self.seam).format(self.joint)

    @property
    def drivers(self) -> tuple[str, ...]:
        """Return the names in the law's formula that are not its factors."""
        own = {name for name, _ in self.factors}
        return tuple(name for name in parse(self.formula).names if name not in own)

    @property
    def label(self) -> str:
        """Return the identifier of the law: its place and the names in its formula."""
        return f"law at {self.place} by {', '.join(self.drivers)}"

    @property
    def conditions(self) -> tuple[str, ...]:
        """Return the names of the columns that the law's formula and insertion point need."""
        names = columns_of(self.drivers)
        if self.seam == "joints":
            names += [f"{n}{j}" for n in self.drivers if n in ("approach", "move") for j in range(1, self.count + 1)]
        needed = {"payload": ("payload_kg",), "distance": ANCHOR_COLUMNS}.get(self.seam.split()[0], ())
        return tuple(dict.fromkeys([*names, *needed, *self.of_head]))

    def refuse_joints(self, arm: Arm) -> None:
        """Check that the arm has the law's joints, and `count` in all if it acts at every joint.

        Raises InputError.
        """
        super().refuse_joints(arm)
        if self.seam == "joints" and self.count != arm.n:
            raise InputError(f"law: count = {self.count}; robot {arm.name!r} has {arm.n} joints")

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each factor by name; for every joint: a1, a2, ..."""
        unit = SEAMS[self.seam].unit
        if self.seam != "joints":
            return {name: (size, unit) for name, size in self.factors}
        return {f"{name}{j}": (size, unit) for j in range(1, self.count + 1) for name, size in self.factors}

    def own_names(self, context: Context) -> dict[str, Symbolic]:
        """Return the symbols of the factors by name; {} if it acts at every joint, with its own."""
        return {name: self.value(context, name) for name, _ in self.factors} if self.seam != "joints" else {}

    def joint_angle(self, context: Context) -> Symbolic:
        """Return the change of the joint variables, shape (n,) [rad or m].

        It is at the law's own joint for the insertion point `joint`, at all for `joints`, else zero.
        """
        moved = super().joint_angle(context)
        for j in range(1, context.arm.n + 1) if self.seam == "joints" else ():
            own = {name: variable(context, f"{name}{j}") for name in self.drivers if JOINT_NAME.fullmatch(name)}
            own |= {name: self.value(context, f"{name}{j}") for name, _ in self.factors}
            moved[j - 1] = self.values_at("joints", context, own)[0]
        return moved
