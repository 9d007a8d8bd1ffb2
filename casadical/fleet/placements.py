"""Base and tool, which are fitted again in each campaign; and how large a change must be to be seen."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from casadical.core.basics import Array
from casadical.core.transforms import small_frame, to_xyz
from casadical.fleet.estimates import Estimate
from casadical.fleet.evidence import Candidate, Model, jumps, visible
from casadical.identification.identifiability import scaled_inverse
from casadical.robot.axes import row_matrix
from casadical.robot.parameter_list import SIX

# Standard errors that a change must have to be seen, roughly: what one of a hundred candidates needs.
SEEN = 5.0
# A tool is another one from so many standard errors on, root mean square of a coordinate; beyond the smaller figure it,
# or the base, moved further than noise makes it in one of a hundred pairs.
OTHER_TOOL, MOVED_TOOL = 4.0, 2.0
# A change that is seen only from so many times its usual size is not seen.
FAR = 30.0
# Within this [m, rad] a base did not move: readings that tell nothing of it leave it where the robot file has it.
SAME = 1e-12
# How far parameters are apart, and its covariance.
Between = Callable[[Sequence[str]], tuple[Array, Array]]


def seen_from(
    beside: Callable[[Candidate], Model], candidates: Sequence[Candidate], first: Estimate
) -> tuple[tuple[str, float, str], ...]:
    """(cause, size, unit) of single parameters: the least change in the last campaign that would be seen."""
    sizes = []
    for c in candidates:
        if c.columns.shape[1] == 1 and c.kind in ("joint_zero", "joint_stiffness"):
            model = beside(c)
            H, _ = visible(model, c.columns, jumps(len(model.shared.score))[-1:])
            p = first.robot.parameters[c.names[0]]
            size = SEEN / np.sqrt(max(float(H[0, 0, 0]), 1e-30))
            seen = size < FAR * float(c.sizes[0])
            sizes.append((c.label, p.readable(float(size) * p.scale) if seen else float("inf"), p.readable_unit))
    return tuple(sizes)


def placements_of(campaigns: Sequence[Estimate], names: Sequence[str], model: Model) -> tuple[tuple[str, str], ...]:
    """How base and tool of the last campaign differ from those of the one before, where they were fitted again."""
    before, after = campaigns[-2], campaigns[-1]
    between = partial(_between, campaigns[0], before, after, names, model)
    return (*_tool(before, after, names, between), *_base(before, after, names, between))


def _tool(before: Estimate, after: Estimate, names: Sequence[str], between: Between) -> Iterable[tuple[str, str]]:
    own = [n for n in SIX["tool"][:3] if n in before.names and n in after.names and n not in names]
    if len(own) < 3 or before.robot.tool_name != after.robot.tool_name:
        return
    apart, cov = between(own)
    scale = np.array([after.robot.parameters[n].scale for n in own])
    size = float(np.linalg.norm(apart * scale))
    error = float(np.sqrt(np.trace(cov * np.outer(scale, scale)) / 3))
    distance = float(np.sqrt(apart @ np.linalg.solve(cov, apart) / 3))
    if distance > OTHER_TOOL:
        words = "another tool, or mounted again"
    elif distance > MOVED_TOOL:
        words = "more than noise alone, too little for another tool"
    else:
        words = "the same point, as far as these poses show"
    yield "tool", f"{1e3 * size:.3g} mm from where it was, +/- {1e3 * error:.2g} mm a coordinate: {words}"


def _between(
    first: Estimate, before: Estimate, after: Estimate, names: Sequence[str], model: Model, own: Sequence[str]
) -> tuple[Array, Array]:
    """How far parameters that are fitted again are apart, in units of their scale, and its covariance."""
    # Parameters of a campaign as the solved ones make them: theta and the changes found by then.
    X, Y = (np.hstack([np.eye(model.p), model.known.columns[k]]) for k in (-2, -1))
    a, A, V = _given(before, own, names, first, X, model.mean)
    b, B, W = _given(after, own, names, first, Y, model.mean)
    return b - a, V + W + (B - A) @ model.inverse @ (B - A).T


def _given(
    c: Estimate, own: Sequence[str], names: Sequence[str], first: Estimate, X: Array, u: Array
) -> tuple[Array, Array, Array]:
    """Of parameters that are fitted again: mean in units of scale given u, its slope by u, and covariance.

    u : what is solved for; X u : the shared parameters of this campaign, about the values of the first one
    """
    place = {n: k for k, n in enumerate(c.names)}
    shared = [place[n] for n in names]
    rest = [k for k in range(len(c.names)) if k not in set(shared)]
    V = scaled_inverse(c.information[np.ix_(rest, rest)] + np.diag(c.spread[rest] ** -2.0))
    G = -V @ c.information[np.ix_(rest, shared)]
    from_first = np.array([first.values[first.names.index(n)] for n in names])
    departure = (from_first - c.values[shared]) / c.scale[shared] + X @ u
    mean = c.values[rest] / c.scale[rest] + V @ c.score[rest] + G @ departure
    at = [rest.index(place[n]) for n in own]
    return mean[at], (G @ X)[at], V[np.ix_(at, at)]


def _base(before: Estimate, after: Estimate, names: Sequence[str], between: Between) -> Iterable[tuple[str, str]]:
    placing = {p.name for p in after.robot.parameters if p.group == "base"}
    if not placing & set(after.names) or placing & set(names):
        return
    T = np.linalg.solve(_placed(before), _placed(after))
    if np.allclose(T, np.eye(4), rtol=0, atol=SAME):
        return  # no reading tells where it stands
    turn = float(np.rad2deg(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))))
    words = "the instrument stands elsewhere, or the robot's foot moved"
    if set(SIX["base"]) <= {*before.names} & {*after.names}:
        _, cov = between(SIX["base"])
        apart = np.concatenate([T[:3, 3], to_xyz(T[:3, :3])])
        apart = apart / [after.robot.parameters[n].scale for n in SIX["base"]]
        if apart @ np.linalg.solve(cov, apart) < len(apart) * MOVED_TOOL**2:
            words = "the same place, as far as these poses show"
    far = f"{1e3 * np.linalg.norm(T[:3, 3]):.3g} mm and {turn:.3g} deg"
    yield "base", f"{far} from where it stood in the instrument's frame: {words}"


def _placed(c: Estimate) -> Array:
    if c.robot.base.unknown == "none":  # the first row of the table places the robot
        return np.asarray(c.robot.base.T @ row_matrix(c.robot.joints[0]))
    values = [c.values[c.names.index(n)] if n in c.names else 0.0 for n in SIX["base"]]
    return np.asarray(c.robot.base.T @ np.array(small_frame(*values)))
