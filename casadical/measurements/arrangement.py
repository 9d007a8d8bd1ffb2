"""Tables rearranged into one row for each measured point: several files, targets side by side."""

import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import reduce
from itertools import combinations

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.measurements.array_files import expanded
from casadical.measurements.columns import in_seconds, numbers_of, seconds_of_one
from casadical.measurements.headings import complete_groups, headings_of, words_of
from casadical.measurements.proposals import position_groups
from casadical.measurements.raw_table import RawTable
from casadical.measurements.table_form import Form
from casadical.measurements.vocabulary import WORDS


def long(raw: RawTable, given: Collection[str] = ()) -> RawTable:
    """Return a table with one position in each row and one number in each cell.

    Lists in cells become columns, and rows with the positions of several targets as many rows.
    Targets on one flange keep their distances while the directions between them turn; coordinates
    in several frames, or nominal ones, do not. The column `tool` names the targets; copies of one
    target, which lie together, have none. In a table without several, lists alone are split.

    given : columns of the file that are assigned already
    """
    split = expanded(raw.frame)
    if {*split} != {*raw.frame}:
        lists = [str(name) for name in raw.frame if name not in split]
        said = f"{raw.path.name}: lists in the cells of {', '.join(lists)} are columns."
        raw = replace(_made(raw, split, said), line=raw.line)
    groups = [g for g in position_groups(raw) if not {h.name for h in g} & {*given}]
    points = [np.column_stack([h.values for h in g]) for g in groups]
    # A rounded copy of a point is none of its own.
    whole = [k for k, a in enumerate(points) if not any(_rounds(a, b) for b in points if b is not a)]
    groups, points = [groups[k] for k in whole], [points[k] for k in whole]
    best: tuple[int, ...] = ()
    pairs = {pair for pair in combinations(range(len(groups)), 2) if _rigid(points[pair[0]], points[pair[1]])}
    for k in range(len(groups)):
        together = (k, *(i for i in range(k + 1, len(groups)) if (k, i) in pairs))
        best = max(best, together, key=len)
    if len(best) < 2:
        return raw
    turns = complete_groups([h for h in headings_of(raw, ()) if h.quantity == "turn"], "xyz")
    turned = {g[0].rest: g for _, g in turns}
    turned = turned if all(groups[k][0].rest in turned for k in best) else {}
    names = _target_names([{*groups[k][0].rest} for k in best])
    names = names if raw.form.header_line else _numbered(len(best))
    columns = {k: [*groups[k], *turned.get(groups[k][0].rest, ())] for k in best}
    others = raw.frame.drop(columns=[h.name for part in columns.values() for h in part])
    units = dict(zip(raw.header, raw.form.units, strict=False))
    parts = []
    for name, (k, part) in zip(names, columns.items(), strict=True):
        own = {}
        for h in part:
            unit = h.unit or units.get(h.name, "")
            what = "rotation" if h.quantity == "turn" else "point"
            own[f"{what} {h.slot}{f' [{unit}]' * bool(unit)}"] = h.values
        seen = np.isfinite(points[k]).any(axis=1)
        parts.append(others.assign(**own, tool=name, **{"row of the file": raw.line})[seen])
    table = pd.concat(parts).sort_values("row of the file", kind="stable")
    apart = float(np.nanmedian(np.linalg.norm(points[best[0]] - points[best[1]], axis=1)))
    copies = apart < 1e-3 * float(np.nanmax(np.nanstd(points[best[0]], axis=0)))
    table = table.drop(columns=["tool"] * copies)
    what = "repeated measurements" if copies else f"targets, {', '.join(names)},"
    said = f"{len(best)} {what} stand side by side: each row gives {len(best)} rows, {len(table)} in all."
    return _made(raw, table, f"{raw.path.name}: {said}")


def _rounds(a: Array, b: Array) -> bool:
    """Return whether the coordinates a are those of b with fewer decimals, shape (n, 3)."""
    both = np.isfinite(a) & np.isfinite(b)
    x, off = a[both], np.abs(a[both] - b[both]).max(initial=0)
    digits = next((k for k in range(6) if np.allclose(x, x.round(k), atol=1e-9)), 6)
    return digits < 6 and bool(0 < off < 0.51 * 10.0**-digits)


