"""What a table's own headings mean: joint readings, positions and conditions, with their units.

Only what is missing under our own names is looked for. A unit comes from the heading, else from a row of units, a
comment, or the size of the numbers; where none of these tells, a question is left, with what would be taken first.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from casadical.core.arrays import Array
from casadical.measurements.angle_unit import RADIANS
from casadical.measurements.column_map import Source
from casadical.measurements.raw_table import RawTable
from casadical.measurements.vocabulary import UNITS, UNSPACED, WORDS

_BRACKETS = re.compile(r"[\[({<【]([^\])}>】]*)[\])}>】]|(?:\bin\b|[,/_])\s*([^\s,/_]+)\s*$")
_WORD = re.compile(r"[^\W\d_]+|\d+")
_OURS = re.compile(r"q(\d+)_(deg|rad|mm|m)")
_UNIT_LINE = re.compile(r"(?:units?|einheit(?:en)?|unités?|单位|単位)\s*[:=：]?\s*(.*)", re.IGNORECASE)
# Positions of a robot spread over more than so many millimetres, and over less than so many metres.
MILLIMETRES, METRES = 30.0, 10.0
FEW = 10
# So many poses at least of each target, on average.
FEWEST_OF_EACH = 6
_RANK = {"measured": 0, "": 1, "nominal": 2}
_OTHERS = {"temperature": ("temperature_degC", "degC"), "time": ("time_s", "s"), "load": ("payload_kg", "kg")}


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
    """

    text: str
    choices: Mapping[str, Mapping[str, Source]]


@dataclass(frozen=True)
class Understanding:
    """What is understood of a table's columns.

    columns : those with other names than ours; questions : what is unsure, the columns hold the first choices
    left : headings of positions or joints that are there and were not taken
    """

    columns: tuple[Understood, ...] = ()
    questions: tuple[Question, ...] = ()
    left: tuple[str, ...] = ()

    @property
    def sources(self) -> dict[str, Source]:
        """Where each of our columns comes from."""
        return {c.ours: c.source for c in self.columns}


@dataclass(frozen=True)
class _Heading:
    """quantity : joint, x, y, z or a kind of words; number : of a joint; rest : words that say nothing to us"""

    name: str
    quantity: str
    number: int
    qualifier: str
    unit: str
    rest: frozenset[str]
    values: Array = field(compare=False)


def understand(raw: RawTable, joints: Sequence[str], given: Collection[str] = ()) -> Understanding:
    """The columns of a table with other headings than ours.

    joints : kind of each ("revolute", "prismatic"); given : our names that are known already
    """
    ours = {*raw.header, *given}
    own = {int(m[1]) for h in ours if (m := _OURS.fullmatch(h))}
    joints_missing = bool(set(range(1, len(joints) + 1)) - own)
    named = not joints_missing and _has_observation(ours)
    frame = raw.frame()
    headings = [
        found
        for k, name in enumerate(raw.header)
        if name and (found := _heading(name, raw.form.units[k] if k < len(raw.form.units) else "", frame.iloc[:, k]))
    ]
    if named:  # beside our own names only what is said with its unit
        return Understanding((*_conditions([h for h in headings if h.unit], ours), *_tools(raw, frame, ours)))
    stated = _stated_units([*raw.comments, *(text for _, text in raw.form.skipped)])
    if not raw.form.header_line:
        headings = _by_order(raw, frame, len(joints))
    columns: list[Understood] = []
    questions: list[Question] = []
    taken: list[_Heading] = []
    if joints_missing:
        chosen = _joints(headings, len(joints), questions)
        if not (chosen or own):  # where some readings are named, the others are missing
            chosen = _numbered(raw, frame, len(joints), questions)
        taken += chosen
        for kind in dict.fromkeys(joints):
            members = [h for h, k in zip(chosen, joints, strict=False) if k == kind]
            numbers = [i for i, k in enumerate(joints[: len(chosen)], 1) if k == kind]
            names = [f"q{i}" for i in numbers]
            angle = kind == "revolute"
            columns += _with_units(members, names, "angle" if angle else "length", stated, questions)
    if not _has_observation(ours):
        chosen = _positions(headings, questions)
        columns += _with_units(chosen, ["x", "y", "z"][: len(chosen)], "length", stated, questions)
        taken += chosen
    columns += [*_conditions(headings, ours), *_tools(raw, frame, ours)]
    if not raw.form.header_line:
        columns = [replace(c, why=f"order of the columns, {c.why}") for c in columns]
    left = [h.name for h in headings if h not in taken and h.quantity in ("joint", "x", "y", "z")]
    return Understanding(tuple(columns), tuple(questions), tuple(left))


