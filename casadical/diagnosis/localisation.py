"""Where the gap lies: shares by joint, link, direction, region, payload, temperature, time and approach, each with a
95 % interval.

In which part of the robot the gap arises: what the whole model explains of each.

What named causes explain is theirs: it goes to the joints, links, base, tool or instrument through which they act,
with the values and the spread that a fit to all poses gives them. For what they leave there is a variance component
for every joint, link, the base and the tool. Each may be wrong by any smooth function of joint readings, load,
approach, time and temperature; its errors act through the base model's own Jacobian, whose constant part is
re-estimated. The size of each part's errors, and of the noise, is found by maximum likelihood
(y ~ N(0, sigma^2 I + sum v_k E_k E_k'), monotone updates as in Zhou et al. 2019), and drawn from its own likelihood
beside the others' best, so that parts which the data do not need come near nothing, and may still be what the data
cannot exclude. Harmonics of a joint's own angle have a size of their own.
Shares and their spread are those of draws from the posterior, each at poses drawn from these.
"""

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pandas as pd

from casadical.core.basics import Array
from casadical.core.linear_gaussian.normal_equations import root_of_inverse
from casadical.core.statistics import thirds
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.linearisation import EffectColumns
from casadical.diagnosis.result import Diagnosis
from casadical.diagnosis.structure import about_vertical, sines
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Noise

# Poses at which causes are shared out.
OF_CAUSES = 1000
ROUNDS = 40
PART_DRAWS = 200
# Sizes that are tried, as a share of what would explain an even part of all, and how many of these are drawn.
SIZES, SIZE_DRAWS = np.geomspace(1e-4, 1e2, 61), 20
SIZE = 30e-6
# Harmonics of a joint's own reading, beside the slow ones of every joint.
FAST = range(3, 13)
INSTRUMENT = "instrument"
# Variables of a twist among the seams.
TWIST = 6
_NUMBERED = re.compile(r"(alpha|a|beta|b|d)(\d+)")


def components(case: Case, noise: Noise, columns: Array, seed: int, remains: float) -> dict[str, Array]:
    """Visible signal of each part: draws of its mean square in what the base model leaves, shape (draws,) [m^2].

    columns : of the named causes; remains : how probable it is that these leave more than noise
    """
    rng = np.random.default_rng(seed)
    energy, left = _of_causes(case, noise, columns, rng)
    for part in _levers(case):
        energy.setdefault(part, np.zeros(PART_DRAWS))
    # Errors that are less probable lie outside of a 95 % interval.
    if remains > 0.025:
        smooth = _of_smooth_errors(case, noise, left, rng)
        there = rng.permutation(PART_DRAWS) < round(remains * PART_DRAWS)
        for part, drawn in smooth.items():
            energy[part] = energy[part] + there * drawn
    return energy


def _of_smooth_errors(case: Case, noise: Noise, left: Evidence, rng: np.random.Generator) -> dict[str, Array]:
    """Draws of the mean square that smooth errors of each part explain; left : the problem that causes leave."""
    # Of smooth errors, more poses make the shares no more accurate, and cost the third power of
    # their number.
    kept = _some(np.flatnonzero(case.kept), 120, rng)
    functions = _functions(case)[kept]
    E = [(part, _products(lever[kept], functions)) for part, lever in _levers(case).items()]
    for j, joint in enumerate(case.given.joints, 1):
        if joint.kind == "revolute":
            own = sines(case.m.q[kept, j - 1], FAST)
            E.append((f"joint {j}", SIZE * case.whole.Jq[kept][:, :, [j - 1]] * own[:, None]))
    some = left.at(np.searchsorted(np.flatnonzero(case.kept), kept))
    projection = some.projected(noise.repeatability / noise.sigma)
    axes = case.base.units / case.base.prior[:, None]
    axes = axes / np.linalg.norm(axes, axis=0)
    every, edges = np.concatenate([e for _, e in E], axis=2), np.cumsum([0, *(e.shape[2] for _, e in E)])
    white, plain = (
        [rows[:, a:b] for a, b in itertools.pairwise(edges)]
        for rows in (projection.columns(every), some.projected(0.0).columns(every))
    )
    signal = dict[str, Array]()
    for (part, _), g, values in zip(E, plain, _draws(projection.y, white, noise.sigma, axes, rng), strict=True):
        signal[part] = signal.get(part, 0.0) + g @ values
    return dict(zip(signal, _mean_squares([*signal.values()], some, rng), strict=True))


