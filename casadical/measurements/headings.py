"""What the headings of a table say: quantity, slot and unit of each column, and groups of columns.

A group is a set of columns that together are one quantity, such as the x, y and z of a point. What
a group is of the robot is proposed in `casadical.measurements.proposals`.
"""

import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Joint
from casadical.measurements.columns import in_seconds, numbers_of
from casadical.measurements.raw_table import RawTable
from casadical.measurements.vocabulary import UNITS, UNSPACED, WORDS

# Tolerance of the length of unit quaternions and of R R' = 1, as tables hold rounded numbers.
ROTATION_TOLERANCE = 1e-2
# Qualifier of a group of columns -> its rank; among groups that could be meant the lowest rank
# wins.
QUALIFIER_RANK = {"measured": 0, "": 1, "nominal": 2}
# Quantity that is a condition -> casadical's column and its unit.
CONDITION_COLUMNS = {"temperature": ("temperature_degC", "degC"), "load": ("payload_kg", "kg")}
# Casadical's columns of an orientation by angles about the fixed x, y, z, without units.
ROLL_PITCH_YAW = ("roll", "pitch", "yaw")
# Word of a heading -> axis of a position, x, y or z.
_AXIS_WORDS = {f"{before}{c}": c for before in ("", "p", "t") for c in "xyz"}
# Word of a heading -> component of an orientation, x, y, z or w.
_ROTATION_WORDS = {f"{before}{c}": c for before in ("r", "q", "o", "phi", "rot") for c in "xyzw"} | {"w": "w"}


@dataclass(frozen=True)
class Heading:
    """A heading, taken apart.

    name : the heading itself
    values : cells as numbers, shape (n,)
    unit : word of the unit, or empty
    quantity : such as joint, position or time
    slot : part of the quantity (number of a joint, axis, entry of a matrix)
    qualifier : measured, nominal or empty
    rest : words without a recognised meaning, which tell groups of columns apart
    led : kind of a joint, then kind, factor and offset of its leader, whose column this is; or None
    """

    name: str
    values: Array = field(compare=False)
    unit: str = ""
    quantity: str = ""
    slot: str = ""
    qualifier: str = ""
    rest: frozenset[str] = frozenset()
    led: tuple[str, str, float, float] | None = None


# Type of a group of columns: a list, or by the number of each one's joint.
_Group = TypeVar("_Group", list[Heading], dict[int, Heading])


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


def headings_of(raw: RawTable, chain: Sequence[Joint]) -> list[Heading]:
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
        if quantity and (np.isfinite(values).mean() > 0.5 or quantity in CONDITION_COLUMNS):
            qualifier = next((q for q in ("measured", "nominal", "instrument") if set(words) & WORDS[q]), "")
            qualifier = "measured" if qualifier == "instrument" else qualifier
            unit = unit or (below[k] if below[k] in UNITS else "")
            headings.append(Heading(name, values, unit, quantity, slot, qualifier, frozenset(rest), led))
    return headings


