"""Blind check of a user's own robot: how often a diagnosis of it would be right.

Simulated campaigns of the robot with hidden effects are diagnosed, and the right answers are
counted.
"""

import json
import secrets
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from io import StringIO
from statistics import median
from typing import ClassVar

import numpy as np
import pandas as pd

from casadical.blind_check.generation import (
    COLUMN_PREFIXES,
    MIN_POSES,
    Plan,
    Subject,
    campaign_of,
    draw_plans,
    engine_versions,
)
from casadical.blind_check.mujoco_physics import LISTED, UNLISTED, FourBar, Plant
from casadical.blind_check.mujoco_physics.cause import rated_torque
from casadical.blind_check.mujoco_physics.hidden import SECONDS_A_POSE, impossible
from casadical.blind_check.mujoco_physics.plant import home_frames
from casadical.blind_check.mujoco_physics.stops import Warmup
from casadical.blind_check.prediction import answer_campaign
from casadical.blind_check.protocol import Answer
from casadical.blind_check.scoring import DETECTABLE_SIGNAL, Estimate, Outcome, fraction, outcome
from casadical.blind_check.worker_pool import completed, workers
from casadical.core.basics import Array, ConvergenceError, InputError
from casadical.core.parts import lacks_masses, with_estimated_masses
from casadical.core.reporting.blocks import Block, Table, Words
from casadical.core.reporting.plain import WRITTEN, Key, written
from casadical.core.reporting.result import Result
from casadical.measurements.derived_columns import derive
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot
from casadical.robot.robot_file import to_toml

# Simulated standard deviation of a joint about its reading [rad or m].
JOINT_REPEATABILITY = 5e-6


def subject_of(robot: Robot, poses: Measurements | None = None) -> tuple[Subject, tuple[str, ...]]:
    """Return a robot as the check simulates it, and sentences on what had to be assumed.

    poses : poses to measure, as they were logged; None: drawn at random
    Raises InputError: what cannot be simulated.
    """
    _refuse(robot)
    assumed = []
    table = None if poses is None else _in_order(poses, _turns(robot))
    taken = [
        word
        for word, start in COLUMN_PREFIXES.items()
        if table is not None and any(table.columns.str.startswith(start))
    ]
    if taken:
        assumed.append(f"{', '.join(taken)} as in the table of poses")
    if "temperature" not in taken:
        assumed.append(f"the arm warms by {Warmup().rise_K:g} K")
    if robot.effects:
        robot = robot.with_only(())
        assumed.append("the effects of its file are ignored: campaigns hide effects of their own")
    if robot.targets:
        robot = replace(robot, targets=(), tool_name="")
        assumed.append("of its several measured points the first is measured")
    weighed = with_estimated_masses(robot) if lacks_masses(robot) else robot
    # Standard deviation of the logarithm of simulated masses that are estimated from the reach.
    log_mass_sigma = 0.3
    if weighed.masses == "estimated":
        assumed.append(f"masses of the links are estimates from the reach, each off by some {log_mass_sigma:.0%}")
    if "payload" not in taken:
        both = "no payload and {:g} kg in turns, or the latter alone where it is not logged"
        assumed.append(both.format(robot.payload.mass) if robot.payload else "no payload, for the file has none")
    joints, bar = weighed.joints, weighed.loops[0] if weighed.loops else None
    gravity = np.asarray(weighed.gravity, float)
    if weighed.gravity_frame == "base":
        gravity = weighed.base.T[:3, :3] @ gravity
    nominal = Plant(
        name=weighed.name,
        home=home_frames([(j.alpha, j.a, j.beta or 0.0, j.b or 0.0, j.theta, j.d) for j in joints]),
        reflector=weighed.tool.T[:3, 3].copy(),
        mass=np.array([j.body.mass if j.body else 0.0 for j in joints]),
        com=np.array([j.body.com if j.body else np.zeros(3) for j in joints]),
        payload_kg=weighed.payload.mass if weighed.payload else 0.0,
        payload_com=weighed.payload.com if weighed.payload else np.zeros(3),
        stiffness=np.ones(weighed.n),
        ranges=np.array([[j.lower, j.upper] for j in joints]),
        base=weighed.base.T,
        four_bar=None
        if bar is None
        else FourBar(
            bar.crank,
            bar.coupler,
            bar.rocker,
            crank_zero_rad=joints[bar.driven - 1].theta - joints[bar.carrier - 1].theta,
            passive_offset_rad=bar.offset - joints[bar.driven - 1].theta,
            driven=bar.driven,
        ),
        slides=frozenset(int(i) for i in np.flatnonzero(~_turns(weighed)) + 1),
        gravity=gravity,
    )
    given = [joint.compliance for joint in weighed.joints]
    # Simulated deflection at the rated torque of a joint whose stiffness is unknown [rad or m].
    deflection_unknown_stiffness = 3e-4
    # Simulated deflection at the rated torque of a joint that is rigid in the file [rad or m].
    deflection_rigid = 2e-6
    values = [
        1 / c if c else torque / (deflection_rigid if c is None else deflection_unknown_stiffness)
        for c, torque in zip(given, rated_torque(nominal), strict=True)
    ]
    for compliance, word, size in (
        (0.0, "no stiffness", deflection_unknown_stiffness),
        (None, "rigid", deflection_rigid),
    ):
        if numbers := [str(i) for i, c in enumerate(given, 1) if c == compliance]:
            words = f"{word} in the file: {1e6 * size:.0f} urad (um) at the rated torque"
            assumed.append(f"joint {', '.join(numbers)}: {words}")
    nominal = replace(nominal, stiffness=np.array(values))
    subject = Subject(
        nominal,
        to_toml(robot),
        base_shift=robot.base.unknown != "none" or robot.joints[0].beta is not None,
        base_turn=robot.base.unknown == "pose" or robot.joints[0].beta is not None,
        reflector=robot.tool.unknown != "none",
        mass_spread=log_mass_sigma if weighed.masses == "estimated" else 0.0,
        level=robot.gravity_frame != "base",
        poses=table,
    )
    return subject, tuple(assumed)


