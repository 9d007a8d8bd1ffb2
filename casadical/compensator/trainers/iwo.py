"""Training by invasive weed optimisation: the paper's method (section 4)."""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from casadical.compensator.iwo import InvasiveWeeds, IwoSettings
from casadical.compensator.task import Task
from casadical.compensator.trainers.base import Trainer
from casadical.core.arrays import Array
from casadical.core.errors import InputError


@dataclass(frozen=True)
class Iwo(Trainer):
    """Invasive weed optimisation of all weights.

    settings : of the search. precision : the colony's losses are compared in "double" or, in about half the time, in
    "single" precision; weights and all reported losses are double in both.
    """

    name: ClassVar[str] = "iwo"
    method: ClassVar[str] = "IWO-NN-SKCM"
    output_scale_mm: ClassVar[float | None] = 1.0  # the paper's

    settings: IwoSettings = field(default_factory=IwoSettings)
    precision: Literal["double", "single"] = "double"

    def __post_init__(self) -> None:
        if self.precision not in ("double", "single"):
            raise InputError(f"precision is 'double' or 'single'; got {self.precision!r}")

    def begin(self, task: Task, seed: int) -> "IwoRun":
        return IwoRun(self, task, InvasiveWeeds(task.layout.count, self.settings, seed=seed))

    def resume(self, task: Task, seed: int, state: dict[str, Any]) -> "IwoRun":  # noqa: ARG002 (the state holds it)
        return IwoRun(self, task, InvasiveWeeds.restore(task.layout.count, self.settings, state))


class IwoRun:
    """One search; a step is one generation."""

    def __init__(self, trainer: Iwo, task: Task, search: InvasiveWeeds):
        self.search = search
        self._dtype = np.float32 if trainer.precision == "single" else np.float64
        inputs, targets = task.inputs.astype(self._dtype), task.targets.astype(self._dtype)
        self._task = Task(task.layout, inputs, targets, task.scale_mm, task.loss)

    @property
    def steps(self) -> int:
        return self.search.iteration + 1

    def step(self) -> None:
        self.search.tell(self._task.losses(self.search.ask().astype(self._dtype, copy=False)))

    def reasons(self) -> tuple[str, ...]:
        return self.search.stop()

    def best(self) -> Array:
        return self.search.result().x

    def note(self) -> str:
        return ""

    def state(self) -> dict[str, Any]:
        return self.search.state()
