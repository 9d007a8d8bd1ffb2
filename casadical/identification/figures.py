"""Tables, sentences and figures of an identification: parameter departures and fit quality."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.figure import Axis, Figure, Note, Panel, Series, Values
from casadical.identification.gravity import in_words
from casadical.identification.identifiability import CONFOUNDED_CONDITION_NUMBER
from casadical.identification.result import Identification
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

# Maximum number of residuals (their quantiles), and of poses of a set whose joint variables are
# drawn, to keep the page small.
MAX_POINTS_DRAWN = 600
# Caption of the figure of residual quantiles.
_RESIDUALS_CAPTION = (
    "Every coordinate of every pose that was used. Noise alone lies on the diagonal, within the band: ends that bend "
    "away are errors that the model does not describe, or bad rows."
)


def identification_figures(result: Identification) -> list[Figure]:
    """Return the figures of parameter departures from nominal and of the quality of the fit."""
    return [*parameter_figures(result), *fit_figures(result, {"poses that identified": result.used})]


def intervals(
    name: str,
    title: str,
    x: Axis,
    rows: Sequence[str],
    value: Values,
    low: Values,
    high: Values,
    notes: Sequence[str],
    tip: str,
    colours: Sequence[str] = (),
    **more: Any,
) -> Figure:
    """Return a figure with a row for each label: a dot with the interval from low to high.

    name : of the figure; rows : labels; value, low, high : of each row, in the unit of the axis x
    notes : last line of each row's tooltip; tip : format of the value there, such as %{x:.2f}
    colours : of the dots, one per row, blue by default; more : further arguments of `Figure`
    """
    dots = Series(
        "points",
        np.round(value, 5),
        range(len(rows)),
        size=9,
        colour=colours or "blue",
        less=np.maximum(np.subtract(value, low), 0).round(5),
        more=np.maximum(np.subtract(high, value), 0).round(5),
        facts=[list(row) for row in zip(rows, low, high, notes, strict=True)],
        tip=f"<b>%{{customdata[0]}}</b><br>{tip}, 95 %: %{{customdata[1]:.3g}} to %{{customdata[2]:.3g}}<br>"
        "%{customdata[3]}",
    )
    return Figure(name, title, [dots], x, rows=rows, height=118 + 26 * len(rows), **more)


def banded(x: Array, low: Array, high: Array, **style: Any) -> Series:
    """Return the area between two curves over x as a series; x, low and high have shape (n,)."""
    return Series("area", np.concatenate([x, x[::-1]]), np.concatenate([high, low[::-1]]), **style)


def parameter_figures(result: Identification) -> Iterator[Figure]:
    """Yield a figure for each unit (mm, deg, ...): identified minus nominal values, 95 % intervals.

    Base and tool frames are omitted: their departures depend on how the robot was set up, and are
    so much larger that they would hide the others.
    """
    table = result.shown
    table = table[table.status.isin(["identified", "at bound"]) & ~table.group.isin(["base", "tool"])]
    # Unit of a parameter, as tables show it -> name and title of the figure of parameters with it.
    figure_of_unit = {
        "mm": ("lengths", "Lengths"),
        "deg": ("angles", "Angles"),
        "urad/(N m)": ("compliance", "Joint compliance"),
    }
    order = list(figure_of_unit)
    for unit in sorted(
        set(table["unit"]),
        key=lambda unit: (order.index(unit) if unit in figure_of_unit else len(figure_of_unit), unit),
    ):
        rows = table[table["unit"] == unit]
        name, words = figure_of_unit.get(unit, (unit, f"Parameters in {unit}"))
        value, low, high = (np.nan_to_num((rows[c] - rows["nominal"]).to_numpy()) for c in ("value", "low", "high"))
        sure = rows["std_error"].notna().to_numpy()
        notes = [
            f"{r.nominal:.5g} -> {r.value:.6g} {unit}" + ("" if r.status == "identified" else ", AT BOUND")
            for r in rows.itertuples()
        ]
        yield intervals(
            f"parameters/{name}",
            f"{words}: departure from nominal",
            Axis(f"value less nominal [{unit}]", zero=True),
            list(rows["name"]),
            value.tolist(),
            np.where(sure, low, value).tolist(),
            np.where(sure, high, value).tolist(),
            notes,
            f"%{{x:+.4g}} {unit}",
            ["red" if s == "at bound" else "blue" for s in rows.status],
        )


def fit_figures(
    result: Identification, sets: Mapping[str, Sequence[Measurements]], residuals: Array | None = None
) -> Iterator[Figure]:
    """Yield the figures of residuals, joint coverage and, if any correlate, pairs of parameters.

    sets : legend entry of the figure of joint coverage -> its sets of measurements
    residuals : in place of the fit's own, in units of their standard deviation, any shape
    """
    if residuals is None:
        own = np.concatenate([r.ravel() for r in result.problem.residuals(result.solution.v)])
        residuals = own / float(np.sqrt(result.variance))
    yield residual_quantiles(residuals)
    yield joint_coverage(result.robot, sets)
    if names := most_correlated(result):
        yield correlated_pairs(result, names)


def residual_quantiles(residuals: Array) -> Figure:
    """Return the normal quantile plot of the residuals, with a 95 % band for normal noise.

    residuals : of every coordinate of every used pose, in units of their standard deviation, any
        shape
    """
    from scipy.special import ndtri

    residuals = np.sort(residuals, axis=None)
    n = len(residuals)
    k = np.unique(np.linspace(0, n - 1, min(n, MAX_POINTS_DRAWN)).round().astype(int))
    share = (k + 0.5) / n
    expected = ndtri(share)
    # The standard error of an order statistic follows from the normal density at its quantile.
    density = np.exp(-0.5 * expected**2) / np.sqrt(2 * np.pi)
    width = 1.96 * np.sqrt(share * (1 - share) / n) / density
    low, high = (expected - width).round(4), (expected + width).round(4)
    band = banded(expected.round(4), low, high, name="noise, 95 %", colour="grey", opacity=0.25)
    tip = "%{y:.2f} sigma, of noise %{x:.2f}"
    dots = Series("points", expected.round(4), residuals[k].round(4), name="residuals", size=4.5, tip=tip)
    x, y = Axis("expected of noise [sigma]", count=8), Axis("residual [sigma]")
    return Figure("fit/residuals", "Residuals: are they noise?", [band, dots], x, y, 380, _RESIDUALS_CAPTION)


def joint_coverage(robot: Robot, sets: Mapping[str, Sequence[Measurements]]) -> Figure:
    """Return the figure of each joint's variable within its limits, in % of its range.

    A pose is a tick; each of the first four entries of `sets` has ticks at every joint, those of
    MAX_POINTS_DRAWN poses at most.

    sets : legend entry -> its sets of measurements
    """
    lower, upper = robot.limits
    units = [(key.split("_")[1], factor) for key, factor in robot.reading_units.items()]
    series = [Series("bars", [100] * robot.n, list(range(robot.n)), width=0.7, colour="line", opacity=0.4)]
    for k, ((words, parts), colour) in enumerate(zip(sets.items(), ("blue", "orange", "muted", "ink"), strict=False)):
        q = np.concatenate([m.q for m in parts])
        q = q[np.unique(np.linspace(0, len(q) - 1, min(len(q), MAX_POINTS_DRAWN)).round().astype(int))]
        places = np.arange(robot.n) + 0.36 * ((k + 0.5) * 2 / len(sets) - 1)
        readings = [f"{v / f:.4g} {unit}" for row in q for v, (unit, f) in zip(row, units, strict=True)]
        series.append(
            Series(
                "points",
                (100 * (q - lower) / (upper - lower)).ravel().round(2),
                np.tile(places, len(q)).round(3),
                name=words,
                colour=colour,
                symbol="line-ns-open",
                size=22 / len(sets),
                width=1,
                facts=readings,
                tip=f"%{{customdata}}, {words}",
            )
        )
    rows = [f"q{i} [{unit}]" for i, (unit, _) in enumerate(units, 1)]
    x = Axis("from the lower to the upper limit [%]", (-1, 101), ticks=[0, 25, 50, 75, 100])
    title, height = "Readings of each joint within its limits", 120 + 40 * robot.n
    return Figure(
        "fit/coverage",
        title,
        series,
        x,
        rows=rows,
        height=height,
        caption="Where ticks are missing, the model was not tried. Without limits in the robot file, full turns.",
    )


def most_correlated(result: Identification) -> tuple[str, ...]:
    """Return at most four names of the most correlated parameters, the strongest correlation first.

    Only pairs with an absolute correlation above 0.5 count; () where there is none.
    """
    return tuple(dict.fromkeys(name for a, b, _ in _pairs(result, 0.5) for name in (a, b)))[:4]


def correlated_pairs(result: Identification, names: Sequence[str]) -> Figure:
    """Return the figure of the joint 95 % regions (ellipses) of every two of some parameters.

    Axes are departures from the estimates in standard errors. Each ellipse extends 2.45 standard
    errors along each axis, so that its shape shows the correlation.

    names : of identified parameters
    """
    n = len(names) - 1
    place = [result.names.index(name) for name in names]
    error = result.standard_errors[place]
    C = result.covariance[np.ix_(place, place)] / np.outer(error, error)
    angle, radius = np.linspace(0, 2 * np.pi, 73), float(np.sqrt(-2 * np.log(0.05)))
    panels, series, notes = [], [], []
    for i in range(n):
        for j in range(n):
            titles = names[j] if i == n - 1 else "", names[i + 1] if j == 0 else ""
            panels.append(Panel(i + 1, j + 1, "", *(Axis(t, (-3.3, 3.3), ticks=[-2, 0, 2]) for t in titles)))
            if j > i:
                continue
            r, k = float(np.clip(C[i + 1, j], -1, 1)), i * n + j
            x, y = radius * np.cos(angle), radius * (r * np.cos(angle) + np.sqrt(1 - r * r) * np.sin(angle))
            tip = f"{names[j]}, {names[i + 1]}: correlation {r:+.3f}"
            colour = "red" if abs(r) > 0.95 else "blue"
            series.append(
                Series("area", x.round(3), y.round(3), colour=colour, fill="grid", width=1.5, tip=tip, panel=k)
            )
            at: tuple[float, Any] = (0.03, "below right") if r > 0 else (0.97, "below left")
            notes.append(Note(f"{r:+.2f}", at[0], 1, "xy", at[1], size=11, panel=k))
    return Figure(
        "fit/pairs",
        "Correlated parameters",
        series,
        height=110 + 130 * n,
        caption="Joint 95 % regions of the most correlated parameters, in standard errors. A thin ellipse "
        "(red: above 0.95) means that the poses determine a combination of both, and neither alone.",
        marks=notes,
        panels=panels,
        shared="xy",
    )


def fit_quality(result: Identification) -> Words:
    """Return sentences with residual scatter, condition number and check of the optimum.

    The scatter is a standard deviation for each set [mm per coordinate]; a large condition number is
    followed by a warning.
    """
    noise = ", ".join(f"{1e3 * sigma:.3f} mm per coordinate" for sigma, _ in result.sigmas)
    optimal = "confirmed" if result.is_optimal() else "NOT confirmed"
    condition = result.identifiability.condition
    if result.noise_is_assumed:
        noise += " (an upper bound: so few poses do not determine it beyond the prior; state sigma_mm in problem.toml)"
    text = f"Residual scatter {noise}; condition number {condition:.0f}; optimum {optimal} by recomputation; "
    text += f"{result.degrees_of_freedom} degrees of freedom."
    if condition > CONFOUNDED_CONDITION_NUMBER:
        text += f" A condition number above {CONFOUNDED_CONDITION_NUMBER} means that some parameters are nearly "
        text += "confounded: trust the robot as a whole, by its held-out errors, more than each value. Standard "
        text += "errors and correlations tell which; poses spread wider (casadical plan) would separate them."
    return Words(text)


def parameter_tables(result: Identification, whole: bool = False) -> list[Table | Words]:
    """Return the table of nominal value, estimate, standard error and 95 % interval, with notes.

    Parameters at a bound are bold. A table of those that are not identifiable, with reasons, and
    the pairs whose absolute correlation exceeds 0.95 follow.

    whole : True gives a folded table that has the fixed parameters too, in grey; False the
        identified ones alone
    """
    strong: set[int] = set()
    faint: set[int] = set()
    rows: list[tuple[str, ...]] = []
    for r in result.shown.to_dict("records"):
        status = "" if r["status"] == "identified" else "AT BOUND" if r["status"] == "at bound" else r["status"]
        determined = status in ("", "AT BOUND")
        if not (determined or whole):
            continue
        if status:
            (strong if determined else faint).add(len(rows))
        sure = not math.isnan(r["std_error"])
        interval = (f"{r['std_error']:.2g}", f"{r['low']:.4f}", f"{r['high']:.4f}") if sure else ("-", "-", "-")
        rows.append((r["name"], f"{r['nominal']:.4f}", f"{r['value']:.4f}", *interval, f"{r['unit']} {status}".strip()))
    columns = ("parameter", "nominal", "value", "std error", "95 % low", "high", "unit")
    title = f"{'All parameters of' if whole else 'Parameters identified by'} {result.method}"
    table = Table(title, columns, rows, frozenset(range(1, 6)), frozenset(strong), frozenset(faint), folded=whole)
    # Nominal base and tool values then come from a first placement (see `placement.place_frames`).
    notes = []
    if result.given.base.unknown == "pose" and any(m.position is not None for m in result.measurements):
        text = "nominal of base and tool: as first placed on the data (base_* are what is added to that), not as in "
        notes.append(Words(f"{text}the robot file", "note"))
    notes += _stiffness_words(result)
    for effect in (e for e in result.start.effects if e.summary):  # too many parameters to be shown
        text = ", ".join(f"{name} {value} {unit}".rstrip() for name, value, unit in effect.summary)
        notes.append(Words(f"{effect.label}: {text}; coefficients in the robot file", "note"))
    if whole and result.at_bounds:
        remedy = "Widen the bounds or doubt the model; no interval can be given."
        notes.append(Words(f"At a bound: {', '.join(result.at_bounds)}. {remedy}", "warning"))
    fixed = result.shown[result.shown["status"] == "not identifiable"][["name", "reason"]]
    rows = [*fixed.itertuples(index=False, name=None)]
    why = Table("Not identifiable: held at nominal", ("parameter", "why"), rows)
    pairs = _pairs(result, 0.95)
    text = ", ".join(f"{a}/{b} {c:+.3f}" for a, b, c in pairs[:8]) + " ..." * (len(pairs) > 8)
    correlated = [Words(f"Correlated above 0.95: {text}")] if text else []
    return [table, *notes, why if rows else Words("Every parameter was identified."), *correlated]


def _stiffness_words(result: Identification) -> list[Words]:
    """Return a sentence with the joint stiffness [N m/rad]; [] without identified compliance.

    Where the masses are estimates, it states the deflections under gravity [mrad] instead.
    """
    if result.robot.masses == "estimated":
        gives = any(result.start.parameters[name].group == "compliance" for name in result.names)
        return [Words(in_words(result).capitalize())] if gives else []
    identified = [
        r for r in result.shown.to_dict("records") if r["status"] == "identified" and r["group"] == "compliance"
    ]
    text = ", ".join(
        f"joint {r['name'][1:]} {stiffness(r['value'], r['std_error'])}" for r in identified if r["value"] > 0
    )
    return [Words(f"Joint stiffness [N m/rad]: {text}")] if text else []


def stiffness(compliance: float, error: float) -> str:
    """Return the stiffness [N m/rad] of a joint as text, without its standard error.

    Where zero compliance lies within the 95 % interval, the text states a lower bound.

    compliance, error : estimate and standard error [urad/(N m)]
    """
    if compliance <= 1.96 * error:
        return f"above {1e6 / (compliance + 1.96 * error):.2g} (rigid is possible)"
    return f"{1e6 / compliance:.3g}"


def _pairs(result: Identification, above: float) -> list[tuple[str, str, float]]:
    """Return (name, name, correlation) of pairs of shown parameters, the strongest first."""
    pairs = result.correlations(above)
    return [*pairs[pairs[["parameter", "with"]].isin(result.start.shown).all(axis=1)].itertuples(index=False)]
