"""Localisation of the remaining error: fractions by part, direction, region and circumstances.

Every fraction ("share") of the squared residual has a 95 % interval.

Contributions of named causes go to the joints, links, base, tool or instrument through which they
act, with the posterior that a fit to all poses gives them. The remaining error is divided by
variance components: one for every joint, link, the base and the tool. Each part may err by any
smooth function of joint variables, load, approach, time and temperature; its errors act through the
base model's own Jacobian, whose constant part is re-estimated. The variances of the parts' errors
and of the noise are found by maximum likelihood (y ~ N(0, sigma^2 I + sum v_k E_k E_k'), monotone
updates as in Zhou et al. 2019). Each variance is then drawn from its likelihood given the others'
maximum, so that parts which the data do not need get almost nothing, with an interval that covers
what the data cannot exclude. Harmonics of a joint's own angle have a variance of their own. Shares
and intervals are those of draws from the posterior, each at a bootstrap sample of the poses.
"""

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pandas as pd

from casadical.core.basics import Array
from casadical.core.linear_gaussian.noise import log_gain_by_size
from casadical.core.linear_gaussian.normal_equations import inverse_of, normal_sums, root_of_inverse
from casadical.core.statistics import thirds
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import EffectColumns
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.settings import SETTINGS
from casadical.diagnosis.structure import about_vertical, sines
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Noise

# Grid of the variance of a part's errors, divided by the variance at which this part would explain
# an equal fraction of the residual (see `_even_variances`).
VARIANCE_FACTORS = np.geomspace(1e-4, 1e2, 61)


def components(case: Case, noise: Noise, columns: Array, seed: int, remains: float) -> dict[str, Array]:
    """Return posterior draws of each part's mean square in the residual, shape (draws,) [m^2].

    Keys are the parts: "joint 1", "link 1", "base", "tool", "loop", "instrument".
    columns : indices of the named causes' columns, shape (k,)
    remains : probability that the named causes leave more than noise
    """
    rng = np.random.default_rng(seed)
    energy, remaining = _of_causes(case, noise, columns, rng)
    for part in _part_jacobians(case):
        energy.setdefault(part, np.zeros(SETTINGS.posterior_draws))
    # Less probable errors lie outside of a 95 % interval.
    if remains > 0.025:
        smooth = _of_smooth_errors(case, noise, remaining, rng)
        there = rng.permutation(SETTINGS.posterior_draws) < round(remains * SETTINGS.posterior_draws)
        for part, drawn in smooth.items():
            energy[part] = energy[part] + there * drawn
    return energy


def _of_smooth_errors(case: Case, noise: Noise, remaining: Evidence, rng: np.random.Generator) -> dict[str, Array]:
    """Return posterior draws of the mean square of each part's smooth errors, (draws,) [m^2].

    Keys are the parts, see `components`. remaining : linear model of the residual after the named
    causes
    """
    # More than 120 poses make these fractions no more accurate, at a cost of the third power of
    # their number.
    indices = _sample(np.flatnonzero(case.inliers), 120, rng)
    functions = _smooth_functions(case)[indices]
    E = [(part, _products(lever[indices], functions)) for part, lever in _part_jacobians(case).items()]
    for j, joint in enumerate(case.given.joints, 1):
        if joint.kind == "revolute":
            # A joint's own reading has fast harmonics, too [cycles per turn].
            own = sines(case.m.q[indices, j - 1], range(3, 13))
            E.append((f"joint {j}", SETTINGS.unit_error * case.whole.Jq[indices][:, :, [j - 1]] * own[:, None]))
    some = remaining.at(np.searchsorted(np.flatnonzero(case.inliers), indices))
    projection = some.projection(noise.repeatability / noise.sigma)
    axes = case.base.units / case.base.prior[:, None]
    axes = axes / np.linalg.norm(axes, axis=0)
    every, edges = np.concatenate([e for _, e in E], axis=2), np.cumsum([0, *(e.shape[2] for _, e in E)])
    white, plain = (
        [rows[:, a:b] for a, b in itertools.pairwise(edges)]
        for rows in (projection.columns(every), some.projection(0.0).columns(every))
    )
    signal = dict[str, Array]()
    for (part, _), g, values in zip(E, plain, _draws(projection.y, white, noise.sigma, axes, rng), strict=True):
        signal[part] = signal.get(part, 0.0) + g @ values
    return dict(zip(signal, _mean_squares([*signal.values()], some, rng), strict=True))