def _rigid(a: Array, b: Array) -> bool:
    """Return whether two points, shape (n, 3), keep their distance while its direction turns.

    Points that are equal within noise count, too. Rows with gross errors (zeros where nothing was
    seen) do not.
    """
    whole = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    way = (a - b)[whole]
    if len(way) < 4:
        return False
    length = np.linalg.norm(way, axis=1)
    size = 1.5 * float(np.median(np.abs(a[whole] - np.median(a[whole], axis=0)), axis=0).max())
    scatter = float(np.median(np.abs(length - np.median(length))))
    # Tolerances as shares of the positions' spread: a flange of 1 m of travel is rigid to 2 mm.
    if np.median(length) < 1e-3 * size:
        return float(np.std(b[whole], axis=0).max()) > 0
    way = way[np.abs(length - np.median(length)) < 0.05 * np.median(length)]
    return scatter < 2e-3 * size and scatter < 0.05 * np.median(length) and directions_turn(way)


def directions_turn(ways: Array) -> bool:
    """Return whether vectors, shape (n, 3), turn: no direction has 95 % of their squares."""
    values = np.linalg.eigvalsh(ways.T @ ways)
    return bool(values[-1] < 0.95 * values.sum())


def _target_names(words: Sequence[set[str]]) -> list[str]:
    """Return a name for each target by the words that only its headings have; else target1, ..."""
    common = set.intersection(*words)
    own = ["_".join(sorted(w - common)) for w in words]
    if len({*own}) < len(own) or all(re.fullmatch(r"\d*", name) for name in own):
        own = [f"target{name or k}" for k, name in enumerate(own, 1)]
    return [name or f"target{k}" for k, name in enumerate(own, 1)] if len({*own}) == len(own) else _numbered(len(own))


def _numbered(count: int) -> list[str]:
    """Return the names target1, target2 and so on of that many targets."""
    return [f"target{k}" for k in range(1, count + 1)]


def with_headings(raw: RawTable, names: Sequence[str]) -> RawTable:
    """Return the table with these headings. Raises InputError: not one for each column."""
    if len(names) != len(raw.header):
        raise InputError(
            f"{raw.path}: {len(names)} headings for {len(raw.header)} columns; the first row has "
            f"{', '.join(map(str, raw.frame.iloc[0]))}"
        )
    made = _made(raw, raw.frame.set_axis([*names], axis=1), f"{raw.path.name}: its headings are those that were given.")
    return replace(made, form=Form())


def joined(tables: Sequence[RawTable]) -> RawTable:
    """Return one table of several files: below each other, or joined by a key, a time or the order.

    Files with the same headings are put below each other. Else rows are joined by a column whose
    cells the files share (a number or name of a point), by the nearest time stamp, or, if they have
    equally many rows, by their order. Raises InputError where none of these is possible.
    """
    return reduce(_pair, tables)


def _pair(a: RawTable, b: RawTable) -> RawTable:
    """Return one table of two (see `joined`)."""
    names = f"{a.path.name} and {b.path.name}"
    if {*a.header} == {*b.header} and a.form.header_line:
        return _made(a, pd.concat([a.frame, b.frame]), f"{names} have the same headings: the rows of both are taken.")
    if not (a.form.header_line and b.form.header_line):
        together = _pair(*(_with_file_names(raw) for raw in (a, b)))
        return replace(together, form=replace(together.form, header_line=0))
    found = []
    for left in a.header:
        for right in b.header:
            cells = [_labels(a.frame[left]), _labels(b.frame[right])]
            if any(c is None for c in cells):
                continue
            own, theirs = (set(c) for c in cells if c is not None)
            least = min(len(own), len(theirs))
            shared = len(own & theirs) / least
            unique = len(own) == len(a.frame) or len(theirs) == len(b.frame)
            alike = words_of(left)[0] == words_of(right)[0]
            if unique and shared >= (0.5 if alike else 0.8) and least > 2:
                found.append((-shared - alike, left, right))
    keys = [(left, right) for _, left, right in sorted(found)]
    if keys:
        left, right = keys[0]
        one = a.frame.rename(columns=_apart(b, a) | {left: left})
        two = b.frame.rename(columns=_apart(a, b)).drop(columns=_apart(a, b).get(right, right))
        one = one.assign(_key=_labels(a.frame[left]))
        table = one.merge(two.assign(_key=_labels(b.frame[right])), on="_key", sort=False)
        said = f"{names} are joined by their columns {left!r} and {right!r}."
        return _made(a, table.drop(columns="_key"), said)
    times = _time(a), _time(b)
    if times[0] and times[1]:
        x, y = _seconds(a, times[0]), _seconds(b, times[1])
        # Over 80 % of the times of one table are within those of the other, +- 1 s.
        if max(np.mean((u >= v.min() - 1) & (u <= v.max() + 1)) for u, v in ((x, y), (y, x))) > 0.8:
            swap = len(a.frame) > len(b.frame)
            few, many, x, y = (b, a, y, x) if swap else (a, b, x, y)
            frame = many.frame.rename(columns=_apart(few, many)).assign(_t=y)
            step = float(np.median(np.diff(y))) if len(y) > 1 else np.inf
            near = pd.merge_asof(
                few.frame.rename(columns=_apart(many, few)).assign(_t=x),
                frame,
                on="_t",
                direction="nearest",
                tolerance=max(step, 1e-9),  # type: ignore[arg-type]
            )
            lost = int(near[[n for n in frame if n != "_t"]].isna().all(axis=1).sum())
            names = f"{few.path.name} and {many.path.name}"
            rest = f"; {lost} without one are left out" if lost else ""
            said = f"{names} are joined by time: each row of the first has the nearest of"
            said += f" the second, within {step:.3g} s{rest}."
            near = near[~near[[n for n in frame if n != "_t"]].isna().all(axis=1)]
            if not len(near):
                raise InputError(f"{names}: no time stamps within {step:.3g} s of each other; are the clocks the same?")
            return _made(few, near.drop(columns="_t"), said)
    if len(a.frame) == len(b.frame):
        right_frame = b.frame.rename(columns=_apart(a, b)).reset_index(drop=True)
        table = pd.concat([a.frame.rename(columns=_apart(b, a)).reset_index(drop=True), right_frame], axis=1)
        return _made(a, table, f"{names} have no column in common: they are joined by the order of their rows.")
    raise InputError(
        f"{names}: {len(a.frame)} and {len(b.frame)} rows, and no column in common by which they could be "
        "joined; give both a column with the number or the name of each pose, or a time stamp"
    )


