"""The building blocks of laws: drivers, on which errors may depend, and functions of a driver.

A form is text in x (the driver) and its settings k, w, f, in which it is not linear. Values of
settings have four digits, so that the formula that is written is the one that was evaluated.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.parts import Arm
from casadical.diagnosis.linearisation import Linearisation
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.formula import NUMERIC_FUNCTIONS, names_in, parse
from casadical.effects.formula_effect import COLUMN_NAME, Law, columns_of
from casadical.measurements.derived_columns import Loads, derive
from casadical.measurements.measurements import Measurements


@dataclass(frozen=True)
class Driver:
    """A quantity on which an error may depend.

    text : its formula; kind : key of `FORMS_BY_KIND`, which has the forms that it may have
    family : name of a group of similar drivers
    """

    text: str
    kind: str
    family: str

    @property
    def columns_only(self) -> bool:
        """Return whether all names in its formula are columns, none a quantity of the pose."""
        return all(COLUMN_NAME.fullmatch(name) for name in parse(self.text).names)


def drivers_of(arm: Arm) -> list[Driver]:
    """Return every possible driver of a robot's errors, whether its columns were logged or not.

    Those of an instrument's beam are in `beams`.
    """
    drivers = [Driver(f"q{i}", "angle", "angle") for i in arm.numbers]
    for i in arm.numbers[:-1]:
        drivers += [Driver(f"q{i} {sign} q{i + 1}", "angle", "angles") for sign in "+-"]
        unequal = (f"{a}q{i} {sign} {b}q{i + 1}" for a, b in (("2*", ""), ("", "2*")) for sign in "+-")
        drivers += [Driver(text, "weighted", "angles") for text in unequal]
    drivers += [Driver(f"tau{i}", "signed", "load") for i in arm.numbers]
    drivers += [Driver(f"m{i}{c}", "signed", "moment") for i in arm.numbers for c in "xy"]
    drivers += [Driver(f"sqrt(m{i}x**2 + m{i}y**2 + m{i}z**2)", "positive", "moment") for i in arm.numbers]
    drivers += [Driver(f"g{c}", "signed", "gravity") for c in "xyz"]
    drivers += [Driver("sqrt(px**2 + py**2)", "positive", "place"), Driver("pz", "positive", "place")]
    drivers += [Driver("t", "time", "time"), Driver("warmth", "positive", "warmth")]
    # The warmth lags behind the measured temperature by these time constants [s].
    drivers += [Driver(f"warmth_{lag}s", "positive", "warmth") for lag in (300, 600, 1200, 2400)]
    drivers.append(Driver("payload", "linear", "payload"))
    for i in arm.numbers:
        drivers += [Driver(f"approach{i}", "linear", "approach"), Driver(f"move{i}", "signed", "move")]
        # Half of a backlash [mrad or mm].
        drivers += [Driver(f"play{i}_{play}mrad", "play", "play") for play in (100, 300, 1000)]
        # Time constants of the heat of a motor under load [s].
        drivers += [Driver(f"heat{i}_{lag}s", "linear", "heat") for lag in (300, 1200)]
        # Lengths of the motion memory [mrad or mm].
        memories = [f"memory{i}_{way}mrad" for way in (100, 300, 1000, 3000)]
        drivers += [Driver(f"{own}{m}", "linear", "memory") for m in memories for own in ("", f"tau{i}*")]
        drivers += [Driver(f"approach{i}*{other}", "linear", "approach") for other in (f"tau{i}", f"abs(tau{i})", "t")]
        parts = (f"q{i}", f"tau{i}", f"sin(q{i})", f"cos(q{i})")
        drivers += [Driver(f"{own}*{other}", "linear", "product") for own in parts for other in ("t", DEFAULT_WARMTH)]
        drivers.append(Driver(f"tau{i}*payload", "linear", "product"))
    pairs = [(i, j) for i in arm.numbers for j in arm.numbers if i < j]
    drivers += [Driver(f"tau{i}*tau{j}", "linear", "product") for i, j in pairs]
    drivers += [Driver(f"approach{i}*approach{j}", "linear", "approach") for i, j in pairs]
    return drivers


# Name of the warmth in products of drivers: the temperature with a lag of 600 s.
DEFAULT_WARMTH = "warmth_600s"


def with_columns(
    m: Measurements, drivers: Sequence[Driver], loads: Loads | None = None
) -> tuple[Measurements, list[Driver]]:
    """Return measurements with the drivers' columns, and the drivers whose columns all exist.

    loads : function that returns the joint loads of the robot, see `derive`
    """
    needed = {d: columns_of(parse(d.text).names) for d in drivers}
    m, missing = derive(m, [c for columns in needed.values() for c in columns], loads)
    return m, [d for d in drivers if not set(needed[d]) & set(missing)]


def values_of(linear: Linearisation, drivers: Sequence[Driver]) -> tuple[list[Driver], Array]:
    """Return the drivers that vary over the poses, and their values, shape (n, drivers).

    Their columns must be among the conditions of `linear`.
    """
    names = names_in([parse(d.text) for d in drivers])
    at = variables(linear, names)
    values = [np.asarray(parse(d.text).values(at, NUMERIC_FUNCTIONS)[0]) for d in drivers]
    # Drivers that vary by 0.02 or less [rad, m, K, kg, or 1] are constant.
    limit = SETTINGS.max_driver_value
    varying_indices = [k for k, v in enumerate(values) if np.ptp(v) > 0.02 and np.abs(v).max() < limit]
    varying = [
        replace(drivers[k], kind="linear") if len(np.unique(values[k])) < 3 else drivers[k] for k in varying_indices
    ]
    return varying, np.stack([values[k] for k in varying_indices], axis=1)


def own_drivers() -> list[Driver]:
    """Return the drivers of laws of all joints at once; their names have no number of a joint."""
    drivers = [Driver("q", "angle", "angle"), Driver("tau", "signed", "load"), Driver("move", "signed", "move")]
    drivers += [Driver(text, "linear", "approach") for text in ("approach", "approach*tau", "approach*t")]
    return [
        *drivers,
        *(Driver(f"{own}*{other}", "linear", "product") for own in ("q", "tau") for other in ("t", DEFAULT_WARMTH)),
    ]


def own_values(linear: Linearisation, known: Mapping[str, Array], driver: Driver) -> Array:
    """Return the values of a driver of `own_drivers` for every joint, shape (n, joints).

    known : values of names with the joint's number, as of `variables`
    """
    formula = parse(driver.text)
    joints = [{n: known[n] if n in known else known[f"{n}{j}"] for n in formula.names} for j in linear.robot.numbers]
    return np.stack([np.asarray(formula.values(at, NUMERIC_FUNCTIONS)[0]) for at in joints], axis=1)


def variables(linear: Linearisation, names: Sequence[str]) -> dict[str, Array]:
    """Return the values at the poses of names in formulas, by name, shape (n,) each.

    They are computed as ratios of the columns of laws that shift the base.
    """
    unit = linear.columns([Law(None, "base shift", "[a, 0, 0]")])[:, :, 0]
    values: dict[str, Array] = {}
    letters = "abcdefghijklmnopqs"  # factors of a formula that evaluates several names at once
    for first in range(0, len(names), len(letters)):
        some = dict(zip(letters, names[first:], strict=False))
        terms = " + ".join(f"{letter}*{name}" for letter, name in some.items())
        law = Law(None, "base shift", f"[{terms}, 0, 0]", tuple((letter, 1e-5) for letter in some))
        columns = linear.columns([law])
        share = (columns * unit[:, :, None]).sum(axis=1) / (unit**2).sum(axis=1)[:, None]
        values.update(zip(some.values(), share.T, strict=True))
    return values


@dataclass(frozen=True)
class Form:
    """A function of a driver, linear in factors and nonlinear in settings.

    name : name of the form; parts : formulas in x and the settings, each with its own factor
    settings : names of the settings
    grid : function of the driver's values, shape (n,), that returns K candidate settings, shape (K,
        settings)
    also : values of other names in the parts, shape (n,) each
    """

    name: str
    parts: tuple[str, ...]
    settings: tuple[str, ...]
    grid: Callable[[Array], Array]
    also: Mapping[str, Array] = field(default_factory=dict)

    def values(self, x: Array, settings: Array) -> Array:
        """Return the value of each part at all poses and K settings, shape (parts, n, K).

        x : driver's values, shape (n,), or (n, joints) for a result of shape (parts, n, joints, K)
        settings : shape (K, settings)
        """
        names = {"x": x[..., None], **{n: settings[None, :, i] for i, n in enumerate(self.settings)}}
        names |= {n: value[:, None] for n, value in self.also.items()}
        parts = [parse(part).values(names, NUMERIC_FUNCTIONS)[0] for part in self.parts]
        return np.stack([np.broadcast_to(part, (*x.shape, len(settings))) for part in parts])

    def texts(self, driver: str, settings: Sequence[float]) -> tuple[str, ...]:
        """Return the formula of each part with the driver's formula and the settings inserted."""
        given = dict(zip(self.settings, settings, strict=True))
        texts = []
        for part in self.parts:
            text = part
            if given.get("k", 0.0) < 0:
                text = text.replace("x - k", f"x + {number(-given['k'])}")
            for name, value in given.items():
                text = re.sub(rf"\b{name}\b", number(value), text)
            texts.append(
                re.sub(r"\bx\b", (driver if re.fullmatch("\\w+|\\w+\\([^()]*\\)", driver) else f"({driver})"), text)
            )
        return tuple(texts)