def _some(kept: Array, most: int, rng: np.random.Generator) -> Array:
    return kept if len(kept) <= most else np.sort(rng.choice(kept, most, replace=False))


def _of_causes(case: Case, noise: Noise, columns: Array, rng: np.random.Generator) -> tuple[dict[str, Array], Evidence]:
    """Draws of the mean square that causes explain through each part, and the problem that their mean leaves."""
    e = case.evidence
    if not len(columns):
        return {}, e
    fit = new_fit(e, columns, noise, combined=False)
    first = len(fit.prior) - len(columns)
    # The root is a triangle: nothing is drawn for the base, whose number of directions round-off decides.
    mean, spread = fit.x[first:], fit.root.T[first:, first:] @ rng.standard_normal((len(columns), PART_DRAWS))
    left = np.asarray(e.r - (e.take(columns) @ mean))
    poses = _some(np.arange(len(e.r)), OF_CAUSES, rng)
    assert isinstance(e.E, EffectColumns)
    E, some = e.E.only(columns).at(poses), e.at(poses)
    S, signal = E.levers(), dict[str, Array]()
    for variable, own, values in E.factors().blocks:
        part, drawn = _part_of(variable, case.given.n), values.T @ (mean[own, None] + spread[own])
        signal[part] = signal.get(part, 0.0) + S[:, :, variable, None] * drawn[:, None]
    # In mm, whatever part of it the noise of the joints can hide.
    projection = some.projected(0.0)
    squares = _mean_squares([projection.columns(drawn) for drawn in signal.values()], some, rng)
    return dict(zip(signal, squares, strict=True)), replace(e, r=left)


def _mean_squares(signals: Sequence[Array], e: Evidence, rng: np.random.Generator) -> list[Array]:
    """Mean square of each signal, shape (rows, PART_DRAWS), in every draw, at poses drawn with replacement."""
    n, numbers = e.r.shape[:2]
    times = np.repeat(rng.multinomial(n, np.full(n, 1 / n), PART_DRAWS).T, numbers, axis=0)
    # Behind the poses' rows stand those of the base's priors, which are no errors of a pose.
    return [(times * rows[: n * numbers] ** 2).sum(axis=0) / e.count for rows in signals]


def _part_of(variable: int, joints: int) -> str:
    """The part that a seam's variable belongs to: joint variables, twists behind links, at base and tool, the point."""
    frames = [*(f"link {j}" for j in range(1, joints)), "tool", "base", "tool"]
    places = [*(f"joint {j}" for j in range(1, joints + 1)), *(f for f in frames for _ in range(TWIST))]
    return places[variable] if variable < len(places) else INSTRUMENT


def _products(lever: Array, functions: Array) -> Array:
    """Every lever times every function, shape (n, 3, levers * functions)."""
    return np.asarray((lever[:, :, :, None] * functions[:, None, None, :]).reshape(*lever.shape[:2], -1))


def _levers(case: Case) -> dict[str, Array]:
    """What an error of one size in each part does to the point, shape (n, 3, ways in which the part can err) [m]."""
    names = case.given.parameters.names
    columns: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        if hit := _NUMBERED.fullmatch(name):
            columns.setdefault("base" if hit[2] == "0" else f"link {hit[2]}", []).append(k)
        elif name.startswith(("base_", "tool_")):
            columns.setdefault(name[:4], []).append(k)
        elif name.startswith("L"):
            columns.setdefault("loop", []).append(k)
    n = case.robot.n
    moved = [k for k in ("base", *(f"link {i}" for i in range(1, n)), "loop") if k in columns]
    links = {k: SIZE * case.base.J[:, :, columns[k]] for k in moved}
    last = [*columns.get(f"link {n}", []), *columns.get("tool", [])]
    tool = {"tool": SIZE * case.base.J[:, :, last]} if last else {}
    joints = {f"joint {j + 1}": SIZE * case.whole.Jq[:, :, [j]] for j in range(n)}
    return {**joints, **links, **tool}


def _functions(case: Case) -> Array:
    """Smooth functions of pose and circumstances, shape (n, functions), each of size one or so."""
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


