"""Compensator of the error that remains after calibration (paper, section 4).

A network is used only if it reduces the error of poses on which it was not trained.

Sign: the residual is measured minus computed position (paper, eq. 9), and the correction is added
to the computed one. Positions are in the measuring frame.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from casadical.compensator.layout import JointBox, Layout, box_around
from casadical.compensator.network import Loss, Network, Task, joint_angles, make_task, residuals, training_masks
from casadical.compensator.trainers.base import State, Trainer
from casadical.compensator.trainers.registry import trainer_named
from casadical.core.basics import Array, InputError

if TYPE_CHECKING:
    import casadi


@dataclass(frozen=True)
class Errors:
    """Statistics of the position errors of a set of poses.

    poses : number n of poses
    mean_mm, max_mm, std_mm : mean, maximum and sample standard deviation (divisor n - 1) of the
        errors' norms [mm]; the last is 0 for one pose
    """

    poses: int
    mean_mm: float
    max_mm: float
    std_mm: float

    @classmethod
    def summarise(cls, errors_mm: Array) -> Self:
        """Return the statistics of the norms of error vectors, shape (n, outputs) [mm]."""
        length = np.linalg.norm(errors_mm, axis=1)
        spread = float(length.std(ddof=1)) if len(length) > 1 else 0.0
        return cls(len(length), float(length.mean()), float(length.max()), spread)


@dataclass(frozen=True)
class BeforeAfter:
    """Errors of the same poses without and with the network.

    before, after : statistics without and with the network
    gain : relative reduction of the mean error, 1 - mean after / mean before; 0.3 is 30 %; 0 if
        the mean before is zero
    gain_error : standard error of the gain; 0 for one pose, or if the mean before is zero
    """

    before: Errors
    after: Errors
    gain: float
    gain_error: float

    @classmethod
    def compare(cls, before_mm: Array, after_mm: Array) -> Self:
        """Return the comparison of n poses' error vectors without and with the network.

        before_mm, after_mm : shape (n, outputs) [mm]
        """
        was, now = np.linalg.norm(before_mm, axis=1), np.linalg.norm(after_mm, axis=1)
        mean = float(was.mean())
        if mean == 0.0:
            return cls(Errors.summarise(before_mm), Errors.summarise(after_mm), 0.0, 0.0)
        ratio = float(now.mean()) / mean
        # Standard error of the ratio of two means of paired values, by the delta method.
        spread = float(np.std(now - ratio * was, ddof=1)) if len(was) > 1 else 0.0
        return cls(Errors.summarise(before_mm), Errors.summarise(after_mm), 1 - ratio, spread / mean / len(was) ** 0.5)


def table(rows: dict[str, BeforeAfter]) -> str:
    """Return statistics of sets of poses, by name, as text, without > with the network [mm]."""
    lines = [f"{'[mm]':24}{'poses':>6}  {'mean':>15}  {'max':>15}  {'std':>15}"]
    for name, row in rows.items():
        b, a = row.before, row.after
        pairs = ((b.mean_mm, a.mean_mm), (b.max_mm, a.max_mm), (b.std_mm, a.std_mm))
        lines.append(f"{name:24}{b.poses:6}  " + "  ".join(f"{was:6.4f} > {now:6.4f}" for was, now in pairs))
    return "\n".join(lines)


# Function that is called during each training with the number of steps done and the loss [mm^2] at
# the best weights so far.
Progress = Callable[[int, float], None]


def train(
    task: Task,
    trainer: Trainer,
    *,
    seed: int = 0,
    every: int = 50,
    progress: Progress | None = None,
) -> State:
    """Train one network and return its last state; see `train_all`.

    task : the training problem; trainer, seed, every, progress : as of `train_all`

    Examples
    --------
    >>> from casadical.compensator import JointBox, Layout, make_task, train
    >>> from casadical.compensator.trainers.registry import trainers_by_name
    >>> task = make_task(Layout(2), JointBox((-3.0, -3.0), (3.0, 3.0)), poses.q, residual_mm)
    >>> train(task, trainers_by_name()["lm"](), seed=1).weights.shape
    (33,)
    """
    return train_all([task], trainer, seed=seed, every=every, progress=progress)[0]


def train_all(
    tasks: Sequence[Task],
    trainer: Trainer,
    *,
    seed: int = 0,
    every: int = 50,
    progress: Progress | None = None,
) -> list[State]:
    """Train one network for each task, one after the other, and return the last states.

    tasks : training problems
    trainer : trainer with its settings
    seed : seed of every training, the same for all
    every : number of steps between two calls of `progress` and two entries of the history
    progress : see `Progress`
    Raises InputError: `every` is below 1.
    """
    if every < 1:
        raise InputError(f"every must be at least 1 step; got {every}")
    done: list[State] = []
    for task in tasks:
        history: list[tuple[int, float]] = []
        for state in trainer.states(task, seed):
            if not state.reasons and (state.steps == 0 or state.steps % every):
                continue
            history.append((state.steps, float(task.losses(state.weights[None])[0])))
            if state.reasons:
                done.append(state._replace(history=tuple(history)))
            if progress is not None:
                progress(*history[-1])
    return done


# Joint variables q, shape (n, joints) [rad], and residuals, shape (n, outputs) [mm].
Data = tuple[ArrayLike, ArrayLike]


@dataclass(frozen=True, eq=False)
class Compensator:
    """A trained compensator, or the null one if the network was refused.

    network : network in use; None: the null compensator, which corrects nothing
    layout : sizes of the network
    trained_box : ranges of the joint variables of the training poses [rad]
    training : errors of the training poses without and with the trained network, even if refused
    choice : the same for poses that it was not trained on and that decided whether it is used
    validation : the same for poses that had no part in any choice; None: none were given
    chosen_by : poses of `choice`, in words
    margin : number of its standard errors by which the gain had to exceed zero
    trainer : name of the trainer
    settings : settings of the trainer, by name
    note : why the training stopped and what the trainer chose, in words
    seed : seed of everything random
    data_sha256 : SHA-256 of the training data
    trained : network as trained, even if refused; None for a compensator from a file
    history : (step, loss [mm^2]) of the training; empty for a compensator from a file

    Examples
    --------
    >>> residual_mm = casadical.identification.residual_mm(robot, poses)
    >>> net = casadical.Compensator.fit(poses.q[:30], residual_mm[:30], choose=(poses.q[30:], residual_mm[30:]))
    >>> net.helps
    True
    >>> net.correction_mm(poses.q[:2]).shape, net.inside(poses.q[:2])
    ((2, 3), array([ True,  True]))
    >>> print(net.function())
    network:(q[2])->(dp[3]) SXFunction
    """

    network: Network | None
    layout: Layout
    trained_box: JointBox
    training: BeforeAfter
    choice: BeforeAfter
    validation: BeforeAfter | None
    chosen_by: str
    margin: float
    trainer: str
    settings: dict[str, Any]
    note: str
    seed: int
    data_sha256: str
    trained: Network | None = None
    history: tuple[tuple[int, float], ...] = ()

    @classmethod
    def fit(
        cls,
        q: ArrayLike,
        residual_mm: ArrayLike,
        *,
        validate: Data | None = None,
        choose: Data | None = None,
        trainer: Trainer | str = "lm",
        layout: Layout | None = None,
        joint_range: JointBox | None = None,
        output_scale_mm: float | None = None,
        loss: Loss | None = None,
        seed: int = 0,
        folds: int = 5,
        margin: float = 1.0,
        progress: Progress | None = None,
    ) -> Self:
        """Return a network trained on residuals, or the null compensator if it does not help.

        q : shape (n, joints) [rad]: joint variables of the training poses, not a controller's
            readings where these differ
        residual_mm : shape (n, outputs) [mm]: their residuals, measured less computed
        validate : (q, residual_mm) of further poses, for the report only
        choose : (q, residual_mm) of poses that decide whether the network helps, instead of a
            cross-validation
        trainer : name of one of `trainers_by_name`, or a trainer with its settings
        layout : sizes of the network; None: one hidden layer of 5 neurons
        joint_range : joint ranges that scale the inputs; None: those of the training poses
        output_scale_mm : millimetres of one unit of the output layer, 1 in the paper; None: root
            mean square of the residual's coordinates, or 1 if all are zero
        loss : loss that is minimised; None: the paper's
        seed : seed of everything random
        folds : number of folds of the cross-validation, where `choose` is not given
        margin : number of its standard errors that the gain must exceed
        progress : as of `train_all`
        Raises InputError: wrong shapes, values that are not finite, fewer than 10 poses, folds not
        from 2 to n, a negative margin, an unknown trainer.
        """
        rows = joint_angles(q, layout.joints if layout else None)
        targets = residuals(residual_mm, len(rows), layout.outputs if layout else None)
        size = layout or Layout(joints=rows.shape[1], outputs=targets.shape[1])
        if len(rows) < 10:
            why = "are too few to train and to judge a network; give at least 10"
            raise InputError(f"{len(rows)} training poses {why}")
        if not 2 <= folds <= len(rows):
            raise InputError(f"folds must be 2 to the number of training poses ({len(rows)}); got {folds}")
        if not margin >= 0:
            raise InputError(f"margin is a number of standard errors, not negative; got {margin}")
        how = trainer_named(trainer)
        rms = float(np.sqrt(np.mean(targets**2))) or 1.0
        scale = output_scale_mm if output_scale_mm is not None else rms
        box = joint_range or box_around(rows)

        masks = training_masks(len(rows), folds, seed) if choose is None else np.empty((0, len(rows)), dtype=bool)
        parts = [*masks, np.ones(len(rows), dtype=bool)]
        tasks = [make_task(size, box, rows[m], targets[m], scale_mm=scale, loss=loss) for m in parts]
        outcomes = train_all(tasks, how, seed=seed, progress=progress)
        networks = [Network(size, box, outcome.weights, scale) for outcome in outcomes]

        network, last = networks[-1], outcomes[-1]
        if choose is None:
            after = targets.copy()
            for one, mask in zip(networks, masks, strict=False):
                after[~mask] -= one.output_mm(rows[~mask])
            judged = BeforeAfter.compare(targets, after)
        else:
            judged = _apply(network, choose)
        blobs = (np.ascontiguousarray(array, dtype="<f8").tobytes() for array in (rows, targets))
        return cls(
            network=network if judged.gain > margin * judged.gain_error and judged.gain > 0 else None,
            layout=size,
            trained_box=box_around(rows),
            training=_apply(network, (rows, targets)),
            choice=judged,
            validation=None if validate is None else _apply(network, validate),
            chosen_by=f"{folds}-fold cross-validation" if choose is None else "a set of poses of its own",
            margin=float(margin),
            trainer=how.name,
            settings=asdict(how),
            note="; ".join((*last.reasons, *([last.note] if last.note else []))),
            seed=int(seed),
            data_sha256=hashlib.sha256(f"{rows.shape} {targets.shape}".encode() + b"".join(blobs)).hexdigest(),
            trained=network,
            history=last.history,
        )

    @property
    def helps(self) -> bool:
        """Return whether a network is in use; if not, the compensator corrects nothing."""
        return self.network is not None

    @property
    def verdict(self) -> str:
        """Return a sentence that states whether the network helps, with its effect on held-out poses.

        It has the mean error before and after [mm] and its relative reduction with the standard
        error [%], of poses not trained on; if it helps, a second sentence warns if the largest
        error grows.
        """
        c = self.choice
        change = f"{c.before.mean_mm:.4g} -> {c.after.mean_mm:.4g} mm on poses not trained on, by {self.chosen_by}"
        gain = f"gain {100 * c.gain:.1f} % +/- {100 * c.gain_error:.1f} %"
        if not self.helps:
            return f"The network does not help here, nothing is corrected: mean error {change} ({gain})."
        worse = c.after.max_mm > c.before.max_mm
        warning = f" But the largest error grows: {c.before.max_mm:.4g} -> {c.after.max_mm:.4g} mm." if worse else ""
        return f"The network helps: mean error {change} ({gain}).{warning}"

    def __str__(self) -> str:
        rows = {"training": self.training, self.chosen_by: self.choice}
        if self.validation is not None:
            rows["validation"] = self.validation
        which = "" if self.helps else "Figures of the refused network, without > with it:\n"
        return f"{self.verdict}\n{which}{table(rows)}\n{self.trainer}, seed {self.seed}: {self.note}"

    def correction_mm(self, q: ArrayLike) -> Array:
        """Return the correction to add to computed positions, (n, outputs) or (outputs,) [mm].

        It is in the measuring frame. The null compensator returns zeros.

        q : joint variables, shape (n, joints) or (joints,) [rad]; outside of `trained_box` the
            network extrapolates, see `inside`
        """
        if self.network is not None:
            return self.network.output_mm(np.asarray(q))
        rows = joint_angles(q, self.layout.joints)
        return np.zeros((len(rows), self.layout.outputs) if np.ndim(q) == 2 else self.layout.outputs)

    def inside(self, q: ArrayLike) -> Array:
        """Return a mask of joint variables q, (n, joints) [rad], in the training ranges, (n,)."""
        return self.trained_box.contains(joint_angles(q, self.layout.joints))

    def function(self) -> "casadi.Function":
        """Return the CasADi function ``network:(q[joints] rad)->(dp[outputs] mm)``.

        q are joint variables, dp is in the measuring frame; that of the null compensator is zero.
        """
        if self.network is not None:
            return self.network.function()
        import casadi

        q = casadi.SX.sym("q", self.layout.joints)
        return casadi.Function("network", [q], [casadi.SX.zeros(self.layout.outputs)], ["q"], ["dp"])


def _apply(network: Network, data: Data) -> BeforeAfter:
    """Return statistics of the norms of position errors [mm], without and with a network.

    data : joint variables, shape (n, joints) [rad], and residuals, shape (n, outputs) [mm]
    """
    rows = joint_angles(data[0], network.layout.joints)
    before = residuals(data[1], len(rows), network.layout.outputs)
    return BeforeAfter.compare(before, before - network.output_mm(rows))
