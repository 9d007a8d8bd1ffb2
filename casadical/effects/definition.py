"""Effects defined in a file: a table [[definition]] has their formulas, sizes, settings and texts.

The package's own list, `listed.effect.toml`, and users' effect and robot files have the same
format. A definition may name a counterpart in a simulator; each is for effects with the parameters
that it reads.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, fields, make_dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, Strict, model_validator

from casadical.core.basics import InputError, errors_of
from casadical.core.parts import Arm, Body
from casadical.core.reading import MAX_ITEMS, load_toml
from casadical.core.schema import FaultError, TomlTable, Triple, check
from casadical.core.transforms import Symbolic
from casadical.effects.base import Context, Counterparts, Effect
from casadical.effects.formula import ARGUMENT_COUNTS, Formula, parse
from casadical.effects.formula_effect import (
    ANCHOR_COLUMNS,
    DEFAULT_TARGET_DIRECTION,
    SEAMS,
    STATION_SEAMS,
    FormulaEffect,
    check_formula,
    check_values,
    columns_of,
    is_variable,
)
from casadical.effects.settings import MAX_SETTING_COUNT, NEAR_JOINTS, setting


def gear_ratio(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Return a simulator's counterparts with a changed gear ratio of the effect's joint.

    v : `k`, by which the rotation of the joint per commanded rotation exceeds 1
    """
    return simulator.with_drive(effect, "gear of the drive", ratio=1 + v["k"])


