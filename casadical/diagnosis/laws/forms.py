"""State variables on which an error may depend, and the functions of them that are compared.

A state variable has one smooth function, which describes an error without a form, and drivers,
formulas of it that the grammar's forms take. A form is text in x (the driver) and its settings k, w
and f, in which it is not linear. Settings have four digits, so that the formula that is written is
the one that was evaluated.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Self

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Arm
from casadical.diagnosis.linearisation import Linearisation
from casadical.effects.formula import NUMERIC_FUNCTIONS, names_in, parse
from casadical.effects.formula_effect import COLUMN_NAME, Law, columns_of


@dataclass(frozen=True)
class StateVariable:
    """What an error may depend on: a quantity of one joint or link, of the tool, or of the whole.

    family : kind of quantity; joints : numbers of its joints or links, 0 for the pedestal, () for none
    parts : terms of its smooth function, formulas; () for cosines of its driver over the range
    drivers : (formula, kind as of `forms_of`) of each driver that a form may take
    """

    family: str
    joints: tuple[int, ...]
    parts: tuple[str, ...]
    drivers: tuple[tuple[str, str], ...]

    @property
    def words(self) -> str:
        """Return the state variable in words: load of joint 2."""
        noun = ("", " of joint ", " of joints ")[len(self.joints)]
        return (self.family + noun + " and ".join(map(str, self.joints))).replace("of joint 0", "of the pedestal")

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names in its formulas, each once."""
        return names_in([parse(text) for text in (*self.parts, *(text for text, _ in self.drivers))])


def state_variables(arm: Arm) -> list[StateVariable]:
    """Return every state variable of a robot's errors, whether its columns were logged or not."""

    def linear(texts: Sequence[str]) -> tuple[tuple[str, str], ...]:
        """Return formulas as drivers of the linear form alone."""
        return tuple((text, "linear") for text in texts)

    warmth = ("warmth", *(f"warmth_{lag}s" for lag in (300, 600, 1200, 2400)))
    of_gravity = ("gx", "gy", "gz", "gx*gx", "gy*gy", "gx*gy", "gx*gz", "gy*gz")
    radius = "sqrt(px**2 + py**2)"
    of_place = ("px", "py", "pz", "px*px", "py*py", "pz*pz", "px*py", radius)
    found = [
        StateVariable("time", (), (), (("t", "time"),)),
        StateVariable("temperature", (), (*warmth, "warmth_600s**2"), tuple((w, "positive") for w in warmth)),
        StateVariable("payload", (), ("payload", "payload**2"), (("payload", "linear"),)),
        StateVariable("gravity in the tool", (), of_gravity, tuple((g, "signed") for g in of_gravity[:3])),
        StateVariable("place of the flange", (), of_place, ((radius, "positive"), ("pz", "positive"))),
    ]
    for i in (0, *arm.numbers):
        x, y, size = f"m{i}x", f"m{i}y", f"sqrt(m{i}x**2 + m{i}y**2 + m{i}z**2)"
        of_moment = (x, y, size, f"{x}*{x}", f"{y}*{y}", f"{x}*{y}", f"tanh(6*{x})", f"tanh(6*{y})")
        found.append(StateVariable("moment", (i,), of_moment, ((x, "signed"), (y, "signed"), (size, "positive"))))
    for i in arm.numbers:
        q, tau, move, side = f"q{i}", f"tau{i}", f"move{i}", f"approach{i}"
        of_both = tuple(f"{tau}*{f}({h}*{q})" for h in range(1, 5) for f in ("sin", "cos"))
        slow = tuple(f"{own}*{o}" for own in (q, f"sin({q})", f"cos({q})", tau) for o in ("t", "warmth_600s"))
        of_move = (side, f"{side}*{tau}", move, f"abs({move})", *(f"{side}*exp(-abs({move})/{d})" for d in (0.1, 0.4)))
        sided = (side, f"{side}*{tau}", f"{side}*t")
        memories = tuple(f"memory{i}_{way}mrad" for way in (100, 300, 1000, 3000))
        memories = (*memories, *(f"{tau}*{memory}" for memory in memories))
        plays = tuple(f"play{i}_{play}mrad" for play in (100, 300, 1000))
        heats = tuple(f"heat{i}_{lag}s" for lag in (300, 1200))
        found += [
            StateVariable("angle", (i,), (), ((q, "angle"),)),
            StateVariable("load", (i,), (), ((tau, "signed"),)),
            StateVariable("angle and load", (i,), of_both, ((f"{q}*{tau}", "linear"), (q, f"wave by {tau}"))),
            StateVariable("angle, in time and temperature,", (i,), slow, linear(slow)),
            StateVariable("last motion", (i,), of_move, ((move, "signed"), *linear(sided))),
            StateVariable("motion history", (i,), memories, linear((*memories, *plays))),
            StateVariable("load history", (i,), (*heats, f"{tau}*{heats[0]}"), linear(heats)),
        ]
    for i, j in combinations(arm.numbers, 2):
        angles = (f"q{i}", f"q{j}", f"q{i} + q{j}", f"q{i} - q{j}", f"2*q{i}", f"2*q{j}")
        of_two = tuple(f"{f}({angle})" for angle in angles for f in ("sin", "cos"))
        sums = tuple((f"q{i} {sign} q{j}", "angle") for sign in "+-") if j == i + 1 else ()
        found.append(StateVariable("angles", (i, j), of_two, sums))
        found.append(StateVariable("loads", (i, j), (f"tau{i}*tau{j}",), ((f"tau{i}*tau{j}", "linear"),)))
    return found