def _in_order(poses: Measurements, turns: Array) -> pd.DataFrame:
    """Return readings and logged quantities in the order of measuring, as a campaign's columns.

    Times are shifted to begin at `SECONDS_A_POSE`.

    turns : whether each joint is revolute, shape (joints,)
    """
    logged = {k: c for k, c in poses.conditions.items() if k.startswith(tuple(COLUMN_PREFIXES.values()))}
    if "time_s" in logged:
        logged["time_s"] = logged["time_s"] - logged["time_s"].min() + SECONDS_A_POSE
    shown = np.where(turns, np.rad2deg(poses.q), 1e3 * poses.q)
    names = [f"q{j}_deg" if turning else f"q{j}_mm" for j, turning in enumerate(turns, 1)]
    order = np.argsort(derive(poses, ["progress"])[0].conditions["progress"], kind="stable")
    return pd.DataFrame(dict(zip(names, shown.T, strict=True)) | logged).iloc[order].reset_index(drop=True)


def _refuse(robot: Robot) -> None:
    """Check that the robot's structure can be simulated. Raises InputError."""
    coupled = [str(i) for i, j in enumerate(robot.joints, 1) if j.coupling is not None]
    faults = {
        f"joint {', '.join(coupled)} follows other joints or is locked": bool(coupled),
        "its controller counts otherwise than its rows (readings)": robot.counts_otherwise,
        "it has several four-bars": len(robot.loops) > 1,
        "its four-bar is not between a joint from 3 on and the joint before": any(
            loop.carrier != loop.driven - 1 or loop.driven < 3 for loop in robot.loops
        ),
        "its gravity is logged pose by pose": robot.gravity_frame == "logged",
        "it has no gravity, by which effects are sized": not np.any(robot.gravity),
        "it has no revolute joint": not _turns(robot).any(),
    }
    for fault, true in faults.items():
        if true:
            raise InputError(f"{robot.name}: cannot be simulated: {fault}")


def _turns(robot: Robot) -> Array:
    """Return a mask of the revolute joints, shape (joints,)."""
    return np.array([j.kind == "revolute" for j in robot.joints])


