"""Proposed meanings of a table's columns: joint readings, observations and conditions, with units.

Only quantities that are missing under casadical's own names are searched for: by their headings,
and where these do not tell, by their order. A unit comes from the heading, else from a row of
units, a comment, or the size of the numbers. Where several meanings are possible, a question is
returned whose first choice is the most probable answer; `casadical.project.recognition` answers it
by the robot.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Joint
from casadical.measurements.columns import FULL_TURN_RAD, MAX_TURNS, Source, columns_used, numbers_of, seconds_of_one
from casadical.measurements.headings import (
    CONDITION_COLUMNS,
    QUALIFIER_RANK,
    ROLL_PITCH_YAW,
    Heading,
    best_of,
    complete_groups,
    finite_rows,
    groups_of,
    headings_of,
    in_order,
    is_rotation,
    is_unit,
    numbered,
    words_of,
)
from casadical.measurements.kinds.position import FIRST_ORIENTATION_COLUMN
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.raw_table import RawTable
from casadical.measurements.vocabulary import UNITS, WORDS

# Form of an orientation in words -> casadical's columns, without units, and their quantity.
_ORIENTATION_FORMS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "a rotation vector": (tuple(f"rotvec_{c}" for c in "xyz"), "angle"),
    "angles about x, then the new y, then the new z": (tuple(f"r{c}" for c in "xyz"), "angle"),
    "roll, pitch, yaw: angles about the fixed x, y, z": (ROLL_PITCH_YAW, "angle"),
    "angles about z, then the new y, then the new x": (ROLL_PITCH_YAW[::-1], "angle"),
    "a quaternion, w first": (("qw", "qx", "qy", "qz"), ""),
    "a quaternion, w last": (("qx", "qy", "qz", "qw"), ""),
    "a matrix, row by row": (tuple(f"R{i}{j}" for i in range(3) for j in range(3)), ""),
    "a matrix, column by column": (tuple(f"R{j}{i}" for i in range(3) for j in range(3)), ""),
}
# Headings, casadical's names for them, and their quantity: "angle", "length", or empty for one
# without a unit.
_Parts = Sequence[tuple[Sequence[Heading], Sequence[str], str]]
# Possible meanings: each in words, with the columns that it implies.
_Options = Sequence[tuple[str, _Parts]]


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
    about : "orientation", "observation", "layout" (of a table without headings) or "order" (such a
        layout whose first choice holds where the robot does not decide): the robot's model ranks
        the choices; else ""
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

    @property
    def in_usual_order(self) -> "Understanding":
        """The understanding, with the columns of a table without headings in their usual order."""
        found = self
        for question in self.questions:
            if question.about == "order":
                found = found.answered(question, next(iter(question.choices)), "order of the columns")
        return found


def understand(
    raw: RawTable,
    joints: Sequence[str | Joint],
    given: Mapping[str, str | Source] | None = None,
    *,
    kind: str | None = None,
) -> Understanding:
    """Return the meaning of a table's columns whose headings are not casadical's own.

    joints : each joint with its name and coupling, or its kind alone ("revolute", "prismatic")
    given : casadical's column name -> its source, of columns that are assigned already
    kind : kind of measurement, None where it is not declared
    """
    chain = [Joint(kind=j) if isinstance(j, str) else j for j in joints]  # type: ignore[arg-type]
    free = [i for i, joint in enumerate(chain, 1) if joint.coupling is None]
    assigned = {name: Source(s) if isinstance(s, str) else s for name, s in (given or {}).items()}
    taken = {name for name, _ in columns_used(assigned)}
    ours = {*raw.header, *assigned}
    own = {int(m[1]) for h in ours if (m := re.fullmatch(r"q(\d+)_(deg|rad|mm|m)", h))}
    headings = headings_of(raw, chain)
    stated: dict[str, str] = {}
    # A comment or title that states the units of the table.
    unit_line = re.compile(r"(?:units?|einheit(?:en)?|unités?|单位|単位)\s*[:=：]?\s*(.*)", re.IGNORECASE)
    for line in [*raw.comments, *(text for _, text in raw.form.skipped)]:
        match = unit_line.search(unicodedata.normalize("NFKC", line))
        for word in re.findall(r"[^\s,;:/()\[\]]+", match[1].casefold()) if match else ():
            unit = UNITS.get(word, ("", 1.0))[0]
            if quantity := {"mm": "length", "m": "length", "deg": "angle", "rad": "angle"}.get(unit):
                stated.setdefault(quantity, word)
    # A table without headings of just the readings and a position, perhaps with a matrix, needs no
    # robot to be understood.
    layout = "" if raw.form.header_line else "layout"
    if layout and len(in_order(raw)) - len(free) in (3, 12):
        layout = "order"
    # Only kinds that determine the scale count: a column "point" alone names touched points, but
    # together with positions it may name the points of a tracker.
    seen = {each.name for each in kinds().values() if each.has_scale and each.matches(ours)}
    if not all({f"{c}_mm", f"{c}_m"} & ours for c in "xyz") and groups_of(headings, "position", "xyz"):
        seen -= {"position", "position_covariance", "pose"}  # one axis in another unit: z_cm
    columns: list[Understood] = []
    questions: list[Question] = []

    def decide(options: _Options, which: str, about: str = "", ask: bool = False) -> None:
        """Add the columns of the only possible meaning and unit; with several, add a question.

        ask : whether it is asked for a single option, too
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
        names = [j.name for j in chain]
        joint_of = {}
        for heading in raw.header:
            numbers = re.findall(r"\d+", heading)
            if len(numbers) == 1 and "name" in words_of(heading)[0]:
                cells = {str(cell) for cell in raw.frame[heading]}
                if len(cells) == 1 and cells <= {*names}:
                    joint_of[str(int(numbers[0]))] = 1 + [*names].index(cells.pop())
        groups = _joints(headings, len(chain), open_joints, joint_of, own)
        unknown = not (groups or own)  # where some readings are named, the others are missing
        if unknown:
            some = numbered(raw, len(free), taken)
            some = [g for g in some if np.abs(finite_rows(g)).max(initial=0) <= 360 * MAX_TURNS]
            groups = [dict(zip(free, g, strict=True)) for g in some]
        text = "Are these the joint readings?" if unknown else "Which columns are the joint readings?"
        decide([(_listed(g.values()), _parts_of(g, chain)) for g in groups], text, layout, unknown)
    ways = [columns, *(way for q in questions for way in q.choices.values())]
    read = {c.source.name for c in ways[-1]} if len(ways) < 3 else set()
    claimed = taken | {c.source.name for way in (ways[:1] if layout else ways) for c in way}
    if not seen:
        positions = [] if kind == "distance" else groups_of(headings, "position", "xyz")
        lengths = groups_of(headings, "distance", ("",)) if kind in (None, "distance") else []
        read |= {h for h in raw.header if re.fullmatch(r"approach\d+", h)}
        frames = _frames(raw, read) if kind in (None, "position", "pose") else []
        if not (positions or frames or lengths):
            some = position_groups(raw) if layout else numbered(raw, 3, claimed)
            words = WORDS["translation"] | WORDS["instrument"]
            some = [g for g in some if layout or {*words_of(g[0].name)[0]} & words]
            positions = [g for g in some if not claimed & {h.name for h in g}]
            # Positions behind the readings come first.
            first = {c.source.name for way in ways[1:2] for c in way}
            positions.sort(key=lambda g: bool(first & {h.name for h in g}))
        options, about = _observations(positions, lengths, frames)
        decide(options, "What was measured?", layout or about)
    turned = any(re.fullmatch(FIRST_ORIENTATION_COLUMN, name) for name in ours)
    turned = turned or kind not in (None, "pose", "relative_pose")
    turned = turned or any(c.ours == "R00" for c in columns) or bool(layout and questions)
    if not turned and (not seen or seen & {"position", "relative_pose"}):
        ways = [columns, *(way for q in questions for way in q.choices.values())]
        taken |= {name for way in ways for c in way for name in (c.source.name, *c.source.add)}
        decide(*_orientation([h for h in headings if h.name not in taken], raw, taken), ask=bool(layout))
    if layout:
        columns = [replace(c, why="order of the columns") for c in columns]
    if seen and not without_readings:  # with our own names, only headings with a unit count
        headings = [h for h in headings if h.unit]
    columns += [*_logged_quantities(headings, ours), *_words_of_rows(raw, ours)]
    return Understanding(tuple(columns), tuple(questions))


