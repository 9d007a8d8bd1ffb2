"""Measuring sessions of planned campaigns: a robot as built in a physics, what is hidden in it, and its table."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import pandas as pd

from casadical.blind_check.campaign_plans import Plan
from casadical.blind_check.mujoco_physics import Plant, campaign, draw_effect, perturb
from casadical.blind_check.mujoco_physics.draw import SECONDS_A_POSE
from casadical.blind_check.mujoco_physics.plant import Building
from casadical.blind_check.mujoco_physics.stops import Warmup
from casadical.blind_check.mujoco_physics.table import readings


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot whose diagnosis is checked.

    nominal : its drawing, for the physics; model : text of the file of the base model that the diagnosis is given
    building : which errors the real robot has; level : whether gravity is known in the measuring frame, not in the base
    poses : of the poses to measure, in their order, the columns of a campaign: readings, and those of time_s,
        temperature_degC, payload_kg, approach1 .. that are not to be simulated; None: drawn within the joint ranges
    """

    nominal: Plant
    model: str
    building: Building = Building()  # noqa: RUF009  (frozen)
    level: bool = True
    poses: pd.DataFrame | None = None

    def built(self, seed: int) -> Plant:
        plant = perturb(self.nominal, seed, building=self.building)
        if self.level:
            return plant
        before, now = self.nominal.base[:3, :3], plant.base[:3, :3]
        return replace(plant, gravity=now @ before.T @ plant.gravity)


class Acting(Protocol):
    """An effect that is switched on: its name, its 1-based joint or None, and its sizes in words."""

    @property
    def effect(self) -> str: ...
    @property
    def joint(self) -> int | None: ...
    @property
    def about(self) -> str: ...


@dataclass(frozen=True, eq=False)
class Simulator:
    """What measures robots: draw gives an effect by its name for a campaign of so many poses, campaign its table."""

    draw: Callable[[Plant, str, np.random.Generator, int], Acting]
    campaign: Callable[..., pd.DataFrame]


MUJOCO = Simulator(draw_effect, campaign)


@dataclass(frozen=True, eq=False)
class Record:
    """A measuring session as it was, and as it would have been with less.

    session : with all that is hidden; its columns are a campaign's, and x_true_mm, y_true_mm, z_true_mm without noise
    clean : without any effect; alone : with each effect by itself; of the same seed, poses and noise
    """

    hidden: tuple[Acting, ...]
    session: pd.DataFrame
    clean: pd.DataFrame
    alone: tuple[pd.DataFrame, ...]


def record(subject: Subject, plan: Plan, n: int, poses: pd.DataFrame | None, simulator: Simulator = MUJOCO) -> Record:
    """The session of a plan, of n poses; poses : of all of them, as of `Subject`."""
    rng = np.random.default_rng(plan.seed)
    plant = subject.built(int(rng.integers(1 << 30)))
    options: dict[str, Any] = {}
    lasting = n
    if poses is not None:
        options = {"q_deg": poses[readings(plant)].to_numpy(), "given": poses}
        if "temperature_degC" in poses:
            options["warmup"] = Warmup(start_degC=float(poses["temperature_degC"].iloc[0]))
        if "time_s" in poses:
            lasting = max(1, round(float(poses["time_s"].iloc[-1]) / SECONDS_A_POSE))
    # A payload that is not logged is constant.
    if "payload" in plan.not_logged:
        options["payload_states"] = [plant.payload_kg]
        if poses is not None:
            options["given"] = poses.drop(columns="payload_kg", errors="ignore")
    hidden = tuple(simulator.draw(plant, effect, rng, lasting) for effect in plan.effects)
    seed = int(rng.integers(1 << 30))

    def session(*acting: Acting) -> pd.DataFrame:
        return simulator.campaign(
            plant,
            acting,
            n,
            seed,
            noise_mm=1e3 * plan.noise,
            repeatability_urad=1e6 * plan.repeatability,
            approach="motion",
            truth=True,
            **options,
        )

    return Record(
        hidden=hidden,
        session=session(*hidden),
        clean=session(),
        alone=tuple(session(each) for each in hidden) if len(hidden) > 1 else (),
    )