def _sample(indices: Array, most: int, rng: np.random.Generator) -> Array:
    """Return at most `most` of the indices, drawn without replacement, in rising order."""
    return indices if len(indices) <= most else np.sort(rng.choice(indices, most, replace=False))


def _of_causes(case: Case, noise: Noise, columns: Array, rng: np.random.Generator) -> tuple[dict[str, Array], Evidence]:
    """Return draws of the mean square that causes explain, by part, and the remaining model.

    The draws have the shape (draws,) [m^2], {} without causes. The remaining model is that of the
    residual after the causes' posterior mean.
    columns : indices of the causes' columns, shape (k,)
    """
    e = case.evidence
    if not len(columns):
        return {}, e
    fit = new_fit(e, columns, noise, combined=False)
    first = len(fit.prior) - len(columns)
    # The root is triangular: nothing is drawn for the base, whose number of directions depends on
    # round-off.
    drawn = rng.standard_normal((len(columns), SETTINGS.posterior_draws))
    mean, spread = fit.x[first:], fit.root.T[first:, first:] @ drawn
    remaining = np.asarray(e.r - (e.take(columns) @ mean))
    # The contributions of causes are computed at 1000 poses at most.
    poses = _sample(np.arange(len(e.r)), 1000, rng)
    assert isinstance(e.E, EffectColumns)
    E, some = e.E.only(columns).at(poses), e.at(poses)
    S, signal = E.levers(), dict[str, Array]()
    joints = range(1, case.given.n + 1)
    frames = [*(f"link {j}" for j in joints[:-1]), "tool", "base", "tool"]
    # A frame has the six variables of a twist.
    places = [*(f"joint {j}" for j in joints), *(frame for frame in frames for _ in range(6))]
    for variable, own, values in E.factors().blocks:
        part = places[variable] if variable < len(places) else "instrument"
        drawn = values.T @ (mean[own, None] + spread[own])
        signal[part] = signal.get(part, 0.0) + S[:, :, variable, None] * drawn[:, None]
    # Rows are whitened without joint repeatability, so that the squares are those of position
    # errors.
    projection = some.projection(0.0)
    squares = _mean_squares([projection.columns(drawn) for drawn in signal.values()], some, rng)
    return dict(zip(signal, squares, strict=True)), replace(e, r=remaining)


def _mean_squares(signals: Sequence[Array], e: Evidence, rng: np.random.Generator) -> list[Array]:
    """Return each signal's mean square in every draw, (draws,) [m^2], over bootstrapped poses.

    signals : whitened rows, shape (rows, draws) each
    """
    n, numbers = e.r.shape[:2]
    times = np.repeat(rng.multinomial(n, np.full(n, 1 / n), SETTINGS.posterior_draws).T, numbers, axis=0)
    # The rows after those of the poses belong to the base's priors and are no errors of a pose.
    return [(times * rows[: n * numbers] ** 2).sum(axis=0) / e.count for rows in signals]


def _products(lever: Array, functions: Array) -> Array:
    """Return the Jacobian by the coefficients of parameters that are linear in some functions.

    Its shape is (n, 3, levers * functions): the product of every lever and every function.
    lever : Jacobian by the parameters, shape (n, 3, levers)
    functions : values of the functions at the poses, shape (n, functions)
    """
    return np.asarray((lever[:, :, :, None] * functions[:, None, None, :]).reshape(*lever.shape[:2], -1))


def _part_jacobians(case: Case) -> dict[str, Array]:
    """Return the Jacobian by each part's parameters in `Settings.unit_error`, (n, 3, k) [m].

    Keys are the parts: "joint 1", "base", "link 1", "loop", "tool".
    """
    names = case.given.parameters.names
    columns: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        # A kinematic parameter's name ends in the number of its link.
        if hit := re.fullmatch(r"(alpha|a|beta|b|d)(\d+)", name):
            columns.setdefault("base" if hit[2] == "0" else f"link {hit[2]}", []).append(k)
        elif name.startswith(("base_", "tool_")):
            columns.setdefault(name[:4], []).append(k)
        elif name.startswith("L"):
            columns.setdefault("loop", []).append(k)
    n = case.robot.n
    moved = [k for k in ("base", *(f"link {i}" for i in range(1, n)), "loop") if k in columns]
    links = {k: SETTINGS.unit_error * case.base.J[:, :, columns[k]] for k in moved}
    last = [*columns.get(f"link {n}", []), *columns.get("tool", [])]
    tool = {"tool": SETTINGS.unit_error * case.base.J[:, :, last]} if last else {}
    joints = {f"joint {j + 1}": SETTINGS.unit_error * case.whole.Jq[:, :, [j]] for j in range(n)}
    return {**joints, **links, **tool}


