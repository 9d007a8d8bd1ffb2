"""Cost of each effect: replays without one effect at a time, for every arm and without a threshold.

A response that was identified is replayed again, with one effect removed, in runs that were not
fitted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.blocks import Table
from casadical.diagnosis.motion.response import Response
from casadical.measurements.logs.log import JointLog

# Function that removes an effect from a response, by the effect's name in tables. Damping is only
# reduced to a tenth.
REMOVALS: Mapping[str, Callable[[Response], Response]] = {
    "dry friction": lambda r: replace(r, friction=0 * r.friction),
    "gravity": lambda r: replace(r, gravity=False),
    "damping": lambda r: replace(r, damping=r.damping / 10),
    "delay": lambda r: replace(r, delay=0 * r.delay),
    "inertia": lambda r: replace(r, inertia=0 * r.inertia),
    "surface": lambda r: replace(r, floor=None),
    "stops": lambda r: replace(r, stops=()),
}
# The sentence names the effects and joints that together have this fraction of all costs.
NAMED_SHARE = 0.8


@dataclass(frozen=True, eq=False)
class EffectTable:
    """Rms errors of each joint with all effects, and without one of them at a time.

    joints : names of the joints; before : rms of what the effects explain, reading minus command
        [rad] or the logged torque [N m], shape (joints,)
    full : rms error with all effects, shape (joints,)
    without : the same without one effect, by its name
    title : what is predicted; unit : unit in the table; factor : from the errors' unit to it
    """

    joints: tuple[str, ...]
    before: Array
    full: Array
    without: Mapping[str, Array]
    title: str = "Replays"
    unit: str = "mrad"
    factor: float = 1e3

    def costs(self) -> Mapping[str, Array]:
        """Return, by effect, the increase of mean square error without it, shape (joints,).

        Decreases count as zero.
        """
        return {name: np.maximum(rms**2 - self.full**2, 0.0) for name, rms in self.without.items()}

    @property
    def sum_of_parts(self) -> Array:
        """Return the rms errors if the costs of all effects added up, shape (joints,)."""
        return np.asarray(np.sqrt(self.full**2 + sum(self.costs().values())))

    @property
    def sentence(self) -> str:
        """Return a sentence that names the effects and joints of most of the error.

        Torques count by their share of each joint's, so that small joints count. It also names the
        effects without influence on any joint.
        """
        unit = 1.0 if self.unit == "mrad" else self.before**2 + 1e-300
        costs, said, share = {name: cost / unit for name, cost in self.costs().items()}, list[str](), 0.0
        total = sum(float(cost.sum()) for cost in costs.values())
        if not total > 0:
            return "No effect of the response lowers the error."
        for name in sorted(costs, key=lambda k: -float(costs[k].sum())):
            if share >= NAMED_SHARE:
                break
            order = np.argsort(-costs[name], kind="stable")
            reached = np.cumsum(costs[name][order]) / costs[name].sum()
            most = order[: 1 + int(np.searchsorted(reached, NAMED_SHARE))]
            said.append(f"{name} ({', '.join(self.joints[j] for j in sorted(most.tolist()))})")
            share += float(costs[name].sum()) / total
        # An effect counts as having no cost if its removal raises no joint's mean square error by
        # more than a tenth of that with all effects.
        free = [name for name, cost in self.costs().items() if (cost < 0.1 * self.full**2).all()]
        verb = "make" if len(said) > 1 else "makes"
        return f"{', '.join(said)} {verb} {100 * share:.0f} % of what the effects explain" + (
            f"; {', '.join(free)}: nothing." if free else "."
        )

    def table(self) -> Table:
        """Return the rms errors by joint (column): with no effect, without each one, with all."""
        short = {"dry friction": "friction", "damping": "9/10 damp."}
        rows = {
            "everything": self.before,
            **{short.get(name, name): rms for name, rms in self.without.items()},
            "(in sum)": self.sum_of_parts,
            "nothing": self.full,
        }
        return Table(
            f"{self.title} without one effect, rms [{self.unit}]",
            ("without", *(name.replace("_", " ") for name in self.joints)),  # wrapped at spaces
            [(name, *(f"{self.factor * v:.3g}" for v in rms)) for name, rms in rows.items()],
            frozenset(range(1, 1 + len(self.joints))),
        )


def effect_table(
    runs: Sequence[JointLog], predicted: Sequence[Array], responses: Sequence[Response], before: Array
) -> EffectTable:
    """Return the rms errors of replays with one effect removed at a time, without a new fit.

    Damping is reduced to a tenth instead; surface and stops have a replay only where one was found.
    predicted : positions of each run by its response, shape (rows, joints) [rad]
    responses : response that predicts each run
    before : rms of reading minus command, shape (joints,) [rad]
    """

    def rms(positions: Sequence[Array]) -> Array:
        """Return the rms of reading minus replayed positions, shape (joints,) [rad]."""
        error = np.concatenate([run.position - q for run, q in zip(runs, positions, strict=True)])
        return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))

    there = {"surface": any(r.floor is not None for r in responses), "stops": any(r.stops for r in responses)}
    return EffectTable(
        runs[0].joints,
        before,
        rms(predicted),
        {
            name: rms([change(r).predicted(run) for run, r in zip(runs, responses, strict=True)])
            for name, change in REMOVALS.items()
            if there.get(name, True)
        },
    )