def number(value: float) -> str:
    """Return a setting as text with four significant digits."""
    return f"{float(value):.4g}"


def rounded(settings: Array) -> Array:
    """Return settings rounded to four significant digits, as `number` writes them."""
    flat = np.ravel(settings).tolist()
    written = " ".join(["%.4g"] * len(flat)) % tuple(flat)
    return np.array(written.split(), dtype=float).reshape(np.shape(settings))


def _none(_x: Array) -> Array:
    """Return the grid of a form without settings: one point, shape (1, 0)."""
    return np.zeros((1, 0))


def _quantiles(count: int) -> Callable[[Array], Array]:
    """Return a function for a grid of k, shape (K, 1): `count` quantiles of the driver."""

    def grid(x: Array) -> Array:
        k = np.quantile(x, np.linspace(0.5 / count, 1 - 0.5 / count, count))
        return rounded(np.unique(k)[:, None])

    return grid


def _beyond(x: Array) -> Array:
    """Return the grid of k, shape (K, 1): six quantiles of the absolute value of a driver."""
    return rounded(np.unique(np.quantile(np.abs(x), [0.1, 0.25, 0.4, 0.55, 0.7, 0.85]))[:, None])


def with_widths(count: int, shares: Sequence[float]) -> Callable[[Array], Array]:
    """Return a function for a grid of all pairs of k and w, shape (K, 2).

    count : number of k, quantiles of the driver; shares : w divided by the range of the driver
    """

    def grid(x: Array) -> Array:
        """Return the pairs of k and w for a driver's values."""
        k = np.quantile(x, np.linspace(0.5 / count, 1 - 0.5 / count, count))
        w = np.array(shares) * np.ptp(x)
        return rounded(np.array([(a, b) for a in k for b in w]))

    return grid


