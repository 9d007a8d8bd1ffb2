"""The diagnosis of a joint log as a result: residual of each joint, causes that fit, confidence."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from casadical.core.basics import Array, InputError, Show
from casadical.core.linear_gaussian.search import Posterior
from casadical.core.reporting.blocks import Block, Table
from casadical.core.reporting.plain import WRITTEN, Key
from casadical.core.reporting.result import Result
from casadical.core.statistics import first_of_best, rounded_at
from casadical.diagnosis.motion.effect_table import EffectTable
from casadical.diagnosis.motion.engine import Found, LogProblem, joint_of, search
from casadical.diagnosis.motion.floor import Stop, stops_of
from casadical.diagnosis.motion.friction_laws import FrictionLaws, friction_laws
from casadical.diagnosis.motion.hypotheses import NAMED_RIVALS, problem_of
from casadical.diagnosis.motion.signals import Arm, Fault, arm_of, faults_of, motion_of
from casadical.diagnosis.motion.view import UNDECLARED_PAYLOAD_SHARE, LogView, log_view
from casadical.diagnosis.settings import SETTINGS
from casadical.effects.motion import Cause, motion_effects
from casadical.identification.inertial import contradictions, determined
from casadical.measurements.logs.log import JointLog
from casadical.robot.robot import Robot

REGION_PARTS = 4  # number of quantile ranges of each variable in which a residual is compared


@dataclass(frozen=True, eq=False)
class LogDiagnosis(Result):
    """Diagnosis of a joint log: verdict, causes, residuals.

    log : the diagnosed log; view : its residuals and signals; problem : base and candidates
    found : causes in the model; rankings : posterior over the next cause in each step
    stops : angles at which joints stop while commands go on
    faults : faults of the log itself; reference : source of the healthy log, empty without one
    contradictions : sentences on contradictions between the log and the robot file
    determined : names of the inertial parameters that the motion determines
    """

    line: ClassVar[str] = " {{ it.log.source }}: {{ it.verdict }}{% for f in it.faults %}, {{ f.name }}{% endfor %}"

    file_stem: ClassVar[str] = "log_diagnosis"
    report: ClassVar[str] = "log.j2"

    derived: ClassVar[tuple[Key, ...]] = (
        Key("log", "log.source"),
        Key("verdict"),
        Key("causes"),
        Key("fits", lambda d: [_plain(f.label, f.probability) for f in d.fitting]),
        Key(
            "alike",
            lambda d: [_plain(k, d.rankings[0].probability[k]) for f in d.found[:1] for k in f.twins],
        ),
        Key("gap", lambda d: d.figures["gap"]),
        Key("joints", lambda d: d.figures["joints"]),
        Key("cause_effects", "cause_effects.without"),
        Key("torque_effects", lambda d: d.torques.plain["effects"] if d.torques else {}),
        Key("torque_by_model", lambda d: d.torques.plain["models"] if d.torques else {}),
        Key("friction_law", lambda d: d.torques.plain["laws"] if d.torques else {}),
        Key("ranking"),
        Key("none", lambda d: d.rankings[0].none),
        Key("payload_kg", lambda d: (p := d.payload()) and dict(zip(("beyond", "sigma"), p, strict=True))),
        Key("findings", "log.findings"),
        Key("cannot_tell", lambda d: cannot_tell(d.log, d.arm, bool(d.reference))),
    )

    log: JointLog
    view: LogView
    problem: LogProblem
    found: tuple[Found, ...]
    rankings: tuple[Posterior, ...]
    faults: tuple[Fault, ...]
    stops: tuple[Stop, ...] = ()
    reference: str = field(default="", metadata=WRITTEN)
    contradictions: tuple[str, ...] = field(default=(), metadata=WRITTEN)
    determined: tuple[str, ...] = field(default=(), metadata=WRITTEN)

    @property
    def arm(self) -> Arm:
        """Return bodies and drives of the arm."""
        return self.view.arm

    @property
    def fitting(self) -> tuple[Found, ...]:
        """Return the causes that fit (see `Found.fits`), at most one of each joint.

        Further ones, and all without torques, have at least `Settings.min_further_log_evidence`,
        those without torques and of no joint `Settings.min_arm_hint_log_evidence`. They are named
        if torques were logged, else hints; () if the log is faulty.
        """
        found = () if self.faults else self.found
        joints = [joint_of(f.label) for f in found]
        alone = self.view.motion.torque is None
        least = SETTINGS.min_further_log_evidence if alone else 0.0
        return tuple(
            f
            for k, f in enumerate(found)
            if f.fits and f.gain >= (SETTINGS.min_further_log_evidence if k else least) and joints[k] not in joints[:k]
            if joints[k] or f.gain >= SETTINGS.min_arm_hint_log_evidence or not alone
        )

    @property
    def named(self) -> tuple[Found, ...]:
        """Return the causes that are named: those that fit a log with torques."""
        return () if self.view.motion.torque is None else self.fitting

    @property
    def verdict(self) -> str:
        """Return "explained" (fault, stop or cause), "ambiguous", "unknown" or "none"."""
        if self.faults or self.stops or self.named:
            return "explained"
        if not self.found:
            return "none"
        first = self.found[0]
        # Smallest probability of a cause and its twins that is not called ambiguous.
        return "ambiguous" if first.listed and first.probability < 0.9 else "unknown"

    @cached_property
    def unit(self) -> tuple[str | None, Array]:
        """Return the unit of the residuals, and the factor to it of each joint, shape (joints,).

        The unit is "A" or "N m", that of the log's torques; without torques it is None: rad.
        """
        if self.view.motion.torque is None:
            return None, np.ones(self.arm.joints)
        if self.arm.per_ampere is None:
            return "N m", self.view.peak_torque
        return "A", self.view.peak_torque / self.arm.per_ampere

    def _rms(self, residuals: Sequence[Array]) -> Array:
        """Return the rms of each joint's torques, or positions if none were logged, in `unit`.

        residuals : of each group of the problem's rows
        """
        rms = [float(np.sqrt((r**2).mean())) if len(r) else 0.0 for r in residuals[: self.arm.joints]]
        return np.asarray(np.array(rms) * self.unit[1])

    def gap(self) -> tuple[Array, Array, Array]:
        """Return the rms residuals of each joint, of three models, shape (joints,) each.

        The models are the nominal one, the fitted base, and base with causes. Residuals are those
        of torques [A or N m] in sliding where they were logged, otherwise of positions [rad], by
        the nominal model the command.
        """
        problem, complete, m = self.problem, self.problem.given(self.found), self.view.motion
        nominal = [r.r for r in problem.rows]
        if m.torque is None and m.command is not None:
            nominal = [(m.position - m.command)[r.used, r.joint] for r in problem.rows]
        fitted = (p.residuals(p.fit.x) for p in (problem, complete))
        first, before, after = map(self._rms, (nominal, *fitted))
        return first, before, after

    def held_out_gap(self) -> tuple[Array, Array]:
        """Return the rms residuals of each joint in held-out runs, of two models, (joints,) each.

        The models are the fitted base, and base with causes; units are those of `gap`. Each run is
        predicted by a fit to the others (or each third of one run).
        """
        return self._held_out(()), self._held_out(self.found)

    def _held_out(self, found: Sequence[Found]) -> Array:
        """Return the rms residuals of each joint in held-out runs, with these causes."""
        return self._rms(self.problem.given(found).held_out())

    @cached_property
    def cause_effects(self) -> EffectTable | None:
        """Return the errors in held-out runs without each named cause; None without any."""
        found, unit = self.found, self.unit[0]
        without = {f.label: self._held_out([g for g in found if g is not f]) for f in self.named}
        names, title = self.log.joints[: self.arm.joints], "Held-out runs, beyond a usual arm,"
        every = (*self.held_out_gap(), without, title, unit or "mrad", 1.0 if unit else 1e3)
        return EffectTable(names, *every) if without else None

    def payload(self) -> tuple[float, float] | None:
        """Return the mass at the flange minus the declared payload, and its standard error [kg].

        None where payload is no candidate.
        """
        problem = self.problem
        if "payload" not in problem.by_label:
            return None
        others = [problem.groups[f.label, f.variant] for f in self.found if f.label != "payload"]
        own = problem.groups["payload", 0]
        # Prior standard deviation of a payload whose mass is reported, in typical ones.
        complete = problem.with_causes(np.sort(np.concatenate([own, *others])), 5.6)
        k = len(problem.mean) + int(np.searchsorted(np.sort(np.concatenate([own, *others])), own[0]))
        unit = UNDECLARED_PAYLOAD_SHARE * float(self.arm.inertial[::10].sum())
        mass, error = complete.fit.x[k] * unit, float(np.sqrt(np.linalg.inv(complete.fit.precision)[k, k])) * unit
        return rounded_at(float(mass), error, 4), rounded_at(error, error, 4)

    def blocks(self) -> list[Block]:
        """Return the report of the diagnosis as blocks of sentences and tables."""
        said = [*(f.sentence for f in self.faults), *(_stop_in_words(s, self.log) for s in self.stops)]
        hints = [in_words(self.problem, *f.twins) for f in self.fitting]
        if self.named:
            others = dict.fromkeys(joint_of(f.label) for f in self.found if not f.listed)
            said += [*hints, *(f"in joint {joint} is more than on the list" for joint in others)]
        elif self.found and not self.stops:
            said.append("more is there than in a usual arm")
            first = self.found[0].label
            said[-1] += f", most of all in joint {joint_of(first)}" if joint_of(first) else ""
            said[-1] += f"; no cause is named, but a hint fits: {hints[0]}" if hints else "; no listed cause fits it"
            name = self.problem.by_label[first].name
            if name in NAMED_RIVALS:
                does = f"and so does {name}" if hints else f"but {name} does"
                said[-1] += f", {does.replace('_', ' ')}: {in_words(self.problem, first)}"
        still = "never moved" if self.log.findings else "?"  # a finding of the log says it, with what would help
        return self._report_blocks(
            said=said,
            friction=self.torques,
            causes=self.cause_effects,
            residuals=self._gap_table(),
            fits=self._fits(),
            missing=[t for t in cannot_tell(self.log, self.arm, bool(self.reference)) if still not in t],
        )

    def _gap_table(self) -> Table:
        """Return the table of each joint's rms residuals, and of the region of the largest ones."""
        nominal, before, after = self.gap()
        (_, held_out), unit = self.held_out_gap(), self.unit[0] or "mrad"
        factor = 1.0 if self.unit[0] else 1e3
        rows = [
            (name, *(f"{factor * v[j]:.3g}" for v in (nominal, before, after, held_out)), self._where(j))
            for j, name in enumerate(self.log.joints[: self.arm.joints])
        ]
        title = f"Residual of each joint, rms [{unit}]: model alone, usual friction, with the causes, held-out runs"
        columns = ("joint", "model", "usual arm", "with causes", "held out", "most at")
        return Table(title, columns, rows, frozenset({1, 2, 3, 4}))

    @cached_property
    def torques(self) -> FrictionLaws | None:
        """Return held-out torque errors by model and law; None without torque or signed current."""
        has_torque = self.log.torque is not None or (self.log.current is not None and not self.log.current_unsigned)
        return friction_laws(self.log, self.arm) if has_torque else None

    def _where(self, j: int) -> str:
        """Return the range of angle, speed, load or time with the largest residual of joint j.

        It is a text, "" if the base's residual is about equal everywhere. j : 0-based
        """
        problem, m = self.problem, self.view.motion
        rows = problem.rows[j]
        residual = rows.r - rows.J @ problem.fit.x[rows.own]
        if not residual.any():
            return ""
        residual, parts = residual**2, []
        signals = (m.q[:, j], m.v[:, j], self.view.variables["load"][:, j], m.time)
        # Names of the variables over which the region of a joint's largest residual is reported.
        for name, values in zip(("angle", "speed", "load", "time"), (v[rows.used] for v in signals), strict=True):
            edges = np.quantile(values, np.linspace(0, 1, REGION_PARTS + 1))
            part = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, REGION_PARTS - 1)
            mean = np.array([residual[part == k].mean() if (part == k).any() else 0.0 for k in range(REGION_PARTS)])
            k = first_of_best(mean)
            parts.append((float(np.sqrt(mean[k] / residual.mean())), f"{name} {edges[k]:.3g} to {edges[k + 1]:.3g}"))
        worst = parts[first_of_best([share for share, _ in parts])]
        # A range is reported if its rms residual exceeds the overall one by this factor.
        return worst[1] if worst[0] > 1.5 else ""

    def _fits(self) -> Table:
        """Return the table of the most probable causes, and of none, each with its probability."""
        ranking, problem = self.rankings[0], self.problem
        # The table of probable causes has three, and none below a probability of 0.01.
        rows = [
            (label, f"{ranking.probability[label]:.2f}", f"{ranking.log_factor[label]:.0f}", in_words(problem, label))
            for label in ranking.order[:3]
            if ranking.probability[label] > 0.01
        ]
        rows += [("none", f"{ranking.none:.2f}", "", "a usual arm")]
        heads = ("cause", "probability", "log evidence", "what the log shows")
        return Table("What fits", heads, rows, frozenset({1, 2}))

    @cached_property
    def figures(self) -> dict[str, Any]:
        """Return the rms residuals of all joints ("gap") and of each ("joints") as plain data.

        Units are those of the method `gap`.
        """
        (nominal, before, after), held_out = self.gap(), self.held_out_gap()
        total = {"before": np.sqrt((before**2).mean()), "after": np.sqrt((after**2).mean())}
        names = ("joint", "model", "usual", "after", "usual_left_out", "after_left_out")
        each = zip(self.log.joints, nominal, before, after, *held_out, strict=False)
        return {
            "gap": {**total, "unit": self.unit[0] or "rad"},
            "joints": [dict(zip(names, row, strict=True)) for row in each],
        }

    @property
    def certain(self) -> list[dict[str, Any]]:
        """Return faults of the log, and stops with their angles, as plain data."""
        faults: list[dict[str, Any]] = [{"effect": f.name, "joint": None, "probability": 1.0} for f in self.faults]
        return [*faults, *({**_plain(f"contact@{s.joint + 1}", 1.0), "angle_rad": s.angle} for s in self.stops)]

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Return what is `certain`, and named causes, as plain data."""
        return [*self.certain, *(_plain(f.label, f.probability) for f in self.named)]

    @property
    def ranking(self) -> list[dict[str, Any]]:
        """Return what is `certain`, then the ten likeliest first causes with log evidence [nats]."""
        first = self.rankings[0]
        fits = [{**_plain(k, first.probability[k]), "log_evidence": first.log_factor[k]} for k in first.order[:10]]
        return [*self.certain, *fits]


def _plain(label: str, probability: float) -> dict[str, Any]:
    """Return a cause as a dict with the keys effect, joint (1-based or None) and probability."""
    name, _, joint = label.partition("@")
    return {"effect": name, "joint": int(joint) if joint else None, "probability": float(probability)}


def _stop_in_words(stop: Stop, log: JointLog) -> str:
    """Return a sentence on a stop: joint, angle, commands beyond it, and effort there."""
    said = (
        f"{log.joints[stop.joint]} stops at {stop.angle:.2f} rad ({np.rad2deg(stop.angle):.0f} deg) while commands go "
        f"{stop.beyond:.2f} rad beyond, for {stop.seconds:.1f} s"
    )
    what = "torque" if log.torque is not None else "current"
    return (
        said
        if stop.effort is None
        else f"{said}; its {what} is {stop.effort[0] / stop.effort[1]:.0f} times that elsewhere"
    )


def in_words(problem: LogProblem, label: str, *twins: str) -> str:
    """Return a text on how the cause of a label appears in data, with its joint.

    twins : labels of causes that these data do not distinguish from it; their names are added
    """
    candidate = problem.by_label[label]
    if candidate.name == "unknown":
        return f"on no list: {label}"
    names = dict.fromkeys(k.partition("@")[0] for k in (label, *twins))
    signature = candidate.variants[0][0].signature + (f" ({' or '.join(names)})" if twins else "")
    return f"joint {candidate.joint}: {signature}" if candidate.joint else signature


def cannot_tell(log: JointLog, arm: Arm, compared: bool) -> Iterator[str]:
    """Yield sentences on causes that such a log cannot show, and on what to log for them.

    compared : whether there is a reference
    """
    if not compared:
        yield (
            "Friction cannot be judged without a log of the healthy arm, as no arm's friction has a usual value "
            "(--reference LOG)."
        )
    if log.torque is None and (log.current is None or log.current_unsigned):
        yield "Torque scale and servo stiffness look alike without a signed current (current1_A ...) or torque."
    elif arm.kp is None:
        yield "Servo stiffness needs the gains: kp, kd, ki of the table [drive] of the robot file."
    if log.command is None:
        yield "Delay, lag, servo stiffness and play need the commands: log command1_rad ..."
    if arm.dynamics.given.drive is None or arm.dynamics.given.drive.encoder_side != "joint":
        yield "Play and compliance behind an encoder on the motor do not reach it; link lengths and the tool never do."
    if len({*np.unique(log.run).tolist()}) < 2:
        yield "A zero that jumps between runs needs two runs or more in one table (column run)."
    speed = np.abs(np.diff(log.position, axis=0)).max(axis=0) if len(log) > 1 else np.zeros(1)
    if still := [name for name, v in zip(log.joints, speed, strict=True) if not v > 0]:
        yield f"{', '.join(still)} never moved: of such a joint only the load at rest is identified."


def diagnose_log(
    robot: Robot,
    log: JointLog,
    reference: JointLog | None = None,
    show: Show = lambda _: None,
    healthy: Robot | None = None,
    own: Sequence[Cause] = (),
) -> LogDiagnosis:
    """Return the diagnosis of a joint log: why an arm moves differently from its model.

    robot : model with masses, and the declared properties of its drives
    log : log of one arm, with commands, or a torque or current, or both
    reference : log of the same arm in health on another day: differences from it that exceed those
        from day to day are causes
    show : called with a line of progress
    healthy : robot of the reference, where it carried another payload
    own : causes in addition to the listed ones, such as an effect file defines (for torque or
        response)
    Raises InputError: a log that is too short, or has other joints than the robot.
    """
    show("signals and rigid bodies")
    views = log_views_of(robot, log, reference, healthy)
    show("hypotheses")
    problem = problem_of(views, [*motion_effects().values(), *own])
    bodies = determined(robot, log)
    numbers = tuple(k for k in bodies.independent if not k.startswith("Ia")) if bodies else ()
    compared, arm = reference.source if reference else "", views[0].arm
    faults = tuple(faults_of(log, arm, reference))
    stops = tuple(stops_of(arm.dynamics, [*log.runs()]))
    return LogDiagnosis(
        log, views[0], problem, *search(problem), faults, stops, compared, contradictions(robot, log), numbers
    )


def log_views_of(
    robot: Robot, log: JointLog, reference: JointLog | None = None, healthy: Robot | None = None
) -> tuple[LogView, ...]:
    """Return residuals and variables of a log and, if there is one, of its reference.

    healthy : robot of the reference; None: the same
    Raises InputError: other joints than the robot has, or neither a torque nor commands.
    """
    arm = arm_of(robot)
    for one in filter(None, (log, reference)):
        if len(one.joints) != arm.joints:
            raise InputError(
                f"{one.source}: has {len(one.joints)} joints ({', '.join(one.joints)}), the robot {robot.name!r} has "
                f"{arm.joints}; name the columns by the robot's joints, or by their numbers"
            )
    of_command = log.torque is None and (log.current is None or log.current_unsigned or arm.per_ampere is None)
    if of_command and log.command is None:
        raise InputError(
            f"{log.source}: a current without a torque constant, and no commands of every joint; give "
            "torque_constant_Nm_per_A and gear_ratio in [drive] of the robot file, or log command1_rad to "
            f"command{arm.joints}_rad"
        )

    def seen(one: JointLog, of: Arm, peak_torque: Array | None = None) -> LogView:
        """Return residuals and variables of one log, without torques of unknown unit.

        peak_torque : of each joint [N m]; None: from this log
        """
        used = replace(one, torque=None, current=None) if of_command else one
        of = of if one.torque is None else replace(of, per_ampere=None)
        # Of longer logs every k-th sample is used, so that about this many are judged.
        return log_view(motion_of(used, of, max_samples=12000), of, peak_torque)

    if reference is None:
        return (seen(log, arm),)
    healthy_view = seen(reference, arm_of(healthy) if healthy else arm)
    return seen(log, arm, healthy_view.peak_torque), healthy_view
