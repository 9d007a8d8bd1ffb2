"""Hidden causes in the structure: bending, growing or loose links; wrong payloads."""

from dataclasses import replace

import numpy as np

from casadical.blind_check.mujoco_physics import cause
from casadical.blind_check.mujoco_physics.cause import Vector, acts, length_of, stretched_moments, triple
from casadical.blind_check.mujoco_physics.equilibrium import Setting
from casadical.blind_check.mujoco_physics.mechanism import (
    SPRING_TIME_CONSTANT_S,
    Body,
    Mechanism,
    X,
    Y,
    spring,
    springs,
)
from casadical.blind_check.mujoco_physics.plant import Array, Plant, slide
from casadical.blind_check.mujoco_physics.stops import Stops


@acts("built")
def link_flexure(mechanism: Mechanism, plant: Plant, *, link: int, size: float, torsion: float) -> Mechanism:
    """Return the mechanism with a link that bends and twists like a beam.

    The link is cut at a quarter and at three quarters of its length, with three hinges on springs
    each.

    link : number of the link, from 1
    size : slope of its end [rad] by the moment there if all beyond were stretched out horizontally
    torsion : ratio of torsional to bending stiffness
    """
    name = f"link{link}"
    whole, length = mechanism.body(name), length_of(plant, link)
    e, across, aside = cause.beam_axes(length)
    bend = 2 * stretched_moments(plant, link)[0] / size
    hinges = [("up", across, bend), ("side", aside, bend), ("twist", e, torsion * bend)]
    for cut, at in (("b", 0.75), ("a", 0.25)):
        joints = tuple(spring(f"{name}{cut}_{n}", k, axis=triple(axis)) for n, axis, k in hinges)
        part = Body(f"{name}{cut}", name, slide(at * length), joints)
        if cut == "a":  # the middle piece carries the link's weight
            part = replace(part, mass=whole.mass, com=triple(np.array(whole.com) - at * length))
        mechanism = mechanism.with_body_after(name, part)
    return mechanism.with_body(replace(mechanism.body(name), mass=0.0))


@acts("built")
def base_compliance(mechanism: Mechanism, plant: Plant, *, size: float, across: float, height_m: float) -> Mechanism:
    """Return the mechanism with a pedestal on compliant anchors: it tilts and sinks.

    size : tilt about x by the moment of the arm stretched out horizontally [rad]
    across : ratio of the tilt about y by the same moment to that about x
    height_m : distance of the two axes below the base [m]
    """
    k, at = stretched_moments(plant, 0)[1] / size, (0.0, 0.0, -height_m)
    width = 0.15 * float(np.linalg.norm(np.diff(plant.stations, axis=0), axis=-1).sum())
    joints = (
        spring("anchors_x", k, axis=X, at=at),
        spring("anchors_y", k / across, axis=Y, at=at),
        spring("anchors_z", 2 * k / width**2, kind="slide"),
    )
    return mechanism.with_body_after("pedestal", Body("column", "pedestal", np.eye(4), joints))


@acts("settings")
def axis_wobble(
    plant: Plant, stops: Stops, *, joint: int, size: float, shift_m: float, cycles: int, phase: float
) -> list[Setting]:
    """Return the settings, at each stop, of a joint whose axis wobbles as it turns.

    Its ring rests on three pads; the ring's track has waves, which raise it at two of them.

    joint : number of the joint, from 1
    size : tilt of the ring, about, with one pad on a crest [rad]
    shift_m : largest displacement across the axis [m]
    cycles : waves per turn of the joint; phase : their phase at zero reading [rad]
    """
    pads = np.array([0.0, 2.0, 4.2])
    track = cycles * (cause.link_angles(plant, stops.q)[:, [joint - 1]] - pads) + phase
    height = np.cos(track) * np.array([1.0, 1.0, 0.0])
    plane = height @ np.linalg.inv(np.column_stack([np.cos(pads), np.sin(pads), np.ones(3)])).T
    tilt = size * np.column_stack([plane[:, 1], -plane[:, 0], np.zeros(len(stops))])
    shift = shift_m * np.column_stack([height[:, 0], height[:, 1], np.zeros(len(stops))])
    before = np.eye(3) if joint == 1 else plant.home[joint - 2, :3, :3]
    R, link = before.T @ plant.home[joint - 1, :3, :3], f"link{joint}"
    return [Setting("turn", link, tilt @ R.T), Setting("shift", link, shift @ R.T)]