def _bands(x: Array) -> Array:
    """Return the grid of centre k and half width w of a dead band, shape (K, 2).

    The band need not include zero.
    """
    k = np.quantile(x, [0.3, 0.4, 0.5, 0.6, 0.7])
    return rounded(np.array([(a, b) for a in k for b in np.array([0.08, 0.16, 0.24, 0.32]) * np.ptp(x)]))


def _between(count: int) -> Callable[[Array], Array]:
    """Return a function for a grid of pairs k < w, shape (K, 2), of `count` driver quantiles.

    Neighbouring quantiles form no pair.
    """

    def grid(x: Array) -> Array:
        edges = np.quantile(x, np.linspace(0.05, 0.95, count))
        return rounded(np.array([(a, b) for i, a in enumerate(edges) for b in edges[i + 2 :]]))

    return grid


def _turns(_x: Array) -> Array:
    """Return the grid of the frequency f of slow waves, shape (K, 1) [cycles per revolution]."""
    return rounded(np.arange(0.5, SETTINGS.max_slow_cycles + 0.01, 0.25)[:, None])


def _fine(x: Array) -> Array:
    """Return the grid of the frequency f of fine waves, shape (K, 1) [cycles per revolution]."""
    # Between neighbouring frequencies the phase changes by at most 2 rad over the range.
    return rounded(np.arange(SETTINGS.max_slow_cycles + 0.5, 1100.0, 2 / max(np.ptp(x), 0.1))[:, None])


