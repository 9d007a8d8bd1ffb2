"""Meaning of a table's headings: joint readings, observations and conditions, with their units.

Only quantities that are missing under casadical's own names are searched for. A unit comes from the
heading, else from a row of units, a comment, or the size of the numbers; where none of these is
conclusive, a question is returned whose first choice is the most probable answer.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TypeVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Joint
from casadical.measurements.columns import FULL_TURN_RAD, Source, in_seconds, numbers_of
from casadical.measurements.kinds.position import FIRST_ORIENTATION_COLUMN
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.raw_table import RawTable
from casadical.measurements.vocabulary import UNITS, UNSPACED, WORDS

# Tolerance of the length of unit quaternions and of R R' = 1, as tables hold rounded numbers.
ROTATION_TOLERANCE = 1e-2
# Qualifier of a group of columns -> its rank; among groups that could be meant the lowest rank
# wins.
_QUALIFIER_RANK = {"measured": 0, "": 1, "nominal": 2}
# Quantity that is a condition -> casadical's column and its unit.
_CONDITIONS = {"temperature": ("temperature_degC", "degC"), "load": ("payload_kg", "kg")}
# Word of a heading -> axis of a position, x, y or z.
_AXIS_WORDS = {f"{before}{c}": c for before in ("", "p", "t") for c in "xyz"}
# Word of a heading -> component of an orientation, x, y, z or w.
_ROTATION_WORDS = {f"{before}{c}": c for before in ("r", "q", "o") for c in "xyzw"} | {"w": "w"}
# Casadical's columns of an orientation by angles about the fixed x, y, z, without units.
_ROLL_PITCH_YAW = ("roll", "pitch", "yaw")
# Casadical's columns of a position, without units.
_XYZ = ("x", "y", "z")
# Form of an orientation in words -> casadical's columns, without units, and their quantity.
_ORIENTATION_FORMS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "a rotation vector": (tuple(f"rotvec_{c}" for c in _XYZ), "angle"),
    "angles about x, then the new y, then the new z": (tuple(f"r{c}" for c in _XYZ), "angle"),
    "roll, pitch, yaw: angles about the fixed x, y, z": (_ROLL_PITCH_YAW, "angle"),
    "angles about z, then the new y, then the new x": (_ROLL_PITCH_YAW[::-1], "angle"),
    "a quaternion, w first": (("qw", "qx", "qy", "qz"), ""),
    "a quaternion, w last": (("qx", "qy", "qz", "qw"), ""),
    "a matrix, row by row": (tuple(f"R{i}{j}" for i in range(3) for j in range(3)), ""),
    "a matrix, column by column": (tuple(f"R{j}{i}" for i in range(3) for j in range(3)), ""),
}
# Forms that three angles rx, ry, rz may have.
_THREE_ANGLE_FORMS = tuple(_ORIENTATION_FORMS)[:3]


@dataclass(frozen=True)
class Understood:
    """The meaning of one column of a file.

    ours : casadical's name for it, with its unit
    source : column of the file and its conversion
    unit : unit in the file, empty if it has none
    why : how the meaning or unit was found, such as "heading"
    """

    ours: str
    source: Source
    unit: str
    why: str


@dataclass(frozen=True)
class Question:
    """A question about a table that its headings leave open.

    text : the question
    choices : possible answers in words, each with the columns that it means; the most probable
        first
    about : "orientation", "observation" or "layout", whose choices the robot's model ranks; else ""
    """

    text: str
    choices: Mapping[str, Sequence[Understood]]
    about: str = ""


@dataclass(frozen=True)
class Understanding:
    """What is understood of a table: the meaning of its columns, and the open questions."""

    columns: tuple[Understood, ...] = ()
    questions: tuple[Question, ...] = ()

    @property
    def sources(self) -> dict[str, Source]:
        """Return each column's source by our name; open questions are answered by their first choice."""
        first = (c for question in self.questions for c in next(iter(question.choices.values())))
        return {c.ours: c.source for c in (*self.columns, *first)}

    def answered(self, question: Question, choice: str, why: str = "") -> "Understanding":
        """Return the understanding with one question answered by one of its choices.

        why : how the answer was found; by default as the columns of the choice say
        """
        chosen = (replace(c, why=why or c.why) for c in question.choices[choice])
        return Understanding((*self.columns, *chosen), tuple(q for q in self.questions if q is not question))


@dataclass(frozen=True)
class Heading:
    """A heading, taken apart.

    name : the heading itself
    quantity : such as joint, position or time
    slot : part of the quantity (number of a joint, axis, entry of a matrix)
    qualifier : measured, nominal or empty
    unit : word of the unit, or empty
    rest : words without a recognised meaning, which tell groups of columns apart
    values : cells as numbers, shape (n,)
    led : kind of a joint, then kind, factor and offset of its leader, whose column this is; or None
    numbers : numbers in the heading of a position
    """

    name: str
    quantity: str
    slot: str
    qualifier: str
    unit: str
    rest: frozenset[str]
    values: Array = field(compare=False)
    led: tuple[str, str, float, float] | None = None
    numbers: frozenset[str] = frozenset()


# Headings, casadical's names for them, and their quantity: "angle", "length", or empty for one
# without a unit.
_Parts = Sequence[tuple[Sequence[Heading], Sequence[str], str]]
# Type of a group of columns: a list, or by the number of each one's joint.
_Group = TypeVar("_Group", list[Heading], dict[int, Heading])
# Possible meanings: each in words, with the columns that it implies.
_Options = Sequence[tuple[str, _Parts]]