def varying(linear: Linearisation, variables: Sequence[StateVariable]) -> tuple[list[StateVariable], dict[str, Array]]:
    """Return the state variables with what varies of them, and the values of all names, (n,) each.

    Constant parts and drivers are removed. A state variable is omitted where nothing varies or a
    column that it needs does not exist.
    """
    columns = {name: c for v in variables for name in v.names for c in columns_of([name])}
    values = {name: linear.conditions[c] for name, c in columns.items() if c in linear.conditions}
    # Values of a pose's own quantities are ratios of the columns of laws that shift the base.
    names = tuple(dict.fromkeys(n for v in variables for n in v.names if not COLUMN_NAME.fullmatch(n)))
    unit = linear.columns([Law(None, "base shift", "[a, 0, 0]")])[:, :, 0]
    letters = "abcdefghijklmnopqs"  # factors of a formula that evaluates several names at once
    for first in range(0, len(names), len(letters)):
        some = dict(zip(letters, names[first:], strict=False))
        terms = " + ".join(f"{letter}*{name}" for letter, name in some.items())
        law = Law(None, "base shift", f"[{terms}, 0, 0]", tuple((letter, 1e-5) for letter in some))
        share = (linear.columns([law]) * unit[:, :, None]).sum(axis=1) / (unit**2).sum(axis=1)[:, None]
        values.update(zip(some.values(), share.T, strict=True))

    def varies(text: str) -> bool:
        """Return whether a formula varies over the poses, by more than 0.02 (SI), up to 1e6."""
        x = value_of(text, values)
        return bool(np.isfinite(x).all() and np.ptp(x) > 0.02 and np.abs(x).max() < 1e6)

    found = []
    for v in (v for v in variables if all(name in values for name in v.names)):
        parts, drivers = tuple(p for p in v.parts if varies(p)), tuple(d for d in v.drivers if varies(d[0]))
        # A driver of two values has no form but the linear one.
        drivers = tuple((t, k if len(np.unique(value_of(t, values))) > 2 else "linear") for t, k in drivers)
        if parts or (drivers and not v.parts):
            found.append(replace(v, parts=parts, drivers=drivers))
    return found, values


def value_of(text: str, values: Mapping[str, Array]) -> Array:
    """Return the values of a formula at the poses, shape (n,); values : of its names."""
    return np.asarray(parse(text).values(values, NUMERIC_FUNCTIONS)[0])


@dataclass(frozen=True)
class Form:
    """A function of a driver, linear in factors and nonlinear in settings.

    name : name of the form, SMOOTH_FORM for the description of a state variable
    parts : formulas in x and the settings, each with its own factor; settings : their names
    grid : function of the driver's values, shape (n,), that returns K settings, shape (K, settings)
    """

    name: str
    parts: tuple[str, ...]
    settings: tuple[str, ...] = ()
    grid: Callable[[Array], Array] = lambda _x: np.zeros((1, 0))

    def texts(self, driver: str, settings: Sequence[float]) -> tuple[str, ...]:
        """Return the formula of each part with the driver's formula and the settings inserted."""
        given = dict(zip(self.settings, settings, strict=True))
        x = driver if re.fullmatch("\\w+|\\w+\\([^()]*\\)", driver) else f"({driver})"
        texts = []
        for text in self.parts:
            if given.get("k", 0.0) < 0:
                text = text.replace("x - k", f"x + {-given['k']:.4g}")
            for name, value in given.items():
                text = re.sub(rf"\b{name}\b", f"{float(value):.4g}", text)
            texts.append(re.sub(r"\bx\b", x, text))
        return tuple(texts)


