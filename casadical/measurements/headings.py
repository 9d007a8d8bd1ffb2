"""What a table's own headings mean: joint readings, what was measured, and conditions, with their units.

Only what is missing under our own names is looked for. A unit comes from the heading, else from a row of units, a
comment, or the size of the numbers; where none of these tells, a question is left, with the most probable answer first.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from casadical.core.basics import Array
from casadical.measurements.columns import RADIANS, Source, in_seconds, numbers_of
from casadical.measurements.kinds.position import FIRST
from casadical.measurements.kinds.registry import kinds
from casadical.measurements.raw_table import RawTable
from casadical.measurements.vocabulary import UNITS, UNSPACED, WORDS

_BRACKETS = re.compile(r"[\[({<【]([^\])}>】]*)[\])}>】]|(?:\bin\b|[,/_])\s*([^\s,/_]+)\s*$")
_UNIT_LINE = re.compile(r"(?:units?|einheit(?:en)?|unités?|单位|単位)\s*[:=：]?\s*(.*)", re.IGNORECASE)
FEW = 10
# Quaternions and matrices are rounded.
NEARLY = 1e-2
_RANK = {"measured": 0, "": 1, "nominal": 2}
_OTHERS = {"temperature": ("temperature_degC", "degC"), "load": ("payload_kg", "kg")}
# Words that say an axis: of a position, and of an orientation.
_AXES = {f"{before}{c}": c for before in ("", "p", "t") for c in "xyz"}
_TURNS = {f"{before}{c}": c for before in ("r", "q", "o") for c in "xyzw"} | {"w": "w"}
# Three angles as controllers call them: KUKA's A, B, C are about z, y, x, FANUC's W, P, R about x, y, z.
_LETTERS = {"a": "yaw", "b": "pitch", "c": "roll", "w": "roll", "p": "pitch", "r": "yaw"}
_ROLL, _QUATERNION = ("roll", "pitch", "yaw"), ("qw", "qx", "qy", "qz")
_MATRIX = tuple(f"R{i}{j}" for i in range(3) for j in range(3))
_XYZ = ("x", "y", "z")
_ENTRIES = tuple([f"{i}{j}" for i in range(k, k + 3) for j in range(k, k + 3)] for k in (0, 1))
# Ways to read three angles rx, ry, rz, with our names for them.
_TRIPLES = {
    "a rotation vector": tuple(f"rotvec_{c}" for c in _XYZ),
    "angles about x, then the new y, then the new z": tuple(f"r{c}" for c in _XYZ),
    "roll, pitch, yaw: angles about the fixed x, y, z": _ROLL,
}


@dataclass(frozen=True)
class Understood:
    """One column: our name for it, where it comes from, its unit in the file, and how that is known."""

    ours: str
    source: Source
    unit: str
    why: str


@dataclass(frozen=True)
class Question:
    """What the table does not tell.

    choices : in words, with the columns that each means; the first is the most probable
    about : "orientation" or "observation", on which the robot's model may answer; else nothing
    """

    text: str
    choices: Mapping[str, Sequence[Understood]]
    about: str = ""


@dataclass(frozen=True)
class Understanding:
    """What is understood of a table: columns with other names than ours, and questions on what is open."""

    columns: tuple[Understood, ...] = ()
    questions: tuple[Question, ...] = ()

    @property
    def sources(self) -> dict[str, Source]:
        """Where each of our columns comes from, by the first choices of what is open."""
        first = (c for question in self.questions for c in next(iter(question.choices.values())))
        return {c.ours: c.source for c in (*self.columns, *first)}

    def answered(self, question: Question, choice: str, why: str = "") -> "Understanding":
        """With one of a question's choices; why : how that is known, where not as the columns say."""
        chosen = (replace(c, why=why or c.why) for c in question.choices[choice])
        return Understanding((*self.columns, *chosen), tuple(q for q in self.questions if q is not question))


@dataclass(frozen=True)
class _Heading:
    """quantity : what it says; slot : which part of it (number of a joint, axis); rest : words that tell us nothing"""

    name: str
    quantity: str
    slot: str
    qualifier: str
    unit: str
    rest: frozenset[str]
    values: Array = field(compare=False)