# Every form of a law over one driver, by its name.
FORMS = {
    form.name: form
    for form in (
        Form("linear", ("x",), (), _none),
        Form("square", ("x**2",), (), _none),
        Form("cube", ("x**3",), (), _none),
        Form("size", ("abs(x)",), (), _none),
        Form("signed square", ("x*abs(x)",), (), _none),
        # Zero below k, then a line.
        Form("hinge", ("max(0, x - k)",), ("k",), _quantiles(12)),
        # A line down to zero at k, then zero.
        Form("hinge below", ("max(0, k - x)",), ("k",), _quantiles(12)),
        # Zero where the absolute value is below k, then a line to both sides.
        Form("hinge of the size", ("max(0, abs(x) - k)",), ("k",), _beyond),
        # Zero between -k and k, then a line with the sign of the driver.
        Form("dead band", ("(max(0, x - k) - max(0, -x - k))",), ("k",), _beyond),
        # Zero within w of k, then a line with the sign of the distance.
        Form("dead band in between", ("(max(0, x - k - w) - max(0, k - w - x))",), ("k", "w"), _bands),
        # A smooth transition at k of width w, constant beyond.
        Form("saturation", ("tanh((x - k)/w)",), ("k", "w"), with_widths(7, (0.03, 0.08, 0.16, 0.32))),
        # A step at k, at many places; the relay has few.
        Form("step", ("step(x - k)",), ("k",), _quantiles(30)),
        Form("relay", ("step(x - k)",), ("k",), _quantiles(10)),
        # A Gaussian bump at k of width w.
        Form("bump", ("exp(-((x - k)/w)**2)",), ("k", "w"), with_widths(9, (0.05, 0.1, 0.2, 0.35))),
        # Two steps, at k and w, each with its own factor.
        Form("levels", ("step(x - k)", "step(x - w)"), ("k", "w"), _between(10)),
        # One between k and w, else zero.
        Form("on and off", ("step(x - k)*step(w - x)",), ("k", "w"), _between(16)),
        # Exponential decay with the constant w, a fraction of the driver's range.
        Form("fading", ("exp(-x/w)",), ("w",), lambda x: rounded((np.ptp(x) * np.geomspace(0.03, 0.6, 6))[:, None])),
        # A wave of frequency f of up to 16 cycles per revolution, or more.
        Form("wave", ("sin(f*x)", "cos(f*x)"), ("f",), _turns),
        Form("fine wave", ("sin(f*x)", "cos(f*x)"), ("f",), _fine),
        # A wave of frequency f with half a cycle to six over the driver's range.
        Form(
            "cycle",
            ("sin(f*x)", "cos(f*x)"),
            ("f",),
            lambda x: rounded((2 * np.pi / np.ptp(x) * np.arange(0.5, 6.01, 0.25))[:, None]),
        ),
    )
}

# Forms in which a law may depend on a driver, by the driver's kind.
FORMS_BY_KIND = {
    kind: tuple(FORMS[name] for name in names.split(", "))
    for kind, names in {
        "angle": "linear, square, hinge, hinge below, dead band in between, saturation, step, bump, wave",
        "signed": "linear, square, cube, size, signed square, hinge, hinge below, hinge of the size, dead band, "
        "saturation, step, bump",
        "positive": "linear, square, hinge, hinge below, saturation, step, bump",
        "time": "linear, square, hinge, hinge below, saturation, step, bump, levels, on and off, fading, cycle",
        "play": "linear, relay",
        "weighted": "wave",
        "linear": "linear",
        "range": "linear, square, wave",
        "azimuth": "linear, wave",
        "incidence": "linear, square, hinge, hinge below",
    }.items()
}


def wave_by(name: str, values: Array) -> Form:
    """Return the form of a wave whose amplitude is proportional to another driver.

    name, values : formula of the other driver and its values, shape (n,)
    """
    return Form(f"wave by {name}", (f"{name}*sin(f*x)", f"{name}*cos(f*x)"), ("f",), _turns, {name: values})


def wave_plus(name: str, values: Array) -> Form:
    """Return the form of a wave of integer frequency whose phase is linear in another driver.

    name, values : formula of the other driver and its values, shape (n,)
    """
    parts = f"sin(f*x + p*{name})", f"cos(f*x + p*{name})"
    rates = (-6.0, -4.5, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.5, 6.0)  # of the phase [rad]
    grid = rounded(np.array([(f, p) for f in range(1, int(SETTINGS.max_slow_cycles) + 1) for p in rates]))
    return Form(f"wave plus {name}", parts, ("f", "p"), lambda _x: grid, {name: values})