def understand(
    raw: RawTable,
    joints: Sequence[str | Joint],
    given: Collection[str] = (),
    *,
    kind: str | None = None,
) -> Understanding:
    """Return the meaning of a table's columns whose headings are not casadical's own.

    joints : each joint with its name and coupling, or its kind alone ("revolute", "prismatic")
    given : casadical's names of columns that the user has assigned already
    kind : kind of measurement, None where it is not declared
    """
    chain = [Joint(kind=j) if isinstance(j, str) else j for j in joints]  # type: ignore[arg-type]
    free = [i for i, joint in enumerate(chain, 1) if joint.coupling is None]
    ours = {*raw.header, *given}
    own = {int(m[1]) for h in ours if (m := re.fullmatch(r"q(\d+)_(deg|rad|mm|m)", h))}
    headings = _headings(raw, chain) if raw.form.header_line else _by_order(raw, len(free))
    stated = _stated_units([*raw.comments, *(text for _, text in raw.form.skipped)])
    # Only kinds that determine the scale count: a column "point" alone names touched points, but
    # together with positions it may name the points of a tracker.
    seen = {each.name for each in kinds().values() if each.has_scale and each.matches(ours)}
    columns: list[Understood] = []
    questions: list[Question] = []

    def decide(options: _Options, which: str, about: str = "", ask: bool = False) -> None:
        """Add the columns of the only possible meaning and unit; with several, add a question.

        which : the question, if more than the unit is open; about : as of `Question`; ask :
            whether it is asked for a single option, too
        """
        choices = _choices(options, stated, which if ask else "")
        if len(choices) == 1 and not ask:
            columns.extend(next(iter(choices.values())))
        elif choices:
            unsure = _listed([h for members, _, _ in options[0][1] for h in members])
            text = which if len(options) > 1 or ask else f"In which unit are {unsure}?"
            questions.append(Question(text, choices, about))

    without_readings = bool({*free} - own)
    if without_readings:
        open_joints = [i for i in free if i not in own]
        groups = _joints(headings, len(chain), open_joints, _names_in_cells(raw, [j.name for j in chain]), own)
        unknown = not (groups or own)  # where some readings are named, the others are missing
        if unknown:
            numbered = _numbered(raw, len(free))
            groups = [dict(zip(free, group, strict=True)) for group in numbered]
        text = "Are these the joint readings?" if unknown else "Which columns are the joint readings?"
        decide([(_listed(group.values()), _parts_of(group, chain)) for group in groups], text, ask=unknown)
    if not seen:
        positions = [] if kind == "distance" else _groups(headings, "position", _XYZ)
        lengths = _groups(headings, "distance", ("",)) if kind in (None, "distance") else []
        readings = [columns, *(way for q in questions for way in q.choices.values())]
        used = {c.source.name for c in readings[-1]} if len(readings) < 3 else set()
        used |= {h for h in raw.header if re.fullmatch(r"approach\d+", h)}
        frames = _frames(raw, used) if kind in (None, "position", "pose") and raw.form.header_line else []
        if not (positions or frames or lengths):
            triples = _numbered(raw, 3, {*given, *(c.source.name for way in readings for c in way)})
            positions = [g for g in triples if {*words_of(g[0].name)[0]} & WORDS["translation"]]
        options, about = _observations(positions, lengths, frames)
        decide(options, "What was measured?", about)
    turned = any(re.fullmatch(FIRST_ORIENTATION_COLUMN, name) for name in ours) or kind not in (
        None,
        "pose",
        "relative_pose",
    )
    turned = turned or any(c.ours == "R00" for c in columns)
    if not turned and (not seen or seen & {"position", "relative_pose"}):
        ways = (columns, *(way for q in questions for way in q.choices.values()))
        taken = {*given, *(name for way in ways for c in way for name in (c.source.name, *c.source.add))}
        unused = [h for h in headings if h.name not in taken]
        decide(*_orientation(unused, raw, taken))
    if seen and not without_readings:  # with our own names, only headings with a unit count
        headings = [h for h in headings if h.unit]
    columns += [*_conditions(headings, ours), *_times(headings, ours), *_tools(raw, ours), *_approaches(raw, ours)]
    if not raw.form.header_line:
        columns = [replace(c, why=f"order of the columns, {c.why}") for c in columns]
    return Understanding(tuple(columns), tuple(questions))


def _conditions(headings: Iterable[Heading], ours: Collection[str]) -> Iterator[Understood]:
    """Yield temperature and payload, each if exactly one heading names it.

    ours : casadical's names that the table has already
    """
    for quantity, (name, unit) in _CONDITIONS.items():
        named = [h for h in headings if h.quantity == quantity and not h.rest and UNITS.get(h.unit, (unit,))[0] == unit]
        if len(named) == 1 and name not in ours and np.isfinite(named[0].values).all():
            factor = UNITS.get(named[0].unit, ("", 1.0))[1]
            yield Understood(name, Source(named[0].name, factor), named[0].unit or unit, "heading")


def _times(headings: Iterable[Heading], ours: Collection[str]) -> Iterator[Understood]:
    """Yield the column time_s, if one heading names the time, or two its seconds and nanoseconds.

    The unit of time stamps without one follows from their size.

    ours : casadical's names that the table has already
    """
    named = [h for h in headings if h.quantity == "time" and not h.rest and UNITS.get(h.unit, ("s",))[0] == "s"]
    named = [h for h in named if np.isfinite(h.values).all()]
    fine = [h for h in named if UNITS.get(h.unit, ("", 1.0))[1] == 1e-9]
    whole = [h for h in named if h not in fine] or fine
    if "time_s" in ours or len(whole) != 1 or len(fine) > 1:
        return
    size = float(np.median(np.abs(whole[0].values)))
    # Largest time stamps in seconds, milliseconds and microseconds, with their factors to seconds.
    stamps = ((1e11, 1.0), (1e14, 1e-3), (1e17, 1e-6))
    factor = UNITS[whole[0].unit][1] if whole[0].unit else next((f for most, f in stamps if size < most), 1e-9)
    if size * factor < 1e10:  # later than the year 2286 is no time stamp [s]
        add = {h.name: 1e-9 for h in fine if h is not whole[0]}
        yield Understood("time_s", Source(whole[0].name, factor, add=add), whole[0].unit or "s", "heading")