def _logged_quantities(headings: Collection[Heading], ours: Collection[str]) -> Iterator[Understood]:
    """Yield temperature and payload, each if exactly one heading names it, and the column time_s.

    The time is named by one heading, or by two with its seconds and nanoseconds. The unit of time
    stamps without one follows from their size.
    """
    for quantity, (name, unit) in CONDITION_COLUMNS.items():
        named = [h for h in headings if h.quantity == quantity and not h.rest and UNITS.get(h.unit, (unit,))[0] == unit]
        if len(named) == 1 and name not in ours and np.isfinite(named[0].values).all():
            factor = UNITS.get(named[0].unit, ("", 1.0))[1]
            yield Understood(name, Source(named[0].name, factor), named[0].unit or unit, "heading")
    named = [h for h in headings if h.quantity == "time" and not h.rest and UNITS.get(h.unit, ("s",))[0] == "s"]
    named = [h for h in named if np.isfinite(h.values).all()]
    fine = [h for h in named if UNITS.get(h.unit, ("", 1.0))[1] == 1e-9]
    whole = [h for h in named if h not in fine] or fine
    if "time_s" in ours or len(whole) != 1 or len(fine) > 1:
        return
    factor = seconds_of_one(whole[0].values, whole[0].unit)
    if np.median(np.abs(whole[0].values)) * factor < 1e10:  # [s]; the year 2286 and later is no time stamp
        add = {h.name: 1e-9 for h in fine if h is not whole[0]}
        yield Understood("time_s", Source(whole[0].name, factor, add=add), whole[0].unit or "s", "heading")


