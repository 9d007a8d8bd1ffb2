"""The interface of a trainer: a training step by step."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self

from casadical.compensator.network import Task
from casadical.core.basics import Array


class Run(Protocol):
    """A training in progress."""

    @property
    def steps(self) -> int:
        """Return how many steps are done."""

    def step(self) -> None:
        """Do the next piece of work."""

    def reasons(self) -> tuple[str, ...]:
        """Return why it is over; empty while it should go on."""

    def best(self) -> Array:
        """Return the best weights so far, shape (count,)."""

    def note(self) -> str:
        """Return in words what the trainer chose by itself, or an empty string."""


@dataclass(frozen=True)
class Trainer(ABC):
    """Settings of one way to train. Every trainer is one small frozen dataclass in a file of its own.

    name : short name, as in tables and saved files
    method : how problem.toml and `calibrate --method` call a network that it trains on what SKCM leaves; "" for none
    output_scale_mm : of networks of that method, millimetres of one output unit; None: root mean square residual

    Examples
    --------
    >>> from casadical.compensator import JointBox, Layout, make_task
    >>> from casadical.compensator.trainers.known import known_trainers
    >>> trainer = known_trainers()["lm"].for_method()
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
        """The trainer with the settings that its method has; by default those it has anyway."""
        return cls()

    @abstractmethod
    def begin(self, task: Task, seed: int) -> Run:
        """Start a training."""
