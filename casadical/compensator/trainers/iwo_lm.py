"""Invasive weed optimisation first, Levenberg-Marquardt from its best member then."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

from casadical.compensator.task import Task
from casadical.compensator.trainers.base import Trainer
from casadical.compensator.trainers.iwo import Iwo, IwoRun
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt, LmRun
from casadical.core.arrays import Array


@dataclass(frozen=True)
class IwoThenLm(Trainer):
    """Settings of both parts; of ``lm.restarts`` nothing is used. The ridge is chosen as in `LevenbergMarquardt`."""

    name: ClassVar[str] = "iwo-lm"
    method: ClassVar[str] = "IWO-LM-NN-SKCM"

    iwo: Iwo = field(default_factory=Iwo)
    lm: LevenbergMarquardt = field(default_factory=LevenbergMarquardt)

    def begin(self, task: Task, seed: int) -> "IwoThenLmRun":
        return IwoThenLmRun(self, task, seed, self.iwo.begin(task, seed))

    def resume(self, task: Task, seed: int, state: dict[str, Any]) -> "IwoThenLmRun":
        part = {"iwo": self.iwo, "lm": self.lm}[state["part"]]
        run = IwoThenLmRun(self, task, seed, part.resume(task, seed, state["state"]))  # type: ignore[arg-type]
        run.done = state["done"]
        return run


class IwoThenLmRun:
    """One training; a step is a step of the part in progress."""

    def __init__(self, trainer: IwoThenLm, task: Task, seed: int, run: IwoRun | LmRun):
        self.trainer, self.task, self.seed, self.run, self.done = trainer, task, seed, run, 0

    @property
    def steps(self) -> int:
        return self.done + self.run.steps

    def step(self) -> None:
        self.run.step()
        if isinstance(self.run, IwoRun) and self.run.reasons():
            self.done, start = self.run.steps, self.run.best()
            self.run = self.trainer.lm.begin(self.task, self.seed, starts=start[None])

    def reasons(self) -> tuple[str, ...]:
        return () if isinstance(self.run, IwoRun) else self.run.reasons()

    def best(self) -> Array:
        return self.run.best()

    def note(self) -> str:
        return self.run.note()

    def state(self) -> dict[str, Any]:
        part = "iwo" if isinstance(self.run, IwoRun) else "lm"
        return {"part": part, "done": self.done, "state": self.run.state()}