def _tools(raw: RawTable, ours: Collection[str]) -> Iterator[Understood]:
    """Yield the column `tool` if a column of words names the measured target of each row.

    Its heading has a word for a target, and it has few names, each at six poses or more on average.
    """
    for name in raw.header:
        words = set(words_of(name)[0])
        if "tool" not in ours and words & WORDS["target"] and words <= WORDS["target"] | WORDS["dh_joint"]:
            cells = raw.frame[name].dropna().astype(str)
            # A target has at least six poses on average; otherwise the names are remarks.
            if len(cells) == len(raw.frame) and 1 < cells.nunique() <= len(cells) / 6:
                yield Understood("tool", Source(name), "", "heading")
                return


def _approaches(raw: RawTable, ours: Collection[str]) -> Iterator[Understood]:
    """Yield the columns with the direction from which joints approached a pose, by their headings."""
    for name in raw.header:
        words = words_of(name)[0]
        numbers = [w for w in words if w.isdecimal()]
        if {*words} & WORDS["approach"] and len(numbers) == 1 and f"approach{int(numbers[0])}" not in ours:
            yield Understood(f"approach{int(numbers[0])}", Source(name), "", "heading")


def words_of(heading: str) -> tuple[list[str], str]:
    """Return the lower-case words of a heading, and its unit's word (a key of `UNITS`) or ""."""
    text = unicodedata.normalize("NFKC", heading).strip()
    unit = ""
    # The unit at the end of a heading, in brackets, behind "in" or behind a comma, slash or
    # underscore.
    bracket_pattern = re.compile(r"[\[({<【]([^\])}>】]*)[\])}>】]|(?:\bin\b|[,/_])\s*([^\s,/_]+)\s*$")
    for match in bracket_pattern.finditer(text):
        word = (match[1] or match[2] or "").strip().casefold()
        if word in UNITS:
            unit, text = word, text[: match.start()] + " " + text[match.end() :]
            break
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).casefold()
    words = re.findall(r"[^\W\d_]+|\d+", UNSPACED.sub(lambda m: f" {m[0]} ", text))
    if not unit and words and words[-1] in UNITS and len(words) > 1 and len(words[-1]) > 1:
        unit = words.pop()
    return words, unit


def _headings(raw: RawTable, chain: Sequence[Joint]) -> list[Heading]:
    """Return the headings that have a recognised meaning, taken apart."""
    below = [*raw.form.units, *([""] * len(raw.header))]
    named = [(words_of(joint.name)[0], str(i)) for i, joint in enumerate(chain, 1) if joint.name]
    leaders = [(words_of(joint.leader[0])[0], str(i)) for i, joint in enumerate(chain, 1) if joint.leader]
    headings = []
    for k, name in enumerate(raw.header):
        words, unit = words_of(name)
        if not words or set(words) & (WORDS["about"] | WORDS["approach"]):
            continue
        said = {w for w in words if w not in WORDS["measured"] | WORDS["nominal"]}
        quantity, slot, rest = _meaning(words, said, [*named, *leaders])
        led = None
        if "by name" in rest and _meaning(words, said, named)[:2] != (quantity, slot):
            joint = chain[int(slot) - 1]
            led = (joint.kind, *joint.leader[1:]) if joint.leader else None
        cells = raw.frame.iloc[:, k]
        values = in_seconds(cells) if quantity == "time" else numbers_of(cells)
        if quantity and (np.isfinite(values).mean() > 0.5 or quantity in _CONDITIONS):
            qualifier = next((q for q in ("measured", "nominal", "instrument") if set(words) & WORDS[q]), "")
            qualifier = "measured" if qualifier == "instrument" else qualifier
            unit = unit or (below[k] if below[k] in UNITS else "")
            headings.append(Heading(name, quantity, slot, qualifier, unit, frozenset(rest), values, led))
    return headings


def _meaning(
    words: Sequence[str], said: set[str], named: Sequence[tuple[Sequence[str], str]]
) -> tuple[str, str, Collection[str]]:
    """Return quantity, slot and unexplained words of a heading; all empty if it has no meaning.

    Slot and quantity are as of `Heading`.

    words : all words of the heading
    said : those that are neither "measured" nor "nominal"
    named : words of each joint's name, and its number, from 1
    """
    starts = range(len(words))
    own = [(len(name), n, name) for name, n in named if any(words[k : k + len(name)] == name for k in starts)]
    if own:
        _, number, name = max(own)
        return "joint", number, {"by name"} | said - {*name} - WORDS["filler"] - WORDS["joint"]
    numbers = [w for w in words if w.isdecimal()]
    joint = said & WORDS["joint"]
    rest = said - WORDS["filler"] - WORDS["joint"] - {*numbers}
    axis = said & {*_AXIS_WORDS, *_ROTATION_WORDS}
    if re.fullmatch(r"[0-3]{2}|[1-4]{2}", "".join(numbers)) and said & WORDS["matrix"] and not axis:
        return "matrix", "".join(numbers), rest - WORDS["rotation"] - WORDS["matrix"] | said & {"t"}
    if joint and len(numbers) == 1 and not axis:
        # The joint's word stays in the rest: A1 .. A6 and J1 .. J6 in one table are two groups.
        return "joint", str(int(numbers[0])), rest | joint
    # Letters of controllers for three angles: KUKA's A, B, C are about z, y, x, FANUC's W, P, R
    # about x, y, z.
    angle_letters = {"a": "yaw", "b": "pitch", "c": "roll", "w": "roll", "p": "pitch", "r": "yaw"}
    if len(said) == 1 and (letter := min(said)) in angle_letters:
        return ("abc" if letter in "abc" else "wpr"), angle_letters[letter], ()
    if len(axis) == 1:
        (word,) = axis
        if word in _ROTATION_WORDS or said & WORDS["rotation"]:
            return "turn", {**_AXIS_WORDS, **_ROTATION_WORDS}[word], rest - axis - WORDS["rotation"] | {*numbers}
        return "position", _AXIS_WORDS[word], (rest - axis) | {*numbers}
    for slot in _ROLL_PITCH_YAW:
        if rest & WORDS[slot]:
            return "roll", slot, rest - WORDS[slot] - WORDS["rotation"]
    for kind in ("time", *_CONDITIONS, "distance"):
        if rest & WORDS[kind] and not numbers:
            return kind, "", rest - WORDS[kind]
    return "", "", ()


