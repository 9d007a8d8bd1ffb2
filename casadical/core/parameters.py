"""Parameters by name: value, unit, scale, bounds, prior; chosen by name or group, never by position."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from casadical.core.basics import Array, InputError

# SI unit -> (unit of reports, factor)
_READABLE = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "rad/(N m)": ("urad/(N m)", 1e6), "": ("", 1.0)}

# Words that stand for several groups.
_UNIONS = {"kinematic": ("base", "geometry", "loop", "tool"), "placement": ("base", "tool")}


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    name : as in the paper's tables: alpha2, a2, beta2, d3, theta3, L4, tool_x, base_rx, c3
    group : base, geometry, loop, tool, compliance, or the name of an effect
    unit : SI unit
    value : nominal value [unit]
    scale : unit of the solver's variable: 1 mm, 1 mrad [unit]
    lower, upper : bound [unit]
    prior : one sigma of the deviation from nominal [unit]
    held : why it is never identified; empty if it can be
    guess : whether nobody knows its value: its prior holds it back in every fit
    """

    name: str
    group: str
    unit: str
    value: float
    scale: float
    lower: float
    upper: float
    prior: float
    held: str = ""
    guess: bool = False

    @property
    def readable_unit(self) -> str:
        """Unit of reports: mm, deg, urad/(N m), or the SI unit."""
        return _READABLE.get(self.unit, (self.unit, 1.0))[0]

    def readable(self, value: float) -> float:
        """A value [SI] in the unit of reports (mm, deg, urad/(N m))."""
        return value * _READABLE.get(self.unit, (self.unit, 1.0))[1]


class Parameters(Sequence[Parameter]):
    """An ordered, immutable set of parameters, in model order. Raises InputError: two of one name."""

    def __init__(self, items: Iterable[Parameter]) -> None:
        self._items = tuple(items)
        self._index = {p.name: k for k, p in enumerate(self._items)}
        if len(self._index) != len(self._items):
            names = [p.name for p in self._items]
            raise InputError(f"parameter names occur twice: {sorted({n for n in names if names.count(n) > 1})}")

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._items)

    def __getitem__(self, key: int | str) -> Parameter:  # type: ignore[override]
        return self._items[key if isinstance(key, int) else self.index_of(key)]

    def index_of(self, name: str) -> int:
        """Place of a parameter in the list. Raises InputError: no such name; those that there are."""
        if name not in self._index:
            raise InputError(f"no parameter {name!r}; there are {', '.join(self.names)}")
        return self._index[name]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self._items)

    @property
    def values(self) -> Array:
        """Nominal values, shape (len(self),) [SI]."""
        return np.array([p.value for p in self._items])

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups, each once, in model order."""
        return tuple(dict.fromkeys(p.group for p in self._items))

    def select(self, wanted: Iterable[str]) -> tuple[str, ...]:
        """Names chosen by group, union of groups (kinematic, placement), name, or pattern with * - in model order.

        Raises InputError: a word that chooses nothing.
        """
        chosen: set[str] = set()
        for word in [wanted] if isinstance(wanted, str) else wanted:
            if word in self._index:  # at once: a prior names hundreds
                chosen.add(word)
                continue
            groups = _UNIONS.get(word, (word,))
            hit = {p.name for p in self._items if p.group in groups or fnmatchcase(p.name, word)}
            if not hit and word not in (*_UNIONS, "compliance"):
                raise InputError(
                    f"{word!r} is no parameter, group or pattern of this robot; groups: "
                    f"{', '.join((*_UNIONS, *self.groups))}; parameters: {', '.join(self.names)}"
                )
            chosen |= hit
        return tuple(n for n in self.names if n in chosen)