def _smooth_functions(case: Case) -> Array:
    """Return the values at all poses of smooth functions, of order one, shape (n, functions).

    They are of joint variables and loads, and of time, approach, temperature and payload if logged.
    """
    robot, q = case.given, case.m.q
    parts = []
    for j, joint in enumerate(robot.joints):
        if joint.kind == "revolute":
            parts += [f(h * q[:, j]) / h for h in (1, 2) for f in (np.sin, np.cos)]
        else:
            parts += [(q[:, j] - q[:, j].mean()) / max(float(q[:, j].std()), 1e-9)]
    m, _ = derive(case.m, ["progress", "warmth_0s", *(f"approach{i}" for i in range(1, robot.n + 1))])
    parts += [*np.tanh(2 * case.torques(m) / robot.torque_scale).T]
    parts += [np.cos(h * np.pi * m.conditions["progress"]) / h for h in (1, 2, 3)]
    parts += [m.conditions[c] for c in m.conditions if re.fullmatch(r"approach\d", c)]
    for name in ("warmth_0s", "payload_kg"):
        column = m.conditions.get(name)
        if column is not None and np.ptp(column) > 0:
            parts.append((column - column.mean()) / column.std())
    return np.stack(parts, axis=1)


def group_variances(y: Array, groups: list[Array], K: Array, sigma: float) -> tuple[Array, float]:
    """Return the maximum-likelihood variance of each group's coefficients, and the noise.

    The variances have the shape (groups,); the noise is a standard deviation [m].
    y : whitened residual, shape (n,)
    groups, K : columns, shape (n, columns) each, and their Gram matrices (see `products_of_rows`)
    sigma : lower bound of the noise [m], which is larger where no group explains the residual
    """
    size, variance = _even_variances(y, K), sigma**2
    for _ in range(40):
        inverse = inverse_of(_total(K, size, variance))
        z = inverse @ y
        fit = np.array([(z @ g) @ (z @ g) for g in groups])
        size *= np.sqrt(fit / np.maximum(K @ inverse.ravel(), 1e-30))
        variance = max(variance * float(np.sqrt(z @ z / np.trace(inverse))), sigma**2)
    return np.asarray(size), float(np.sqrt(variance))


def _even_variances(y: Array, K: Array) -> Array:
    """Return the variance at which each group alone explains 1 / groups of y's square, (groups,).

    y, K : see `group_variances`
    """
    return np.asarray(float(y @ y) / len(K) / np.maximum(K[:, :: len(y) + 1].sum(axis=1), 1e-30))


def _drawn_variances(
    y: Array, groups: list[Array], K: Array, size: Array, sigma: float, rng: np.random.Generator
) -> Array:
    """Return draws of the groups' variances, shape (draws, groups).

    Each is drawn from its posterior given the maximum-likelihood variances of the others.
    y, K : see `group_variances`; groups : columns, shape (n, columns) each
    size : maximum-likelihood variances, shape (groups,); sigma : noise [m]
    """
    sizes = []
    for k, (g, even) in enumerate(zip(groups, _even_variances(y, K), strict=True)):
        # The covariance is formed without the group: subtracting the group would leave only
        # round-off where it explains much.
        root = root_of_inverse(_total(K, np.where(np.arange(len(size)) == k, 0.0, size), sigma**2))
        sums = normal_sums(root @ y, root @ g)
        # The prior is uniform in the standard deviation (Gelman 2006).
        log = 0.5 * np.log(VARIANCE_FACTORS)
        log += log_gain_by_size(sums.H[None], sums.g[None], np.sqrt(even * VARIANCE_FACTORS))[0]
        share = np.cumsum(np.exp(log - log.max()))
        drawn = rng.random(SETTINGS.variance_draws) * share[-1]
        sizes.append(even * np.exp(np.interp(drawn, share, np.log(VARIANCE_FACTORS))))
    return np.stack(sizes, axis=1)


def products_of_rows(groups: list[Array]) -> Array:
    """Return each group's g @ g.T, flattened, shape (groups, n * n).

    groups : columns g of each group, shape (n, columns)
    """
    return np.stack([(g @ g.T).ravel() for g in groups])


