"""In which part of the robot the gap arises: a variance component for every joint, link, the base and the tool.

Each part may be wrong by any smooth function of joint readings, load, approach, time and temperature; its errors act
through the base model's own Jacobian, whose constant part is re-estimated. The size of each part's errors is found
by maximum likelihood (y ~ N(0, sigma^2 I + sum v_k E_k E_k'), monotone updates as in Zhou et al. 2019), so that parts
which the data do not need fall to nothing; shares and their spread are those of draws from the posterior.
"""

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadical.core.arrays import Array
from casadical.core.linear_gaussian.normal_equations import root_of_inverse
from casadical.diagnosis.linear_problem import Case
from casadical.effects import Effect
from casadical.measurements.derived_columns import derive
from casadical.measurements.noise import Noise

# More poses make the shares no more accurate, and cost the third power of their number.
MOST_POSES = 120
ROUNDS = 40
DRAWS = 200
SIZE = 30e-6
# Harmonics of a joint's own reading, beside the slow ones of every joint.
FAST = range(3, 13)
INSTRUMENT = "instrument"
_NUMBERED = re.compile(r"(alpha|a|beta|b|d)(\d+)")


@dataclass(frozen=True, eq=False)
class Components:
    """Visible signal of each part: draws of its mean square, shape (draws, parts) [m^2] a coordinate."""

    parts: tuple[str, ...]
    energy: Array


def components(case: Case, noise: Noise, seed: int = 0, faults: Sequence[Effect] = ()) -> Components:
    """The parts' shares of what the base model leaves, at a known noise; faults : found in the instrument."""
    rng = np.random.default_rng(seed)
    kept = np.flatnonzero(case.kept)
    if len(kept) > MOST_POSES:
        kept = np.sort(rng.choice(kept, MOST_POSES, replace=False))
    e = case.whole
    functions = _functions(case)[kept]
    E = {part: _products(lever[kept], functions) for part, lever in _levers(case).items()}
    for j, joint in enumerate(case.given.joints, 1):
        if joint.kind == "revolute":
            own = np.stack([f(h * case.m.q[kept, j - 1]) for h in FAST for f in (np.sin, np.cos)], axis=1)
            E[f"joint {j}"] = np.concatenate(
                [E[f"joint {j}"], SIZE * case.whole.Jq[kept][:, :, [j - 1]] * own[:, None]], axis=2
            )
    if faults:
        E[INSTRUMENT] = case.whole.take(np.sort(case.group(faults)), kept)
    widths = [part.shape[2] for part in E.values()]
    some = e.at(kept)
    projection = some.projection(noise.repeatability / noise.sigma)
    white = projection.columns(np.concatenate([*E.values()], axis=2))
    edges = np.cumsum([0, *widths])
    groups = [white[:, a:b] for a, b in itertools.pairwise(edges)]
    K = _products_of(groups)
    size = _sizes(projection.y, K, noise.sigma)
    return Components(tuple(E), _draws(projection.y, groups, K, size, noise.sigma, rng) / some.count)


def _products(lever: Array, functions: Array) -> Array:
    """Every lever times every function, shape (n, 3, levers * functions)."""
    return np.asarray((lever[:, :, :, None] * functions[:, None, None, :]).reshape(*lever.shape[:2], -1))


def _levers(case: Case) -> dict[str, Array]:
    """What an error of one size in each part does to the point, shape (n, 3, ways in which the part can err) [m]."""
    names = case.given.parameters.names
    found: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        if hit := _NUMBERED.fullmatch(name):
            found.setdefault("base" if hit[2] == "0" else f"link {hit[2]}", []).append(k)
        elif name.startswith(("base_", "tool_")):
            found.setdefault(name[:4], []).append(k)
        elif name.startswith("L"):
            found.setdefault("loop", []).append(k)
    n = case.robot.n
    moved = [k for k in ("base", *(f"link {i}" for i in range(1, n)), "loop") if k in found]
    links = {k: SIZE * case.whole.J[:, :, found[k]] for k in moved}
    last = [*found.get(f"link {n}", []), *found.get("tool", [])]
    tool = {"tool": SIZE * case.whole.J[:, :, last]} if last else {}
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
    w = m.condition_matrix(robot.conditions, robot.declared)
    tau = robot.model.function("torque", ("tau",)).map(len(m))(q.T, w.T, case.values).full().T
    parts += [*np.tanh(2 * tau / robot.torque_scale).T]
    parts += [np.cos(h * np.pi * m.conditions["progress"]) / h for h in (1, 2, 3)]
    parts += [m.conditions[c] for c in m.conditions if re.fullmatch(r"approach\d", c)]
    for name in ("warmth_0s", "payload_kg"):
        column = m.conditions.get(name)
        if column is not None and np.ptp(column) > 0:
            parts.append((column - column.mean()) / column.std())
    return np.stack(parts, axis=1)


def _sizes(y: Array, K: Array, sigma: float) -> Array:
    """Variance of each group of columns by maximum likelihood, shape (groups,); K : see `_products_of`."""
    n, share = len(y), float(y @ y) / len(K)
    size = share / np.maximum(K[:, :: n + 1].sum(axis=1), 1e-30)
    for _ in range(ROUNDS):
        root = root_of_inverse(_total(K, size, sigma))
        inverse = root.T @ root
        z = inverse @ y
        fit, cost = K @ np.outer(z, z).ravel(), K @ inverse.ravel()
        size *= np.sqrt(fit / np.maximum(cost, 1e-30))
    return np.asarray(size)


def _products_of(groups: list[Array]) -> Array:
    """Products of the rows of each group, one matrix a row, shape (groups, n * n)."""
    return np.stack([(g @ g.T).ravel() for g in groups])


def _total(K: Array, size: Array, sigma: float) -> Array:
    """Covariance of all groups and the noise, shape (n, n)."""
    n = math.isqrt(K.shape[1])
    return (size @ K).reshape(n, n) + sigma**2 * np.eye(n)


def _draws(y: Array, groups: list[Array], K: Array, size: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Squares of each group's signal in draws from the posterior, shape (DRAWS, groups) (Matheron's rule)."""
    prior = [np.sqrt(v) * g @ rng.standard_normal((g.shape[1], DRAWS)) for v, g in zip(size, groups, strict=True)]
    noise = sigma * rng.standard_normal((len(y), DRAWS))
    missed = np.linalg.solve(_total(K, size, sigma), y[:, None] - sum(prior) - noise)
    drawn = [f + v * g @ (g.T @ missed) for f, v, g in zip(prior, size, groups, strict=True)]
    return np.stack([(d**2).sum(axis=0) for d in drawn], axis=1)