def _groups(headings: Sequence[Heading], quantity: str, slots: Sequence[str]) -> list[list[Heading]]:
    """Return the groups of columns that fill all slots of a quantity, only those of the best rank.

    A group has equal qualifier and unexplained words, and its columns are in the order of slots.
    Measured ones rank before unqualified ones, and those with unexplained words last; nominal
    columns are excluded.
    """
    for alone in (True, False):  # words that say nothing tell groups apart, too, if they are complete
        groups: dict[tuple[str, frozenset[str], frozenset[str]], dict[str, Heading]] = {}
        for h in headings:
            if h.quantity == quantity and h.qualifier != "nominal":
                key = (h.qualifier, h.rest, frozenset(words_of(h.name)[0]) & WORDS["filler"] if alone else frozenset())
                groups.setdefault(key, {}).setdefault(h.slot, h)
        found = _best(
            # The markers of a rigid body come after the body itself.
            (_QUALIFIER_RANK[qualifier] + 3 * bool(rest) + 3 * ("marker" in filler), [members[slot] for slot in slots])
            for (qualifier, rest, filler), members in groups.items()
            if all(slot in members for slot in slots)
        )
        if found:
            return found
    return []


def position_groups(raw: RawTable) -> list[list[Heading]]:
    """Return all groups of columns that are the x, y and z of a point, without nominal ones.

    A nominal "target" counts as measured where there is no other point. Columns whose headings
    differ in the letter x, y or z alone are groups, too, and so are columns with two indices, of
    points and of coordinates.
    """
    groups: dict[tuple[object, ...], dict[str, Heading]] = {}
    headings = {h.name: h for h in _headings(raw, ()) if h.quantity == "position"}
    for name in raw.header:
        h = headings.get(name)
        numbers = frozenset(re.findall(r"\d+", name))
        if h is not None:
            key: tuple[object, ...] = (h.qualifier, h.rest, frozenset({*words_of(name)[0]} & WORDS["filler"]))
        else:
            words, unit = words_of(name)
            stem = re.sub(unit, "", name, flags=re.IGNORECASE) if unit else name
            match = re.fullmatch(r"([^xyz]{0,12})([xyz])([^xyz]{0,8})", stem, re.IGNORECASE)
            values = numbers_of(raw.frame[name]) if match else np.zeros(0)
            if not match or {*words} & WORDS["about"] or not np.isfinite(values).mean() > 0.5:
                continue
            if match[1].casefold() in ("r", "q", "o", "w", "n", "d"):
                continue
            rest = frozenset({f"{match[1]}{match[3]}".casefold().strip("_ .")})
            h = Heading(name, "position", match[2].casefold(), "", unit, rest, values)
            key = ("", rest)
        groups.setdefault(key, {}).setdefault(h.slot, replace(h, numbers=numbers))
    whole = [[g[c] for c in _XYZ] for g in groups.values() if all(c in g for c in _XYZ)]
    measured = [g for g in whole if g[0].qualifier != "nominal"]
    # The markers of a rigid body are no targets where the body itself is one.
    measured = [g for g in measured if "marker" not in words_of(g[0].name)[0]] or measured
    # A "target" is a commanded point only where there are other points; else it is a reflector.
    targets = [g for g in whole if not {*words_of(g[0].name)[0]} & (WORDS["nominal"] - WORDS["target"])]
    return measured or targets or ([] if _frames(raw) else _grid_points(raw))


def points_in_order(raw: RawTable) -> list[list[Heading]]:
    """Return groups of three neighbouring columns of a table without headings that may be points.

    There are none where some columns are rotation or homogeneous matrices.
    """
    columns = [Heading(n, "", "", "", "", frozenset(), numbers_of(raw.frame[n])) for n in raw.header]
    moving = [np.isfinite(h.values).mean() > 0.5 and np.nanstd(h.values) > 0 for h in columns]
    if any(all(moving[k : k + 9]) and _is_rotation(columns[k : k + 9]) for k in range(len(columns) - 8)):
        return []
    if any(_matrices(columns[k : k + n]) for n in (12, 16) for k in range(len(columns) - n + 1)):
        return []
    starts = [k for k in range(len(columns) - 2) if all(moving[k : k + 3])]
    return [[replace(h, numbers=frozenset({str(k)})) for h in columns[k : k + 3]] for k in starts]


def points(raw: RawTable, taken: Collection[str]) -> Question | None:
    """Return the question which columns are the measured point; None where there are no candidates.

    taken : columns that are no candidates
    """
    groups = [g for g in position_groups(raw) if not {h.name for h in g} & {*taken}]
    choices = _choices([(_listed(g), [(g, _XYZ, "length")]) for g in groups], {}, "points")
    return Question("Which columns are the measured point?", choices, "observation") if choices else None


def _grid_points(raw: RawTable) -> list[list[Heading]]:
    """Return groups of three columns whose headings have two indices, of a point and a coordinate."""
    grids: dict[str, dict[str, list[str]]] = {}
    for name in raw.header:
        if match := re.fullmatch(r"(\D*)(\d)\D{0,3}([0-3])\D*", name):
            grids.setdefault(match[1], {}).setdefault(match[2], []).append(name)
    return [
        [
            Heading(n, "position", c, "", words_of(n)[1], frozenset(), numbers_of(raw.frame[n]), None, frozenset({k}))
            for c, n in zip(_XYZ, names, strict=True)
        ]
        for points in grids.values()
        if len(points) > 1 and all(len(names) == 3 for names in points.values()) and not _turns(raw, points)
        for k, names in points.items()
    ]