# Columns with our names for them, and their quantity: angle, length, or nothing of a unit.
_Parts = Sequence[tuple[Sequence[_Heading], Sequence[str], str]]
# What may be meant, in words, and the columns of each.
_Options = Sequence[tuple[str, _Parts]]


def understand(
    raw: RawTable,
    joints: Sequence[str],
    given: Collection[str] = (),
    *,
    names: Sequence[str] = (),
    kind: str | None = None,
) -> Understanding:
    """The columns of a table with other headings than ours.

    joints : kind of each ("revolute", "prismatic"); names : of them, as in a URDF; given : our names that are known
    kind : of measurement, where it is said
    """
    ours = {*raw.header, *given}
    own = {int(m[1]) for h in ours if (m := re.fullmatch(r"q(\d+)_(deg|rad|mm|m)", h))}
    headings = _headings(raw, names) if raw.form.header_line else _by_order(raw, len(joints))
    stated = _stated_units([*raw.comments, *(text for _, text in raw.form.skipped)])
    # A column "point" names points that are touched, or, beside positions, the points of a tracker.
    seen = {each.name for each in kinds().values() if each.has_scale and each.matches(ours)}
    columns: list[Understood] = []
    questions: list[Question] = []

    def decide(options: _Options, which: str, about: str = "", ask: bool = False) -> None:
        choices = _choices(options, stated, which if ask else "")
        if len(choices) == 1 and not ask:
            columns.extend(next(iter(choices.values())))
        elif choices:
            unsure = _listed([h for members, _, _ in options[0][1] for h in members])
            text = which if len(options) > 1 or ask else f"In which unit are {unsure}?"
            questions.append(Question(text, choices, about))

    without_readings = bool(set(range(1, len(joints) + 1)) - own)
    if without_readings:
        groups = _joints(headings, len(joints), _names_in_cells(raw, names))
        unknown = not (groups or own)  # where some readings are named, the others are missing
        if unknown:
            numbered = _numbered(raw, len(joints))
            groups = numbered if len(numbered) == 1 else []
        text = "Are these the joint readings?" if unknown else "Which columns are the joint readings?"
        decide([(_listed(group), _parts_of(group, joints)) for group in groups], text, ask=unknown)
    if not seen:
        positions = [] if kind == "distance" else _groups(headings, "position", _XYZ)
        lengths = _groups(headings, "distance", ("",)) if kind in (None, "distance") else []
        options, about = _observations(positions, lengths)
        decide(options, "What was measured?", about)
    turned = any(re.fullmatch(FIRST, name) for name in ours) or kind not in (None, "pose", "relative_pose")
    if not turned and (not seen or seen & {"position", "relative_pose"}):
        ways = (columns, *(way for q in questions for way in q.choices.values()))
        taken = {*given, *(name for way in ways for c in way for name in (c.source.name, *c.source.add))}
        free = [h for h in headings if h.name not in taken]
        decide(*_orientation(free, raw, taken))
    if seen and not without_readings:  # beside our own names only what is said with its unit
        headings = [h for h in headings if h.unit]
    columns += [*_conditions(headings, ours), *_times(headings, ours), *_tools(raw, ours)]
    if not raw.form.header_line:
        columns = [replace(c, why=f"order of the columns, {c.why}") for c in columns]
    return Understanding(tuple(columns), tuple(questions))


def _conditions(headings: Iterable[_Heading], ours: Collection[str]) -> Iterator[Understood]:
    """Temperature and payload, where exactly one heading names them."""
    for quantity, (name, unit) in _OTHERS.items():
        named = [h for h in headings if h.quantity == quantity and not h.rest and UNITS.get(h.unit, (unit,))[0] == unit]
        if len(named) == 1 and name not in ours and np.isfinite(named[0].values).all():
            factor = UNITS.get(named[0].unit, ("", 1.0))[1]
            yield Understood(name, Source(named[0].name, factor), named[0].unit or unit, "heading")