@dataclass(frozen=True, eq=False)
class RobotCheck(Result):
    """Simulated campaigns of one robot with hidden effects, and how they were diagnosed.

    robot : name of the robot
    poses : number of measured poses of a campaign
    noise : standard deviation of a measured coordinate [m]
    seed : seed of everything drawn
    not_logged : quantities that the campaigns lack
    assumed : sentences on what the robot file does not specify
    not_drawn : reason for each effect that the robot cannot have, by its name
    outcomes : outcomes of the campaigns that were diagnosed
    failed : reason for each campaign without a diagnosis, by its name
    """

    derived: ClassVar[tuple[Key, ...]] = (
        Key("versions", lambda _: engine_versions()),
        Key("withheld", "figures"),
        Key(
            "effects",
            lambda check: {
                name: {
                    "listed": name in LISTED,
                    "campaigns": len(part),
                    "noticed": sum(t.detected for t in part),
                    "named": sum(_named(name, t) for t in part),
                }
                for name, part in check.by_effect.items()
            },
        ),
        Key(
            "campaigns",
            lambda check: [
                {
                    "name": t.name,
                    "kind": t.kind,
                    "hidden": t.truth or t.effects,
                    "signal": t.signal,
                    "verdict": t.verdict,
                    "named": t.named,
                }
                for t in check.outcomes
            ],
        ),
    )

    robot: str = field(metadata=WRITTEN)
    poses: int = field(metadata=WRITTEN)
    noise: float = field(metadata=written(unit="um"))
    seed: int = field(metadata=WRITTEN)
    not_logged: tuple[str, ...] = field(metadata=WRITTEN)
    assumed: tuple[str, ...] = field(metadata=WRITTEN)
    not_drawn: dict[str, str] = field(metadata=WRITTEN)
    outcomes: tuple[Outcome, ...]
    failed: dict[str, str] = field(metadata=WRITTEN)

    @property
    def figures(self) -> dict[str, Estimate]:
        """Return the fractions of right and wrong answers, 0 to 1, with 95 % intervals, by description."""
        none, one, off = ([t for t in self.outcomes if t.kind == kind] for kind in ("none", "one", "unlisted"))
        hidden = [t for t in self.outcomes if t.kind != "none"]
        claims = [t for t in self.outcomes if t.claimed]
        return {
            "claims that are right": fraction([not t.wrong_claims for t in claims]),
            "false alarms where nothing is hidden": fraction([t.alarmed for t in none]),
            "hidden effects noticed": fraction([t.detected for t in hidden]),
            "of those that stand out of the noise": fraction(
                [t.detected for t in hidden if t.signal >= DETECTABLE_SIGNAL]
            ),
            "one effect: named first": fraction([t.first_right for t in one]),
            "one effect: claimed, and right": fraction([t.claimed and t.first_right for t in one]),
            "effect on no list: claimed as a listed one": fraction([t.claimed for t in off]),
        }

    @property
    def by_effect(self) -> dict[str, list[Outcome]]:
        """Return the outcomes of campaigns that hid an effect, alone or with others, by its name."""
        names = sorted({e for t in self.outcomes for e in t.effects}, key=lambda e: (e in UNLISTED, e))
        return {name: [t for t in self.outcomes if name in t.effects] for name in names}

    def blocks(self) -> list[Block]:
        """Return the report as blocks of text and tables."""
        shares = [
            [name, "-" if e.value is None else f"{e.value:.2f}  ({e.low:.2f} .. {e.high:.2f}; {e.hits} of {e.n})"]
            for name, e in self.figures.items()
        ]
        lacking = f", without {' and '.join(self.not_logged)}" if self.not_logged else ""
        reasons: dict[str, list[str]] = {}
        for effect, reason in self.not_drawn.items():
            reasons.setdefault(reason, []).append(effect.replace("_", " "))
        return [
            Words(f"Would a diagnosis of {self.poses} poses of {self.robot} be right?", "title"),
            Words(self.verdict, "verdict"),
            Table("", ["", "share (95 % interval)"], shares),
            Table(
                "By hidden effect",
                ["effect", "noticed", "named", "95 %", "signal, median"],
                [_row(name, part) for name, part in self.by_effect.items()],
                frozenset({1, 2, 4}),
            ),
            Words(
                f"{len(self.outcomes)} campaigns of MuJoCo{lacking}; noise {1e6 * self.noise:g} "
                f"um a coordinate, joints repeat to {1e6 * JOINT_REPEATABILITY:g} urad; seed "
                f"{self.seed}. Signal: what the base model cannot absorb of all that is hidden, "
                "over the noise.",
                "note",
            ),
            *(Words(f"Assumed: {text}.", "note") for text in self.assumed),
            *(Words(f"Not hidden, for {reason}: {', '.join(names)}.", "note") for reason, names in reasons.items()),
            *(Words(f"{name}: no answer: {why}", "warning") for name, why in self.failed.items()),
        ]

    @property
    def verdict(self) -> str:
        """Return a sentence with the numbers of right claims and of false alarms."""
        right, alarms = self.figures["claims that are right"], self.figures["false alarms where nothing is hidden"]
        first = f"{right.hits} of {right.n} claims are right" if right.n else "No cause is claimed"
        many = "campaigns that hide" if alarms.n > 1 else "campaign that hides"
        return f"{first}; {alarms.hits} false alarms in {alarms.n} {many} nothing."


def _named(effect: str, t: Outcome) -> bool:
    """Return whether an answer named a hidden effect of this name at the right joint."""
    return any(text in t.named for text in t.truth if text.partition("@")[0] == effect)