def _turns(raw: RawTable, points: Mapping[str, Sequence[str]]) -> bool:
    """Return whether three groups of three columns are the rows or columns of rotation matrices."""
    R = np.stack([[numbers_of(raw.frame[n]) for n in names] for names in points.values()]).transpose(2, 0, 1)
    return len(points) == 3 and bool(np.nanmax(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3))) < ROTATION_TOLERANCE)


def _best(ranked: Iterable[tuple[int, _Group]]) -> list[_Group]:
    """Return the groups with the lowest rank; ranked : (rank, columns of the group)."""
    groups = list(ranked)
    return [members for rank, members in groups if rank == min(rank for rank, _ in groups)]


def _joints(
    headings: Iterable[Heading], n: int, free: Sequence[int], order: Mapping[str, int], own: Collection[int]
) -> list[dict[int, Heading]]:
    """Return the groups of columns that may be the joint readings, each by the number of its joint.

    Groups with the fewest missing free joints are returned, if more than half of these joints are
    present; of equal ones those whose headings are plain and of the preferred qualifier.

    n : number of joints; free : numbers of those that need a reading, as they follow no other
    own : numbers of joints with readings under casadical's own names, which are omitted; with any,
        only headings that are names of joints count for the others
    order : joint of each number, where a column of the table names it (see `_names_in_cells`)
    """
    groups: dict[tuple[str, frozenset[str]], dict[int, Heading]] = {}
    for h in sorted(headings, key=lambda h: h.led is not None):  # a joint's own column ranks first
        if h.quantity == "joint":
            number = order.get(h.slot, -1) if order and "by name" not in h.rest else int(h.slot)
            groups.setdefault((h.qualifier, h.rest), {}).setdefault(number, h)
    ranked = []
    for (qualifier, rest), members in groups.items():
        if "by name" in rest and all(str(i) in re.findall(r"\d+", h.name) for i, h in members.items()):
            # joint1 to joint5 are names of joints of the robot, joint0 is not: all count from 0.
            like = [g for (q, r), g in groups.items() if (q, r - WORDS["joint"]) == (qualifier, rest - {"by name"})]
            members = {i: h for group in (*like, members) for i, h in group.items()}
        # With numbers 0 to n and no n + 1, column 0 is no joint of this robot but, for example, a
        # row counter.
        first = 0 if 0 in members and not (n in members and n + 1 not in members) else 1
        group = {i: members[i + first - 1] for i in range(1, n + 1) if i + first - 1 in members}
        if own:  # together with our own names, only the names of joints count
            group = {i: h for i, h in group.items() if i not in own and "by name" in rest}
        elif [*group] == [*range(1, len(free) + 1)]:  # without the joints that follow others
            group = dict(zip(free, group.values(), strict=True))
        rank = _QUALIFIER_RANK[qualifier] + (0 if rest <= WORDS["joint"] | {"by name"} else 3)
        missing = len({*free} - {*group})
        if 2 * missing < len(free):
            ranked.append((rank + 10 * missing, group))
    return _best(ranked)


def _names_in_cells(raw: RawTable, names: Sequence[str]) -> dict[str, int]:
    """Return column number -> joint (from 1), where columns such as `name[0]` hold joint names.

    ROS writes JointState messages in this way. Empty where there are no such columns.

    names : of the robot's joints
    """
    joint_of = {}
    for heading in raw.header:
        numbers = re.findall(r"\d+", heading)
        if len(numbers) == 1 and "name" in words_of(heading)[0]:
            cells = {str(cell) for cell in raw.frame[heading]}
            if len(cells) == 1 and cells <= {*names}:
                joint_of[str(int(numbers[0]))] = 1 + [*names].index(cells.pop())
    return joint_of


def _numbered(raw: RawTable, n: int, taken: Collection[str] = ()) -> list[list[Heading]]:
    """Return groups of n numeric columns whose headings differ only in a number, from 0 or 1 on.

    taken : headings that are not considered
    """
    groups: dict[str, dict[int, Heading]] = {}
    for name in raw.header:
        numbers = re.findall(r"\d+", name)
        if len(numbers) == 1 and name not in taken and np.isfinite(values := numbers_of(raw.frame[name])).mean() > 0.5:
            words, unit = words_of(name)
            heading = Heading(name, "numbered", numbers[0], "", unit, frozenset(words) - {*numbers}, values)
            groups.setdefault(re.sub(r"\d+", "#", name), {})[int(numbers[0])] = heading
    return [[m[i] for i in sorted(m)] for m in groups.values() if sorted(m) in ([*range(1, n + 1)], [*range(n)])]


def _parts_of(group: Mapping[int, Heading], chain: Sequence[Joint]) -> _Parts:
    """Return the readings of revolute and of prismatic joints, and of leaders, as separate parts.

    group : number of a joint -> its column
    """
    parts: dict[str, tuple[list[Heading], list[str]]] = {}
    for i, heading in group.items():
        members, names = parts.setdefault(heading.led[1] if heading.led else chain[i - 1].kind, ([], []))
        members.append(heading)
        names.append(f"q{i}")
    return [(*part, "angle" if kind == "revolute" else "length") for kind, part in parts.items()]


