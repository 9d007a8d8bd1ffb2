"""Isolability of effects in a set of poses: absorption by the base model and look-alikes.

It needs no measured positions. It also shows which causes a campaign cannot reveal, and which it
rules out. The visible signal is the part of an effect's columns that is orthogonal to the base
model's, whose parameters are re-estimated with every cause, in the noise's metric; an effect with
visible signal r per coordinate, in units of the noise, at n poses has noncentrality 3 n r^2.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.columns import array_columns
from casadical.core.reporting.blocks import Table, Words
from casadical.core.reporting.result import Result
from casadical.core.statistics import ranked
from casadical.diagnosis.candidates import (
    Candidate,
    EffectChoice,
    candidates_of,
    choose,
    columns_to_log,
    gathered,
    gathered_by_columns,
)
from casadical.diagnosis.evidence import Evidence
from casadical.diagnosis.linear_problem import Case, base_prior_sigmas, column_indices
from casadical.diagnosis.linearisation import signatures
from casadical.diagnosis.result import Diagnosis, Unlisted
from casadical.diagnosis.settings import SETTINGS
from casadical.effects import Effect
from casadical.identification.sessions import undetermined
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements, Noise
from casadical.robot.robot import Robot

# Explanation of the columns of an isolability table, which is printed below it.
NOTES = (
    "size: rms at a realistic size; absorbed: the share that the base model absorbs; visible: the remainder, and "
    "a coordinate of that in units of the noise; found from: the multiple of the realistic size that is found 9 times "
    "in 10; looks like: causes that reproduce this share of what is visible."
)


@dataclass(frozen=True, eq=False)
class Isolability(Result):
    """Isolability of the candidates in a set of poses, at the effects' realistic sizes.

    effects : a row per candidate (index: label): size_mm, rms displacement over the poses by the
        effect at its realistic size; absorbed, the fraction of that signal's energy that the base
        model absorbs; visible_mm, the rms of the rest; visible_to_noise, its rms per coordinate in
        units of the noise; findable_from, the multiple of its realistic size from which it is found
        nine times in ten
    compare : labels of candidates, None: all -> `alike` of these; most reports need few or none
    missing : columns that would have to be logged, by label of the effect
    """

    line: ClassVar[str] = " of {{ it.effects | length }} candidates"

    effects: pd.DataFrame
    compare: Callable[[Collection[str] | None], pd.DataFrame]
    missing: dict[str, tuple[str, ...]]

    @cached_property
    def alike(self) -> pd.DataFrame:
        """Return the fraction of a candidate's visible energy (row) in another's span (column)."""
        return self.compare(None)

    def rivals(self, label: str, above: float = 0.5) -> dict[str, float]:
        """Return the candidates that reproduce a large part of a candidate's visible signal.

        Keys are their labels, values the fractions of its energy, the largest first.
        label : of the candidate; above : fraction, 0 to 1, that must be exceeded
        """
        names, shares = self.alike.columns, self.alike.loc[label].to_numpy(dtype=float)
        return {str(names[k]): float(shares[k]) for k in ranked(shares) if shares[k] > above and names[k] != label}

    def blocks(self) -> list[Words | Table]:
        """Return the table with a row per effect, its explanation, and what was not logged."""
        rows = []
        for label, row in self.effects.iterrows():
            rivals = [f"{k} {v:.2f}" for k, v in list(self.rivals(str(label)).items())[:3]]
            figures = (f"{row['size_mm']:.3f}", f"{100 * row['absorbed']:.0f} %", f"{row['visible_mm']:.4f}")
            # This is a multiple of the realistic size.
            times = row["findable_from"]
            multiple = f"{times:.2g} x" if np.isfinite(times) and times < 100 else "never"
            rows.append((str(label), *figures, f"{row['visible_to_noise']:.2f}", multiple, "\n".join(rivals)))
        blocks: list[Words | Table] = [
            Table(
                "",
                ("effect", "size mm", "absorbed", "visible mm", "to noise", "found from", "looks like"),
                rows,
                frozenset(range(1, 6)),
            ),
            Words(NOTES, "note"),
        ]
        gathered_columns = gathered_by_columns(columns_to_log(self.missing, ())).items()
        return [*blocks, *(Words(f"not logged: {columns}; it would show {them}") for columns, them in gathered_columns)]

    def to_json(self, campaign: str = "") -> dict[str, Any]:
        """Return the isolability as plain data for JSON; campaign : name of the poses.

        Keys are campaign, effects, alike and missing. Fractions of at most 0.1 are omitted; an
        infinite multiple, at which an effect is never found, is None.
        """
        rows = {
            str(k): {c: (float(f"{v:.5g}") if np.isfinite(v) else None) for c, v in row.items()}
            for k, row in self.effects.iterrows()
        }
        alike = {k: {r: round(v, 4) for r, v in self.rivals(k, 0.1).items()} for k in rows}
        return {"campaign": campaign, "effects": rows, "alike": alike, "missing": self.missing}


def isolability(
    robot: Robot | Diagnosis,
    m: Measurements | None = None,
    effects: EffectChoice = "standard",
    *,
    noise: Noise | None = None,
    whole: bool = False,
) -> Isolability:
    """Return the isolability of effects at the poses of a (planned) campaign.

    Measured positions are not used.
    robot : nominal robot; or a diagnosis, whose candidates are evaluated at its own poses,
        calibrated geometry and noise, whatever the other arguments
    m : poses, measured or planned; None for a diagnosis; effects : see `diagnose`
    noise : expected noise; default: 0.02 mm (laser tracker) and joints that repeat to 8 urad
    whole : whether an effect counts as one cause in all its joints together instead of joint by
        joint
    Raises InputError: a name that is no effect, or where poses are missing.

    Examples
    --------
    >>> design = casadical.isolability(robot, poses, ["gear_eccentricity", "backlash"])
    >>> design.missing
    {}
    """
    if isinstance(robot, Diagnosis):
        return of_case(robot.case, robot.noise)
    if m is None:
        raise InputError("poses are missing; give isolability(robot, measurements), or a diagnosis alone")
    candidates = [c for c in candidates_of(robot, effects) if c.listed]
    possible, missing = choose(candidates, m, robot.loads)
    used = tuple(dict.fromkeys(e for c in possible for v in c.variants for e in v))
    m, _ = derive(m, [c for e in used for c in e.conditions], robot.loads)
    noise = noise or Noise(20e-6, 8e-6)
    values = robot.parameters.values
    E, J, Jq = signatures(robot, used, m, values)
    evidence = Evidence(
        np.zeros((len(m), 3)),
        J,
        0 * values,
        base_prior_sigmas(robot),
        array_columns(E * [size for e in used for size, _ in e.sizes().values()]),
        noise.sigma,
        Jq=Jq,
    )
    columns = column_indices(used, 0)
    named = _whole(possible) if whole else {c.label: c.variants for c in possible}
    groups = {k: [np.concatenate([columns[e] for e in v]) for v in variants] for k, variants in named.items()}
    return _judged(evidence, groups, noise, missing)


def of_case(case: Case, noise: Noise, also: Sequence[Effect] = ()) -> Isolability:
    """Return the isolability of a case's listed candidates at its inlier poses.

    also : effects that are in the base model in addition
    """
    listed = [c for c in case.candidates if c.listed]
    groups = {c.label: [case.group(v) for v in c.variants] for c in listed}
    evidence = case.evidence.with_base(np.unique(case.group(also))) if also else case.evidence
    return _judged(replace(evidence, reference=noise.sigma), groups, noise, case.missing)


def _whole(candidates: Sequence[Candidate]) -> dict[str, tuple[tuple[Effect, ...], ...]]:
    """Return each effect, by name, as one cause in all its joints, at the middle of its settings.

    Each has a single variant, a tuple of effects.
    """
    causes: dict[str, dict[tuple[str, ...], tuple[Effect, ...]]] = {}
    for c in candidates:
        by_parameters: dict[tuple[str, ...], list[tuple[Effect, ...]]] = {}
        for v in c.variants:
            by_parameters.setdefault(tuple(p.name for e in v for p in e.parameters()), []).append(v)
        middle = {names: like[len(like) // 2] for names, like in by_parameters.items()}
        causes.setdefault(c.name, {}).update(middle)
    return {name: (tuple(dict.fromkeys(e for v in parts.values() for e in v)),) for name, parts in causes.items()}


def _judged(
    evidence: Evidence, groups: dict[str, list[Array]], noise: Noise, missing: dict[str, tuple[str, ...]]
) -> Isolability:
    """Return the isolability of candidates at the poses of a linear model.

    groups : indices of the columns of each setting, by label; missing : see `Isolability`
    """
    n, rho = len(evidence.r), noise.repeatability / noise.sigma
    owner = [label for label, variants in groups.items() for _ in variants]
    columns = [c for variants in groups.values() for c in variants]
    by_column = _squares(evidence, rho)
    size, *energy = (np.array([squares[c].sum() for c in columns]) for squares in by_column)
    table = pd.DataFrame(
        {
            "label": owner,
            "size_mm": 1e3 * np.sqrt(size / n),
            "absorbed": 1 - energy[0] / np.maximum(size, 1e-30),
            "visible_mm": 1e3 * np.sqrt(energy[0] / n),
            "visible_to_noise": np.sqrt(energy[1] / evidence.count) / noise.sigma,
        }
    )
    # A candidate is rated by the mean over its grid of settings.
    effects = table.groupby("label", sort=False).mean()
    # At a noncentrality of 36 one among about a hundred candidates is found nine times in ten.
    effects["findable_from"] = np.sqrt(36.0 / evidence.count) / effects["visible_to_noise"]
    return Isolability(effects, partial(_alike, evidence, rho, columns, owner), missing)


def _squares(evidence: Evidence, rho: float) -> Array:
    """Return three sums of squares of each column, shape (3, columns).

    They are of the column itself, of its part orthogonal to the base model, and of this part in the
    metric of the noise [m^2].
    rho : ratio of joint repeatability to the instrument's sigma [rad/m]
    """
    # The columns that are processed at once take 4 MB.
    step = max(1, 4_000_000 // (24 * len(evidence.r)))
    projections = [evidence.projection(ratio) for ratio in (0.0, rho)]
    squares = []
    for first in range(0, evidence.width, step):
        E = evidence.take(np.arange(first, min(first + step, evidence.width)))
        visible = (projection.columns(E) for projection in projections)
        squares.append(np.stack([(E**2).sum(axis=(0, 1)), *((part**2).sum(axis=0) for part in visible)]))
    return np.concatenate(squares, axis=1)


def _alike(
    evidence: Evidence, rho: float, columns: list[Array], owner: list[str], labels: Collection[str] | None
) -> pd.DataFrame:
    """Return the fraction of a candidate's visible energy (row) in another's span (column).

    It is the mean over the candidate's settings and the maximum over the other's; empty for none.
    rho : ratio of joint repeatability to the instrument's sigma [rad/m]
    columns : indices of the columns of each setting; owner : label of each setting
    labels : of the candidates that are compared; None: all
    """
    asked = [k for k, label in enumerate(owner) if labels is None or label in labels]
    if not asked:
        return pd.DataFrame()
    used = np.unique(np.concatenate([columns[k] for k in asked]))
    columns, owner = [np.searchsorted(used, columns[k]) for k in asked], [owner[k] for k in asked]
    # Effects are compared on at most 500 poses, evenly spaced.
    n = len(evidence.r)
    at_poses = evidence if n <= 500 else evidence.at(np.linspace(0, n - 1, 500).astype(int))
    E = at_poses.projection(rho).columns(at_poses.take(used))
    which, widths = np.concatenate(columns), np.array([len(c) for c in columns])
    by_rival = np.empty((len(columns), len(which)))
    for width in np.unique(widths):
        alike = np.flatnonzero(widths == width)
        # About 512 columns are compared with all others at once.
        for some in np.array_split(alike, min(1 + len(alike) * width // 512, len(alike))):
            U, s, _ = np.linalg.svd(np.stack([E[:, columns[k]] for k in some]), full_matrices=False)
            # Directions with a singular value below 1e-6 of an effect's largest one are round-off.
            there = s > 1e-6 * np.maximum(s.max(axis=1, keepdims=True), 1e-30)
            inner = (U.transpose(0, 2, 1).reshape(-1, len(E)) @ E) ** 2 * there.reshape(-1, 1)
            by_rival[some] = inner.reshape(len(some), -1, E.shape[1]).sum(axis=1)[:, which]
    starts = np.cumsum([0, *widths])[:-1]
    energy = np.array([(E[:, c] ** 2).sum() for c in columns])
    share = np.add.reduceat(by_rival, starts, axis=1) / np.maximum(energy, 1e-30)
    # Settings without a signal (coupling to an idle joint) do not count: energies below 1e-18 m^2,
    # a nanometre, are round-off.
    share[:, energy < 1e-18] = np.nan
    by_setting = pd.DataFrame(share, index=pd.Index(owner), columns=pd.Index(owner))
    best = by_setting.groupby(level=0, sort=False).max()
    return best.T.groupby(level=0, sort=False).mean().fillna(0.0).clip(0.0, 1.0)


def cannot_tell(d: Diagnosis) -> tuple[str, ...]:
    """Return phrases of quantities that the kinds of measurement cannot determine.

    Each completes the sentence "these data cannot ...".
    """
    return tuple(undetermined(d.identification.measurements, d.identification.unknown_points))


def indistinguishable(d: Diagnosis, poses: Isolability | None) -> dict[str, str]:
    """Return, by label of a cause, a text of the labels that the data cannot distinguish from it.

    Causes without such labels are omitted. Where `poses` is given, each label has the percentage of
    the cause's visible signal energy in these poses that it reproduces.
    """
    causes = [c for c in d.causes if c.indistinguishable]
    labels = {label for c in causes for label in (c.label, *c.indistinguishable)}
    table = poses.compare(labels) if poses and labels else pd.DataFrame()
    return {
        c.label: ", ".join(
            f"{k} ({100 * float(table.loc[c.label, k]):.0f} % similar here)"  # type: ignore[arg-type]
            if c.label in table.index and k in table.columns
            else k
            for k in c.indistinguishable
        )
        for c in causes
    }


def invisible(d: Diagnosis, poses: Isolability | None) -> dict[str, str]:
    """Return, by reason in words, the labels of the effects that these poses cannot show.

    Claimed causes are omitted. poses : isolability at these poses; None: {} is returned
    """
    if poses is None:
        return {}
    seen = poses.effects.drop(index=[c.label for c in d.causes], errors="ignore")
    idle = seen["size_mm"] < SETTINGS.min_size_mm
    absorbed = ~idle & (seen["absorbed"] > SETTINGS.max_absorbed_share)
    weak = ~idle & ~absorbed & (seen["findable_from"] > SETTINGS.max_findable_multiple)
    most = 100 * SETTINGS.max_absorbed_share
    reasons = {
        "as nothing here causes them (no masses in the robot file, an idle joint)": seen.index[idle],
        f"as the base model takes up {most:.0f} % or more of each in these poses": seen.index[absorbed],
        f"against this noise, unless {SETTINGS.max_findable_multiple:.0f} times their usual size": seen.index[weak],
    }
    return {why: gathered(labels) for why, labels in reasons.items() if len(labels)}


def ruled_out(d: Diagnosis, unlisted: Unlisted | None) -> dict[str, list[str]]:
    """Return the labels of listed causes that are ruled out, by multiple of their usual size.

    Keys are "1", "2" and "5". From this multiple on, they would be found nine times in ten in these
    poses, given the named causes and the description of the unlisted one; and the evidence is
    against each of them. A cause that the description absorbs, as a curve of a joint absorbs its
    gear's errors, is not ruled out.
    """
    if unlisted is None or unlisted.further is None:
        return {}
    noise = unlisted.further.noise[""]
    poses = of_case(d.case, noise, d.effects(unlisted=unlisted))
    seen = poses.effects[
        (poses.effects["size_mm"] >= SETTINGS.min_size_mm) & (poses.effects["absorbed"] <= SETTINGS.max_absorbed_share)
    ]
    named = {label for c in d.causes for label in (c.label, *c.indistinguishable)} | set(d.in_question)
    last = unlisted.further.log_factor
    labels: dict[str, list[str]] = {}
    multiples = (1.0, 2.0, SETTINGS.max_findable_multiple)
    for label in (c.label for c in d.case.candidates if c.listed and c.label in seen.index and c.label not in named):
        times = [t for t in multiples if float(seen.loc[label, "findable_from"]) <= t]  # type: ignore[arg-type]
        if times and last.get(label, 0.0) < 0:
            labels.setdefault(f"{times[0]:g}", []).append(label)
    return {f"{t:g}": labels[f"{t:g}"] for t in multiples if f"{t:g}" in labels}