def _conditions(headings: Sequence[_Heading], ours: Collection[str]) -> Iterator[Understood]:
    """Temperature, time and payload, where exactly one heading names them."""
    for quantity, (name, unit) in _OTHERS.items():
        named = [h for h in headings if h.quantity == quantity and not h.rest and UNITS.get(h.unit, (unit,))[0] == unit]
        if len(named) == 1 and name not in ours and np.isfinite(named[0].values).all():
            factor = UNITS.get(named[0].unit, ("", 1.0))[1]
            yield Understood(name, Source(named[0].name, factor), named[0].unit or unit, "heading")


def _tools(raw: RawTable, frame: pd.DataFrame, ours: Collection[str]) -> Iterator[Understood]:
    """A column of names that say which target was measured: few names, each at several poses."""
    for name in raw.header:
        words = set(words_of(name)[0])
        if "tool" not in ours and words & WORDS["target"] and words <= WORDS["target"] | WORDS["dh_joint"]:
            cells = frame[name].dropna().astype(str)
            if len(cells) == len(frame) and 1 < cells.nunique() <= len(cells) / FEWEST_OF_EACH:
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
    words = _WORD.findall(UNSPACED.sub(lambda m: f" {m[0]} ", text))
    if not unit and words and words[-1] in UNITS and len(words) > 1 and len(words[-1]) > 1:
        unit = words.pop()
    return words, unit


def _heading(name: str, unit_below: str, cells: pd.Series) -> _Heading | None:
    words, unit = words_of(name)
    unit = unit or (unit_below if unit_below in UNITS else "")
    if not words or set(words) & WORDS["about"]:
        return None
    values = pd.to_numeric(cells, errors="coerce").to_numpy(dtype=float)
    qualifier = next((q for q in ("measured", "nominal") if set(words) & WORDS[q]), "")
    said = {w for w in words if w not in WORDS["measured"] | WORDS["nominal"]}
    numbers = [w for w in said if w.isdecimal()]
    joint = said & WORDS["joint"]
    rest = said - WORDS["filler"] - WORDS["joint"] - set(numbers)
    axis = rest & {"x", "y", "z", "px", "py", "pz"}
    if joint and len(numbers) == 1 and not axis and np.isfinite(values).mean() > 0.5:
        # The word is kept apart: A1 .. A6 and J1 .. J6 in one table are two groups.
        return _Heading(name, "joint", int(numbers[0]), qualifier, unit, frozenset(rest | joint), values)
    if len(axis) == 1 and np.isfinite(values).mean() > 0.5:
        letter = next(iter(axis))
        return _Heading(name, letter[-1], 0, qualifier, unit, frozenset((rest - axis) | set(numbers)), values)
    for kind in ("temperature", "time", "load"):
        if rest & WORDS[kind] and not numbers:
            return _Heading(name, kind, 0, qualifier, unit, frozenset(rest - WORDS[kind]), values)
    return None


def _has_observation(names: set[str]) -> bool:
    from casadical.measurements.kinds.registry import kinds

    # A column "point" names points that are touched, or, beside positions, the points of a tracker.
    return any(kind.matches(names) for kind in kinds().values() if kind.has_scale)


def _joints(headings: Sequence[_Heading], n: int, questions: list[Question]) -> list[_Heading]:
    """The readings of all joints, in their order; none where no group of headings has them all."""
    groups: dict[tuple[str, frozenset[str]], dict[int, _Heading]] = {}
    for h in headings:
        if h.quantity == "joint":
            groups.setdefault((h.qualifier, h.rest), {}).setdefault(h.number, h)
    full = []
    for (qualifier, rest), members in groups.items():
        for first in (1, 0):
            wanted = range(first, first + n)
            if all(i in members for i in wanted) and not (first == 0 and n in members):
                known = rest <= WORDS["joint"]
                full.append((_RANK[qualifier] + (0 if known else 3), [members[i] for i in wanted]))
                break
    return _one_of(full, [f"q{i}" for i in range(1, n + 1)], "joint readings", questions)


def _numbered(raw: RawTable, frame: pd.DataFrame, n: int, questions: list[Question]) -> list[_Heading]:
    """Columns of numbers whose headings differ in a number only, 1 to n or 0 to n - 1, in words that are unknown."""
    groups: dict[str, dict[int, _Heading]] = {}
    for name in raw.header:
        values = pd.to_numeric(frame[name], errors="coerce").to_numpy(dtype=float) if name else np.zeros(0)
        numbers = re.findall(r"\d+", name)
        if len(numbers) == 1 and np.isfinite(values).mean() > 0.5:
            text = re.sub(r"\d+", "#", name)
            found = _Heading(name, "joint", int(numbers[0]), "", words_of(name)[1], frozenset(), values)
            groups.setdefault(text, {})[found.number] = found
    full = [[m[i] for i in sorted(m)] for m in groups.values() if sorted(m) in ([*range(1, n + 1)], [*range(n)])]
    if len(full) != 1:
        return []
    choice = {", ".join(h.name for h in full[0]): {f"q{i}": Source(h.name) for i, h in enumerate(full[0], 1)}}
    questions.append(Question("Are these the joint readings?", choice))
    return full[0]