def _times(headings: Iterable[_Heading], ours: Collection[str]) -> Iterator[Understood]:
    """Time, where one heading names it, or two with its seconds and nanoseconds; dates and stamps count, too."""
    named = [h for h in headings if h.quantity == "time" and not h.rest and UNITS.get(h.unit, ("s",))[0] == "s"]
    named = [h for h in named if np.isfinite(h.values).all()]
    fine = [h for h in named if UNITS.get(h.unit, ("", 1.0))[1] == 1e-9]
    whole = [h for h in named if h not in fine] or fine
    if "time_s" in ours or len(whole) != 1 or len(fine) > 1:
        return
    size = float(np.median(np.abs(whole[0].values)))
    # Time stamps below these sizes are in seconds, milliseconds and microseconds.
    stamps = ((1e11, 1.0), (1e14, 1e-3), (1e17, 1e-6))
    factor = UNITS[whole[0].unit][1] if whole[0].unit else next((f for most, f in stamps if size < most), 1e-9)
    if size * factor < 1e10:  # the latest possible one [s]
        add = {h.name: 1e-9 for h in fine if h is not whole[0]}
        yield Understood("time_s", Source(whole[0].name, factor, add=add), whole[0].unit or "s", "heading")


def _tools(raw: RawTable, ours: Collection[str]) -> Iterator[Understood]:
    """A column of names that say which target was measured: few names, each at several poses."""
    for name in raw.header:
        words = set(words_of(name)[0])
        if "tool" not in ours and words & WORDS["target"] and words <= WORDS["target"] | WORDS["dh_joint"]:
            cells = raw.frame[name].dropna().astype(str)
            # Six poses at least of each target, on average.
            if len(cells) == len(raw.frame) and 1 < cells.nunique() <= len(cells) / 6:
                yield Understood("tool", Source(name), "", "heading")
                return


def words_of(heading: str) -> tuple[list[str], str]:
    """The words of a heading in lower case, and its unit, as in `UNITS`, or nothing."""
    text = unicodedata.normalize("NFKC", heading).strip()
    unit = ""
    for match in _BRACKETS.finditer(text):
        word = (match[1] or match[2] or "").strip().casefold()
        if word in UNITS:
            unit, text = word, text[: match.start()] + " " + text[match.end() :]
            break
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).casefold()
    words = re.findall(r"[^\W\d_]+|\d+", UNSPACED.sub(lambda m: f" {m[0]} ", text))
    if not unit and words and words[-1] in UNITS and len(words) > 1 and len(words[-1]) > 1:
        unit = words.pop()
    return words, unit


def _headings(raw: RawTable, names: Sequence[str]) -> list[_Heading]:
    """What each heading says that says something; names : of the joints."""
    below = [*raw.form.units, *([""] * len(raw.header))]
    named = [(words_of(name)[0], str(i)) for i, name in enumerate(names, 1) if name]
    headings = []
    for k, name in enumerate(raw.header):
        words, unit = words_of(name)
        if not words or set(words) & WORDS["about"]:
            continue
        said = {w for w in words if w not in WORDS["measured"] | WORDS["nominal"]}
        quantity, slot, rest = _meaning(words, said, named)
        cells = raw.frame.iloc[:, k]
        values = in_seconds(cells) if quantity == "time" else numbers_of(cells)
        if quantity and (np.isfinite(values).mean() > 0.5 or quantity in _OTHERS):
            qualifier = next((q for q in ("measured", "nominal") if set(words) & WORDS[q]), "")
            unit = unit or (below[k] if below[k] in UNITS else "")
            headings.append(_Heading(name, quantity, slot, qualifier, unit, frozenset(rest), values))
    return headings