def _total(K: Array, size: Array, variance: float) -> Array:
    """Return the covariance of the rows by all groups and the noise, shape (n, n).

    K : see `products_of_rows`; size : variance of each group; variance : that of the noise [m^2]
    """
    n = math.isqrt(K.shape[1])
    return (size @ K).reshape(n, n) + variance * np.eye(n)


def _draws(y: Array, groups: list[Array], sigma: float, axes: Array, rng: np.random.Generator) -> list[Array]:
    """Return posterior draws of each group's coefficients, shape (columns, draws) each.

    Draws follow Matheron's rule.
    y : whitened residual, shape (n,); groups : whitened columns, shape (n, columns) each
    sigma : lower bound of the noise [m]
    axes : directions of the base's parameters, as columns, whose priors are the last rows. Noise is
        drawn for the parameters instead of the directions, because round-off decides between
        directions that the data determine equally and how many of them move a pose.
    """
    K = products_of_rows(groups)
    size, sigma = group_variances(y, groups, K, sigma)
    draws, each = [], SETTINGS.posterior_draws // SETTINGS.variance_draws
    for own in _drawn_variances(y, groups, K, size, sigma, rng):
        prior = [np.sqrt(v) * rng.standard_normal((g.shape[1], each)) for v, g in zip(own, groups, strict=True)]
        prior_signal = sum(g @ f for f, g in zip(prior, groups, strict=True))
        of_poses = rng.standard_normal((len(y) - axes.shape[1], each))
        noise = sigma * np.concatenate([of_poses, axes.T @ rng.standard_normal((len(axes), each))])
        missed = np.linalg.solve(_total(K, own, sigma**2), y[:, None] - prior_signal - noise)
        draws.append([f + v * (g.T @ missed) for f, v, g in zip(prior, own, groups, strict=True)])
    return [np.concatenate(values, axis=1) for values in zip(*draws, strict=True)]


# Columns of the tables of parts of the robot (see `Localisation`).
PART_COLUMNS = ("part", "share", "low", "high", "rms_mm")
# Columns of the table of directions (see `Localisation`).
DIRECTION_COLUMNS = ("frame", *PART_COLUMNS)
# Columns of the tables of regions and circumstances (see `Localisation`).
BIN_COLUMNS = ("by", "part", "poses", "share", "low", "high", "rms_mm", "rms_low_mm", "rms_high_mm")


@dataclass(frozen=True, eq=False)
class Localisation:
    """Shares of the base model's residual, one table for each kind; empty without its column.

    joints : columns part, share, low, high, rms_mm: fraction, 0 to 1, of the squared gap by named
        causes that act through each joint and by smooth errors of this joint; all else as
        "elsewhere"; shares sum to one, low and high bound the posterior's 95 % interval; rms_mm is
        the rms effect on a measured coordinate
    links : the same for base, links, loop and tool, and for the instrument if a cause acts there
    directions : the same with column frame: base (x, y, z), axis (radial, tangential, vertical
        about joint 1), tool (x, y, z); each frame sums to one, noise included; intervals by
        bootstrap over poses, as in all tables that follow
    regions : columns by, part, poses (their number), share (of the squared error), low, high,
        rms_mm (of the distance), rms_low_mm, rms_high_mm, for the poses in each third of the
        values of a joint variable, of radius and of height
    payload, temperature, time : the same by these; approach : by joint and direction of approach
    """

    joints: pd.DataFrame
    links: pd.DataFrame
    directions: pd.DataFrame
    regions: pd.DataFrame
    payload: pd.DataFrame
    temperature: pd.DataFrame
    time: pd.DataFrame
    approach: pd.DataFrame

    def tables(self) -> Iterator[tuple[str, pd.DataFrame]]:
        """Yield name and table of each table that is not empty."""
        for f in fields(self):
            table = getattr(self, f.name)
            if len(table):
                yield f.name, table

    @property
    def worst(self) -> pd.DataFrame:
        """Return the rows of regions and circumstances with significantly larger squared errors.

        The additional column `excess` is the fraction of the squared error divided by the fraction
        of the poses, the largest first.
        """
        every = pd.concat([t for name, t in self.tables() if "poses" in t], ignore_index=True)
        even = every["poses"] / every.groupby("by")["poses"].transform("sum")
        every = every.assign(excess=every["share"] / even)
        return every[every["low"] > even].sort_values("excess", ascending=False, ignore_index=True)


