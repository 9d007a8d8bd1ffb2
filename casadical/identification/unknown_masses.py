"""A robot whose masses nobody knows: loads through the known geometry, free in the fit.

Compliances are fitted to the torques of estimated masses (`core.estimated_masses`), and what the estimates may be off
by is fitted with them: mass and mass centre of every link, of a logged payload its mass centre. Gravity then deflects
each joint as it does (see `gravity`), while its stiffness stays unknown: twice the masses at twice the stiffness is the
same robot.
"""

from collections.abc import Sequence

from casadical.core.estimated_masses import with_estimated_masses, with_payload, without_masses
from casadical.effects import LinkMasses, PayloadError
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot


def with_unknown_masses(robot: Robot, sets: Sequence[Measurements]) -> tuple[Robot, tuple[str, ...]]:
    """The robot with all that is unknown of its masses in the model, and the labels of the effects to be free.

    As it is, and no labels, where its masses are declared, no joint gives, or an earlier fit has found them.
    """
    if all(j.compliance is None for j in robot.joints):
        return robot, ()
    if without_masses(robot):
        robot = with_estimated_masses(robot)
    if robot.masses != "estimated" or any(isinstance(e, LinkMasses) for e in robot.effects):
        return robot, ()
    effects = [*LinkMasses.candidates(robot)]
    logged = [m.conditions["payload_kg"] for m in sets if "payload_kg" in m.conditions]
    if robot.payload is None and (mass := max((float(kg.max()) for kg in logged), default=0.0)) > 0:
        robot = with_payload(robot, mass)
        effects += PayloadError.candidates(robot)
    return robot.with_effect(*effects), tuple(e.label for e in effects)