def sizes_of_groups(y: Array, K: Array, sigma: float) -> tuple[Array, float]:
    """Variance of each group of columns by maximum likelihood, shape (groups,), and the noise.

    K : see `products_of_rows`. The noise is no less than sigma, but grows where no group explains what is there.
    """
    size, variance = _even_sizes(y, K), sigma**2
    for _ in range(ROUNDS):
        root = root_of_inverse(_total(K, size, variance))
        inverse = root.T @ root
        z = inverse @ y
        fit, cost = K @ np.outer(z, z).ravel(), K @ inverse.ravel()
        size *= np.sqrt(fit / np.maximum(cost, 1e-30))
        variance = max(variance * float(np.sqrt(z @ z / np.trace(inverse))), sigma**2)
    return np.asarray(size), float(np.sqrt(variance))


def _even_sizes(y: Array, K: Array) -> Array:
    """The variance at which each group explains an even part of all, shape (groups,)."""
    return np.asarray(float(y @ y) / len(K) / np.maximum(K[:, :: len(y) + 1].sum(axis=1), 1e-30))


def _drawn_sizes(y: Array, groups: list[Array], K: Array, size: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Variances of the groups, each drawn from its likelihood beside the others' best, shape (SIZE_DRAWS, groups)."""
    sizes = []
    for k, (g, even) in enumerate(zip(groups, _even_sizes(y, K), strict=True)):
        # Without the group: to take it away again would leave round-off alone where it explains much.
        root = root_of_inverse(_total(K, np.where(np.arange(len(size)) == k, 0.0, size), sigma**2))
        white = root @ g
        d, axes = np.linalg.eigh(white.T @ white)
        own = even * SIZES[:, None]
        grown = 1 + own * np.maximum(d, 0.0)
        log = 0.5 * (own * (axes.T @ (white.T @ (root @ y))) ** 2 / grown - np.log(grown)).sum(axis=1)
        # Alike for all standard deviations (Gelman 2006).
        log += 0.5 * np.log(SIZES)
        share = np.cumsum(np.exp(log - log.max()))
        sizes.append(even * np.exp(np.interp(rng.random(SIZE_DRAWS) * share[-1], share, np.log(SIZES))))
    return np.stack(sizes, axis=1)


def products_of_rows(groups: list[Array]) -> Array:
    """Products of the rows of each group, one matrix a row, shape (groups, n * n)."""
    return np.stack([(g @ g.T).ravel() for g in groups])


def _total(K: Array, size: Array, variance: float) -> Array:
    """Covariance of all groups and the noise, shape (n, n)."""
    n = math.isqrt(K.shape[1])
    return (size @ K).reshape(n, n) + variance * np.eye(n)


def _draws(y: Array, groups: list[Array], sigma: float, axes: Array, rng: np.random.Generator) -> list[Array]:
    """Factors of each group's columns in draws from the posterior, shape (columns, PART_DRAWS) (Matheron's rule).

    axes : of the base's parameters, as columns, whose priors are the last rows: noise is drawn for the parameters, for
        round-off chooses between axes that the data determine alike, and how many move a pose
    """
    K = products_of_rows(groups)
    size, sigma = sizes_of_groups(y, K, sigma)
    draws, each = [], PART_DRAWS // SIZE_DRAWS
    for own in _drawn_sizes(y, groups, K, size, sigma, rng):
        prior = [np.sqrt(v) * rng.standard_normal((g.shape[1], each)) for v, g in zip(own, groups, strict=True)]
        known = sum(g @ f for f, g in zip(prior, groups, strict=True))
        of_poses = rng.standard_normal((len(y) - axes.shape[1], each))
        noise = sigma * np.concatenate([of_poses, axes.T @ rng.standard_normal((len(axes), each))])
        missed = np.linalg.solve(_total(K, own, sigma**2), y[:, None] - known - noise)
        draws.append([f + v * (g.T @ missed) for f, v, g in zip(prior, own, groups, strict=True)])
    return [np.concatenate(values, axis=1) for values in zip(*draws, strict=True)]


DRAWS = 500
ELSEWHERE = "elsewhere"
PARTS = ("part", "share", "low", "high", "rms_mm")
DIRECTIONS = ("frame", *PARTS)
BINS = ("by", "part", "poses", "share", "low", "high", "rms_mm", "rms_low_mm", "rms_high_mm")


@dataclass(frozen=True, eq=False)
class Localisation:
    """Where the gap that the base model leaves lies; a table each, empty where a column was not logged.

    joints : columns part, share, low, high, rms_mm: what named causes explain through each joint, and smooth errors of
        it beside them; the rest as "elsewhere"; shares sum to one, intervals are those of the fit
    links : the same of base, links and tool, and of the instrument where a cause is in it
    directions : the same with column frame: base (x, y, z), axis (radial, tangential, vertical about joint 1), tool (x,
        y, z); each frame sums to one, noise included; intervals by bootstrap over poses, as in all that follow
    regions : columns by, part, poses, share (of the squared error), low, high, rms_mm (of the distance), rms_low_mm,
        rms_high_mm, of the poses that fall in each part of the ranges
    payload, temperature, time : the same by these; approach : by the direction from which a joint came
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
        """Name and table of each that is not empty."""
        for f in fields(self):
            table = getattr(self, f.name)
            if len(table):
                yield f.name, table

    @property
    def worst(self) -> pd.DataFrame:
        """Parts of the data that hold surely more of the squared error than of the poses, the worst first."""
        every = pd.concat([t for name, t in self.tables() if "poses" in t], ignore_index=True)
        even = every["poses"] / every.groupby("by")["poses"].transform("sum")
        every = every.assign(excess=every["share"] / even)
        return every[every["low"] > even].sort_values("excess", ascending=False, ignore_index=True)


def localise(found: Diagnosis) -> Localisation:
    """Where the gap of a diagnosis' base model lies: by joint, link, direction, region and circumstances."""
    return localise_residual(found.case, found.noise, found.columns, found.seed, remains=found.remains)


def localise_residual(case: Case, noise: Noise, causes: Array, seed: int = 0, *, remains: float = 1.0) -> Localisation:
    """Where the residual of a case lies.

    noise : that is left aside in the shares of joints and links; causes : columns of those that were found
    remains : how probable it is that these leave more than noise
    """
    # Between two poses no one reading is where the gap lies.
    parts = components(case, noise, causes, seed, remains) if case.one_end else {}
    split = _Split(case, seed)
    return Localisation(
        joints=_parts(parts, "joint"),
        links=_parts(parts, "link", "base", "loop", "tool", INSTRUMENT),
        directions=_directions(case, split),
        regions=split.table(*_regions(case)),
        payload=split.table(*_payload(case)),
        temperature=split.table(*thirds_of(case, "temperature", "temperature_degC", "degC")),
        time=split.table(*_time(case)),
        approach=split.table(*_approach(case)),
    )


def _parts(energy: dict[str, Array], *kinds: str) -> pd.DataFrame:
    """Shares of the parts of some kinds, with the others summed up as elsewhere; energy : of `components`."""
    mine = {part: drawn for part, drawn in energy.items() if part.startswith(kinds)}
    if energy:
        others = (drawn for part, drawn in energy.items() if part not in mine)
        mine[ELSEWHERE] = sum(others, np.zeros(PART_DRAWS))
    whole, rows = np.maximum(np.sum([*energy.values()], axis=0), 1e-30), []
    for part, drawn in mine.items():
        share = drawn / whole
        rows.append((part, share.mean(), *np.quantile(share, [0.025, 0.975]), 1e3 * np.sqrt(drawn.mean())))
    return pd.DataFrame(rows, columns=list(PARTS))


Masks = list[tuple[str, str, Array]]


class _Split:
    """Shares of the squared residual that fall into parts of the data, by bootstrap over the kept poses."""

    def __init__(self, case: Case, seed: int) -> None:
        self.kept = case.kept
        self.r = case.lengths
        n = len(self.r)
        self.times = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), DRAWS).astype(float)

    def shares(self, squares: Array) -> tuple[Array, Array, Array]:
        """Share, low and high of each column of squares, shape (n, parts), whose sum counts as one."""
        total = squares.sum()
        drawn = self.times @ squares
        drawn /= np.maximum(drawn.sum(axis=1, keepdims=True), 1e-30)
        low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
        return squares.sum(axis=0) / max(total, 1e-30), low, high

    def table(self, *masks: tuple[str, str, Array]) -> pd.DataFrame:
        """A row for each (by, part, mask over all poses) with poses in it."""
        rows = []
        size = (self.r**2).sum(axis=1)
        for by in dict.fromkeys(m[0] for m in masks):
            mine = [(part, mask[self.kept]) for b, part, mask in masks if b == by and mask[self.kept].any()]
            inside = np.stack([mask for _, mask in mine], axis=1).astype(float)
            share, low, high = self.shares(size[:, None] * inside)
            count = np.maximum(self.times @ inside, 1)
            drawn = 1e3 * np.sqrt(self.times @ (size[:, None] * inside) / count)
            rms_low, rms_high = np.quantile(drawn, [0.025, 0.975], axis=0)
            for k, (part, mask) in enumerate(mine):
                rms = 1e3 * float(np.sqrt(size[mask].mean()))
                rows.append((by, part, int(mask.sum()), share[k], low[k], high[k], rms, rms_low[k], rms_high[k]))
        return pd.DataFrame(rows, columns=list(BINS))