def _words_of_rows(raw: RawTable, ours: Collection[str]) -> Iterator[Understood]:
    """Yield the column `tool`, and the directions from which joints approached a pose.

    The column of a measured target's name has a word for a target in its heading, and few names,
    each at six poses or more on average; directions of approach are found by their headings.
    """
    for name in raw.header:
        words = set(words_of(name)[0])
        if "tool" not in ours and words & WORDS["target"] and words <= WORDS["target"] | WORDS["dh_joint"]:
            cells = raw.frame[name].dropna().astype(str)
            # A target has at least six poses on average; otherwise the names are remarks.
            if len(cells) == len(raw.frame) and 1 < cells.nunique() <= len(cells) / 6:
                yield Understood("tool", Source(name), "", "heading")
                break
    for name in raw.header:
        said = words_of(name)[0]
        numbers = [w for w in said if w.isdecimal()]
        if {*said} & WORDS["approach"] and len(numbers) == 1 and f"approach{int(numbers[0])}" not in ours:
            yield Understood(f"approach{int(numbers[0])}", Source(name), "", "heading")


def position_groups(raw: RawTable) -> list[list[Heading]]:
    """Return all groups of columns that are the x, y and z of a point, without nominal ones.

    A nominal "target" counts as measured where there is no other point. Columns whose headings
    differ in the letter x, y or z alone are groups, too, and so are columns with two indices, of
    points and of coordinates. In a table without headings, all neighbours that move are groups.
    """
    if not raw.form.header_line:
        moving = [g for g in numbered(raw, 3) if all(np.nanstd(h.values) > 0 for h in g)]
        return [] if _frames(raw) else [[replace(h, slot=c) for c, h in zip("xyz", g, strict=True)] for g in moving]
    named = {h.name: h for h in headings_of(raw, ()) if h.quantity == "position"}
    headings = [named[name] if name in named else _by_letter(raw, name) for name in raw.header]
    whole = [g for _, g in complete_groups([h for h in headings if h], "xyz")]
    measured = [g for g in whole if g[0].qualifier != "nominal"]
    # The markers of a rigid body are no targets where the body itself is one.
    measured = [g for g in measured if "marker" not in words_of(g[0].name)[0]] or measured
    # A "target" is a commanded point only where there are other points; else it is a reflector.
    targets = [g for g in whole if not {*words_of(g[0].name)[0]} & (WORDS["nominal"] - WORDS["target"])]
    return measured or targets or ([] if _frames(raw) else _grid_points(raw))