def _row(effect: str, part: Sequence[Outcome]) -> list[str]:
    """Return the table's row of an effect: name, times noticed and named, interval, signal."""
    noticed, signal = f"{sum(t.detected for t in part)} of {len(part)}", f"{median(t.signal for t in part):.2g}"
    if effect in UNLISTED:
        return [f"{effect} (on no list)".replace("_", " "), noticed, "-", "-", signal]
    named = fraction([_named(effect, t) for t in part])
    interval = f"{named.low:.2f} .. {named.high:.2f}"
    return [effect.replace("_", " "), noticed, f"{named.hits} of {named.n}", interval, signal]


def check_robot(
    robot: Robot,
    *,
    poses: int | Measurements = 60,
    noise_um: float = 20.0,
    n: int = 40,
    seed: int | None = None,
    not_logged: Sequence[str] = (),
    executor: Executor | None = None,
    show: Callable[[str, int, int], None] = lambda _text, _done, _all: None,
) -> RobotCheck:
    """Return how often a diagnosis of this robot, with this instrument, would be right.

    Campaigns of robots built after its file are simulated in MuJoCo, with effects hidden at random;
    each is diagnosed from its table alone, and compared with what was hidden.

    robot : nominal robot
    poses : number of poses of a campaign, which are drawn within the joint ranges; or the poses to
        measure, of which logged quantities (time since a start, temperature, payload, approach) are
        taken and all others are simulated
    noise_um : standard deviation of a measured coordinate [um]
    n : number of campaigns, at least 4
    seed : seed of everything drawn; None: a random one
    not_logged : quantities that are not logged, of temperature, payload, approach and time
    executor : executor of `concurrent.futures`; None: a process for each core
    show : called with a campaign's name, the number of campaigns done, and that of all
    Raises InputError for a robot that cannot be simulated, and for too few poses or campaigns.

    Examples
    --------
    >>> from casadical.blind_check import check_robot
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> arm = casadical.read_robot("problems/planar/robot.toml")
    >>> with ThreadPoolExecutor(1) as pool:
    ...     checked = check_robot(arm, poses=20, n=4, seed=1, executor=pool)
    >>> len(checked.outcomes)
    4
    """
    count = poses if isinstance(poses, int) else len(poses)
    min_poses = max(MIN_POSES, 3 * robot.n)
    if count < min_poses:
        raise InputError(
            f"{count} poses; a campaign of {robot.name} needs at least {min_poses}, or no robot is identified"
        )
    if not 0 < noise_um < 1e5:
        raise InputError(f"noise_um is {noise_um:g}; it must be between 0 and 100000")
    if n < 4:
        raise InputError(f"n is {n}; a check needs at least 4 campaigns, one of each kind")
    for word in not_logged:
        if word not in COLUMN_PREFIXES:
            raise InputError(f"not logged: {word}: unknown; allowed: {', '.join(COLUMN_PREFIXES)}")
    engine_versions()
    subject, assumed = subject_of(robot, None if isinstance(poses, int) else poses)
    seed = secrets.randbits(32) if seed is None else seed
    not_drawn = impossible(subject.nominal)
    words = ([e for e in LISTED if e not in not_drawn], [e for e in UNLISTED if e not in not_drawn])
    plans = draw_plans(n, seed, words, (count,), robots=("campaign",), noise_levels=(1e-6 * noise_um,), struck=0.0)
    plans = [replace(p, missing=",".join(not_logged) or None, repeatability=JOINT_REPEATABILITY) for p in plans]
    results: dict[str, Outcome | str] = {}
    with workers(executor) as pool:
        for done, (name, result) in enumerate(completed(pool, _checked, [(subject, p) for p in plans]), 1):
            results[name] = result
            show(name, done, n)
    in_order = {p.name: results[p.name] for p in plans}
    return RobotCheck(
        robot=robot.name,
        poses=count,
        noise=1e-6 * noise_um,
        seed=seed,
        not_logged=tuple(not_logged),
        assumed=assumed,
        not_drawn=not_drawn,
        outcomes=tuple(t for t in in_order.values() if isinstance(t, Outcome)),
        failed={name: t for name, t in in_order.items() if isinstance(t, str)},
    )


def _checked(subject: Subject, plan: Plan) -> tuple[str, Outcome | str]:
    """Return a campaign's name and its outcome, or the reason why it has none, as text.

    The campaign is simulated, diagnosed from its tables alone, and compared with its secret. This
    runs in a worker process.
    """
    try:
        _, table, secret = campaign_of(subject, plan)
    except (InputError, ConvergenceError) as error:
        return plan.name, f"not simulated: {error}"
    answer = answer_campaign(plan.name, subject.model, pd.read_csv(StringIO(table)))
    if "failed" in answer:
        return plan.name, str(answer["failed"])
    return plan.name, outcome(plan.name, secret, Answer.model_validate_json(json.dumps(answer)))