def _directions(case: Case, split: _Split) -> pd.DataFrame:
    r = case.vectors
    if r is None:
        return pd.DataFrame(columns=list(DIRECTIONS))
    in_base, about = r @ case.robot.base.T[:3, :3], about_vertical(_in_base(case)[case.kept])
    R = predicted(case.robot, case.m)[1][case.kept]
    rows = []
    for frame, names, parts in (
        ("base", ("x", "y", "z"), in_base),
        ("axis", ("radial", "tangential", "vertical"), np.einsum("ni,nij->nj", in_base, about)),
        ("tool", ("x", "y", "z"), np.einsum("ni,nij->nj", r, R)),
    ):
        share, low, high = split.shares(parts**2)
        rms = 1e3 * np.sqrt((parts**2).mean(axis=0))
        rows += [(frame, names[k], share[k], low[k], high[k], rms[k]) for k in range(3)]
    return pd.DataFrame(rows, columns=list(DIRECTIONS))


def _in_thirds(by: str, values: Array, unit: str, digits: int) -> Masks:
    which, edges = thirds(values)
    if not (np.diff(edges) > 0).all():
        return []
    # Rounded first, so that round-off about zero or a half is not told.
    shown = [f"{round(round(float(v), 9), digits) + 0.0:.{digits}f}" for v in edges]
    return [(by, f"{a} .. {b} {unit}", which == k) for k, (a, b) in enumerate(itertools.pairwise(shown))]


