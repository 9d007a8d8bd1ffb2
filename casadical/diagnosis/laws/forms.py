"""Forms of laws: functions of a driver with settings in which they are not linear, and grids of these settings.

A form is text in x (the driver) and its settings k, w, f. Values of settings are numbers of four digits, so that the
formula that is written out is the one that was judged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casadical.core.basics import Array
from casadical.effects.formula import NUMERIC, parse

# Cycles per turn of an angle: of slow waves, and of fine ones, which need so many poses.
SLOW, FINE = 16.0, 1100.0
POSES_FOR_FINE = 50
# How far a wave's phase runs with a driver [rad a unit of it].
PHASES = (-6.0, -4.5, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.5, 6.0)
# A fine wave's phase runs off by so much at most [rad] between two frequencies of the grid.
STEP = 1.0


@dataclass(frozen=True)
class Form:
    """A form.

    parts : texts, each with a factor of its own; settings : their names
    grid : settings, shape (K, settings), from the driver's values, shape (n,)
    also : values of other names in the parts, shape (n,) each
    """

    name: str
    parts: tuple[str, ...]
    settings: tuple[str, ...]
    grid: Callable[[Array], Array]
    also: Mapping[str, Array] = field(default_factory=dict)

    def values(self, x: Array, settings: Array) -> Array:
        """Of each part at all poses and settings, shape (parts, n, K), with x of n poses; settings : (K, settings).

        With x of every joint, shape (n, joints), it is (parts, n, joints, K).
        """
        names = {"x": x[..., None], **{n: settings[None, :, i] for i, n in enumerate(self.settings)}}
        names |= {n: value[:, None] for n, value in self.also.items()}
        found = [parse(part).values(names, NUMERIC)[0] for part in self.parts]
        return np.stack([np.broadcast_to(part, (*x.shape, len(settings))) for part in found])

    def texts(self, driver: str, settings: Sequence[float]) -> tuple[str, ...]:
        """Its parts written out for a driver and settings."""
        given = dict(zip(self.settings, settings, strict=True))
        found = []
        for part in self.parts:
            text = part
            if given.get("k", 0.0) < 0:
                text = text.replace("x - k", f"x + {number(-given['k'])}")
            for name, value in given.items():
                text = re.sub(rf"\b{name}\b", number(value), text)
            found.append(re.sub(r"\bx\b", _bracketed(driver), text))
        return tuple(found)


def _bracketed(driver: str) -> str:
    return driver if re.fullmatch(r"\w+|\w+\([^()]*\)", driver) else f"({driver})"


def number(value: float) -> str:
    """A setting as it is written."""
    return f"{float(value):.4g}"


def rounded(settings: Array) -> Array:
    """Settings as they are written, four digits."""
    flat = np.ravel(settings).tolist()
    written = " ".join(["%.4g"] * len(flat)) % tuple(flat)
    return np.array(written.split(), dtype=float).reshape(np.shape(settings))


def _none(_x: Array) -> Array:
    return np.zeros((1, 0))


def _quantiles(count: int) -> Callable[[Array], Array]:
    def grid(x: Array) -> Array:
        k = np.quantile(x, np.linspace(0.5 / count, 1 - 0.5 / count, count))
        return rounded(np.unique(k)[:, None])

    return grid


def _beyond(x: Array) -> Array:
    """Bounds on the size of a driver."""
    return rounded(np.unique(np.quantile(np.abs(x), [0.1, 0.25, 0.4, 0.55, 0.7, 0.85]))[:, None])


def with_widths(count: int, shares: Sequence[float]) -> Callable[[Array], Array]:
    """Positions and widths, these as shares of the driver's range."""

    def grid(x: Array) -> Array:
        k = np.quantile(x, np.linspace(0.5 / count, 1 - 0.5 / count, count))
        w = np.array(shares) * np.ptp(x)
        return rounded(np.array([(a, b) for a in k for b in w]))

    return grid


def _bands(x: Array) -> Array:
    """Middles and half widths of a dead band that need not lie about zero."""
    k = np.quantile(x, [0.3, 0.4, 0.5, 0.6, 0.7])
    return rounded(np.array([(a, b) for a in k for b in np.array([0.08, 0.16, 0.24, 0.32]) * np.ptp(x)]))


def _between(count: int) -> Callable[[Array], Array]:
    def grid(x: Array) -> Array:
        edges = np.quantile(x, np.linspace(0.05, 0.95, count))
        return rounded(np.array([(a, b) for i, a in enumerate(edges) for b in edges[i + 2 :]]))

    return grid