@acts("settings")
def thermal_growth(plant: Plant, stops: Stops, *, size: float, lag_minutes: float) -> list[Setting]:
    """Return the settings, at each stop, of links that lengthen with their temperature.

    The cores of the first links are the last to become warm; the tool stays cooler.

    size : coefficient of thermal expansion [1/K]
    lag_minutes : time constant of the lag of link 3 behind the surface [min]
    """
    n = plant.n

    def longer(warmth: Array, length: Array) -> Array:
        """Return the elongation at each stop, (n, 3) [m], of a length (3,) [m] that warms [K]."""
        return np.outer(size * warmth, length)

    warm = [cause.warmth_inside(stops, lag_minutes * max(1.6 - 0.2 * i, 0.2)) for i in range(n + 1)]
    settings = [Setting("shift", "link1", longer(warm[0], plant.home[0, :3, 3]))]
    settings += [Setting("shift", f"link{i + 1}", longer(warm[i], length_of(plant, i))) for i in range(1, n)]
    settings.append(Setting("mark", "reflector", longer(0.3 * warm[n], plant.reflector)))
    if plant.four_bar is not None:
        bar, angle = plant.four_bar, plant.four_bar.crank_zero_rad
        end = bar.crank_m * np.array([np.cos(angle), np.sin(angle), 0.0])
        rocker = bar.rocker_m * np.array([np.cos(bar.passive_offset_rad), -np.sin(bar.passive_offset_rad), 0.0])
        d = bar.driven
        rocker = plant.home[d - 1, :3, :3].T @ plant.home[d - 2, :3, :3] @ rocker
        settings += [
            Setting("shift", "crank", longer(warm[d - 2], length_of(plant, d - 2))),
            Setting("shift", "coupler", longer(warm[d - 1], end)),
            Setting("mark", "coupler_end", longer(warm[d - 1], np.array([bar.coupler_m, 0.0, 0.0]))),
            Setting("mark", "rocker_end", longer(warm[d], rocker)),
        ]
    return settings


@acts("built")
def payload_error(mechanism: Mechanism, plant: Plant, *, size: float, shift_m: Vector) -> Mechanism:
    """Return the mechanism with a payload that is not as declared.

    size : relative error of its mass; shift_m : displacement of its mass centre in the frame of the
        last link, shape (3,) [m]
    """
    body = mechanism.body("payload")
    shifted = replace(body, place=slide(np.array(shift_m)) @ body.place)
    return replace(mechanism.with_body(shifted), payload_factor=mechanism.payload_factor * (1 + size))


@acts("settings")
def thermal_bend(plant: Plant, stops: Stops, *, size: float, towards: float, lag_minutes: float) -> list[Setting]:
    """Return the settings, at each stop, of a column that is warmed from one side; not listed.

    It leans by the temperature difference between its surface and its core.

    size : lean per temperature difference [rad/K]
    towards : direction of the axis about which it leans, in the base's xy plane [rad]
    lag_minutes : time constant of the core's lag [min]
    """
    lean = np.array([np.cos(towards), np.sin(towards), 0.0])
    difference = stops.warmth_K - cause.warmth_inside(stops, lag_minutes)
    turn = np.outer(size * difference, lean) @ plant.home[0, :3, :3]
    sideways = np.cross(turn, length_of(plant, 1)) / 2
    bar = plant.four_bar
    links = ("link2", "crank") if bar is not None and bar.driven == 3 else ("link2",)
    return [Setting("turn", link, turn) for link in links] + [Setting("shift", link, sideways) for link in links]


@acts("built")
def bearing_play(mechanism: Mechanism, plant: Plant, *, joint: int, size: float) -> Mechanism:
    """Return the mechanism with a worn bearing of a joint; not a listed effect.

    Its ring drops across its axis, between hard stops.

    joint : number of the joint, from 1; size : largest displacement along x and along y [m]
    """
    weight = plant.weight * (plant.mass[joint - 1 :].sum() + plant.payload_kg)
    k = 0.1 * weight / size
    slides = springs(f"worn{joint}", k, size, "xy", kind="slide")
    own = next(j for j in mechanism.body(f"link{joint}").joints if j.name in (f"joint{joint}", "elbow"))
    return mechanism.with_joints(own.name, *slides, own)