def _frames(raw: RawTable, taken: Collection[str] = ()) -> _Options:
    """Return the possible meanings of columns that are homogeneous matrices, such as T00 to T33.

    They are 4x4 or 3x4 by the indices in their headings (n, o, a, p for the columns, too), or 12 or
    16 numbered columns; the values show where rotation and translation are. Six or seven numbered
    columns are a position and an orientation.

    taken : headings that are not considered
    """
    grids: dict[str, dict[tuple[int, int], str]] = {}
    for name in raw.header:
        if match := re.fullmatch(
            r"(.*?)[\[(_,.\s]*(\d)[\])(\[_,;.\s]*(\d)[\])]*(?:\s*[\[(_]\s*[a-z]+\s*[\])]?)?", name
        ):
            grids.setdefault(match[1], {})[int(match[2]), int(match[3])] = name
        elif match := re.fullmatch(r"(.*?)([noap])[_.\s]?([xyz])(?:[\s_\[(]*[a-z]+[\])]*)?", name, re.IGNORECASE):
            entry = "xyz".index(match[3].lower()), "noap".index(match[2].lower())
            grids.setdefault(f"{match[1]} noap", {})[entry] = name
    columns = []
    for grid in grids.values():
        first = min((min(entry) for entry in grid), default=0)
        if {*grid} in [
            {*product(range(first, first + r), range(first, first + c))} for r, c in ((4, 4), (3, 4), (4, 3))
        ]:
            columns.append([grid[entry] for entry in sorted(grid)])
    columns += [[h.name for h in group] for n in (12, 16) for group in _numbered(raw, n)]
    options: list[tuple[str, _Parts]] = []
    for names in columns:
        headings = [Heading(n, "", "", "", words_of(n)[1], frozenset(), numbers_of(raw.frame[n])) for n in names]
        options += _matrices(headings)
    for n in (7, 6):
        for group in _numbered(raw, n, taken):
            if not any({*words_of(h.name)[0]} & (WORDS["joint"] - WORDS["filler"]) for h in group):
                options += [
                    (f"a position, then {way}: {_listed(group)}", [(group[:3], _XYZ, "length"), (group[3:], *form)])
                    for way, form in _ORIENTATION_FORMS.items()
                    if len(form[0]) == n - 3 and (n == 6 or _is_unit(group[3:]))
                ]
    return options


def _matrices(columns: Sequence[Heading]) -> list[tuple[str, _Parts]]:
    """Return the possible meanings of 16 or 12 columns as homogeneous matrices, in words.

    Only those whose rotation is one in every row are returned; the last row of 4x4 is 0, 0, 0, 1.
    """
    by_rows, by_columns = (0, 1, 2, 4, 5, 6, 8, 9, 10), (0, 4, 8, 1, 5, 9, 2, 6, 10)
    whole, turned = tuple(range(9)), (0, 3, 6, 1, 4, 7, 2, 5, 8)
    forms: Sequence[tuple[str, Sequence[int], Sequence[int], Sequence[int]]] = (
        ("a 4x4 matrix, row by row", by_rows, (3, 7, 11), (12, 13, 14, 15)),
        ("a 4x4 matrix, column by column", by_columns, (12, 13, 14), (3, 7, 11, 15)),
    )
    if len(columns) == 12:
        forms = (
            ("a 3x4 matrix, row by row", by_rows, (3, 7, 11), ()),
            ("a 3x4 matrix, column by column", turned, (9, 10, 11), ()),
            ("a rotation, row by row, then a position", whole, (9, 10, 11), ()),
            ("a position, then a rotation, row by row", [k + 3 for k in whole], (0, 1, 2), ()),
            ("a position, then a rotation, column by column", [k + 3 for k in turned], (0, 1, 2), ()),
        )
    found: list[tuple[str, _Parts]] = []
    for words, rotation, position, last in forms:
        R, p = [columns[k] for k in rotation], [columns[k] for k in position]
        constant = _finite([columns[k] for k in last]) if last else np.zeros((1, 0))
        if (np.abs(constant - [0, 0, 0, 1][4 - len(last) :]) < 1e-9).all() and len(_finite(R)) and _is_rotation(R):
            label = f"{words}: {columns[0].name} to {columns[-1].name}"
            found.append((label, [(p, _XYZ, "length"), (R, tuple(f"R{i}{j}" for i in range(3) for j in range(3)), "")]))
    return found


def _observations(
    positions: Sequence[Sequence[Heading]], lengths: Sequence[Sequence[Heading]], frames: _Options
) -> tuple[_Options, str]:
    """Return the possible observations, and the topic (`about`) of a question on them.

    If only positions or only lengths are marked as measured, the others are dropped. The topic is
    empty unless both remain.

    positions, lengths : groups of columns, of three and of one
    frames : possible meanings of homogeneous matrices
    """
    whole = [{h.name for members, _, _ in parts for h in members} for _, parts in frames]
    positions = [g for g in positions if not any({h.name for h in g} <= names for names in whole)]
    said = [any(g[0].qualifier == "measured" for g in groups) for groups in (positions, lengths)]
    if positions and lengths and said[0] != said[1]:
        positions, lengths = (positions, ()) if said[0] else ((), lengths)
    options: list[tuple[str, _Parts]] = [(_listed(g), [(g, _XYZ, "length")]) for g in positions]
    options += [*frames, *((_listed(g), [(g, ("distance",), "length")]) for g in lengths)]
    return options, "observation" if len(options) > 1 else ""