# Name of the form of a description: a smooth function of a state variable.
SMOOTH_FORM = "smooth"


@dataclass(frozen=True, eq=False)
class Function:
    """A form over one driver of a state variable, at the poses.

    driver : formula of the driver; x : its values, shape (n,)
    names : values of other names in the form, shape (n,) each
    """

    variable: StateVariable
    driver: str
    form: Form
    x: Array
    names: Mapping[str, Array]

    @classmethod
    def smooth(cls, variable: StateVariable, values: Mapping[str, Array]) -> Self:
        """Return the smooth function of a state variable: the sum of its parts, each with a factor.

        If the variable has no parts, they are cosines over its driver's range, the Karhunen-Loeve
        expansion of a random walk. No settings remain to be chosen.
        values : of the names in the variable's formulas, shape (n,) each
        """
        driver = variable.drivers[0][0] if variable.drivers else variable.parts[0]
        x, names = value_of(driver, values), {name: values[name] for name in variable.names}
        if variable.parts:
            form = Form(SMOOTH_FORM if len(variable.parts) > 1 else "linear", variable.parts)
            return cls(variable, driver, form, x, names)
        settings = rounded(np.array([[x.min(), np.pi / np.ptp(x)]]))
        parts = tuple(f"cos({h}*f*(x - k))" for h in range(1, 9 if variable.family == "time" else 7))
        return cls(variable, driver, Form(SMOOTH_FORM, parts, ("k", "f"), lambda _x: settings), x, names)

    def others(self) -> list[Self]:
        """Return all forms in this smooth function's state variable; [] if it has one part."""
        every = [(d, form) for d, kind in self.variable.drivers for form in forms_of(kind)]
        some = every if len(self.form.parts) > 1 else []
        return [replace(self, driver=d, form=form, x=value_of(d, self.names)) for d, form in some]

    @cached_property
    def settings(self) -> Array:
        """Return the grid of settings, shape (K, settings)."""
        return self.form.grid(self.x)

    def values(self, settings: Array, x: Array | None = None, names: Mapping[str, Array] | None = None) -> Array:
        """Return the value of each part at all poses and K settings, shape (parts, n, K).

        settings : shape (K, settings)
        x, names : values of the driver and of the names in place of those at the poses
        """
        x, names = self.x if x is None else x, self.names if names is None else names
        at = {name: value[:, None] for name, value in names.items()}
        at |= {"x": x[:, None], **{n: settings[None, :, i] for i, n in enumerate(self.form.settings)}}
        parts = [parse(part).values(at, NUMERIC_FUNCTIONS)[0] for part in self.form.parts]
        return np.stack([np.broadcast_to(part, (len(x), len(settings))) for part in parts])

    def scaled(self, settings: Array) -> tuple[Array, Array]:
        """Return the values in units of their variation, (parts, n, K), and the units, (parts, K).

        The unit is the largest of the standard deviation, a tenth of the range, and 1e-3; that of the
        h-th cosine of a smooth function is h times as large, since it varies by a share 1/h.
        """
        f = self.values(settings)
        units = np.maximum(np.maximum(f.std(axis=1), 0.1 * np.ptp(f, axis=1)), 1e-3)
        if self.form.name == SMOOTH_FORM and self.form.settings:
            units = units * np.arange(1, len(f) + 1)[:, None]
        return f / units[:, None], units

    @cached_property
    def on_grid(self) -> Array:
        """Return the values in units of their variation at all settings, shape (parts, n, K)."""
        return self.scaled(self.settings)[0]


def rounded(settings: Array) -> Array:
    """Return settings rounded to four significant digits, as they are written."""
    return np.array([float(f"{v:.4g}") for v in np.ravel(settings)]).reshape(np.shape(settings))


