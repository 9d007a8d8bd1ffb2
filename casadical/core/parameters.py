"""Model parameters by name: value, unit, scale, bounds and prior; selected by name or group."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from casadical.core.basics import Array, InputError

# Unit of reports, and the factor to it from the SI unit, by SI unit.
_REPORT_UNITS = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "rad/(N m)": ("urad/(N m)", 1e6), "": ("", 1.0)}


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    name : as in the paper's tables: alpha2, a2, d3, theta3, L4, tool_x, base_rx, c3; or label.name
    group : base, geometry, loop, tool, compliance, or the label of an effect
    unit : SI unit of the other numbers: m, rad, rad/(N m), ...
    value : nominal value [unit]
    scale : size of one unit of the solver's variable, such as 1e-3 for 1 mm or 1 mrad [unit]
    lower, upper : bounds [unit]
    prior : prior standard deviation of the deviation from nominal [unit]
    fixed_reason : reason why it is fixed and never identified; empty if it can be identified
    guess : whether its nominal value is a guess: its prior then applies in every fit
    as_declared : whether reports have it in `unit`, as the user's own effect declares it
    """

    name: str
    group: str
    unit: str
    value: float
    scale: float
    lower: float
    upper: float
    prior: float
    fixed_reason: str = ""
    guess: bool = False
    as_declared: bool = False

    @property
    def readable_unit(self) -> str:
        """Return the unit of reports: mm, deg or urad/(N m), or `unit`, always if `as_declared`."""
        return self.unit if self.as_declared else _REPORT_UNITS.get(self.unit, (self.unit, 1.0))[0]

    def readable(self, value: float) -> float:
        """Return a value or difference of the parameter [SI] in `readable_unit`."""
        return value if self.as_declared else value * _REPORT_UNITS.get(self.unit, (self.unit, 1.0))[1]


class Parameters(Sequence[Parameter]):
    """An ordered, immutable set of parameters, in model order.

    Raises InputError: two parameters of one name.
    """

    def __init__(self, items: Iterable[Parameter]) -> None:
        self._items = tuple(items)
        self._index = {p.name: k for k, p in enumerate(self._items)}
        self.names = tuple(self._index)  # in model order
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
        """Return the index of a parameter in model order.

        Raises InputError that lists all names for an unknown one.
        """
        if name not in self._index:
            raise InputError(f"no parameter {name!r}; there are {', '.join(self.names)}")
        return self._index[name]

    @property
    def values(self) -> Array:
        """Return the nominal values, shape (len(self),) [SI]."""
        return np.array([p.value for p in self._items])

    @property
    def groups(self) -> tuple[str, ...]:
        """Return the groups, each once, in model order."""
        return tuple(dict.fromkeys(p.group for p in self._items))

    def select(self, wanted: Iterable[str]) -> tuple[str, ...]:
        """Return the names of the selected parameters, in model order.

        wanted : one or more groups, unions (kinematic, placement), names, or patterns with *
        Raises InputError: a word that selects nothing, other than a union or compliance.
        """
        chosen: set[str] = set()
        # Words that select several groups of parameters, with these groups.
        group_unions = {"kinematic": ("base", "geometry", "loop", "tool"), "placement": ("base", "tool")}
        for word in [wanted] if isinstance(wanted, str) else wanted:
            if word in self._index:  # a prior names hundreds of parameters: no search
                chosen.add(word)
                continue
            groups = group_unions.get(word, (word,))
            hit = {p.name for p in self._items if p.group in groups or fnmatchcase(p.name, word)}
            if not hit and word not in (*group_unions, "compliance"):
                raise InputError(
                    f"{word!r} is no parameter, group or pattern of this robot; groups: "
                    f"{', '.join((*group_unions, *self.groups))}; parameters: "
                    f"{', '.join(self.names)}"
                )
            chosen |= hit
        return tuple(n for n in self.names if n in chosen)