def _meaning(
    words: Sequence[str], said: set[str], named: Sequence[tuple[Sequence[str], str]]
) -> tuple[str, str, Collection[str]]:
    """Return quantity, slot and unexplained words of a heading; all empty if it has no meaning.

    Slot and quantity are as of `Heading`.

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
    for slot in ROLL_PITCH_YAW:
        if rest & WORDS[slot]:
            return "roll", slot, rest - WORDS[slot] - WORDS["rotation"]
    for kind in ("time", *CONDITION_COLUMNS, "distance"):
        if rest & WORDS[kind] and not numbers:
            return kind, "", rest - WORDS[kind]
    return "", "", ()


def groups_of(headings: Iterable[Heading], quantity: str, slots: Sequence[str]) -> list[list[Heading]]:
    """Return the groups of columns that fill all slots of a quantity, only those of the best rank.

    Nominal columns are excluded.
    """
    some = [h for h in headings if h.quantity == quantity and h.qualifier != "nominal"]
    # Words that say nothing tell groups apart, too, if they are complete.
    return best_of(complete_groups(some, slots)) or best_of(complete_groups(some, slots, WORDS["filler"]))


def complete_groups(
    headings: Iterable[Heading], slots: Sequence[str], but: Collection[str] = ()
) -> list[tuple[int, list[Heading]]]:
    """Return the groups of columns of one quantity that fill all slots, each with its rank.

    A group has its columns in the order of the slots, and equal qualifier and unexplained words.
    Measured ones rank before unqualified ones, and those with unexplained words last.

    but : words that tell no groups apart
    """
    groups: dict[tuple[str, frozenset[str], frozenset[str]], dict[str, Heading]] = {}
    for h in headings:
        filler = {*words_of(h.name)[0]} & (WORDS["filler"] - {*but})
        groups.setdefault((h.qualifier, h.rest, frozenset(filler)), {}).setdefault(h.slot, h)
    return [
        # The markers of a rigid body come after the body itself.
        (QUALIFIER_RANK[qualifier] + 3 * bool(rest) + 3 * ("marker" in filler), [members[slot] for slot in slots])
        for (qualifier, rest, filler), members in groups.items()
        if all(slot in members for slot in slots)
    ]


def best_of(ranked: Iterable[tuple[int, _Group]]) -> list[_Group]:
    """Return the groups with the lowest rank; ranked : (rank, columns of the group)."""
    groups = list(ranked)
    return [members for rank, members in groups if rank == min(rank for rank, _ in groups)]


def in_order(raw: RawTable, taken: Collection[str] = ()) -> list[Heading]:
    """Return the numeric columns, without their meaning, except a first one that counts the rows.

    taken : headings that are not considered
    """
    names = (name for name in raw.header if name and name not in taken)
    columns = [Heading(name, numbers_of(raw.frame[name])) for name in names]
    columns = [h for h in columns if np.isfinite(h.values).mean() > 0.5]
    return columns[bool(columns and (np.diff(columns[0].values) == 1).all()) :]


def numbered(
    raw: RawTable, n: int, taken: Collection[str] = (), fits: Callable[[list[Heading]], bool] | None = None
) -> list[list[Heading]]:
    """Return groups of n numeric columns whose headings differ only in a number, from 0 or 1 on.

    In a table without headings every n neighbours are a group; without `fits`, those of a rotation
    matrix or a unit quaternion are in none.

    taken : headings that are not considered; fits : condition that a group fulfils
    """
    if not raw.form.header_line:
        columns = in_order(raw, taken)
        turned = [*numbered(raw, 9, taken, is_rotation), *numbered(raw, 4, taken, is_unit)] if fits is None else []
        others = {h.name for group in turned for h in group}
        groups = [columns[k : k + n] for k in range(len(columns) - n + 1)]
        free = [g for g in groups if not others & {h.name for h in g}]
        return [g for g in free if fits is None or (fits(g) and np.ptp(finite_rows(g), axis=0).any())]
    named: dict[str, dict[int, Heading]] = {}
    for name in raw.header:
        numbers = re.findall(r"\d+", name)
        if len(numbers) == 1 and name not in taken and np.isfinite(values := numbers_of(raw.frame[name])).mean() > 0.5:
            words, unit = words_of(name)
            heading = Heading(name, values, unit, "numbered", numbers[0], rest=frozenset(words) - {*numbers})
            named.setdefault(re.sub(r"\d+", "#", name), {})[int(numbers[0])] = heading
    groups = [[m[i] for i in sorted(m)] for m in named.values() if sorted(m) in ([*range(1, n + 1)], [*range(n)])]
    return [g for g in groups if fits is None or fits(g)]


def finite_rows(group: Sequence[Heading]) -> Array:
    """Return the rows of a group's columns that are finite, shape (rows, columns)."""
    values = np.column_stack([h.values for h in group])
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def is_unit(group: Sequence[Heading]) -> bool:
    """Return whether the finite rows of four columns are unit quaternions."""
    rows = finite_rows(group)
    return bool(len(rows) and (np.abs(np.linalg.norm(rows, axis=1) - 1) < ROTATION_TOLERANCE).all())


def is_rotation(group: Sequence[Heading]) -> bool:
    """Return whether the finite rows of nine columns are orthonormal matrices, mirrored or not."""
    R = finite_rows(group).reshape(-1, 3, 3)
    return bool(len(R) and (np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)) < ROTATION_TOLERANCE).all())
