"""Where the gap lies: shares by joint, link, direction, region, payload, temperature, time and approach, each with a
95 % interval."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from casadical.core.basics import Array
from casadical.diagnosis.components import INSTRUMENT, Components, components
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.result import Diagnosis
from casadical.identification.accuracy import predicted
from casadical.measurements.derived_columns import derive
from casadical.measurements.noise import Noise

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
    payload : the same by payload
    temperature : the same by temperature
    time : the same by time
    approach : the same by the direction from which a joint came
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
    return localise_residual(found.case, found.noise, found.columns, found.seed, noise_is_left=found.noise_is_left)


def localise_residual(
    case: Case, noise: Noise, causes: Array, seed: int = 0, *, noise_is_left: bool = False
) -> Localisation:
    """Where the residual of a case lies.

    noise : that is left aside in the shares of joints and links; causes : columns of those that were found
    noise_is_left : whether these leave noise alone
    """
    # Between two poses no one reading is where the gap lies.
    found = components(case, noise, causes, seed, noise_is_left=noise_is_left) if case.one_end else None
    split = _Split(case, seed)
    return Localisation(
        joints=_parts(found, "joint"),
        links=_parts(found, "link", "base", "loop", "tool", INSTRUMENT),
        directions=_directions(case, split),
        regions=split.table(*_regions(case)),
        payload=split.table(*_payload(case)),
        temperature=split.table(*thirds_of(case, "temperature", "temperature_degC", "degC")),
        time=split.table(*_time(case)),
        approach=split.table(*_approach(case)),
    )


def _parts(found: Components | None, *kinds: str) -> pd.DataFrame:
    """Shares of the parts of some kinds, with the others summed up as elsewhere."""
    if found is None:
        return pd.DataFrame(columns=list(PARTS))
    share = found.energy / np.maximum(found.energy.sum(axis=1, keepdims=True), 1e-30)
    mine = [k for k, part in enumerate(found.parts) if part.startswith(kinds)]
    other = [k for k in range(len(found.parts)) if k not in mine]
    rows = []
    for name, which in [*((found.parts[k], [k]) for k in mine), (ELSEWHERE, other)]:
        s, size = share[:, which].sum(axis=1), found.energy[:, which].sum(axis=1)
        rows.append((name, s.mean(), *np.quantile(s, [0.025, 0.975]), 1e3 * np.sqrt(size.mean())))
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
    T = case.robot.base.T
    p = (case.positions[case.kept] - T[:3, 3]) @ T[:3, :3]
    in_base = r @ T[:3, :3]
    out = p[:, :2] / np.maximum(np.linalg.norm(p[:, :2], axis=1, keepdims=True), 1e-9)
    radial = (in_base[:, :2] * out).sum(axis=1)
    tangential = in_base[:, 1] * out[:, 0] - in_base[:, 0] * out[:, 1]
    _, R = predicted(case.robot, case.m)
    in_tool = np.einsum("ni,nij->nj", r, R[case.kept])
    rows = []
    for frame, names, parts in (
        ("base", ("x", "y", "z"), in_base),
        ("axis", ("radial", "tangential", "vertical"), np.column_stack([radial, tangential, in_base[:, 2]])),
        ("tool", ("x", "y", "z"), in_tool),
    ):
        share, low, high = split.shares(parts**2)
        rms = 1e3 * np.sqrt((parts**2).mean(axis=0))
        rows += [(frame, names[k], share[k], low[k], high[k], rms[k]) for k in range(3)]
    return pd.DataFrame(rows, columns=list(DIRECTIONS))


def _binned(by: str, values: Array, edges: Array, unit: str, digits: int) -> Masks:
    """Parts of the range of some values between edges."""
    which = np.searchsorted(edges[1:-1], values, side="left")
    return [
        (by, f"{a:.{digits}f} .. {b:.{digits}f} {unit}", which == k)
        for k, (a, b) in enumerate(itertools.pairwise(edges))
    ]


def _in_thirds(by: str, values: Array, unit: str, digits: int) -> Masks:
    edges = np.quantile(values, [0, 1 / 3, 2 / 3, 1])
    return _binned(by, values, edges, unit, digits) if (np.diff(edges) > 0).all() else []


def _regions(case: Case) -> Masks:
    masks: Masks = []
    for j, joint in enumerate(case.robot.joints):
        unit, factor = ("deg", 180 / np.pi) if joint.kind == "revolute" else ("mm", 1e3)
        masks += _in_thirds(f"q{j + 1}", factor * case.m.q[:, j], unit, 0)
    T = case.robot.base.T
    p = (case.positions - T[:3, 3]) @ T[:3, :3]
    masks += _in_thirds("radius", np.hypot(p[:, 0], p[:, 1]), "m", 2)
    return masks + _in_thirds("height", p[:, 2], "m", 2)


def _payload(case: Case) -> Masks:
    mass = case.m.conditions.get("payload_kg")
    if mass is None or np.ptp(mass) == 0:
        return []
    values = np.unique(mass)
    return (
        [("payload", f"{v:g} kg", mass == v) for v in values]
        if len(values) <= 6
        else _in_thirds("payload", mass, "kg", 1)
    )


def thirds_of(case: Case, by: str, column: str, unit: str) -> Masks:
    logged = case.m.conditions.get(column)
    return [] if logged is None else _in_thirds(by, logged, unit, 1)


def _time(case: Case) -> Masks:
    m, _ = derive(case.m, ["progress"])
    quarter = np.minimum((4 * m.conditions["progress"]).astype(int), 3)
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
