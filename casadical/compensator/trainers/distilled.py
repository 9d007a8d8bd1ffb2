"""A network distilled from a Gaussian process, which is fitted to the measured poses and predicts many others.

Fifty poses do not tell a network with one ridge for all weights which joints matter; a process with a length for each
joint they do (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, ch. 5). Its mean at poses drawn in
the box of the measured ones is then what Levenberg-Marquardt fits.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from casadical.compensator.task import Task
from casadical.compensator.trainers.base import Trainer
from casadical.compensator.trainers.gaussian_process import GaussianProcess
from casadical.compensator.trainers.levenberg_marquardt import LevenbergMarquardt, LmRun
from casadical.core.basics import InputError


@dataclass(frozen=True)
class Taught(Trainer):
    """Settings: poses that the process answers, and the training on its answers.

    Not for periodic inputs, whose box is no box of joint angles.
    """

    name: ClassVar[str] = "taught"
    method: ClassVar[str] = "GP-NN-SKCM"

    lessons: int = 600
    lm: LevenbergMarquardt = field(default_factory=lambda: LevenbergMarquardt(restarts=4, ridges=(1e-5,)))

    def __post_init__(self) -> None:
        if self.lessons < 10:
            raise InputError(f"lessons must be at least 10 poses; got {self.lessons}")

    def begin(self, task: Task, seed: int) -> LmRun:
        lessons, note = self._lessons(task, seed)
        return self.lm.begin(lessons, seed).noted(note)

    def resume(self, task: Task, seed: int, state: dict[str, Any]) -> LmRun:
        lessons, note = self._lessons(task, seed)  # the same ones: nothing in it is left to chance
        return self.lm.resume(lessons, seed, state).noted(note)

    def _lessons(self, task: Task, seed: int) -> tuple[Task, str]:
        """The task to learn from, and what the process found."""
        if task.layout.periodic:
            raise InputError("the trainer 'taught' takes no periodic inputs; take 'lm', or a layout without them")
        inputs, ones = task.inputs[:-1].T, task.inputs[-1]
        process = GaussianProcess.fit(inputs, task.targets.T)
        low, high = inputs.min(axis=0), inputs.max(axis=0)
        drawn = np.random.default_rng((seed, 2)).uniform(low, high, (self.lessons, len(low)))
        rows = np.vstack([drawn, inputs])
        taught = np.ascontiguousarray(process.mean(rows).T)
        lengths = ", ".join(f"{v:.2g}" for v in process.lengths)
        note = f"taught by a Gaussian process, lengths {lengths} half ranges"
        return Task(
            task.layout, np.vstack([rows.T, np.full(len(rows), ones[0])]), taught, task.scale_mm, task.loss
        ), note
