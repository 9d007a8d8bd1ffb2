"""Run trainings to their end, with progress, checkpoints and resume."""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from casadical.compensator.checksummed_json import digest, pack, read_checksummed, unpack, write_checksummed
from casadical.compensator.task import Task
from casadical.compensator.trainers.base import Run, Trainer
from casadical.core.basics import Array, InputError

_KIND, _VERSION = "casadical-training-checkpoint", 1


@dataclass(frozen=True)
class Progress:
    """Where a job stands: training of so many trainings, step of this one, loss [mm^2] of the best weights so far."""

    training: int
    trainings: int
    step: int
    loss_mm2: float


@dataclass(frozen=True, eq=False)
class Training:
    """Outcome of one training.

    weights : shape (count,); loss_mm2 : the paper's loss (eq. 14) on the training poses [mm^2]
    steps : how many; reasons : why it stopped; note : what the trainer chose
    history : (step, loss [mm^2]) now and then
    """

    weights: Array = field(repr=False)
    loss_mm2: float
    steps: int
    reasons: tuple[str, ...]
    note: str
    history: tuple[tuple[int, float], ...] = field(repr=False)


def train(
    task: Task,
    trainer: Trainer,
    *,
    seed: int = 0,
    checkpoint: str | os.PathLike[str] | None = None,
    every: int = 50,
    progress: Callable[[Progress], None] | None = None,
) -> Training:
    """Train one network; see `train_all`.

    task : the training problem
    trainer : with its settings
    seed : of everything random
    checkpoint, every, progress : as of `train_all`

    Examples
    --------
    >>> from casadical.compensator import JointBox, Layout, make_task, train
    >>> from casadical.compensator.trainers.known import known_trainers
    >>> task = make_task(Layout(2), JointBox((-3.0, -3.0), (3.0, 3.0)), poses.q, residual_mm)
    >>> train(task, known_trainers()["lm"](), seed=1).weights.shape
    (33,)
    """
    return train_all([task], trainer, seed=seed, checkpoint=checkpoint, every=every, progress=progress)[0]


def train_all(
    tasks: Sequence[Task],
    trainer: Trainer,
    *,
    seed: int = 0,
    checkpoint: str | os.PathLike[str] | None = None,
    every: int = 50,
    progress: Callable[[Progress], None] | None = None,
) -> list[Training]:
    """Train one network for each task, one after the other.

    tasks : training problems
    trainer : with its settings
    seed : of everything random
    checkpoint : file to write the state to. If it exists, the job continues from it and ends with exactly the weights
        of an uninterrupted one (on the same machine and libraries). It is kept when the job is done
    every : steps between two calls of ``progress``, two checkpoints and two entries of the history
    progress : called with where the job stands
    Raises InputError: the checkpoint is damaged or belongs to other data, settings or seed.
    """
    if every < 1:
        raise InputError(f"every must be at least 1 step; got {every}")
    job = _Job(list(tasks), trainer, seed, checkpoint, every)
    while job.task is not None:
        job.step()
        if progress is not None:
            progress(job.progress())
    return job.done


class _Job:
    """Trainings in progress: those done, and the run of the current one with its history."""

    def __init__(self, tasks: list[Task], trainer: Trainer, seed: int, path: str | os.PathLike[str] | None, every: int):
        self.tasks, self.trainer, self.seed, self.path, self.every = tasks, trainer, seed, path, every
        self.done: list[Training] = []
        self.run: Run | None = None
        self.history: list[tuple[int, float]] = []
        self.mark = _fingerprint(tasks, trainer, seed, every)
        if path is not None and Path(path).exists():
            self._restore(read_checksummed(path, _KIND, _VERSION))

    @property
    def task(self) -> Task | None:
        return self.tasks[len(self.done)] if len(self.done) < len(self.tasks) else None

    def step(self) -> None:
        """Do ``every`` steps, or those left of the current training, and write the checkpoint."""
        task = self.task
        assert task is not None
        if self.run is None:
            self.run, self.history = self.trainer.begin(task, self.seed), []
        for _ in range(self.every):
            if self.run.reasons():
                break
            self.run.step()
        weights = self.run.best()
        self.history.append((self.run.steps, float(task.losses(weights[None])[0])))
        if reasons := self.run.reasons():
            history = tuple(self.history)
            self.done.append(Training(weights, history[-1][1], self.run.steps, reasons, self.run.note(), history))
            self.run = None
        if self.path is not None:
            write_checksummed(self.path, _KIND, _VERSION, self._state())

    def progress(self) -> Progress:
        step, loss = self.history[-1]
        at = len(self.done) - (self.run is None)
        return Progress(at + 1, len(self.tasks), step, loss)

    def _state(self) -> dict[str, Any]:
        done = [asdict(training) | {"weights": pack(training.weights)} for training in self.done]
        run = None if self.run is None else self.run.state()
        return {"fingerprint": self.mark, "done": done, "run": run, "history": self.history}

    def _restore(self, state: dict[str, Any]) -> None:
        if state["fingerprint"] != self.mark:
            raise InputError(
                f"checkpoint {self.path} belongs to another training: data, settings or seed differ; "
                "name another file, or delete this one to start afresh"
            )
        for item in state["done"]:
            history = tuple((int(step), float(loss)) for step, loss in item["history"])
            rest = {"reasons": tuple(item["reasons"]), "history": history, "weights": unpack(item["weights"])}
            self.done.append(Training(**(item | rest)))
        self.history = [(int(step), float(loss)) for step, loss in state["history"]]
        if state["run"] is not None and self.task is not None:
            self.run = self.trainer.resume(self.task, self.seed, state["run"])


def _fingerprint(tasks: list[Task], trainer: Trainer, seed: int, every: int) -> str:
    settings = {"trainer": trainer.name, "settings": asdict(trainer), "seed": seed, "every": every}
    sums = [
        [asdict(task.layout), asdict(task.loss), task.scale_mm, _sum(task.inputs), _sum(task.targets)] for task in tasks
    ]
    return digest(settings | {"tasks": sums})


def _sum(array: Array) -> str:
    return hashlib.sha256(repr(array.shape).encode() + array.astype("<f8").tobytes()).hexdigest()