def _positions(headings: Sequence[_Heading], questions: list[Question]) -> list[_Heading]:
    groups: dict[tuple[str, frozenset[str]], dict[str, _Heading]] = {}
    for h in headings:
        if h.quantity in ("x", "y", "z"):
            groups.setdefault((h.qualifier, h.rest), {}).setdefault(h.quantity, h)
    full = [
        (_RANK[qualifier] + (0 if not rest else 3), [members[c] for c in "xyz"])
        for (qualifier, rest), members in groups.items()
        if len(members) == 3 and qualifier != "nominal"
    ]
    return _one_of(full, ["x", "y", "z"], "measured positions", questions)


def _one_of(
    groups: list[tuple[int, list[_Heading]]], ours: Sequence[str], what: str, questions: list[Question]
) -> list[_Heading]:
    """The first group of the best rank; a question where several have it."""
    if not groups:
        return []
    best = min(rank for rank, _ in groups)
    equal = [members for rank, members in groups if rank == best]
    if len(equal) > 1:
        choices = {
            ", ".join(h.name for h in members): {o: Source(h.name) for o, h in zip(ours, members, strict=True)}
            for members in equal
        }
        questions.append(Question(f"Which columns are the {what}?", choices))
    return equal[0]


def _with_units(
    members: Sequence[_Heading],
    names: Sequence[str],
    quantity: str,
    stated: Mapping[str, str],
    questions: list[Question],
) -> Iterator[Understood]:
    """Columns with our names and units."""
    if not members:
        return
    ours = ("deg", "rad") if quantity == "angle" else ("mm", "m")
    units = [h.unit if UNITS.get(h.unit, ("",))[0] in ours else "" for h in members]
    why = ["heading" if unit else "" for unit in units]
    usual = Counter(u for u in units if u).most_common(1)
    if usual and not all(units):
        units, why = [u or usual[0][0] for u in units], [w or "the other headings" for w in why]
    elif not usual and quantity in stated:
        units, why = [stated[quantity]] * len(units), ["a line of units"] * len(units)
    elif not usual:
        unit, sure = _unit_by_size(np.column_stack([h.values for h in members]), quantity)
        units, why = [unit] * len(units), ["size of the numbers" if sure else "a guess"] * len(units)
        if not sure:
            questions.append(_which_unit(members, names, unit, ours))
    for h, name, unit, reason in zip(members, names, units, why, strict=True):
        base, factor = UNITS[unit]
        yield Understood(f"{name}_{base}", Source(h.name, factor), unit, reason)


def _which_unit(members: Sequence[_Heading], names: Sequence[str], first: str, ours: Sequence[str]) -> Question:
    order = [first, *(u for u in ours if u != first)]
    choices = {u: {f"{n}_{u}": Source(h.name) for n, h in zip(names, members, strict=True)} for u in order}
    return Question(f"In which unit are {', '.join(h.name for h in members)}?", choices)


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
    return ("m", len(values) >= FEW) if spread < METRES else ("mm", spread > MILLIMETRES)


def _stated_units(lines: Sequence[str]) -> dict[str, str]:
    """Units that comments and titles state, for lengths and angles."""
    found: dict[str, str] = {}
    for line in lines:
        match = _UNIT_LINE.search(unicodedata.normalize("NFKC", line))
        for word in re.findall(r"[^\s,;:/()\[\]]+", match[1].casefold()) if match else ():
            if word in UNITS:
                quantity = {"mm": "length", "m": "length", "deg": "angle", "rad": "angle"}.get(UNITS[word][0])
                if quantity:
                    found.setdefault(quantity, word)
    return found


def _by_order(raw: RawTable, frame: pd.DataFrame, n: int) -> list[_Heading]:
    """A table without headings: readings, then positions; a first column that counts is left aside."""
    values = [pd.to_numeric(frame[name], errors="coerce").to_numpy(dtype=float) for name in raw.header]
    start = len(raw.header) - n - 3
    if start not in (0, 1) or (start == 1 and not (np.diff(values[0]) == 1).all()):
        return []
    kinds = [("joint", i) for i in range(1, n + 1)] + [("x", 0), ("y", 0), ("z", 0)]
    return [
        _Heading(raw.header[start + k], quantity, number, "", "", frozenset(), values[start + k])
        for k, (quantity, number) in enumerate(kinds)
    ]