def _meaning(
    words: Sequence[str], said: set[str], named: Sequence[tuple[Sequence[str], str]]
) -> tuple[str, str, Collection[str]]:
    """Quantity, slot and what is left of the words; no quantity where they mean nothing here.

    named : words of the joints' names, with their numbers
    """
    starts = range(len(words))
    own = [(len(name), n, name) for name, n in named if any(words[k : k + len(name)] == name for k in starts)]
    if own:
        _, number, name = max(own)
        return "joint", number, {"by name"} | said - {*name} - WORDS["filler"] - WORDS["joint"]
    numbers = [w for w in words if w.isdecimal()]
    joint = said & WORDS["joint"]
    rest = said - WORDS["filler"] - WORDS["joint"] - {*numbers}
    axis = said & {*_AXES, *_TURNS}
    if re.fullmatch(r"[0-3]{2}|[1-4]{2}", "".join(numbers)) and said & WORDS["matrix"] and not axis:
        return "matrix", "".join(numbers), rest - WORDS["rotation"] - WORDS["matrix"] | said & {"t"}
    if joint and len(numbers) == 1 and not axis:
        # The word is kept apart: A1 .. A6 and J1 .. J6 in one table are two groups.
        return "joint", str(int(numbers[0])), rest | joint
    if len(said) == 1 and (letter := min(said)) in _LETTERS:
        return ("abc" if letter in "abc" else "wpr"), _LETTERS[letter], ()
    if len(axis) == 1:
        (word,) = axis
        if word in _TURNS or said & WORDS["rotation"]:
            return "turn", {**_AXES, **_TURNS}[word], rest - axis - WORDS["rotation"] | {*numbers}
        return "position", _AXES[word], (rest - axis) | {*numbers}
    for slot in _ROLL:
        if rest & WORDS[slot]:
            return "roll", slot, rest - WORDS[slot] - WORDS["rotation"]
    for kind in ("time", *_OTHERS, "distance"):
        if rest & WORDS[kind] and not numbers:
            return kind, "", rest - WORDS[kind]
    return "", "", ()


def _groups(headings: Iterable[_Heading], quantity: str, slots: Sequence[str]) -> list[list[_Heading]]:
    """Columns of a quantity with all slots, of the words that are expected most; nominal ones are none."""
    groups: dict[tuple[str, frozenset[str]], dict[str, _Heading]] = {}
    for h in headings:
        if h.quantity == quantity and h.qualifier != "nominal":
            groups.setdefault((h.qualifier, h.rest), {}).setdefault(h.slot, h)
    return _best(
        (_RANK[qualifier] + (3 if rest else 0), [members[slot] for slot in slots])
        for (qualifier, rest), members in groups.items()
        if all(slot in members for slot in slots)
    )


def _best(ranked: Iterable[tuple[int, list[_Heading]]]) -> list[list[_Heading]]:
    groups = list(ranked)
    return [members for rank, members in groups if rank == min(rank for rank, _ in groups)]


def _joints(headings: Iterable[_Heading], n: int, order: Mapping[str, int]) -> list[list[_Heading]]:
    """The readings of all joints, in their order; order : joint of each number, where a column names it."""
    groups: dict[tuple[str, frozenset[str]], dict[int, _Heading]] = {}
    for h in headings:
        if h.quantity == "joint":
            number = order.get(h.slot, -1) if order and "by name" not in h.rest else int(h.slot)
            groups.setdefault((h.qualifier, h.rest), {}).setdefault(number, h)
    ranked = []
    for (qualifier, rest), members in groups.items():
        # Of 0 to n one more joint than the robot has is counted, or the first column only counts.
        first = 0 if 0 in members and not (n in members and n + 1 not in members) else 1
        if all(i in members for i in range(first, first + n)):
            rank = _RANK[qualifier] + (0 if rest <= WORDS["joint"] | {"by name"} else 3)
            ranked.append((rank, [members[i] for i in range(first, first + n)]))
    return _best(ranked)


def _names_in_cells(raw: RawTable, names: Sequence[str]) -> dict[str, int]:
    """The joint of each number, where columns as `name[0]` hold the joints' names (ROS JointState)."""
    joint_of = {}
    for heading in raw.header:
        numbers = re.findall(r"\d+", heading)
        if len(numbers) == 1 and "name" in words_of(heading)[0]:
            cells = {str(cell) for cell in raw.frame[heading]}
            if len(cells) == 1 and cells <= {*names}:
                joint_of[str(int(numbers[0]))] = 1 + [*names].index(cells.pop())
    return joint_of