def pedestal_hinges(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Return a simulator's counterparts with elastic hinges of the pedestal.

    v : `rx` and `ry`, tilts about the base frame's x and y under the maximum peak gravity torque
        of the revolute joints [rad]
    """
    return simulator.with_springs(effect.label, v, 0)


def joint_spring(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Return a simulator's counterparts with additional compliance of the effect's joint.

    v : `deflection` under the joint's peak gravity torque [rad]; an omission unless above zero
    """
    if v["deflection"] <= 0:
        return simulator.without_sign(effect.label)
    soft = simulator.drive(effect.joint).compliance + v["deflection"] / simulator.peak_torque(effect.joint)
    return simulator.with_drive(effect, f"spring of joint {effect.joint}", compliance=soft)


def dry_friction(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Return a simulator's counterparts with constant dry friction in the effect's joint [N m].

    It is the windup at the joint's mean load, divided by the joint's compliance; it is an omission
    unless both are above zero.
    v : `constant`, windup without load [rad], and `load`, its increase at the peak torque [rad]
    """
    soft = simulator.drive(effect.joint).compliance
    if soft <= 0:
        return simulator.without_sign(effect.label)
    assert effect.joint is not None
    wound = v["constant"] + v["load"] * float(simulator.mean_load[effect.joint - 1])
    if wound <= 0:
        return simulator.without(effect.label, "its friction came out negative")
    text = f"dry friction of {wound / soft:.4g} N m, at its mean load"
    return simulator.with_drive(effect, text, friction=wound / soft)


def soft_spring(effect: Any, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Return a simulator's counterparts with a spring between stops in series in the joint's drive.

    It approximates the deflection bend tanh(torque / (knee peak torque)).
    v : `bend`, at which the deflection saturates [rad]; an omission unless above zero
    The effect's setting `knee` is the torque scale of saturation, divided by the joint's peak
    gravity torque.
    """
    if v["bend"] <= 0:
        return simulator.without_sign(effect.label)
    # The ramp between stops that is closest to tanh(x) has slope 0.76 and stops at 0.92; it differs
    # by up to 0.083.
    stiffness = effect.knee * simulator.peak_torque(effect.joint) / (0.76 * v["bend"])
    spring = f"joint{effect.joint}_bed, a soft spring between stops, within {1e6 * 0.083 * v['bend']:.1f} urad"
    return simulator.with_drive(effect, spring, give=0.92 * v["bend"], give_stiffness=stiffness)


def hardening_spring(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Return a simulator's counterparts with a spring k1 d + k3 d^3 in the effect's joint.

    Its torque is fitted by least squares to the deflection d = c tau - bend (tau / peak)^3 [rad]
    for torques tau up to 1.2 times the joint's peak gravity torque; c is the joint's compliance.
    v : `bend` [rad]; an omission where d would decrease with tau
    """
    peak, load = simulator.peak_torque(effect.joint), np.linspace(-1.2, 1.2, 97)
    d = simulator.drive(effect.joint).compliance * peak * load - v["bend"] * load**3
    if (np.diff(d) <= 0).any():
        return simulator.without(effect.label, "the deflection would decrease with the load")
    scale = np.array([np.abs(d).max(), np.abs(d).max() ** 3])
    k1, k3 = np.linalg.lstsq(np.column_stack([d, d**3]) / scale, peak * load, rcond=None)[0] / scale
    off = 1e6 * float(np.abs(peak * load - k1 * d - k3 * d**3).max() / k1)
    spring = f"joint{effect.joint}_give with the spring k1 d + k3 d^3, within {off:.1f} urad"
    return simulator.with_drive(effect, spring, k1=float(k1), k3=float(k3))


def payload(effect: Effect, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
    """Return a simulator's counterparts with the identified payload; an omission if none is known.

    Without a mass above zero the centre of mass is unknown: that is an omission, too.

    v : `mass`, error of the mass divided by the declared mass; `x`, `y`, `z`, error of the first
        moment in the last link's frame, divided by the declared mass [m]
    """
    declared = simulator.payload
    if declared is None or (factor := 1 + v["mass"]) <= 0:
        return simulator.without(effect.label, "no counterpart in MuJoCo")
    centre = declared.com + np.array([v[c] for c in "xyz"]) / factor
    text = f"{effect.label}: {declared.mass * factor:.4g} kg in place of {declared.mass:.4g} kg, centre moved"
    return simulator.noted(text, payload=Body(declared.mass * factor, centre), payload_factor=factor)


# Functions that add an effect's counterpart in a simulator, by the value of a definition's key
# `counterpart`.
COUNTERPARTS: Mapping[str, Callable[[Effect, Counterparts, Mapping[str, float]], Counterparts]] = {
    "gear ratio": gear_ratio,
    "foot hinges": pedestal_hinges,
    "joint spring": joint_spring,
    "dry friction": dry_friction,
    "soft spring": soft_spring,
    "hardening spring": hardening_spring,
    "payload": payload,
}


# File with the definitions of the package's effects.
LISTED_EFFECTS_FILE = Path(__file__).with_name("listed.effect.toml")
# Pattern of the name of an effect, a setting or a parameter, by full match.
_NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]*")
# Pattern of a placeholder in a definition's texts: `joint` or the name of a setting in braces.
_PLACEHOLDER = re.compile(r"\{(\w+)\}")
# Type of a setting that is not a point.
_Value = bool | int | float | str


class Grid(TomlTable):
    """A grid of `count` equidistant values from `first` to `last`."""

    first: float
    last: float
    count: int = Field(ge=2, le=1000)


class Setting(TomlTable):
    """The table of a setting (number, switch, word or point) in which an effect is not linear.

    about : its description; all other keys are the arguments of `effects.settings.setting`
    """

    default: _Value | Triple
    grid: list[_Value] | Grid | Literal["near"] = []
    steps: bool = False
    signed: bool = False
    given: bool = False
    joint: bool = False
    whole: bool = False
    tried: list[float] = []
    about: str = ""

    @model_validator(mode="after")
    def _values(self) -> Setting:
        """Return the setting unchanged if its grid and `steps` fit its default."""
        if self.grid == "near" and not self.joint:
            raise FaultError("grid", "only for the number of a joint: joint = true")
        if isinstance(self.grid, list) and not {type(v) for v in self.grid} <= {self.type}:
            raise FaultError("grid", f"must hold values like the default one, {self.default!r}")
        if self.steps and not (isinstance(self.grid, Grid) or len(self.grid) > 1):
            raise FaultError("steps", "needs a grid of two values or more")
        return self

    @property
    def value(self) -> Any:
        """Return the default value; a point is a tuple of three numbers."""
        return tuple(self.default) if isinstance(self.default, list) else self.default

    @property
    def type(self) -> Any:
        """Return the type of its values."""
        return tuple[float, float, float] if isinstance(self.default, list) else type(self.default)

    @property
    def points(self) -> int:
        """Return the number of values of the setting's grid, at least 1; 2 is taken for "near"."""
        return (
            self.grid.count
            if isinstance(self.grid, Grid)
            else 2
            if self.grid == NEAR_JOINTS
            else max(1, len(self.grid))
        )

    def field(self) -> Any:
        """Return the setting as a field of an effect's dataclass, made by `setting`."""
        grid: Any = self.grid
        if isinstance(grid, Grid):
            grid = [float(v) for v in np.linspace(grid.first, grid.last, grid.count)]
        how = {key: getattr(self, key) for key in ("steps", "signed", "given", "joint", "whole", "tried")}
        return setting(self.value, NEAR_JOINTS if grid == "near" else tuple(grid), **how)


class Definition(TomlTable):
    """The table that defines an effect; keys named as class attributes of `Effect` set these.

    {joint} and {NAME OF A SETTING} in formulas and in names of parameters and of columns are
    replaced by their values.
    summary : first line of the class's documentation; settings : by name
    sizes : typical size and unit of each parameter; formulas : texts by insertion point (`SEAMS`)
    counterpart : name of the counterpart in a simulator, a key of `COUNTERPARTS`; empty for none
    """

    name: str = Field(pattern=rf"^{_NAME_PATTERN.pattern}$", max_length=60)
    on_list: Literal["standard", "extended", "motion", ""] = ""
    answers_as: str = ""
    acts_at: Literal["arm", "joints", "turning joints", "rigid joints", "payload", ""] = ""
    of_measurement: bool = False
    from_kind: bool = False
    simulated_first: bool = False
    together: bool = False
    needs: list[str] = []
    summary: str = ""
    signature: str = Field(min_length=1)
    physics: str = ""
    confused_with: str = ""
    settings: dict[str, Setting] = {}
    sizes: dict[str, Annotated[tuple[float, str], Strict(False)]] = Field(min_length=1)
    formulas: dict[str, str] = Field(min_length=1)
    counterpart: str = ""


class DefinitionFile(TomlTable):
    """The schema of a TOML file with definitions of effects; `casadical` is its format number."""

    casadical: Literal[2]
    definition: list[Definition] = Field(default=[], max_length=MAX_ITEMS)


@dataclass(frozen=True)
class DefinedEffect(FormulaEffect):
    """An effect that a table defines; its settings are the fields that the table names."""

    definition: ClassVar[Definition]
    places: ClassVar[tuple[str, ...]]  # names in braces in its texts: joint and settings
    texts_with: ClassVar[Callable[[tuple[str, ...]], _Texts]]  # returns the texts with values in their places
    if TYPE_CHECKING:

        def __init__(self, joint: int | None = None, *settings: Any, **named: Any) -> None: ...

        def __getattr__(self, setting: str) -> Any: ...

    def __reduce__(self) -> tuple[Any, ...]:
        settings = {f.name: getattr(self, f.name) for f in fields(self)}
        return _unpickled, (self.definition.model_dump_json(), type(self).__module__, type(self).__name__, settings)

    @property
    def _texts(self) -> _Texts:
        return type(self).texts_with(tuple(_as_word(getattr(self, place)) for place in self.places))

    @property
    def needs(self) -> tuple[str, ...]:  # type: ignore[override]
        """Return the names of the columns, logged or derived, without which it is no candidate.

        temperature_degC is among them if a formula uses a warmth, which is derived from it.
        """
        return self._texts.needs

    @property
    def conditions(self) -> tuple[str, ...]:
        """Return the names of the columns that the effect needs, logged or derived."""
        return (*self._texts.conditions, *self.of_head)

    @property
    def formulas(self) -> Mapping[str, Formula]:
        """Return the formulas by insertion point, with joint and settings inserted."""
        return self._texts.formulas

    @property
    def drivers(self) -> tuple[str, ...]:
        """Return the names in the formulas that are neither parameters nor settings."""
        return self._texts.drivers

    def sizes(self) -> Mapping[str, tuple[float, str]]:
        """Return typical size and unit of each parameter, with joint and settings in its name."""
        return self._texts.sizes

    def refuse_joints(self, arm: Arm) -> None:
        """Check that the effect has a joint if it needs one, and that the arm has all it uses.

        Raises InputError.
        """
        if "joints" in self.acts_at and self.joint is None:
            raise InputError(f"{self.name}: joint is missing")
        super().refuse_joints(arm)

    def own_names(self, context: Context) -> dict[str, Symbolic]:
        """Return the values of the effect's settings and the symbols of its parameters, by name."""
        settings = {name: getattr(self, name) for name in self.definition.settings}
        return settings | {name: self.value(context, name) for name in self.sizes()}

    def counterpart(self, simulator: Counterparts, v: Mapping[str, float]) -> Counterparts:
        """Return a simulator's counterparts with that which the definition names, or an omission.

        v : values of its parameters by short name [SI]
        """
        counterpart = COUNTERPARTS.get(self.definition.counterpart)
        return counterpart(self, simulator, v) if counterpart else super().counterpart(simulator, v)


class _Texts(NamedTuple):
    """Texts of an effect, with the values of joint and settings in place of the placeholders.

    formulas : by insertion point; sizes : typical size and unit of each parameter
    needs : columns without which it is no candidate; conditions : columns that its formulas use
    drivers : names in the formulas that are neither parameters nor settings
    """

    formulas: Mapping[str, Formula]
    sizes: Mapping[str, tuple[float, str]]
    needs: tuple[str, ...]
    conditions: tuple[str, ...]
    drivers: tuple[str, ...]


def _as_word(value: Any) -> str:
    """Return the text of a setting's value in names and formulas; a float is rounded to integer."""
    return str(value) if isinstance(value, int | str | tuple | None) else f"{value:.0f}"


def _texts_of(d: Definition, places: tuple[str, ...], words: tuple[str, ...]) -> _Texts:
    """Return the texts of a definition with its placeholders replaced."""
    of_place = dict(zip(places, words, strict=True))

    def filled(text: str) -> str:
        return _PLACEHOLDER.sub(lambda place: of_place[place[1]], text)

    sizes = {filled(name): size for name, size in d.sizes.items()}
    needs = tuple(map(filled, d.needs))
    own = {*sizes, *d.settings}
    formulas = {seam: parse(filled(text), frozenset(own)) for seam, text in d.formulas.items()}
    names = dict.fromkeys(n for f in formulas.values() for n in f.names if n not in own)
    anchor = ANCHOR_COLUMNS if "distance" in formulas else ()
    conditions = tuple(dict.fromkeys((*needs, *columns_of(names), *anchor)))
    warm = any(c.startswith("warmth") for c in conditions)
    return _Texts(formulas, sizes, (*needs, *(["temperature_degC"] if warm else [])), conditions, tuple(names))


@cache
def _class_of(definition: str, module: str, name: str) -> type[DefinedEffect]:
    """Return the class of an effect, the same object for equal arguments."""
    d = Definition.model_validate_json(definition)
    own = [(key, s.type, s.field()) for key, s in d.settings.items()]
    numbered = any(SEAMS[seam].numbered for seam in d.formulas)
    about = [f"{key} : {s.about}" for key, s in d.settings.items() if s.about]
    places = tuple(dict.fromkeys(place for text in _templates(d) for place in _PLACEHOLDER.findall(text)))
    attributes = {
        **{key: getattr(d, key) for key in Definition.model_fields if key in Effect.__annotations__ and key != "needs"},
        "acts_at": d.acts_at or ("joints" if numbered else "arm"),
        "definition": d,
        "places": places,
        "texts_with": staticmethod(lru_cache(maxsize=1024)(partial(_texts_of, d, places))),
        "__doc__": "\n\n".join([d.summary or d.physics or d.signature, *(["\n".join(about)] if about else [])]),
    }
    made: type[DefinedEffect] = make_dataclass(name, own, bases=(DefinedEffect,), namespace=attributes, frozen=True)
    made.__module__ = module  # from Python 3.12 on, make_dataclass writes its caller's over one in the namespace
    return made


def _templates(d: Definition) -> tuple[str, ...]:
    return (*d.formulas.values(), *d.sizes, *d.needs)


def _unpickled(definition: str, module: str, name: str, settings: Mapping[str, Any]) -> Effect:
    """Return the effect of a pickle; the arguments are those that `__reduce__` stored."""
    return _class_of(definition, module, name)(**settings)


def effect_class(d: Definition, module: str = "effect file") -> type[DefinedEffect]:
    """Return the class of a validated definition, the same object for equal definitions.

    module : name of the module of the class. Formulas are checked with default settings at joint 1.
    Raises InputError that names the faulty key.
    """
    _refuse_names(d, () if module.startswith("casadical.") else ARGUMENT_COUNTS)
    kind = _class_of(d.model_dump_json(), module, "".join(word.title() for word in d.name.split("_")))
    if "joints" not in kind.acts_at and ("joint" in kind.places or any(SEAMS[seam].numbered for seam in d.formulas)):
        raise InputError(
            f"acts_at = {kind.acts_at!r}: its formula is of one joint; allowed: joints, turning joints, rigid joints"
        )
    settings = {key: s.value for key, s in d.settings.items()}
    numbers = {key: value for key, value in settings.items() if isinstance(value, int | float)}
    with errors_of("formulas: "):
        texts = kind.texts_with(tuple(_as_word({"joint": 1, **settings}[place]) for place in kind.places))
        for seam, formula in texts.formulas.items():
            check_formula(formula.text, seam, (*texts.sizes, *numbers, *texts.needs))
            check_values(formula, texts.sizes, numbers)
    used = {name for formula in texts.formulas.values() for name in formula.names}
    if unused := [name for name in texts.sizes if name not in used]:
        raise InputError(f"sizes.{unused[0]}: is in no formula")
    return kind


def _refuse_names(d: Definition, functions: Collection[str]) -> None:
    """Check that no name in a definition is unknown, reserved or used twice. Raises InputError.

    Names are those of insertion points, the counterpart, placeholders, settings and parameters.
    Also checked are the sizes and the number of combinations of settings.
    """
    for seam in d.formulas:
        if seam not in SEAMS or seam == "joints":
            raise InputError(f"formulas.{seam}: no seam; allowed: {', '.join(s for s in SEAMS if s != 'joints')}")
        placed = "station" in d.settings and isinstance(d.settings["station"].default, list)
        if seam in STATION_SEAMS and not placed:
            raise InputError(f"formulas.{seam}: it needs a setting `station`, a point")
        looks = d.settings["towards"].default if "towards" in d.settings else DEFAULT_TARGET_DIRECTION
        if "incidence" in str(d.formulas[seam]) and not (isinstance(looks, (list, tuple)) and any(looks)):
            raise InputError(f"formulas.{seam}: `incidence` takes the setting `towards` as a direction, [0, 0, 1] say")
    if d.counterpart and d.counterpart not in COUNTERPARTS:
        raise InputError(f"counterpart = {d.counterpart!r}: allowed: {', '.join(COUNTERPARTS)}")
    if math.prod(s.points for s in d.settings.values()) > MAX_SETTING_COUNT:
        raise InputError(f"settings: their grids have more than {MAX_SETTING_COUNT} combinations; use coarser ones")
    for name, (size, _) in d.sizes.items():
        if not 0 < size <= 1e3:
            raise InputError(f"sizes.{name}: one sigma of {size!r}; must be above 0, and 1000 at most")
    taken = {"t", "r", "joint", *(d.settings.keys() & d.sizes.keys())}
    for name in (*d.settings, *d.sizes):
        if what := "function" * (name in functions) or "variable" * any(is_variable(name, s) for s in d.formulas):
            raise InputError(f"{name}: is a {what} of formulas; give the parameter or setting another name")
        if name in taken or not _NAME_PATTERN.fullmatch(_PLACEHOLDER.sub("1", name)):
            raise InputError(f"{name}: a name of small letters, digits and _ of its own is needed, not t, r or joint")
    for text in _templates(d):
        for place in _PLACEHOLDER.findall(text):
            if place != "joint" and place not in d.settings:
                raise InputError(f"{text!r}: no setting {place!r}; allowed: {', '.join(('joint', *d.settings))}")


def effect_classes(definitions: Iterable[Definition], module: str = "effect file") -> tuple[type[DefinedEffect], ...]:
    """Return the effect class of each definition, in order.

    Raises InputError that names the table, 1-based, and the key.
    """
    kinds = []
    for k, d in enumerate(definitions, 1):
        with errors_of(f"definition[{k}]."):
            kinds.append(effect_class(d, module))
    return tuple(kinds)


def read_definitions(path: Path, module: str = "effect file") -> dict[str, type[DefinedEffect]]:
    """Return the effect classes that a TOML file defines, by name of the effect.

    module : name of the module of the classes. Raises InputError that names the file.
    """
    file = check(DefinitionFile, load_toml(path), path.name)
    with errors_of(f"{path.name}: "):
        return {kind.name: kind for kind in effect_classes(file.definition, module)}
