"""The mechanism of a six-axis robot as built: links on springs, a four-bar of real bodies, the payload as a body."""

from dataclasses import replace
from typing import Any

import numpy as np

from casadical.blind_check.mujoco_physics.mechanism import Body, Joint, Loop, Mechanism, X, Y, Z
from casadical.blind_check.synthetic.fourbar import close_loop, pivot
from casadical.blind_check.synthetic.plant import Plant
from casadical.blind_check.synthetic.rigid import Array, turn

SLOW = 0.1  # s: every spring joint alone would come to rest with this time constant
NONE = np.zeros(3)
AXES = {"x": X, "y": Y, "z": Z}


def mechanism(plant: Plant) -> Mechanism:
    """Bodies ``pedestal``, ``link1`` to ``link6``, ``tool``, ``payload``; joints ``joint1`` to ``joint6``.

    A four-bar adds the bodies ``crank`` (turned by ``joint3`` on the axis of joint 2) and ``coupler``, and the free
    hinge ``elbow`` between links 2 and 3; the coupler ends in a ball joint on link 3. It is drawn in the middle of the
    joint ranges.

    Parameters
    ----------
    plant : Plant
        the robot as built

    Returns
    -------
    Mechanism
        its bodies and joints

    Examples
    --------
    >>> from casadical.blind_check.mujoco_physics import mechanism
    >>> len(mechanism(plant).bodies)
    9
    """
    middle = np.mean(plant.ranges, 1)
    bodies = [Body("pedestal", "world", plant.base)]
    parent, before = "pedestal", np.eye(4)
    for i in range(6):
        joint = spring(f"joint{i + 1}", plant.stiffness[i], motor=i + 1, ref=float(middle[i]))
        if i == 2 and plant.four_bar is not None:
            joint = free("elbow", plant.stiffness[2], ref=float(close_loop(plant, _crank(middle[None])).passive[0]))
        place = np.linalg.solve(before, plant.home[i])
        size = float(np.linalg.norm(place[:3, 3])) + 0.1
        bodies.append(
            Body(
                f"link{i + 1}",
                parent,
                _turned(place, joint.ref),
                (joint,),
                plant.mass[i],
                tuple(plant.com[i]),
                0.3 * size,
            )
        )
        parent, before = f"link{i + 1}", plant.home[i]
    bodies.append(Body("tool", "link6", np.eye(4), marks={"reflector": plant.reflector}))
    held = np.eye(4)
    held[:3, 3] = plant.payload_com
    bodies.append(Body("payload", "tool", held, mass=plant.payload_kg))
    plain = Mechanism(tuple(bodies))
    return plain if plant.four_bar is None else _with_four_bar(plain, plant, middle)


def start(plant: Plant, angles: Array) -> dict[str, float]:
    """Where to start to look for the rest at the motor angles (6,) [rad]: coordinates of all joints but the small."""
    first = {f"joint{i + 1}": float(angles[i]) for i in range(6)}
    if plant.four_bar is not None:
        loop = close_loop(plant, _crank(angles[None]))
        first |= {"elbow": float(loop.passive[0]), "coupler_turn": _coupler(plant, angles), "coupler_tilt": 0.0}
    return first


def spring(name: str, stiffness: float, *, inertia_of: float | None = None, **more: object) -> Joint:
    """A joint on a spring, with the inertia and damping that let it come to rest in ``SLOW``, whatever its stiffness.

    A spring that hardens takes the inertia of one of the stiffness ``inertia_of``, between its softest and its hardest.
    Inertia and damping do not change the equilibrium.
    """
    k = float(stiffness if inertia_of is None else inertia_of)
    joint = Joint(name, stiffness=float(stiffness), inertia=k * SLOW**2, damping=2 * k * SLOW)
    return replace(joint, **more)  # type: ignore[arg-type]


def springs(name: str, stiffness: float, limit: float, axes: str, **more: Any) -> tuple[Joint, ...]:
    """A joint on a spring for each of the axes ("xy", say), within +-limit [rad or m]; more : as of `spring`."""
    limits = (-limit, limit)
    return tuple(spring(f"{name}_{c}", stiffness, axis=AXES[c], limits=limits, **more) for c in axes)


def free(name: str, like: float, **more: object) -> Joint:
    """A joint without a spring among springs of the stiffness ``like``."""
    return replace(Joint(name, inertia=0.1 * float(like) * SLOW**2), **more)  # type: ignore[arg-type]


def _with_four_bar(plain: Mechanism, plant: Plant, middle: Array) -> Mechanism:
    bar, k = plant.four_bar, plant.stiffness[2]
    assert bar is not None
    axis2 = np.linalg.solve(plant.home[0], plant.home[1])
    crank = spring("joint3", k, motor=3, ref=float(middle[2]))
    end = bar.crank_m * np.array([np.cos(bar.crank_zero_rad), np.sin(bar.crank_zero_rad), 0.0])
    hinge, tilt = free("coupler_turn", k, ref=_coupler(plant, middle)), free("coupler_tilt", k, axis=(0.0, 1.0, 0.0))
    coupler = np.eye(4)
    coupler[:3, 3] = end
    bodies = (
        Body("crank", "link1", _turned(axis2, crank.ref), (crank,), mass=1e-3),
        Body(
            "coupler",
            "crank",
            _turned(coupler, hinge.ref),
            (hinge, tilt),
            mass=1e-3,
            marks={"coupler_end": np.array([bar.coupler_m, 0.0, 0.0])},
        ),
    )
    link = plain.body("link3")
    direction = np.array([np.cos(bar.passive_offset_rad), -np.sin(bar.passive_offset_rad)])
    end_home = plant.at_home(2, np.append(pivot(plant) + bar.rocker_m * direction, 0.0))
    mark = plant.home[2, :3, :3].T @ (end_home - plant.home[2, :3, 3])
    plain = plain.with_body(replace(link, marks={"rocker_end": mark}))
    return replace(plain, bodies=plain.bodies + bodies, loops=(Loop("four_bar", "coupler_end", "rocker_end"),))


def _crank(angles: Array) -> Array:
    crank: Array = angles[:, 2] - angles[:, 1]
    return crank


def _coupler(plant: Plant, angles: Array) -> float:
    """Angle [rad] of the coupler in the crank."""
    loop = close_loop(plant, _crank(angles[None]))
    x, y = (loop.coupler_end - loop.crank_end)[0]
    return float((np.arctan2(y, x) + angles[1] - angles[2] + np.pi) % (2 * np.pi) - np.pi)


def _turned(place: Array, angle: float) -> Array:
    turned: Array = place @ turn(np.array([0.0, 0.0, 1.0]), NONE, np.array(angle))
    return turned
