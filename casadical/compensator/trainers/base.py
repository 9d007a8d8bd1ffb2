"""Interface of a trainer: settings of a training, which yields its state after each step."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Self

from casadical.compensator.network import Task
from casadical.core.basics import Array


class State(NamedTuple):
    """A training between two steps.

    steps : number of steps done
    weights : best weights so far, shape (count,), in the order of `Layout`
    reasons : why the training is over, as text; empty as long as it should continue
    note : in words what the trainer chose by itself, once it is over; empty if nothing
    history : (step, loss [mm^2]) at regular intervals, once it is over (see `train`)
    """

    steps: int
    weights: Array
    reasons: tuple[str, ...] = ()
    note: str = ""
    history: tuple[tuple[int, float], ...] = ()

    @property
    def loss_mm2(self) -> float:
        """Return the task's `Loss` (by default eq. 14) of a training that is over [mm^2]."""
        return self.history[-1][1]


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
    >>> first, second, *_ = trainer.states(task, seed=0)
    >>> first.steps, second.steps
    (0, 1)
    """

    name: ClassVar[str]
    method: ClassVar[str] = ""
    output_scale_mm: ClassVar[float | None] = None

    @classmethod
    def for_method(cls) -> Self:
        """Return the trainer with the settings for its `method`; by default the default ones."""
        return cls()

    @abstractmethod
    def states(self, task: Task, seed: int) -> Iterator[State]:
        """Yield the state of a training after each step until it is over.

        seed : seed of all its random numbers
        """
