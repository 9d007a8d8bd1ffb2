"""Training by invasive weed optimisation (paper, section 4), alone or with refinement."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from casadical.compensator.iwo import InvasiveWeeds, IwoSettings
from casadical.compensator.network import Task
from casadical.compensator.trainers.base import Trainer
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt, LmRun
from casadical.core.basics import Array, InputError


@dataclass(frozen=True)
class Iwo(Trainer):
    """Invasive weed optimisation of all weights.

    settings : settings of the search
    precision : precision in which the colony's losses are compared, "double" or, in about half the
        time, "single"; weights and all reported losses are double in both
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
        """Return a search over all weights, with no generation done."""
        return IwoRun(self, task, InvasiveWeeds(task.layout.count, self.settings, seed=seed))


class IwoRun:
    """One search; a step is one generation."""

    def __init__(self, trainer: Iwo, task: Task, search: InvasiveWeeds):
        self.search = search
        self._dtype = np.float32 if trainer.precision == "single" else np.float64
        inputs, targets = task.inputs.astype(self._dtype), task.targets.astype(self._dtype)
        self._task = Task(task.layout, inputs, targets, task.scale_mm, task.loss)

    @property
    def steps(self) -> int:
        """Return the number of generations done, the first colony included."""
        return self.search.iteration + 1

    def step(self) -> None:
        """Evaluate the next generation and select its members."""
        self.search.tell(self._task.losses(self.search.ask().astype(self._dtype, copy=False)))

    def reasons(self) -> tuple[str, ...]:
        """Return why the search is over; empty as long as it continues."""
        return self.search.stop()

    def best(self) -> Array:
        """Return the weights of the best member so far, shape (count,)."""
        return self.search.result().x

    def note(self) -> str:
        """Return an empty text: nothing is chosen here."""
        return ""


@dataclass(frozen=True)
class IwoThenLm(Trainer):
    """Invasive weed optimisation followed by Levenberg-Marquardt from its best weights.

    iwo, lm : settings of both parts; ``lm.restarts`` is not used, the ridge is chosen as by `lm`
    """

    name: ClassVar[str] = "iwo-lm"
    method: ClassVar[str] = "IWO-LM-NN-SKCM"

    iwo: Iwo = field(default_factory=Iwo)
    lm: LevenbergMarquardt = field(default_factory=LevenbergMarquardt)

    def begin(self, task: Task, seed: int) -> "IwoThenLmRun":
        """Return a training that begins with the invasive weed optimisation, with no step done."""
        return IwoThenLmRun(self, task, seed, self.iwo.begin(task, seed))


class IwoThenLmRun:
    """One training; a step is a step of the current part."""

    def __init__(self, trainer: IwoThenLm, task: Task, seed: int, run: IwoRun | LmRun):
        self.trainer, self.task, self.seed, self.run, self.done = trainer, task, seed, run, 0

    @property
    def steps(self) -> int:
        """Return the number of steps done in both parts."""
        return self.done + self.run.steps

    def step(self) -> None:
        """Do a step of the current part; Levenberg-Marquardt follows the search."""
        self.run.step()
        if isinstance(self.run, IwoRun) and self.run.reasons():
            self.done, start = self.run.steps, self.run.best()
            self.run = self.trainer.lm.begin(self.task, self.seed, starts=start[None])

    def reasons(self) -> tuple[str, ...]:
        """Return why the training is over; empty as long as the second part continues."""
        return () if isinstance(self.run, IwoRun) else self.run.reasons()

    def best(self) -> Array:
        """Return the best weights of the current part, shape (count,)."""
        return self.run.best()

    def note(self) -> str:
        """Return what the current part chose, in words."""
        return self.run.note()