def _decays(x: Array) -> Array:
    return rounded((np.ptp(x) * np.geomspace(0.03, 0.6, 6))[:, None])


def _turns(_x: Array) -> Array:
    return rounded(np.arange(0.5, SLOW + 0.01, 0.25)[:, None])


def _fine(x: Array) -> Array:
    return rounded(np.arange(SLOW + 0.5, FINE, 2 * STEP / max(np.ptp(x), 0.1))[:, None])


def _cycles(x: Array) -> Array:
    """Half a cycle to six over the driver's range."""
    return rounded((2 * np.pi / np.ptp(x) * np.arange(0.5, 6.01, 0.25))[:, None])


LINEAR = Form("linear", ("x",), (), _none)
SQUARE = Form("square", ("x**2",), (), _none)
CUBE = Form("cube", ("x**3",), (), _none)
SIZE = Form("size", ("abs(x)",), (), _none)
SIGNED_SQUARE = Form("signed square", ("x*abs(x)",), (), _none)
ABOVE = Form("hinge", ("max(0, x - k)",), ("k",), _quantiles(12))
BELOW = Form("hinge below", ("max(0, k - x)",), ("k",), _quantiles(12))
BEYOND = Form("hinge of the size", ("max(0, abs(x) - k)",), ("k",), _beyond)
DEAD_BAND = Form("dead band", ("(max(0, x - k) - max(0, -x - k))",), ("k",), _beyond)
BAND = Form("dead band in between", ("(max(0, x - k - w) - max(0, k - w - x))",), ("k", "w"), _bands)
SATURATION = Form("saturation", ("tanh((x - k)/w)",), ("k", "w"), with_widths(7, (0.03, 0.08, 0.16, 0.32)))
STEPPED = Form("step", ("step(x - k)",), ("k",), _quantiles(30))
RELAY = Form("relay", ("step(x - k)",), ("k",), _quantiles(10))
BUMP = Form("bump", ("exp(-((x - k)/w)**2)",), ("k", "w"), with_widths(9, (0.05, 0.1, 0.2, 0.35)))
LEVELS = Form("levels", ("step(x - k)", "step(x - w)"), ("k", "w"), _between(10))
BLOCK = Form("on and off", ("step(x - k)*step(w - x)",), ("k", "w"), _between(16))
FADE = Form("fading", ("exp(-x/w)",), ("w",), _decays)
WAVE = Form("wave", ("sin(f*x)", "cos(f*x)"), ("f",), _turns)
FINE_WAVE = Form("fine wave", ("sin(f*x)", "cos(f*x)"), ("f",), _fine)
CYCLE = Form("cycle", ("sin(f*x)", "cos(f*x)"), ("f",), _cycles)

# Forms by the kind of driver.
FORMS = {
    "angle": (LINEAR, SQUARE, ABOVE, BELOW, BAND, SATURATION, STEPPED, BUMP, WAVE),
    "signed": (LINEAR, SQUARE, CUBE, SIZE, SIGNED_SQUARE, ABOVE, BELOW, BEYOND, DEAD_BAND, SATURATION, STEPPED, BUMP),
    "positive": (LINEAR, SQUARE, ABOVE, BELOW, SATURATION, STEPPED, BUMP),
    "time": (LINEAR, SQUARE, ABOVE, BELOW, SATURATION, STEPPED, BUMP, LEVELS, BLOCK, FADE, CYCLE),
    "play": (LINEAR, RELAY),
    "weighted": (WAVE,),
    "linear": (LINEAR,),
    "range": (LINEAR, SQUARE, WAVE),
    "azimuth": (LINEAR, WAVE),
    "incidence": (LINEAR, SQUARE, ABOVE, BELOW),
}
# Of time: they follow whatever varied while it was measured, and come last.
LAST_RESORT = (BUMP, BLOCK, CYCLE)


def wave_by(name: str, values: Array) -> Form:
    """A wave whose size follows something else, such as a load. values : of the name, shape (n,)"""
    return Form(f"wave by {name}", (f"{name}*sin(f*x)", f"{name}*cos(f*x)"), ("f",), _turns, {name: values})


def wave_plus(name: str, values: Array) -> Form:
    """A wave of a whole number of cycles whose phase runs with something else. values : of the name, shape (n,)"""
    parts = f"sin(f*x + p*{name})", f"cos(f*x + p*{name})"
    return Form(f"wave plus {name}", parts, ("f", "p"), _phases, {name: values})


def _phases(_x: Array) -> Array:
    return rounded(np.array([(f, p) for f in range(1, int(SLOW) + 1) for p in PHASES]))