def _numbered(raw: RawTable, n: int, taken: Collection[str] = ()) -> list[list[_Heading]]:
    """Columns of numbers whose headings differ in a number only, 1 to n or 0 to n - 1."""
    groups: dict[str, dict[int, _Heading]] = {}
    for name in raw.header:
        numbers = re.findall(r"\d+", name)
        if len(numbers) == 1 and name not in taken and np.isfinite(values := numbers_of(raw.frame[name])).mean() > 0.5:
            words, unit = words_of(name)
            heading = _Heading(name, "numbered", numbers[0], "", unit, frozenset(words) - {*numbers}, values)
            groups.setdefault(re.sub(r"\d+", "#", name), {})[int(numbers[0])] = heading
    return [[m[i] for i in sorted(m)] for m in groups.values() if sorted(m) in ([*range(1, n + 1)], [*range(n)])]


def _parts_of(group: Sequence[_Heading], joints: Sequence[str]) -> _Parts:
    """The readings of turning joints, and those of sliding ones."""
    return [
        (
            [h for h, kind in zip(group, joints, strict=True) if kind == each],
            [f"q{i}" for i, kind in enumerate(joints, 1) if kind == each],
            "angle" if each == "revolute" else "length",
        )
        for each in dict.fromkeys(joints)
    ]


def _observations(
    positions: Sequence[Sequence[_Heading]], lengths: Sequence[Sequence[_Heading]]
) -> tuple[_Options, str]:
    """What may have been measured, and what a question on it is about.

    Coordinates that nobody says are measured give way to a length that is, and the reverse.
    """
    said = [any(g[0].qualifier == "measured" for g in groups) for groups in (positions, lengths)]
    if positions and lengths and said[0] != said[1]:
        positions, lengths = (positions, ()) if said[0] else ((), lengths)
    options: list[tuple[str, _Parts]] = [(_listed(g), [(g, _XYZ, "length")]) for g in positions]
    options += [(_listed(g), [(g, ("distance",), "length")]) for g in lengths]
    return options, "observation" if positions and lengths else ""


def _orientation(headings: Sequence[_Heading], raw: RawTable, taken: Collection[str]) -> tuple[_Options, str, str]:
    """How the tool's orientation may be said, with a question, and what that is about."""
    which = "Which columns are the orientation?"
    triples = [*_groups(headings, "turn", _XYZ), *_numbered(raw, 3, taken)]
    sure = [
        ([g for g in _groups(headings, "turn", ("w", *_XYZ)) if _is_unit(g)], _QUATERNION, ""),
        *(([g for g in _groups(headings, "matrix", e) if _is_rotation(g)], _MATRIX, "") for e in _ENTRIES),
        *((_groups(headings, quantity, _ROLL), _ROLL, "angle") for quantity in ("roll", "abc", "wpr")),
        ([g for g in triples if g[0].rest & WORDS["vector"]], _TRIPLES["a rotation vector"], "angle"),
    ]
    for groups, names, quantity in sure:
        if groups:
            return [(_listed(g), [(g, names, quantity)]) for g in groups], which, ""
    ways: Mapping[str, Sequence[str]] = {}
    quantity = ""
    if groups := _groups(headings, "turn", _XYZ):
        ways, quantity = _TRIPLES, "angle"
    elif groups := [g for g in _numbered(raw, 4, taken) if _is_unit(g)]:
        ways = {"a quaternion, w first": _QUATERNION, "a quaternion, w last": (*_QUATERNION[1:], "qw")}
    elif groups := [g for g in _numbered(raw, 9, taken) if _is_rotation(g)]:
        turned = tuple(f"R{name[2]}{name[1]}" for name in _MATRIX)
        ways = {"a matrix, row by row": _MATRIX, "a matrix, column by column": turned}
    options = [(way, [(groups[0], names, quantity)]) for way, names in ways.items()]
    return options, f"How is the orientation {_listed(groups[0])} meant?" if groups else "", "orientation"


