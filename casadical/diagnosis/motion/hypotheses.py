"""Hypotheses on a joint log: the listed causes, a user's own, and smooth functions as their rivals."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.candidates import Candidate
from casadical.diagnosis.motion.engine import LogProblem, smooth_functions, with_candidates
from casadical.diagnosis.motion.servo_rows import Replay, saturation_columns, servo_problem, simulated_columns
from casadical.diagnosis.motion.signals import SMOOTHING_WIDTH_S
from casadical.diagnosis.motion.torque_rows import STRIBECK_SPEED_RAD_S, torque_problem
from casadical.diagnosis.motion.view import LogView, Signals, signals_of
from casadical.effects.definition import DefinedEffect
from casadical.effects.motion import Cause, motion_effects
from casadical.effects.settings import grid_points

# Causes that only a comparison with a healthy log (reference) of the same arm can show.
FRICTION_CAUSES = ("coulomb_friction", "viscous_friction", "load_friction")
# Causes on no list that keep a listed one from being named where they fit better.
NAMED_RIVALS = ("gain_switching", "integrator_windup", "bump")
# Name of dry and of viscous friction among a cause's variables -> kinds of the base's torque columns.
FRICTION_KINDS = {"friction": ("slip", "loaded", "dip"), "drag": ("viscous", "curved")}


def problem_of(views: Sequence[LogView], chosen: Sequence[Cause]) -> LogProblem:
    """Return base and hypotheses of a log.

    views : the log and, if there is one, its reference; chosen : causes that are candidates
    """
    log = views[0]
    # Without a reference the base's friction may be any: that it has grown cannot be judged.
    # In a log of commands alone friction and a servo's gain look like a load, and walls and obstacles
    # would double the time of its simulations.
    alone = log.motion.torque is None
    hidden = {*FRICTION_CAUSES, *(("payload", "link_mass") if alone else ())} if len(views) < 2 else set()
    hidden |= {"wall", "obstacle"} if alone else {"saturation", "speed_saturation"}
    testable = [kind for kind in chosen if kind.name not in hidden]
    effects = [c for kind in testable for c in _settings(kind, log.arm.joints)]
    if log.motion.torque is not None:
        problem = torque_problem(views)
        log = replace(
            log, variables={**log.variables, "slip": np.sign(log.motion.v)}, frictions=_frictions(problem, log)
        )
        made = ((candidate, signals_of(log, effect)) for candidate, effect in effects)
        smooth = smooth_functions(log, problem.rows, problem.fit.variance)
        problem = with_candidates(problem, chain(made, _plateaus(log), smooth))
        own = ((group, problem.by_label[k].name) for (k, _), group in problem.groups.items())
        masks = frozenset(int(group[0]) for group, name in own if name == "saturation")
        return replace(problem, masks=masks)
    problem, replay, x = servo_problem(views)
    torques = {"friction": np.exp(x[:, 2] - x[:, 0]), "drag": np.exp(x[:, 3] - x[:, 0]) * log.motion.v}
    log = replace(log, frictions={k: v / log.peak_torque + 0 * log.motion.q for k, v in torques.items()})
    return with_candidates(problem, _simulated(replace(replay, view=log), x, effects, problem))


def _settings(kind: Cause, joints: int) -> Iterator[tuple[Candidate, DefinedEffect]]:
    """Yield a candidate, and its effect, for each joint and setting of a cause."""
    name = kind.answers_as or kind.name
    for joint in range(1, joints + 1) if kind.acts_at == "joints" else (None,):
        for point in grid_points(kind):
            effect = kind(joint, **point)
            label = name if joint is None else f"{name}@{joint}"
            yield Candidate(label, name, joint, ((effect,),), listed=name not in NAMED_RIVALS), effect


def _plateaus(view: LogView) -> Iterator[tuple[Candidate, list[Signals]]]:
    """Yield saturation of each joint, by torque and by speed: where it is large, it falls behind.

    Large is more than .8 of the largest one, as a plateau is as noisy as the signal, and what
    smoothing mixes with it.
    """
    m, kind = view.motion, motion_effects()["saturation"]
    assert m.torque is not None
    near = np.ones(1 + 2 * round(SMOOTHING_WIDTH_S / m.step))
    for j in range(view.arm.joints) if view.response is not None else ():
        for signal in (m.torque[:, j], m.v[:, j]):
            large = np.abs(signal) > 0.8 * np.quantile(np.abs(signal), 0.998)
            behind = 0.01 * np.sign(signal) * (np.convolve(large, near, "same") > 0.5)
            candidate = Candidate(f"saturation@{j + 1}", "saturation", j + 1, ((kind(j + 1),),))
            yield candidate, [{("position", j): behind}]


def _frictions(problem: LogProblem, log: LogView) -> dict[str, Array]:
    """Return the fitted base's friction torques / peak torque, (samples, joints), by variable."""
    x, m, speed = problem.fit.x, log.motion, log.variables["speed"]
    slip, fall = np.sign(m.v), np.exp(-np.abs(m.v) / STRIBECK_SPEED_RAD_S)
    shapes = {"slip": slip, "loaded": slip * np.abs(log.variables["load"]), "dip": slip * fall}
    shapes |= {"viscous": speed, "curved": speed * np.abs(speed)}
    at = {name: k for k, name in enumerate(problem.names)}
    return {
        name: sum(shapes[k] * np.array([x[at["torque", str(j), k]] for j in range(log.arm.joints)]) for k in kinds)
        for name, kinds in FRICTION_KINDS.items()
    }


def _simulated(
    replay: Replay, x: Array, effects: Sequence[tuple[Candidate, DefinedEffect]], problem: LogProblem
) -> Iterator[tuple[Candidate, list[Signals]]]:
    """Yield each variant of each hypothesis with its columns by simulation."""
    view = replay.view
    made = ((c, signals_of(view, cause, 1.0), signals_of(view, cause, -1.0)) for c, cause in effects)
    torques = [replace(r, kind="torque") for r in problem.rows]
    scale = (0.5 * np.exp(x[:, 2] - x[:, 0]) / view.peak_torque) ** 2
    smooth = ((c, bumps, bumps) for c, bumps in smooth_functions(view, torques, scale))
    yield from simulated_columns(replay, x, chain(made, smooth))
    kind = motion_effects()["saturation"]
    for j, column in saturation_columns(replay, x):
        effect = ((kind(j + 1),),)
        yield Candidate(f"saturation@{j + 1}", "saturation", j + 1, effect), [column]