def localise(found: Diagnosis) -> Localisation:
    """Return the fractions of a diagnosis' gap by part, direction, region and circumstances."""
    return localise_residual(found.case, found.noise, found.columns, found.seed, remains=found.remains)


def localise_residual(case: Case, noise: Noise, causes: Array, seed: int = 0, *, remains: float = 1.0) -> Localisation:
    """Return the fractions of a case's residual by part, direction, region and circumstances.

    The tables of parts are empty where a row depends on two poses (distances between poses).
    noise : noise that is excluded from the fractions of joints and links
    causes : indices of the columns of the named causes, shape (k,)
    seed : seed of the draws and of the bootstrap
    remains : probability that the named causes leave more than noise
    """
    # The error of a distance between two poses cannot be assigned to the parts at one of them.
    parts = components(case, noise, causes, seed, remains) if case.one_end else {}
    split = _BootstrapShares(case, seed)
    return Localisation(
        joints=_parts(parts, "joint"),
        links=_parts(parts, "link", "base", "loop", "tool", "instrument"),
        directions=_directions(case, split),
        regions=split.table(*_regions(case)),
        payload=split.table(*_payload(case)),
        temperature=split.table(*thirds_of(case, "temperature", "temperature_degC", "degC")),
        time=split.table(*_time(case)),
        approach=split.table(*_approach(case)),
    )


def _parts(energy: dict[str, Array], *kinds: str) -> pd.DataFrame:
    """Return the table of the parts of some kinds, with all others summed up as "elsewhere".

    energy : draws of each part's mean square, as of `components`; kinds : first words of the parts
    """
    mine = {part: drawn for part, drawn in energy.items() if part.startswith(kinds)}
    if energy:
        others = (drawn for part, drawn in energy.items() if part not in mine)
        # The last row sums up the parts of other kinds.
        mine["elsewhere"] = sum(others, np.zeros(SETTINGS.posterior_draws))
    whole, rows = np.maximum(np.sum([*energy.values()], axis=0), 1e-30), []
    for part, drawn in mine.items():
        share = drawn / whole
        rows.append((part, share.mean(), *np.quantile(share, [0.025, 0.975]), 1e3 * np.sqrt(drawn.mean())))
    return pd.DataFrame(rows, columns=list(PART_COLUMNS))


# Masks over all poses, each as (quantity, value or range of it in words, mask of shape (n,)).
Masks = list[tuple[str, str, Array]]


class _BootstrapShares:
    """Fractions of the inlier poses' squared residual, with intervals by bootstrap over poses."""

    def __init__(self, case: Case, seed: int) -> None:
        self.inliers = case.inliers
        self.r = case.lengths
        n = len(self.r)
        self.times = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), 500).astype(float)

    def shares(self, squares: Array) -> tuple[Array, Array, Array]:
        """Return fraction of the total, low and high of each column of squares, (parts,) each.

        low and high bound the 95 % interval. squares : shape (n_inliers, parts) [m^2]
        """
        total = squares.sum()
        drawn = self.times @ squares
        drawn /= np.maximum(drawn.sum(axis=1, keepdims=True), 1e-30)
        low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
        return squares.sum(axis=0) / max(total, 1e-30), low, high

    def table(self, *masks: tuple[str, str, Array]) -> pd.DataFrame:
        """Return a table (`BIN_COLUMNS`) with a row for each mask that contains inlier poses.

        masks : (by, part, mask over all poses); the shares of one `by` sum to one
        """
        rows = []
        size = (self.r**2).sum(axis=1)
        for by in dict.fromkeys(m[0] for m in masks):
            mine = [(part, mask[self.inliers]) for b, part, mask in masks if b == by and mask[self.inliers].any()]
            inside = np.stack([mask for _, mask in mine], axis=1).astype(float)
            share, low, high = self.shares(size[:, None] * inside)
            count = np.maximum(self.times @ inside, 1)
            drawn = 1e3 * np.sqrt(self.times @ (size[:, None] * inside) / count)
            rms_low, rms_high = np.quantile(drawn, [0.025, 0.975], axis=0)
            for k, (part, mask) in enumerate(mine):
                rms = 1e3 * float(np.sqrt(size[mask].mean()))
                rows.append((by, part, int(mask.sum()), share[k], low[k], high[k], rms, rms_low[k], rms_high[k]))
        return pd.DataFrame(rows, columns=list(BIN_COLUMNS))