@acts("built")
def cracked_link(mechanism: Mechanism, plant: Plant, *, link: int, size: float, towards: float) -> Mechanism:
    """Return the mechanism with a link that has a crack; not a listed effect.

    The crack opens under load from one side and closes under load from the other.

    link : number of the link, from 1
    size : angle by which it opens if all beyond were stretched out horizontally [rad]
    towards : direction of its axis around the link [rad]
    """
    length = length_of(plant, link)
    _, across, aside = cause.beam_axes(length)
    axis = np.cos(towards) * across + np.sin(towards) * aside
    hinge = spring("crack", stretched_moments(plant, link)[1] / size, axis=triple(axis), limits=(0.0, 20 * size))
    return mechanism.with_body_after(f"link{link}", Body("beyond_crack", "", slide(0.3 * length), (hinge,)))


@acts("built")
def loose_anchor(mechanism: Mechanism, plant: Plant, *, size: float, towards: float) -> Mechanism:
    """Return the mechanism with a pedestal of which one anchor is loose; not a listed effect.

    It tips about the line of the other anchors, between hard stops.

    size : largest angle to either side [rad]
    towards : direction of that line in the base's xy plane [rad]
    """
    moment = 0.3 * stretched_moments(plant, 0)[1]
    axis = (float(np.cos(towards)), float(np.sin(towards)), 0.0)
    tip = spring("tip", 0.2 * moment / size, axis=axis, limits=(-size, size))
    return mechanism.with_body_after("pedestal", Body("tipping", "", np.eye(4), (tip,)))


@acts("built")
def loose_flange(mechanism: Mechanism, plant: Plant, *, size: float) -> Mechanism:
    """Return the mechanism with loose bolts of the flange; not a listed effect.

    The payload tips the tool about the flange's x and y axes, between hard stops.

    size : largest angle about each axis [rad]
    """
    moment = plant.weight * plant.payload_kg * float(np.linalg.norm(plant.payload_com))
    hinges = springs("flange", 0.3 * moment / size, size, "xy")
    return mechanism.with_body(replace(mechanism.body("tool"), joints=hinges))


@acts("built")
def tool_slip(mechanism: Mechanism, plant: Plant, *, size: float, grip: float) -> Mechanism:
    """Return the mechanism with a tool plate that slips on the flange; not a listed effect.

    It slips within its bolt holes once its weight overcomes the friction, and stays there until it
    slips again.

    size : largest displacement along x and along y [m]
    grip : friction divided by the payload's weight
    """
    weight = plant.weight * plant.payload_kg
    k = weight / size
    heavy = 10 * k * SPRING_TIME_CONSTANT_S**2  # for what sticks in the engine creeps the less
    sticking = {"friction": grip * weight, "inertia": heavy, "damping": k * SPRING_TIME_CONSTANT_S, "keeps": True}
    slides = springs("plate", 0.0, size, "xy", kind="slide", **sticking)
    return replace(mechanism.with_body(replace(mechanism.body("tool"), joints=slides)), travels=True)


@acts("built")
def loose_cargo(mechanism: Mechanism, plant: Plant, *, size: float) -> Mechanism:
    """Return the mechanism with a payload that is loose in its crate; not a listed effect.

    It slides against the lowest walls, where springs to the middle take a tenth of its weight. The
    largest displacement is `size` times the stiffness of joint 5 (of the last one, if there are
    fewer) over the payload's weight.

    size : deflection of that joint by the largest displacement [rad]
    """
    weight = plant.weight * plant.payload_kg
    way = size * float(plant.stiffness[min(4, plant.n - 1)]) / weight
    pad = 0.1 * weight / way
    slides = springs("cargo", pad, way, "xyz", inertia_of=3 * pad, kind="slide")
    return mechanism.with_body(replace(mechanism.body("payload"), joints=slides))
