"""A robot as built: where its axes, masses and reflector are when every reading is zero.

The nominal robot comes from a plain mapping (modified DH rows, masses, stiffness, an optional four-bar); from there on
there are no DH parameters, only frames at zero readings and the axes about which the bodies turn.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from casadical.blind_check.synthetic.rigid import Array, motion
from casadical.core.errors import InputError

_X, _Z, _0 = np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.zeros(3)
_KEYS = ("name", "modified_dh", "tool_m", "mass_kg", "com_m", "payload", "stiffness_Nm_per_rad", "joint_range_deg")


@dataclass(frozen=True)
class FourBar:
    """A planar loop that drives joint 3: ground bar = link 2, crank on the axis of joint 2, coupler, rocker on link 3.

    Parameters
    ----------
    crank_m, coupler_m, rocker_m : float
        length [m]
    crank_zero_rad : float, default 0.0
        added to the reading of joint 3 [rad]
    passive_offset_rad : float, optional
        added to the rocker's direction in link 2, which gives the passive angle of link 3 [rad]

    Examples
    --------
    >>> from casadical.blind_check.numpy_physics import FourBar
    >>> FourBar(crank_m=0.4, coupler_m=1.2, rocker_m=0.4).crank_m
    0.4
    """

    crank_m: float
    coupler_m: float
    rocker_m: float
    crank_zero_rad: float = 0.0
    passive_offset_rad: float = -np.pi / 2


@dataclass(frozen=True)
class Plant:
    """A six-axis robot at zero readings, in SI units.

    Parameters
    ----------
    name : str
        of the robot
    home : Array, shape (6, 4, 4) [m]
        frame of every link in the robot's base at zero readings; joint i turns about its z axis
    reflector : Array, shape (3,) [m]
        in frame 6
    mass : Array, shape (6,) [kg]
        of the links
    com : Array, shape (6, 3) [m]
        mass centres in the link frames
    payload_kg : float
        declared payload [kg]
    payload_com : Array, shape (3,) [m]
        its mass centre in frame 6
    stiffness : Array, shape (6,) [N m/rad]
        of the actuated joints (joint 3: the crank, where there is a four-bar)
    ranges : Array, shape (6, 2) [rad]
        joint ranges
    base : Array, shape (4, 4) [m]
        the robot's base in the measuring frame; gravity is along its -z
    four_bar : FourBar, optional
        loop that drives joint 3; None: none
    payload_factor : float, default 1.0
        true mass of the payload over the declared one

    Examples
    --------
    >>> from casadical.blind_check.numpy_physics import HH800, Plant
    >>> plant = Plant.from_dict(HH800)
    >>> plant.at_home(6, plant.reflector).shape, plant.payload_kg
    ((3,), 300.0)
    """

    name: str
    home: Array
    reflector: Array
    mass: Array
    com: Array
    payload_kg: float
    payload_com: Array
    stiffness: Array
    ranges: Array
    base: Array
    four_bar: FourBar | None = None
    payload_factor: float = 1.0

    @classmethod
    def from_dict(cls, robot: Mapping[str, Any]) -> Self:
        """The nominal robot of a mapping.

        Parameters
        ----------
        robot : Mapping[str, Any]
            as the files of data/campaigns/robots

        Returns
        -------
        Self
            as drawn, without errors

        Raises
        ------
        InputError
            a key is missing, or a table has the wrong shape
        """
        for key in _KEYS:
            if key not in robot:
                raise InputError(f"robot: key {key!r} is missing; needed are {', '.join(_KEYS)}")
        bar = robot.get("four_bar")
        return cls(
            name=str(robot["name"]),
            home=_home_frames(robot["modified_dh"]),
            reflector=_table(robot, "tool_m", (3,)),
            mass=_table(robot, "mass_kg", (6,)),
            com=_table(robot, "com_m", (6, 3)),
            payload_kg=float(robot["payload"]["mass_kg"]),
            payload_com=np.array(robot["payload"]["com_m"], float),
            stiffness=_table(robot, "stiffness_Nm_per_rad", (6,)),
            ranges=np.deg2rad(_table(robot, "joint_range_deg", (6, 2))),
            base=np.eye(4),
            four_bar=None if bar is None else _four_bar(bar),
        )

    @property
    def axes(self) -> Array:
        """Directions of the joint axes at zero readings, shape (6, 3) [unit vectors], in the robot's base."""
        return self.home[:, :3, 2]

    @property
    def centres(self) -> Array:
        """A point on every joint axis at zero readings, shape (6, 3) [m], in the robot's base."""
        return self.home[:, :3, 3]

    def at_home(self, link: int, x: Array) -> Array:
        """Points of a link frame, in the robot's base at zero readings.

        Parameters
        ----------
        link : int
            1-based
        x : Array, shape (..., 3) [m]
            in the link's frame

        Returns
        -------
        Array, shape (..., 3) [m]
        """
        placed: Array = x @ self.home[link - 1, :3, :3].T + self.home[link - 1, :3, 3]
        return placed

    @property
    def stations(self) -> Array:
        """Base origin, the six joint centres and the reflector at zero readings, shape (8, 3) [m]: the links' ends."""
        return np.vstack([np.zeros(3), self.centres, self.at_home(6, self.reflector)])


def _home_frames(rows: Any) -> Array:
    if len(rows) != 6:
        raise InputError(f"robot: modified_dh has {len(rows)} rows; the simulator takes six-axis robots")
    T, frames = np.eye(4), []
    for row in rows:
        alpha, theta = np.deg2rad(float(row["alpha_deg"])), np.deg2rad(float(row.get("theta0_deg", 0.0)))
        T = T @ motion(alpha * _X, _0, _0) @ motion(theta * _Z, np.array([row["a_m"], 0.0, row["d_m"]], float), _0)
        frames.append(T)
    return np.array(frames)


def _four_bar(bar: Mapping[str, Any]) -> FourBar:
    return FourBar(
        crank_m=float(bar["crank_L5_m"]),
        coupler_m=float(bar["coupler_L4_m"]),
        rocker_m=float(bar["rocker_L3_m"]),
        passive_offset_rad=float(np.deg2rad(bar.get("passive_offset_deg", -90.0))),
    )


def _table(robot: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> Array:
    table = np.array(robot[key], float)
    if table.shape != shape or not np.isfinite(table).all():
        raise InputError(f"robot: {key} has shape {table.shape}; it must be finite numbers of shape {shape}")
    return table