def _directions(case: Case, split: _BootstrapShares) -> pd.DataFrame:
    """Return the fractions of the squared residual along the axes of base, joint 1 and tool.

    The table has `DIRECTION_COLUMNS` and is empty unless the campaign is one set with positions.
    """
    r = case.vectors
    if r is None:
        return pd.DataFrame(columns=list(DIRECTION_COLUMNS))
    in_base, about = r @ case.robot.base.T[:3, :3], about_vertical(_in_base(case)[case.inliers])
    R = predicted(case.robot, case.m)[1][case.inliers]
    rows = []
    for frame, names, parts in (
        ("base", ("x", "y", "z"), in_base),
        ("axis", ("radial", "tangential", "vertical"), np.einsum("ni,nij->nj", in_base, about)),
        ("tool", ("x", "y", "z"), np.einsum("ni,nij->nj", r, R)),
    ):
        share, low, high = split.shares(parts**2)
        rms = 1e3 * np.sqrt((parts**2).mean(axis=0))
        rows += [(frame, names[k], share[k], low[k], high[k], rms[k]) for k in range(3)]
    return pd.DataFrame(rows, columns=list(DIRECTION_COLUMNS))


def _in_thirds(by: str, values: Array, unit: str, digits: int) -> Masks:
    """Return a mask of the poses for each third of the values by quantiles; [] if thirds coincide.

    by : name of the quantity; values : shape (n,) [unit]; digits : decimals of the shown bounds
    """
    which, edges = thirds(values)
    if not (np.diff(edges) > 0).all():
        return []
    # Values are rounded first, so that round-off about zero or a half does not show.
    shown = [f"{round(round(float(v), 9), digits) + 0.0:.{digits}f}" for v in edges]
    return [(by, f"{a} .. {b} {unit}", which == k) for k, (a, b) in enumerate(itertools.pairwise(shown))]


def _in_base(case: Case) -> Array:
    """Return the points of all poses in the robot's base frame, shape (n, 3) [m]."""
    T = case.robot.base.T
    return np.asarray((case.positions - T[:3, 3]) @ T[:3, :3])


def _regions(case: Case) -> Masks:
    """Return a mask of the poses for each third of every joint reading, of radius and of height.

    Radius and height are those of the point in the base frame, about joint 1.
    """
    masks: Masks = []
    for (column, factor), q in zip(case.robot.reading_units.items(), case.robot.readings_of(case.m.q).T, strict=True):
        name, unit = column.split("_")
        masks += _in_thirds(name, q / factor, unit, 0)
    p = _in_base(case)
    masks += _in_thirds("radius", np.hypot(p[:, 0], p[:, 1]), "m", 2)
    return masks + _in_thirds("height", p[:, 2], "m", 2)


def _payload(case: Case) -> Masks:
    """Return a mask of the poses for each payload [kg], or for each third of more than six values.

    The list is empty where the payload was not logged or is constant, or where thirds coincide.
    """
    mass = case.m.conditions.get("payload_kg")
    if mass is None or np.ptp(mass) == 0:
        return []
    values = np.unique(mass)
    if len(values) > 6:
        return _in_thirds("payload", mass, "kg", 1)
    return [("payload", f"{v:g} kg", mass == v) for v in values]


def thirds_of(case: Case, by: str, column: str, unit: str) -> Masks:
    """Return a mask of the poses for each third of a logged column by quantiles.

    It is empty if not logged or if thirds coincide. by : name of the quantity; unit : of the column
    """
    logged = case.m.conditions.get(column)
    return [] if logged is None else _in_thirds(by, logged, unit, 1)


def _time(case: Case) -> Masks:
    """Return a mask of the poses for each quarter of the campaign in the order of measuring."""
    quarter = np.minimum((4 * case.progress).astype(int), 3)
    return [("time", f"quarter {k + 1} of 4", quarter == k) for k in range(4)]


def _approach(case: Case) -> Masks:
    """Return a mask of the poses for each joint and direction of approach, rising or falling.

    Joints that were approached from one side only are excluded.
    """
    names = [f"approach{i}" for i in range(1, case.robot.n + 1)]
    m, _ = derive(case.m, names)
    sides = ((1, "rising"), (-1, "falling"))
    return [
        (f"approach of joint {i}", word, m.conditions[name] == side)
        for i, name in enumerate(names, 1)
        if name in m.conditions and np.ptp(m.conditions[name]) > 0
        for side, word in sides
    ]
