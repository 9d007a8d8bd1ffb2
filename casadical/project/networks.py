"""The paper's network methods on a problem: networks learn the residual of SKCM (section 5)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from casadical.compensator import Compensator
from casadical.compensator.trainers.registry import network_methods
from casadical.core.basics import Array, Show, silent
from casadical.core.reporting.plain import Key
from casadical.identification.accuracy import Accuracy, residual_mm, summarise
from casadical.identification.result import Identification
from casadical.project.problem import Problem, error_groups


@dataclass(frozen=True, eq=False)
class NetworkResult:
    """The result of one network method on one problem.

    method : name of the network method
    compensator : trained network, None where there was nothing to train on
    why : reason why there is no compensator
    errors : set -> statistics of the corrected positions' errors [m], {} without a network; those
        of SKCM where it was refused, as nothing is corrected then (with it: `as_trained`)
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("verdict"),
        Key("helps"),
        Key("trainer", "compensator.trainer", omit_none=True),
        Key("settings", "compensator.settings", omit_none=True),
        Key("seed", "compensator.seed", omit_none=True),
        Key("chosen_by", "compensator.chosen_by", omit_none=True),
        Key("sets", lambda result: result.compensator and result.errors, omit_none=True),
        Key("as_trained", omit_none=True),
    )

    method: str
    compensator: Compensator | None
    why: str
    errors: Mapping[str, Accuracy]

    @property
    def helps(self) -> bool:
        """Return whether the network was trained and is in use because it reduces the error."""
        return self.compensator is not None and self.compensator.helps

    @property
    def verdict(self) -> str:
        """Return the verdict on the network, or why there is none, as a sentence."""
        return f"{self.method}: {self.why if self.compensator is None else self.compensator.verdict}"

    @property
    def as_trained(self) -> dict[str, Any] | None:
        """Return set (train, choose, report) -> errors without and with the network, as trained.

        None where there is no network; a refused one has them, too.
        """
        if (c := self.compensator) is None:
            return None
        parts = {"train": c.training, "choose": c.choice, "report": c.validation}
        return {name: part for name, part in parts.items() if part}


@dataclass(frozen=True, eq=False)
class Networks:
    """The results of all network methods of a problem.

    results : results by method
    trained_on : sentence on the poses that they were trained on, or on why none was trained
    """

    results: Mapping[str, NetworkResult]
    trained_on: str


def train_networks(
    problem: Problem,
    result: Identification,
    methods: Sequence[str] | None = None,
    *,
    seed: int = 0,
    show: Show = silent,
) -> Networks:
    """Train networks on the position residual that SKCM leaves; return the result of each method.

    SKCM is the paper's joint identification of geometry and compliance. The set train is fitted,
    the set choose decides on acceptance (without it cross-validation in train). Without a set
    train, separate parts of the first table's identification poses serve as both. Where they are
    too few, or no positions were measured or held out, no network is trained and the results state
    why.

    result : identification by SKCM; methods : network methods, None: all
    seed : of the split of identification poses and of the training
    show : called with each line of progress, which states the loss
    Raises InputError: a set whose errors are to be reported has no positions.
    """
    judged = dict(problem.parts())
    trainers = network_methods()
    methods = tuple(trainers) if methods is None else methods
    sets, words = training_material(problem, result, seed)
    if not sets:
        return Networks({m: NetworkResult(m, None, words, {}) for m in methods}, words)
    trained: dict[str, NetworkResult] = {}
    fit = partial(Compensator.fit, *sets["train"], choose=sets.get("choose"), validate=sets.get("report"), seed=seed)
    chosen = ", judged on choose" if "choose" in sets else ", judged by cross-validation in it"
    for method in methods:

        def progress(step: int, loss_mm2: float, method: str = method) -> None:
            show(f"{method} step {step}, loss {loss_mm2:.4g} mm2")

        kind = trainers[method]
        network = fit(trainer=kind.for_method(), output_scale_mm=kind.output_scale_mm, progress=progress)
        residuals = {name: residual_mm(result.robot, m) - network.correction_mm(m.q) for name, m in judged.items()}
        e = {name: 1e-3 * np.linalg.norm(rest, axis=1) for name, rest in residuals.items()}
        figures = {name: summarise(np.concatenate([e[n] for n in names])) for name, names in error_groups(e).items()}
        trained[method] = NetworkResult(method, network, "", figures)
    return Networks(trained, words or f"Networks: trained on the set train{chosen}; report was kept from both.")


def training_material(
    problem: Problem, result: Identification, seed: int = 0
) -> tuple[dict[str, tuple[Array, Array]], str]:
    """Return the training data of the networks by set, and a sentence on them.

    Each set (identify, train, choose, report) has joint variables, (n, joints) [rad or m], and
    position residuals of SKCM, (n, 3) [mm]. The sentence says which identification poses serve as
    train and choose, empty if none do; without any data it says why.

    result : identification by SKCM, whose residuals are learnt; seed : of the split of
        identification poses
    """
    sets = {name: parts for name, parts in problem.sets.items() if all(m.position is not None for m in parts)}
    if "identify" not in sets or "report" not in sets:
        kinds = ", ".join(sorted({m.kind for parts in problem.sets.values() for m in parts}))
        return {}, (
            f"no network: the data are {kinds}, which do not say where the point is; a network "
            "needs measured positions, and a set report to be judged on"
        )
    lent = ""
    # Largest numbers of identification poses that are lent to the network sets, drawn with the
    # seed: a training then takes seconds.
    max_lent_poses = {"train": 1500, "choose": 500}
    if "train" not in sets:
        with_positions = [m for m in result.used if m.position is not None]
        readings = 3 * sum(map(len, with_positions))
        # Without a set to train on, the poses that identified the robot are lent, if there are so
        # many coordinates per parameter that the identification did not fit their noise.
        if readings < 20 * len(result.names) or len(with_positions[0]) < 40:
            return {}, (
                f"no network: there is no set train, and {readings} readings for "
                f"{len(result.names)} parameters are too few to learn from what identification "
                "left of them; name a set train in problem.toml"
            )
        train = min(max_lent_poses["train"], int(0.75 * len(with_positions[0])))
        choose = min(max_lent_poses["choose"], len(with_positions[0]) - train)
        sets |= {name: (m,) for name, m in with_positions[0].split({"train": train, "choose": choose}, seed).items()}
        lent = (
            f"Networks: no set train, so {len(sets['train'][0])} of the poses that identified the "
            f"robot were lent to train and {len(sets['choose'][0])} others of them to choose; "
            "report was kept from all."
        )
    q = {name: np.concatenate([m.q for m in parts]) for name, parts in sets.items()}
    residuals = {name: np.concatenate([residual_mm(result.robot, m) for m in parts]) for name, parts in sets.items()}
    return {name: (q[name], residuals[name]) for name in sets}, lent