def _quantiles(count: int) -> Callable[[Array], Array]:
    """Return a function for a grid of k, shape (K, 1): `count` quantiles of the driver."""
    shares = np.linspace(0.5 / count, 1 - 0.5 / count, count)
    return lambda x: rounded(np.unique(np.quantile(x, shares))[:, None])


def _beyond(x: Array) -> Array:
    """Return the grid of k, shape (K, 1): six quantiles of the absolute value of a driver."""
    return rounded(np.unique(np.quantile(np.abs(x), [0.1, 0.25, 0.4, 0.55, 0.7, 0.85]))[:, None])


def _with_widths(count: int, shares: Sequence[float]) -> Callable[[Array], Array]:
    """Return a function: values of a driver -> grid of a form's settings k and w, shape (K, 2).

    The grid has every pair of a location k, a quantile of the driver, and a width w.

    count : number of locations; shares : widths divided by the range of the driver
    """
    at = np.linspace(0.5 / count, 1 - 0.5 / count, count)
    return lambda x: rounded(np.array([(a, b) for a in np.quantile(x, at) for b in np.array(shares) * np.ptp(x)]))


def _turns(_x: Array) -> Array:
    """Return the grid of the frequency f of waves, shape (K, 1) [cycles per revolution]."""
    return rounded(np.arange(0.5, 16.01, 0.25)[:, None])


# Every form of a law over one driver, by its name.
FORMS = {
    form.name: form
    for form in (
        Form("linear", ("x",)),
        Form("square", ("x**2",)),
        Form("cube", ("x**3",)),
        Form("size", ("abs(x)",)),
        Form("signed square", ("x*abs(x)",)),
        # Zero below k, then a line; the other way round; a line to both sides of a band about zero.
        Form("hinge", ("max(0, x - k)",), ("k",), _quantiles(12)),
        Form("hinge below", ("max(0, k - x)",), ("k",), _quantiles(12)),
        Form("hinge of the size", ("max(0, abs(x) - k)",), ("k",), _beyond),
        # Zero between -k and k, then a line with the sign of the driver.
        Form("dead band", ("(max(0, x - k) - max(0, -x - k))",), ("k",), _beyond),
        # A smooth transition at k of width w, constant beyond.
        Form("saturation", ("tanh((x - k)/w)",), ("k", "w"), _with_widths(7, (0.03, 0.08, 0.16, 0.32))),
        Form("step", ("step(x - k)",), ("k",), _quantiles(30)),
        # A Gaussian bump at k of width w.
        Form("bump", ("exp(-((x - k)/w)**2)",), ("k", "w"), _with_widths(9, (0.05, 0.1, 0.2, 0.35))),
        # One between k and w, else zero.
        Form(
            "on and off",
            ("step(x - k)*step(w - x)",),
            ("k", "w"),
            lambda x: rounded(np.array([*combinations(np.quantile(x, np.linspace(0.05, 0.95, 12)), 2)])),
        ),
        # Exponential decay with the constant w, a fraction of the driver's range.
        Form("fading", ("exp(-x/w)",), ("w",), lambda x: rounded((np.ptp(x) * np.geomspace(0.03, 0.6, 6))[:, None])),
        Form("wave", ("sin(f*x)", "cos(f*x)"), ("f",), _turns),
    )
}

# Forms in which a law may depend on a driver, by the driver's kind.
FORMS_BY_KIND = {
    kind: tuple(FORMS[name] for name in names.split(", "))
    for kind, names in {
        "angle": "linear, square, hinge, hinge below, saturation, step, bump, wave",
        "signed": "linear, square, cube, size, signed square, hinge, hinge below, hinge of the size, dead band, "
        "saturation, step, bump",
        "positive": "linear, square, hinge, hinge below, saturation, step, bump",
        "time": "linear, square, hinge, hinge below, saturation, step, bump, on and off, fading",
        "linear": "linear",
    }.items()
}


def forms_of(kind: str) -> tuple[Form, ...]:
    """Return the forms of a kind of driver; "wave by tau2": waves in proportion to tau2."""
    by = kind.removeprefix("wave by ")
    return FORMS_BY_KIND[kind] if by == kind else (Form(kind, (f"{by}*sin(f*x)", f"{by}*cos(f*x)"), ("f",), _turns),)
