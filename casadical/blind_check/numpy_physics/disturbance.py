"""The base of all disturbances: the places in the machine where one may act. Each does nothing unless it is given."""

from dataclasses import dataclass

import numpy as np

from casadical.blind_check.numpy_physics.state import State
from casadical.blind_check.synthetic.plant import Plant
from casadical.blind_check.synthetic.rigid import Array
from casadical.blind_check.synthetic.stops import Stops


@dataclass(frozen=True)
class Disturbance:
    """One thing about a robot that geometry and linear joint compliance do not contain.

    A disturbance is pure: what it does follows from its own numbers and the arguments, never from a hidden state.

    Examples
    --------
    >>> from casadical.blind_check.numpy_physics import HH800, Disturbance, Plant, campaign
    >>> @dataclass(frozen=True)
    ... class LongDay(Disturbance):
    ...     def measured(self, xyz, stops, rng):
    ...         return xyz + 1e-4 * stops.progress[:, None]
    >>> plant = Plant.from_dict(HH800)
    >>> campaign(plant, 5, seed=1, disturbances=[LongDay()]).shape
    (5, 19)
    >>> nothing = Disturbance()
    >>> nothing.altered(plant) is plant, nothing.misread(None), nothing.torque(None), nothing.twist(None)
    (True, 0.0, 0.0, 0.0)
    >>> nothing.outboard(1, None), nothing.reflector(None)
    (None, 0.0)
    """

    def altered(self, plant: Plant) -> Plant:
        """The robot as it is really built.

        Parameters
        ----------
        plant : Plant
            the robot that was drawn

        Returns
        -------
        Plant
            by default the same
        """
        return plant

    def misread(self, stops: Stops) -> Array | float:
        """What the true joint angles are beyond the readings, without load.

        Parameters
        ----------
        stops : Stops
            readings and circumstances

        Returns
        -------
        Array | float
            shape (n, 6) [rad]
        """
        return 0.0

    def torque(self, state: State) -> Array | float:
        """Torques on the actuated joints beside those of the weights.

        Parameters
        ----------
        state : State
            of the robot at the stops

        Returns
        -------
        Array | float
            shape (n, 6) [N m]
        """
        return 0.0

    def twist(self, state: State) -> Array | float:
        """Twists of the joints beside torque over stiffness.

        Parameters
        ----------
        state : State
            of the robot at the stops

        Returns
        -------
        Array | float
            shape (n, 6) [rad]
        """
        return 0.0

    def outboard(self, link: int, state: State) -> Array | None:
        """Motion of all beyond a link, seen from that link at zero readings.

        Parameters
        ----------
        link : int
            0 pedestal, 6 flange
        state : State
            of the robot at the stops

        Returns
        -------
        Array | None
            shape (n, 4, 4) [m]; None: none
        """
        return None

    def reflector(self, stops: Stops) -> Array | float:
        """How far the reflector sits off its place, in frame 6.

        Parameters
        ----------
        stops : Stops
            readings and circumstances

        Returns
        -------
        Array | float
            shape (n, 3) [m]
        """
        return 0.0

    def measured(self, xyz: Array, stops: Stops, rng: np.random.Generator) -> Array:
        """What the instrument makes of positions.

        Parameters
        ----------
        xyz : Array, shape (n, 3) [m]
            positions
        stops : Stops
            readings and circumstances
        rng : np.random.Generator
            of the instrument

        Returns
        -------
        Array, shape (n, 3) [m]
        """
        return xyz