def _in_base(case: Case) -> Array:
    """Where the measured point was in the base frame, shape (n, 3) [m]."""
    T = case.robot.base.T
    return np.asarray((case.positions - T[:3, 3]) @ T[:3, :3])


def _regions(case: Case) -> Masks:
    masks: Masks = []
    for (column, factor), q in zip(case.robot.reading_units.items(), case.m.q.T, strict=True):
        name, unit = column.split("_")
        masks += _in_thirds(name, q / factor, unit, 0)
    p = _in_base(case)
    masks += _in_thirds("radius", np.hypot(p[:, 0], p[:, 1]), "m", 2)
    return masks + _in_thirds("height", p[:, 2], "m", 2)


def _payload(case: Case) -> Masks:
    mass = case.m.conditions.get("payload_kg")
    if mass is None or np.ptp(mass) == 0:
        return []
    values = np.unique(mass)
    if len(values) > 6:
        return _in_thirds("payload", mass, "kg", 1)
    return [("payload", f"{v:g} kg", mass == v) for v in values]


def thirds_of(case: Case, by: str, column: str, unit: str) -> Masks:
    logged = case.m.conditions.get(column)
    return [] if logged is None else _in_thirds(by, logged, unit, 1)


def _time(case: Case) -> Masks:
    quarter = np.minimum((4 * case.progress).astype(int), 3)
    return [("time", f"quarter {k + 1} of 4", quarter == k) for k in range(4)]


def _approach(case: Case) -> Masks:
    names = [f"approach{i}" for i in range(1, case.robot.n + 1)]
    m, _ = derive(case.m, names)
    sides = ((1, "rising"), (-1, "falling"))
    return [
        (f"approach of joint {i}", word, m.conditions[name] == side)
        for i, name in enumerate(names, 1)
        if name in m.conditions and np.ptp(m.conditions[name]) > 0
        for side, word in sides
    ]
