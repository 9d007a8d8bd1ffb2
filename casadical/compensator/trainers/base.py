"""Interface of a trainer: settings that start a training, which runs step by step."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self

from casadical.compensator.network import Task
from casadical.core.basics import Array


class Run(Protocol):
    """A training in progress."""

    @property
    def steps(self) -> int:
        """Return the number of steps done."""

    def step(self) -> None:
        """Do the next step."""

    def reasons(self) -> tuple[str, ...]:
        """Return why the training is over, as text; empty as long as it should continue."""

    def best(self) -> Array:
        """Return the best weights so far, shape (count,), in the order of `Layout`."""

    def note(self) -> str:
        """Return in words what the trainer chose by itself; empty if nothing."""


@dataclass(frozen=True)
class Trainer(ABC):
    """Settings of one training method; each is a small frozen dataclass.

    name : short name, as in tables and saved files
    method : name in problem.toml and of `calibrate --method` for a network that this trainer trains
        on the residuals of SKCM (joint identification of geometry and compliance); "" for none
    output_scale_mm : millimetres of one unit of the output layer for that method; None: root mean
        square residual

    Examples
    --------
    >>> from casadical.compensator import JointBox, Layout, make_task
    >>> from casadical.compensator.trainers.registry import trainers_by_name
    >>> trainer = trainers_by_name()["lm"].for_method()
    >>> trainer.name
    'lm'
    >>> task = make_task(Layout(2), JointBox((-3.0, -3.0), (3.0, 3.0)), poses.q, residual_mm)
    >>> run = trainer.begin(task, seed=0)
    >>> run.step()
    >>> run.steps
    1
    """

    name: ClassVar[str]
    method: ClassVar[str] = ""
    output_scale_mm: ClassVar[float | None] = None

    @classmethod
    def for_method(cls) -> Self:
        """Return the trainer with the settings for its `method`; by default the default ones."""
        return cls()

    @abstractmethod
    def begin(self, task: Task, seed: int) -> Run:
        """Return a training with no step done; seed : seed of all its random numbers."""