def _orientation(headings: Sequence[Heading], raw: RawTable, taken: Collection[str]) -> tuple[_Options, str, str]:
    """Return the possible meanings of the orientation, the question, and its topic (`about`).

    headings : columns that are free; taken : names of columns in use
    """
    which = "Which columns are the orientation?"
    numbered = [g for g in _numbered(raw, 3, taken) if {*words_of(g[0].name)[0]} & WORDS["rotation"]]
    triples = [*_groups(headings, "turn", _XYZ), *numbered]
    quaternion_columns, _ = _ORIENTATION_FORMS["a quaternion, w first"]
    matrix_columns, _ = _ORIENTATION_FORMS["a matrix, row by row"]
    # Numbers of a rotation matrix's entries, counted from 0 and from 1.
    matrix_entries = tuple([f"{i}{j}" for i in range(k, k + 3) for j in range(k, k + 3)] for k in (0, 1))
    vector = _ORIENTATION_FORMS["a rotation vector"][0]
    sure = [
        ([g for g in _groups(headings, "turn", ("w", *_XYZ)) if _is_unit(g)], quaternion_columns, ""),
        *(([g for g in _groups(headings, "matrix", e) if _is_rotation(g)], matrix_columns, "") for e in matrix_entries),
        *(
            (_groups(headings, quantity, _ROLL_PITCH_YAW), _ROLL_PITCH_YAW, "angle")
            for quantity in ("roll", "abc", "wpr")
        ),
        ([g for g in triples if g[0].rest & WORDS["vector"]], vector, "angle"),
    ]
    for groups, names, quantity in sure:
        if groups:
            return [(_listed(g), [(g, names, quantity)]) for g in groups], which, ""
    ways: Sequence[str] = ()
    if groups := _groups(headings, "turn", _XYZ):
        ways = _THREE_ANGLE_FORMS
    elif groups := [g for g in _numbered(raw, 4, taken) if _is_unit(g)]:
        ways = ("a quaternion, w first", "a quaternion, w last")
    elif groups := [g for g in _numbered(raw, 9, taken) if _is_rotation(g)]:
        ways = ("a matrix, row by row", "a matrix, column by column")
    options = [(way, [(groups[0], *_ORIENTATION_FORMS[way])]) for way in ways]
    return options, f"How is the orientation {_listed(groups[0])} meant?" if groups else "", "orientation"


def _finite(group: Sequence[Heading]) -> Array:
    """Return the rows of a group's columns that are finite, shape (rows, columns)."""
    values = np.column_stack([h.values for h in group])
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def _is_unit(group: Sequence[Heading]) -> bool:
    """Return whether the rows of four columns are unit quaternions, as far as they are finite."""
    return bool((np.abs(np.linalg.norm(_finite(group), axis=1) - 1) < ROTATION_TOLERANCE).all())


def _is_rotation(group: Sequence[Heading]) -> bool:
    """Return whether the finite rows of nine columns are orthonormal matrices, mirrored or not."""
    R = _finite(group).reshape(-1, 3, 3)
    return bool((np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)) < ROTATION_TOLERANCE).all())


def _listed(group: Iterable[Heading]) -> str:
    """Return the names of headings, separated by commas."""
    return ", ".join(h.name for h in group)


def _choices(options: _Options, stated: Mapping[str, str], asked: str) -> dict[str, list[Understood]]:
    """Return a dict: possible meaning in words, with its units -> columns that it implies.

    stated : unit of lengths and angles, where a comment states it
    asked : the question, if it is asked even for a single option; without it the choices of a
        single option are its units
    """
    choices: dict[str, list[Understood]] = {}
    for label, parts in options:
        units = [_by_unit(members, names, quantity, stated) for members, names, quantity in parts if members]
        for ways in product(*units):
            unit = " and ".join(u for u, _ in ways if u)
            words = unit if unit and len(options) == 1 and not asked else f"{label} in {unit}" if unit else label
            choices[words] = [c for _, columns in ways for c in columns]
    return choices


def _by_unit(
    members: Sequence[Heading], names: Sequence[str], quantity: str, stated: Mapping[str, str]
) -> list[tuple[str, list[Understood]]]:
    """Return (unit, columns under casadical's names) of possible units, the most probable first.

    There is one entry, with an empty unit, where the unit is stated or certain by the size of the
    numbers, or the quantity has none.

    members, names : headings and casadical's names, without units; quantity : "angle", "length" or
        empty; stated : quantity -> unit that a comment states
    """
    if not quantity:
        return [("", [Understood(n, Source(h.name), "", "heading") for h, n in zip(members, names, strict=True)])]
    ours = ("deg", "rad") if quantity == "angle" else ("mm", "m")
    units = [h.unit if UNITS.get(h.unit, ("",))[0] in ours else "" for h in members]
    usual = Counter(u for u in units if u).most_common(1)
    why, sure = ["heading" if unit else "the other headings" for unit in units], True
    if usual:
        units = [u or usual[0][0] for u in units]
    elif quantity in stated:
        units, why = [stated[quantity]] * len(units), ["a line of units"] * len(units)
    else:
        unit, sure = _unit_by_size(np.column_stack([h.values for h in members]), quantity)
        units, why = [unit] * len(units), ["size of the numbers" if sure else "a guess"] * len(units)

    def columns(units: Sequence[str]) -> list[Understood]:
        """Return the columns under casadical's names, for the unit of each."""
        return [
            Understood(*_of_leader(h, name, unit), unit, f"{reason}; it drives the joint")
            if h.led
            else Understood(f"{name}_{UNITS[unit][0]}", Source(h.name, UNITS[unit][1]), unit, reason)
            for h, name, unit, reason in zip(members, names, units, why, strict=True)
        ]

    if sure:
        return [("", columns(units))]
    return [(u, columns([u] * len(units))) for u in (units[0], *(u for u in ours if u != units[0]))]


def _of_leader(heading: Heading, name: str, unit: str) -> tuple[str, Source]:
    """Return casadical's column of a joint, in rad or m, and how it is computed from its leader's.

    name : of the column, without unit; unit : word of the unit of the leader's column
    """
    assert heading.led
    kind, _, factor, offset = heading.led
    ours, scale = UNITS[unit]
    to_si = {"deg": np.pi / 180, "mm": 1e-3}.get(ours, 1.0)
    column = f"{name}_{'m' if kind == 'prismatic' else 'rad'}"
    return column, Source(heading.name, float(factor * scale * to_si), offset)


