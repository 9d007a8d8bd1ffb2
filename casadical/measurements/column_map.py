"""Columns under our names, made of those of a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from casadical.core.errors import shown


@dataclass(frozen=True)
class Source:
    """Where one of our columns comes from: times * (a column of the file) + factors * (others) + plus.

    plus : in the unit of our name; add : factors of further columns of the file
    rows : that of so many rows later (earlier: negative), where a logger was ahead or behind
    """

    name: str
    times: float = 1.0
    plus: float = 0.0
    add: Mapping[str, float] = field(default_factory=dict)
    rows: int = 0

    @classmethod
    def read(cls, given: str | Mapping[str, Any]) -> Source:
        """From how a file says it: a name, or a table with `from`."""
        return (
            cls(given) if isinstance(given, str) else cls(given["from"], **{k: given[k] for k in given if k != "from"})
        )

    @property
    def table(self) -> str | dict[str, Any]:
        """How a file says it."""
        usual = Source(self.name)
        more = {k: getattr(self, k) for k in ("times", "plus", "rows", "add") if getattr(self, k) != getattr(usual, k)}
        return {"from": self.name, **more} if more else self.name

    @property
    def plain(self) -> bool:
        """Whether it is the column as it stands."""
        return self == Source(self.name)

    @property
    def words(self) -> str:
        """The whole relation: 0.5 x 'A' - 'B' +90, 1 row below."""
        terms = [(self.times, self.name), *((factor, name) for name, factor in self.add.items())]
        texts = [
            f"{'-' if factor < 0 else '+'} {'' if abs(factor) == 1 else f'{abs(factor):.6g} x '}'{shown(name)}'"
            for factor, name in terms
        ]
        first = f"-{texts[0][2:]}" if self.times < 0 else texts[0][2:]
        plus = f" {self.plus:+g}" if self.plus else ""
        rows = f", {abs(self.rows)} row{'s' * (abs(self.rows) > 1)} {'below' if self.rows > 0 else 'above'}"
        return " ".join([first, *texts[1:]]) + plus + (rows if self.rows else "")


def named(sources: Mapping[str, Source]) -> Iterator[tuple[str, str]]:
    """Columns of the file that ours are made of, each with where it is named, for messages."""
    return ((name, f"named for {ours!r}") for ours, s in sources.items() for name in (s.name, *s.add))


def made(table: pd.DataFrame, sources: Mapping[str, Source], point_from: Sequence[str]) -> tuple[pd.DataFrame, slice]:
    """A table with our columns, and which rows of the file it has: those to which a shift of rows gives a value.

    point_from : columns whose words name the touched point
    """
    # A header that keeps its own name elsewhere in the map is copied, not moved.
    ours = {name: _made(table, source) for name, source in sources.items()}
    if point_from:
        ours["point"] = table[list(point_from)].astype(str).agg("/".join, axis=1)
    moved = {name for name, s in sources.items() if name in table and s.name != name}
    # q3_rad = "q3_deg" says that the unit in the header is wrong.
    moved |= {s.name for name, s in sources.items() if s.name not in sources and _stem(name) == _stem(s.name)}
    shifts = [s.rows for s in sources.values()]
    rows = slice(max(0, -min(shifts, default=0)), len(table) - max(0, *shifts, 0))
    return table.drop(columns=sorted(moved)).assign(**ours).iloc[rows].reset_index(drop=True), rows


def _made(table: pd.DataFrame, source: Source) -> pd.Series:
    """A column as its source says; cells that are no numbers stay as they are where nothing is computed."""
    if source.plain:
        return table[source.name]
    terms = {source.name: source.times, **{n: source.add[n] for n in source.add if n != source.name}}
    number = {name: pd.to_numeric(table[name], errors="coerce") for name in terms}
    total = sum((factor * number[name] for name, factor in terms.items()), start=pd.Series(source.plus, table.index))
    words = table[source.name].where(number[source.name].isna())
    return total.where(words.isna(), words).shift(-source.rows)


def _stem(name: str) -> str:
    return name.rpartition("_")[0]
