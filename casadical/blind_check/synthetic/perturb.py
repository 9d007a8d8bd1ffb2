"""A real robot departs from its drawing: small errors of every kind in every link, its place and its reflector."""

from dataclasses import replace

import numpy as np

from casadical.blind_check.synthetic.plant import Plant
from casadical.blind_check.synthetic.rigid import Array, motion


def perturb(
    plant: Plant,
    seed: int,
    *,
    length_mm: float = 0.3,
    angle_mrad: float = 0.3,
    base: tuple[float, float] = (0.03, 2.0),
    tool_mm: float = 1.0,
    stiffness_spread: float = 0.4,
) -> Plant:
    """The robot with generic errors: all six of every link, not only those that DH rows name.

    Parameters
    ----------
    plant : Plant
        the nominal robot
    seed : int
        everything drawn follows from it
    length_mm : float, default 0.3
        one sigma of each coordinate of a link's error, of the bars and the crank too [mm]
    angle_mrad : float, default 0.3
        one sigma of each angle of a link's error [mrad]
    base : tuple[float, float], optional
        greatest shift [m] and turn [deg] of the robot's base against the measuring frame
    tool_mm : float, default 1.0
        one sigma of each coordinate of the reflector's error [mm]
    stiffness_spread : float, default 0.4
        standard deviation of the logarithm of the joint stiffnesses

    Returns
    -------
    Plant
        the robot as built

    Examples
    --------
    >>> from casadical.blind_check.numpy_physics import HH800, Plant, perturb
    >>> perturb(Plant.from_dict(HH800), seed=1).name
    'hh800'
    """
    links, bars, place, tool, spring = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5))
    wrong = motion(links.normal(0, angle_mrad * 1e-3, (6, 3)), links.normal(0, length_mm * 1e-3, (6, 3)), np.zeros(3))
    bar = plant.four_bar
    if bar is not None:
        crank, coupler, zero = bars.normal(0, [length_mm, length_mm, angle_mrad]) * 1e-3
        bar = replace(
            bar,
            crank_m=bar.crank_m + crank,
            coupler_m=bar.coupler_m + coupler,
            crank_zero_rad=bar.crank_zero_rad + zero,
        )
    return replace(
        plant,
        home=_home(plant, wrong),
        base=plant.base @ motion(np.deg2rad(base[1]) * _in_ball(place), base[0] * _in_ball(place), np.zeros(3)),
        reflector=plant.reflector + tool.normal(0, tool_mm * 1e-3, 3),
        stiffness=plant.stiffness * np.exp(spring.normal(0, stiffness_spread, 6)),
        four_bar=bar,
    )


def _home(plant: Plant, wrong: Array) -> Array:
    """Frames at zero readings when each link ends in a frame that is ``wrong`` (6, 4, 4) in its own axes."""
    before, frame, frames = np.eye(4), np.eye(4), []
    for nominal, error in zip(plant.home, wrong, strict=True):
        frame = frame @ np.linalg.solve(before, nominal) @ error
        before = nominal
        frames.append(frame)
    return np.array(frames)


def _in_ball(rng: np.random.Generator) -> Array:
    """A point drawn evenly from the unit ball."""
    direction = rng.standard_normal(3)
    drawn: Array = direction / np.linalg.norm(direction) * rng.random() ** (1 / 3)
    return drawn