def _apart(a: RawTable, b: RawTable) -> dict[str, str]:
    """Return new names of the columns of b that a has, too: preceded by the name of the file."""
    return {name: f"{b.path.stem} {name}" for name in b.header if name in a.header}


def _with_file_names(raw: RawTable) -> RawTable:
    """Return a table without headings with its columns named for the file; others are unchanged."""
    if raw.form.header_line:
        return raw
    header = tuple(f"{raw.path.stem} {n}" for n in raw.header)
    frame = raw.frame.set_axis(header, axis=1)
    return replace(raw, header=header, frame=frame, form=replace(raw.form, header_line=1))


def _labels(cells: pd.Series) -> list[str] | None:
    """Return cells as labels of poses: words or whole numbers that are not all equal; else None."""
    numbers = numbers_of(cells)
    if np.isfinite(numbers).all():
        return [f"{n:.0f}" for n in numbers] if (numbers == numbers.round()).all() and np.ptp(numbers) else None
    if np.isfinite(numbers).any() and cells.isna().any():
        return None
    texts = [str(cell).strip().casefold() for cell in cells]
    return [re.sub(r"^(\D+?)[\s_-]*0*(\d+)$", r"\1\2", text) for text in texts] if len({*texts}) > 1 else None


def _time(raw: RawTable) -> str:
    """Return the name of the first column of times that never decrease; empty if there is none."""
    words = {n: words_of(n)[0] for n in raw.header}
    named = [n for n, w in words.items() if w == ["t"] or ({*w} & WORDS["time"] and not {*w} & WORDS["about"])]
    some = [n for n in named if (np.diff(in_seconds(raw.frame[n])) >= 0).all()]
    return some[0] if some else ""


def _seconds(raw: RawTable, name: str) -> Array:
    """Return the times of a column [s]."""
    times = in_seconds(raw.frame[name])
    return np.asarray(times * seconds_of_one(times, words_of(name)[1]))


def _made(raw: RawTable, table: pd.DataFrame, said: str) -> RawTable:
    """Return a rearranged table; its rows count as in a file with one line of headings."""
    table = table.reset_index(drop=True)
    line = table.pop("row of the file").to_numpy() if "row of the file" in table else np.arange(len(table)) + 2
    units = dict(zip(raw.header, raw.form.units, strict=False))
    header = tuple(f"{n} [{units[n]}]" if units.get(n) and not words_of(n)[1] else n for n in map(str, table))
    form = Form(header_line=min(raw.form.header_line, 1))
    return replace(
        raw, header=header, cells=(), frame=table.set_axis(header, axis=1), line=line, form=form, said=(*raw.said, said)
    )