def _unit_by_size(values: Array, quantity: str) -> tuple[str, bool]:
    """Return the unit (deg, rad, mm or m) that the numbers' size suggests, and if it is certain.

    values : shape (n, k); quantity : "angle" or "length"
    """
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return ("deg" if quantity == "angle" else "mm"), False
    # Minimum number of rows from which the size of the numbers shows that these are radians or
    # metres.
    min_rows_for_unit = 10
    if quantity == "angle":
        largest = float(np.abs(values).max())
        return ("deg", True) if largest > FULL_TURN_RAD + 1 else ("rad", len(values) >= min_rows_for_unit)
    # Quantiles are used, because single outliers must not decide on the unit.
    spread = float(np.linalg.norm(np.quantile(values, 0.9, axis=0) - np.quantile(values, 0.1, axis=0)))
    # The positions of a robot spread over more than 30 mm and less than 10 m.
    return ("m", len(values) >= min_rows_for_unit) if spread < 10.0 else ("mm", spread > 30.0)


def _stated_units(lines: Sequence[str]) -> dict[str, str]:
    """Return quantity ("length", "angle") -> word of the unit that comments or titles state."""
    units: dict[str, str] = {}
    # A comment or title that states the units of the table.
    unit_line = re.compile(r"(?:units?|einheit(?:en)?|unités?|单位|単位)\s*[:=：]?\s*(.*)", re.IGNORECASE)
    for line in lines:
        match = unit_line.search(unicodedata.normalize("NFKC", line))
        for word in re.findall(r"[^\s,;:/()\[\]]+", match[1].casefold()) if match else ():
            if word in UNITS:
                quantity = {"mm": "length", "m": "length", "deg": "angle", "rad": "angle"}.get(UNITS[word][0])
                if quantity:
                    units.setdefault(quantity, word)
    return units


def layout(raw: RawTable, chain: Sequence[Joint]) -> Question | None:
    """Return the question which columns of a table without headings are what; None without choices.

    A choice has readings of all free joints in neighbouring columns, and a position or a matrix in
    others; where some columns are matrices, only choices with a matrix are returned.
    """
    values = [numbers_of(raw.frame[name]) for name in raw.header]
    columns = [Heading(n, "", "", "", "", frozenset(), v) for n, v in zip(raw.header, values, strict=True)]
    numeric = np.array([bool(np.isfinite(v).mean() > 0.5) for v in values])
    free = [i for i, joint in enumerate(chain, 1) if joint.coupling is None]
    seen: list[tuple[int, int, tuple[str, _Parts]]] = []
    for width in (16, 12):
        for k in range(len(columns) - width + 1 if not seen else 0):
            if numeric[k : k + width].all():
                seen += [(k, k + width, form) for form in _matrices(columns[k : k + width])]
    for fits, width in ((_is_rotation, 9), (_is_unit, 4)):  # no readings, and no positions
        for k in range(len(columns) - width + 1 if not seen else 0):
            window = slice(k, k + width)
            if numeric[window].all() and len(_finite(columns[window])) and fits(columns[window]):
                numeric[window] = False
    for k in range(len(columns) - 2 if not seen else 0):
        part = columns[k : k + 3]
        if numeric[k : k + 3].all() and all(np.nanstd(h.values) > 0 for h in part):
            seen.append((k, k + 3, (f"position: {_listed(part)}", [(part, _XYZ, "length")])))
    options: list[tuple[str, _Parts]] = []
    for j in range(len(columns) - len(free) + 1):
        readings = columns[j : j + len(free)]
        most = max(float(np.nanmax(np.abs(h.values))) for h in readings) if numeric[j : j + len(free)].all() else np.inf
        if most <= 4 * 360:
            label = f"readings: {readings[0].name} to {readings[-1].name}"
            parts = _parts_of(dict(zip(free, readings, strict=True)), chain)
            options += [
                (f"{label}; {words}", [*parts, *what])
                for start, end, (words, what) in seen
                if end <= j or start >= j + len(free)
            ]
    stated = _stated_units([*raw.comments, *(text for _, text in raw.form.skipped)])
    choices = _choices(options, stated, "layout")
    return Question("Which columns are what?", choices, "layout") if choices else None


def orientations_in_order(raw: RawTable, taken: Collection[str]) -> Iterator[Question]:
    """Yield the question which columns of a table without headings are an orientation, if some are.

    These are a unit quaternion, a matrix or three angles in neighbouring columns, except
    constant columns and those that are taken.

    taken : names of columns in use
    """
    values = {name: numbers_of(raw.frame[name]) for name in raw.header if name not in taken}
    columns = [
        Heading(name, "", "", "", "", frozenset(), v)
        for name, v in values.items()
        if np.isfinite(v).mean() > 0.5 and np.nanstd(v) > 0
    ]
    options: list[tuple[str, _Parts]] = []
    forms = (
        (9, ("a matrix, row by row",), _is_rotation),
        (4, ("a quaternion, w first", "a quaternion, w last"), _is_unit),
        (3, tuple(_ORIENTATION_FORMS)[:4], bool),
    )
    for width, words, fits in forms:
        for k in range(len(columns) - width + 1 if not options else 0):
            group = columns[k : k + width]
            if fits(group):
                options += [(f"{way}: {_listed(group)}", [(group, *_ORIENTATION_FORMS[way])]) for way in words]
    if choices := _choices(options, {}, "orientation"):
        yield Question("Which columns are the orientation?", choices, "orientation")


def _by_order(raw: RawTable, n: int) -> list[Heading]:
    """Return headings for a table without any: n readings, x, y, z, possibly a rotation matrix.

    A first column that counts the rows is skipped; the list is empty if the number of columns
    differs.
    """
    values = [numbers_of(raw.frame[name]) for name in raw.header]
    slots = [("joint", str(i)) for i in range(1, n + 1)] + [("position", c) for c in _XYZ]
    matrix = [("matrix", f"{i}{j}") for i in range(3) for j in range(3)]
    for what in (slots, [*slots, *matrix]):
        start = len(raw.header) - len(what)
        if start == 0 or (start == 1 and (np.diff(values[0]) == 1).all()):
            return [
                Heading(raw.header[k], quantity, slot, "", "", frozenset(), values[k])
                for k, (quantity, slot) in enumerate(what, start)
            ]
    return []
