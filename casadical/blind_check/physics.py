"""The physics that makes the campaigns: a plan goes in, measured tables come out.

There are two: MuJoCo (`mujoco_physics`), and the project's own independent simulator (`numpy_physics`), which needs no
further package. Neither shares a formula with the effects, and `predict` loads neither.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import pandas as pd

from casadical.blind_check import mujoco_physics, numpy_physics
from casadical.blind_check.campaign_plans import Plan
from casadical.blind_check.numpy_physics import Plant, disturbances, draw_disturbance, perturb
from casadical.core.errors import InputError

SCALES = (0.7, 1.0, 1.5, 2.5)


@dataclass(frozen=True, eq=False)
class Acting:
    """An effect that is switched on.

    effect, joint : its name, and its 1-based joint or None; about : its sizes in words
    itself : the effect as the physics knows it
    """

    effect: str
    joint: int | None
    about: str
    itself: Any


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


@dataclass(frozen=True, eq=False)
class Physics:
    """One physics as the check uses it.

    listed, unlisted : names of its effects that are on the diagnosis' list, and of those that are on none
    packages : what its campaigns depend on
    draw : an effect by its name, its joint and sizes at random, for a campaign of so many poses
    campaign : the table of a robot with effects, by numbers of poses and seed
    """

    listed: tuple[str, ...]
    unlisted: tuple[str, ...]
    packages: tuple[str, ...]
    draw: Callable[[Plant, str, np.random.Generator, int], Acting]
    campaign: Callable[..., pd.DataFrame]

    def versions(self) -> dict[str, str]:
        """Of its packages. Raises InputError if one is not installed."""
        try:
            return {name: version(name) for name in self.packages}
        except PackageNotFoundError as error:
            raise InputError(
                f"the engine {error.name} is not installed: pip install 'casadical[withheld]', or take --reality numpy"
            ) from None

    def record(self, table: Mapping[str, Any], plan: Plan, poses: int) -> Record:
        """The session of a plan with a robot of which `table` is the drawing."""
        rng = np.random.default_rng(plan.seed)
        plant = perturb(Plant.from_dict(table), int(rng.integers(1 << 30)))
        hidden = tuple(self.draw(plant, effect, rng, poses) for effect in plan.effects)
        seed = int(rng.integers(1 << 30))

        def session(*acting: Acting) -> pd.DataFrame:
            return self.campaign(
                plant,
                [a.itself for a in acting],
                poses,
                seed,
                noise_mm=1e3 * plan.noise,
                repeatability_urad=1e6 * plan.repeatability,
                # A payload that is not logged is constant.
                payload_states=[plant.payload_kg] if plan.missing == "payload" else None,
                approach="motion",
                truth=True,
            )

        return Record(
            hidden=hidden,
            session=session(*hidden),
            clean=session(),
            alone=tuple(session(each) for each in hidden) if len(hidden) > 1 else (),
        )


def physics_named(name: str) -> Physics:
    """The physics of a name. Raises InputError."""
    if name not in PHYSICS:
        raise InputError(f"--reality {name}: not known; allowed: {', '.join(PHYSICS)}")
    return PHYSICS[name]


def _in_mujoco(plant: Plant, effect: str, rng: np.random.Generator, poses: int) -> Acting:
    hidden = mujoco_physics.draw_effect(plant, effect, rng, poses=poses)
    return Acting(effect, hidden.joint, _sizes(hidden.size), hidden)


def _in_numpy(_plant: Plant, effect: str, rng: np.random.Generator, _poses: int) -> Acting:
    names = {f.name for f in fields((disturbances.LISTED | disturbances.UNLISTED)[effect])}
    joint = int(rng.integers(2 if "source" in names else 1, 7)) if "joint" in names else None
    found = draw_disturbance(effect, int(rng.integers(1 << 30)), joint=joint, scale=float(rng.choice(SCALES)))
    sizes = {f.name: getattr(found, f.name) for f in fields(found) if f.name != "joint"}
    return Acting(effect, joint, f"{type(found).__name__}: {_sizes(sizes)}", found)


def _sizes(sizes: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {np.round(value, 9).tolist()}" for name, value in sizes.items())


def _numpy_campaign(plant: Plant, acting: list[Any], n: int, seed: int, **options: Any) -> pd.DataFrame:
    return numpy_physics.campaign(plant, n, seed, disturbances=acting, **options)


PHYSICS = {
    "mujoco": Physics(
        tuple(mujoco_physics.LISTED),
        tuple(mujoco_physics.UNLISTED),
        ("mujoco", "numpy"),
        _in_mujoco,
        mujoco_physics.campaign,
    ),
    "numpy": Physics(tuple(disturbances.LISTED), tuple(disturbances.UNLISTED), ("numpy",), _in_numpy, _numpy_campaign),
}