def _by_letter(raw: RawTable, name: str) -> Heading | None:
    """Return a heading that has one letter x, y or z as a coordinate; None for others."""
    words, unit = words_of(name)
    stem = re.sub(unit, "", name, flags=re.IGNORECASE) if unit else name
    match = re.fullmatch(r"([^xyz]{0,12})([xyz])([^xyz]{0,8})", stem, re.IGNORECASE)
    values = numbers_of(raw.frame[name]) if match else np.zeros(0)
    if not match or {*words} & WORDS["about"] or not np.isfinite(values).mean() > 0.5:
        return None
    if match[1].casefold() in ("r", "q", "o", "w", "n", "d"):
        return None
    rest = frozenset({f"{match[1]}{match[3]}".casefold().strip("_ .")})
    return Heading(name, values, unit, "position", match[2].casefold(), rest=rest)


def _grid_points(raw: RawTable) -> list[list[Heading]]:
    """Return groups of three columns whose headings have two indices, of a point and a coordinate."""
    grids: dict[str, dict[str, list[Heading]]] = {}
    for name in raw.header:
        if match := re.fullmatch(r"(\D*)(\d)\D{0,3}([0-3])\D*", name):
            found = grids.setdefault(match[1], {}).setdefault(match[2], [])
            values, unit = numbers_of(raw.frame[name]), words_of(name)[1]
            found.append(Heading(name, values, unit, "position", "xyz"[len(found) % 3], rest=frozenset({match[2]})))
    whole = [[*g.values()] for g in grids.values() if len(g) > 1 and all(len(part) == 3 for part in g.values())]
    # Three groups of three columns may be the rows or the columns of rotation matrices.
    return [part for g in whole if len(g) != 3 or not is_rotation([h for p in g for h in p]) for part in g]


def points(raw: RawTable, taken: Collection[str]) -> Question | None:
    """Return the question which columns are the measured point; None where there are no candidates.

    taken : columns that are no candidates
    """
    groups = [g for g in position_groups(raw) if not {h.name for h in g} & {*taken}]
    choices = _choices([(_listed(g), [(g, "xyz", "length")]) for g in groups], {}, "points")
    return Question("Which columns are the measured point?", choices, "observation") if choices else None