def _finite(group: Sequence[_Heading]) -> Array:
    values = np.column_stack([h.values for h in group])
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def _is_unit(group: Sequence[_Heading]) -> bool:
    """Whether four columns are unit quaternions."""
    return bool((np.abs(np.linalg.norm(_finite(group), axis=1) - 1) < NEARLY).all())


def _is_rotation(group: Sequence[_Heading]) -> bool:
    """Whether nine columns are matrices of rotations."""
    R = _finite(group).reshape(-1, 3, 3)
    return bool((np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)) < NEARLY).all())


def _listed(group: Iterable[_Heading]) -> str:
    return ", ".join(h.name for h in group)


def _choices(options: _Options, stated: Mapping[str, str], asked: str) -> dict[str, list[Understood]]:
    """What may be meant in which unit, in words: of one option that nobody asks about, the units alone."""
    choices: dict[str, list[Understood]] = {}
    for label, parts in options:
        units = [_by_unit(members, names, quantity, stated) for members, names, quantity in parts if members]
        for ways in product(*units):
            unit = " and ".join(u for u, _ in ways if u)
            words = unit if unit and len(options) == 1 and not asked else f"{label} in {unit}" if unit else label
            choices[words] = [c for _, columns in ways for c in columns]
    return choices


def _by_unit(
    members: Sequence[_Heading], names: Sequence[str], quantity: str, stated: Mapping[str, str]
) -> list[tuple[str, list[Understood]]]:
    """Columns with our names and units; where nothing tells the unit, for each of two, the most probable first."""
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
        return [
            Understood(f"{name}_{UNITS[unit][0]}", Source(h.name, UNITS[unit][1]), unit, reason)
            for h, name, unit, reason in zip(members, names, units, why, strict=True)
        ]

    if sure:
        return [("", columns(units))]
    return [(u, columns([u] * len(units))) for u in (units[0], *(u for u in ours if u != units[0]))]


def _unit_by_size(values: Array, quantity: str) -> tuple[str, bool]:
    """The unit that the size of the numbers shows, and whether it is sure."""
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return ("deg" if quantity == "angle" else "mm"), False
    if quantity == "angle":
        largest = float(np.abs(values).max())
        return ("deg", True) if largest > RADIANS + 1 else ("rad", len(values) >= FEW)
    # Quantiles: single wild numbers say nothing of the unit.
    spread = float(np.linalg.norm(np.quantile(values, 0.9, axis=0) - np.quantile(values, 0.1, axis=0)))
    # Positions of a robot spread over more than 30 mm, and over less than 10 m.
    return ("m", len(values) >= FEW) if spread < 10.0 else ("mm", spread > 30.0)


def _stated_units(lines: Sequence[str]) -> dict[str, str]:
    """Units that comments and titles state, for lengths and angles."""
    units: dict[str, str] = {}
    for line in lines:
        match = _UNIT_LINE.search(unicodedata.normalize("NFKC", line))
        for word in re.findall(r"[^\s,;:/()\[\]]+", match[1].casefold()) if match else ():
            if word in UNITS:
                quantity = {"mm": "length", "m": "length", "deg": "angle", "rad": "angle"}.get(UNITS[word][0])
                if quantity:
                    units.setdefault(quantity, word)
    return units


def _by_order(raw: RawTable, n: int) -> list[_Heading]:
    """A table without headings: readings, positions, and perhaps a matrix; a first column that counts is left aside."""
    values = [numbers_of(raw.frame[name]) for name in raw.header]
    slots = [("joint", str(i)) for i in range(1, n + 1)] + [("position", c) for c in _XYZ]
    matrix = [("matrix", f"{i}{j}") for i in range(3) for j in range(3)]
    for what in (slots, [*slots, *matrix]):
        start = len(raw.header) - len(what)
        if start == 0 or (start == 1 and (np.diff(values[0]) == 1).all()):
            return [
                _Heading(raw.header[k], quantity, slot, "", "", frozenset(), values[k])
                for k, (quantity, slot) in enumerate(what, start)
            ]
    return []