def _joints(
    headings: Iterable[Heading], n: int, free: Sequence[int], order: Mapping[str, int], own: Collection[int]
) -> list[dict[int, Heading]]:
    """Return the groups of columns that may be the joint readings, each by the number of its joint.

    Groups with the fewest missing free joints are returned, if more than half of these joints are
    present; of equal ones those whose headings are plain and of the preferred qualifier.
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
        rank = QUALIFIER_RANK[qualifier] + (0 if rest <= WORDS["joint"] | {"by name"} else 3)
        missing = len({*free} - {*group})
        if 2 * missing < len(free):
            ranked.append((rank + 10 * missing, group))
    return best_of(ranked)


def _parts_of(group: Mapping[int, Heading], chain: Sequence[Joint]) -> _Parts:
    """Return readings of revolute joints, of prismatic ones, and of leaders, as separate parts."""
    parts: dict[str, tuple[list[Heading], list[str]]] = {}
    for i, heading in group.items():
        members, names = parts.setdefault(heading.led[1] if heading.led else chain[i - 1].kind, ([], []))
        members.append(heading)
        names.append(f"q{i}")
    return [(*part, "angle" if kind == "revolute" else "length") for kind, part in parts.items()]


def _frames(raw: RawTable, taken: Collection[str] = ()) -> _Options:
    """Return the possible meanings of columns that are homogeneous matrices, such as T00 to T33.

    They are 4x4 or 3x4 by the indices in their headings (n, o, a, p for the columns, too), or 12 or
    16 numbered columns; the values show where rotation and translation are. Six or seven columns
    with numbered headings are a position and an orientation.
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
    columns = numbered(raw, 16, fits=bool)
    for grid in grids.values():
        first = min((min(entry) for entry in grid), default=0)
        if {*grid} in [
            {*product(range(first, first + r), range(first, first + c))} for r, c in ((4, 4), (3, 4), (4, 3))
        ]:
            names = [grid[entry] for entry in sorted(grid)]
            columns.append([Heading(name, numbers_of(raw.frame[name]), words_of(name)[1]) for name in names])
    options = [form for group in columns for form in _matrices(group)]
    options = options or [form for group in numbered(raw, 12, fits=bool) for form in _matrices(group)]
    for n in (7, 6) if raw.form.header_line else ():
        for group in numbered(raw, n, taken):
            if not any({*words_of(h.name)[0]} & (WORDS["joint"] - WORDS["filler"]) for h in group):
                options += [
                    (
                        f"a position, then {way}: {_listed(group)}",
                        [(group[:3], "xyz", "length"), (group[3:], *form)],
                    )
                    for way, form in _ORIENTATION_FORMS.items()
                    if len(form[0]) == n - 3 and (n == 6 or is_unit(group[3:]))
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
        constant = finite_rows([columns[k] for k in last]) if last else np.zeros((1, 0))
        if (np.abs(constant - [0, 0, 0, 1][4 - len(last) :]) < 1e-9).all() and is_rotation(R):
            label = f"{words}: {columns[0].name} to {columns[-1].name}"
            found.append((label, [(p, "xyz", "length"), (R, *_ORIENTATION_FORMS["a matrix, row by row"])]))
    return found


def _observations(
    positions: Sequence[Sequence[Heading]], lengths: Sequence[Sequence[Heading]], frames: _Options
) -> tuple[_Options, str]:
    """Return the possible observations, and the topic (`about`) of a question on them.

    If only positions or only lengths are marked as measured, the others are dropped. The topic is
    empty unless both remain.
    """
    whole = [{h.name for members, _, _ in parts for h in members} for _, parts in frames]
    positions = [g for g in positions if not any({h.name for h in g} <= names for names in whole)]
    said = [any(g[0].qualifier == "measured" for g in groups) for groups in (positions, lengths)]
    if positions and lengths and said[0] != said[1]:
        positions, lengths = (positions, ()) if said[0] else ((), lengths)
    options: list[tuple[str, _Parts]] = [(_listed(g), [(g, "xyz", "length")]) for g in positions]
    options += [*frames, *((_listed(g), [(g, ("distance",), "length")]) for g in lengths)]
    return options, "observation" if len(options) > 1 else ""


def _orientation(headings: Sequence[Heading], raw: RawTable, taken: Collection[str]) -> tuple[_Options, str, str]:
    """Return the possible meanings of the orientation, the question, and its topic (`about`)."""
    which = "Which columns are the orientation?"
    turns = groups_of(headings, "turn", "xyz")
    named = [g for g in numbered(raw, 3, taken) if {*words_of(g[0].name)[0]} & WORDS["rotation"]]
    # Numbers of a rotation matrix's entries, counted from 0 and from 1.
    entries = tuple([f"{i}{j}" for i in range(k, k + 3) for j in range(k, k + 3)] for k in (0, 1))
    forms = tuple(_ORIENTATION_FORMS)[:4]  # forms of an orientation in three numbers
    sure = [
        ([g for g in groups_of(headings, "turn", ("w", *"xyz")) if is_unit(g)], "a quaternion, w first"),
        *(([g for g in groups_of(headings, "matrix", e) if is_rotation(g)], "a matrix, row by row") for e in entries),
        *((groups_of(headings, quantity, ROLL_PITCH_YAW), forms[2]) for quantity in ("roll", "abc", "wpr")),
        ([g for g in [*turns, *named] if g[0].rest & WORDS["vector"]], "a rotation vector"),
    ]
    for groups, way in sure:
        if groups:
            return [(_listed(g), [(g, *_ORIENTATION_FORMS[way])]) for g in groups], which, ""
    unsure = [
        (turns, forms[:3]),
        (numbered(raw, 4, taken, is_unit), ("a quaternion, w first", "a quaternion, w last")),
        (numbered(raw, 9, taken, is_rotation), ("a matrix, row by row", "a matrix, column by column")),
        ([] if raw.form.header_line else position_groups(raw), forms),
    ]
    for groups, ways in unsure:
        if groups := [g for g in groups if not {h.name for h in g} & {*taken}]:
            several = len(groups) > 1
            text = which if several else f"How is the orientation {_listed(groups[0])} meant?"
            some = [(f"{way}: {_listed(g)}" * several or way, g, way) for g in groups for way in ways]
            return [(words, [(g, *_ORIENTATION_FORMS[way])]) for words, g, way in some], text, "orientation"
    return [], "", ""


def _listed(group: Iterable[Heading]) -> str:
    """Return the names of headings, separated by commas."""
    return ", ".join(h.name for h in group)


def _choices(options: _Options, stated: Mapping[str, str], asked: str) -> dict[str, list[Understood]]:
    """Return a dict: possible meaning in words, with its units -> columns that it implies.

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
    """Return casadical's column of a joint, in rad or m, and how it follows from its leader's."""
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
