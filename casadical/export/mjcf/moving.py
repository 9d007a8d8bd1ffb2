"""MuJoCo models that move as the real arm does, from the drive parameters (`[drive]`) of a robot.

Each joint has dry friction, damping and armature; its actuator has the servo's gain, constant
torque and limit, and its `ctrl` is the command. Delay and filter of commands are contained in
damping and armature, so that there is no history to fill before the first step. Stops on both sides
replace a joint's range. Bodies have their inertias, estimated ones if unknown. A spring between
servo and link is an additional joint. A surface on which the tool came to rest is a plane, which a
ball at the measured point touches without friction. The same numbers by joint names, as JSON, are
for actuator models of other simulators (Isaac Lab, Genesis).
"""

from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.drive import Drive
from casadical.diagnosis.motion.response import response_of
from casadical.export.mjcf.equilibrium import load_mujoco
from casadical.export.mjcf.mjcf import (
    HARDEST_IMPEDANCE,
    MEASURED_SITE,
    TIME_STEP_S,
    MjcfExport,
    add_spring,
    describe,
    mjcf,
    name_joints,
    numbers,
    xml_text,
)
from casadical.measurements.logs.log import JointLog
from casadical.robot.robot import Robot

# JSON key of each drive parameter that a simulation of motion needs, by attribute of `Drive`.
REQUIRED_DRIVE_KEYS = {
    "kp": "stiffness",
    "damping": "damping",
    "friction": "friction",
    "rotor_inertia_at_joint": "armature",
}
# JSON key of each other drive parameter that is exported where it is declared, by attribute.
OPTIONAL_DRIVE_KEYS = {
    "delay": "delay_s",
    "bias": "constant_torque",
    "torque_limit": "effort_limit",
    "speed_limit": "velocity_limit",
}


def has_motion_parameters(robot: Robot) -> bool:
    """Return whether `[drive]` has all required parameters, and the robot is an open chain."""
    declared = robot.drive is not None and all(getattr(robot.drive, name) is not None for name in REQUIRED_DRIVE_KEYS)
    return declared and not robot.loops


def moving_mjcf(robot: Robot) -> MjcfExport:
    """Return a robot's MuJoCo model whose drives follow commands, and what it omits.

    It is the model of `mjcf` with servos, friction, damping, armature and inertias.

    robot : robot for which `has_motion_parameters` is true
    """
    assert robot.drive is not None
    still = mjcf(robot, named=False)
    root = ET.fromstring(still.text)
    about = ["Written by casadical. Joints follow commands (ctrl) as [drive] of the robot says."]
    if (late := float(_each(robot.drive, "delay", robot).max())) > 0:
        about.append(f"Damping and armature contain the delay of commands (up to {1e3 * late:.3g} ms).")
    describe(root, about, still.written, (*still.left_out, *_unrepresented_drive_properties(robot)))
    for compiler in root.iter("compiler"):
        compiler.set("balanceinertia", "true")
    bodies = {str(body.get("name")): body for body in root.iter("body")}
    names = ("kp", "damping", "rotor_inertia_at_joint", "delay", "command_filter")
    kp, damping, armature, delay, within = (_each(robot.drive, name, robot) for name in names)
    # A delay d and a filter of time constant T multiply J s^2 + b s + kp, the denominator of the
    # response, by e^(s d) (1 + s T), whose product is expanded up to s^2.
    first, second = delay + within, delay**2 / 2 + delay * within
    damping, armature = damping + kp * first, armature + damping * first + kp * second
    friction = _each(robot.drive, "friction", robot)
    moved = ("armature", armature), ("damping", damping), ("frictionloss", friction)
    given = (robot.drive.of_joints(name, robot.n) for name in ("lower_stop", "upper_stop"))
    stops = [angles for angles in given if angles is not None]
    for i, row in enumerate(robot.joints, 1):
        body = bodies[f"link{i}"]
        joint = next(node for node in body.iter("joint") if node.get("name") == f"joint{i}")
        for attribute, values in moved:
            joint.set(attribute, numbers(float(values[i - 1])))
        if len(stops) == 2:
            joint.set("range", numbers(*(float(end[i - 1]) for end in stops)))
        if row.compliance:
            add_spring(body, f"joint{i}_spring", "0 0 1", 1 / row.compliance)
    for body in root.iter("body"):
        name = str(body.get("name"))
        if name.startswith("link") and name[4:].isdigit() and (own := robot.joints[int(name[4:]) - 1].body):
            inertial = body.find("inertial")
            pieces = any(str(node.get("name")).startswith(f"{name}_piece") for node in body)
            if inertial is not None and not pieces and own.mass > 0:
                inertia = own.likely_inertia
                inertial.attrib.pop("diaginertia", None)
                inertial.set("fullinertia", numbers(*np.diag(inertia), *inertia[np.triu_indices(3, 1)]))
    _set_floor(root, robot.drive.floor)
    (actuators,) = root.iter("actuator")
    for i in robot.numbers:
        place = next(k for k, node in enumerate(actuators) if node.get("name") == f"drive{i}")
        actuators[place] = _actuator(robot, robot.drive, i)
    name_joints(root, robot)
    return MjcfExport(
        xml_text(root), still.written, still.omitted, (*still.notes, *_unrepresented_drive_properties(robot))
    )


def _set_floor(root: ET.Element, height: float | None) -> None:
    """Add the plane perpendicular to gravity that a ball at the measured point touches.

    root : root element of the model
    height : height of the measured point in contact above the origin of the measuring frame, along
        the vertical [m]; None: there is no plane, nor without gravity
    """
    world, (option,) = root.find("worldbody"), root.iter("option")
    gravity = np.array([float(word) for word in str(option.get("gravity")).split()])
    if height is None or world is None or not gravity.any():
        return
    up = -gravity / np.linalg.norm(gravity)
    alone = {"contype": "0", "conaffinity": "0"}
    ball_radius_m = 0.005
    place = {"pos": numbers(*((height - ball_radius_m) * up)), "zaxis": numbers(*up), "size": "0 0 0.01"}
    ET.SubElement(world, "geom", {"name": "floor", "type": "plane", **place, **alone})
    last, site = next(
        (body, node) for body in root.iter("body") for node in body.findall("site") if node.get("name") == MEASURED_SITE
    )
    ball = {"name": "ball", "type": "sphere", "pos": str(site.get("pos")), "size": numbers(ball_radius_m), "mass": "0"}
    ET.SubElement(last, "geom", {**ball, **alone})
    pair = {"geom1": "floor", "geom2": "ball", "condim": "1", **HARDEST_IMPEDANCE}
    ET.SubElement(ET.SubElement(root, "contact"), "pair", pair)


def _actuator(robot: Robot, drive: Drive, i: int) -> ET.Element:
    """Return the MJCF actuator of joint i, from 1: force = kp (ctrl - q) - bias, limited if declared."""
    row, names = robot.joints[i - 1], ("kp", "bias", "torque_limit")
    kp, bias, limit = (float(_each(drive, name, robot)[i - 1]) for name in names)
    servo = ET.Element("general", name=f"drive{i}", joint=f"joint{i}", biastype="affine", gainprm=numbers(kp))
    servo.set("biasprm", numbers(-bias, -kp, 0))
    servo.set("ctrlrange", numbers(row.lower, row.upper))
    if limit:
        servo.set("forcerange", numbers(-limit, limit))
    return servo


def driven(text: str, log: JointLog) -> Array:
    """Return a MuJoCo model's joint positions under a log's commands, (rows, joints) [rad or m].

    Each run starts at rest at its first logged positions; no later ones are used.

    text : model of `moving_mjcf`; Raises InputError: MuJoCo is not installed.
    """
    mujoco = load_mujoco()
    from mujoco.rollout import rollout

    model, out = mujoco.MjModel.from_xml_string(text), []
    data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    places = model.jnt_qposadr[model.actuator_trnid[:, 0]]
    for run in log.runs():
        assert run.command is not None
        mujoco.mj_resetData(model, data)
        data.qpos[places] = run.position[0]
        start, t = np.empty(mujoco.mj_stateSize(model, kind)), run.time - run.time[0]
        mujoco.mj_getState(model, data, start, kind)
        steps = TIME_STEP_S * np.arange(1 + int(np.ceil(t[-1] / TIME_STEP_S)))
        command = np.column_stack([np.interp(steps, t, column) for column in run.command.T])
        states, _ = rollout(model, data, start[None], command[None, :-1])
        q = np.concatenate([run.position[:1], states[0][:, 1 + places]])  # a state starts with its time
        out.append(np.column_stack([np.interp(t, steps, column) for column in q.T]))
    return np.concatenate(out)


def replay_in_words(robot: Robot, text: str, log: JointLog | None = None) -> str:
    """Return a sentence on the rms errors of a model in MuJoCo, and of casadical's replay.

    Without MuJoCo the sentence says that there is no replay.

    text : model of `moving_mjcf`; log : whose commands the model follows; None: sines of 8 s, where
        the replays are compared with each other
    """
    middle, time = np.mean(robot.limits, axis=0), np.arange(0.0, 8.0, 0.02)
    size = np.minimum(0.1 * np.ptp(robot.limits, axis=0), 0.3)
    sines = middle + size * np.sin(time[:, None] * (2 + 0.3 * np.arange(robot.n)))
    run = log or JointLog(time, tuple(f"joint{i}" for i in robot.numbers), sines, sines)
    try:
        moved = driven(text, run)
    except InputError as error:
        return f"not replayed in MuJoCo: {error}"
    own, unit = response_of(robot).predicted(run), "mrad" if all(robot.revolute) else "mrad or mm"

    def rms(error: Array) -> str:
        """Return the rms of errors, NaN excluded, as text in thousandths of their unit."""
        return f"{1e3 * float(np.sqrt(np.nanmean(error**2))):.3g}"

    if log is None:
        return f"replay of 8 s of sines in MuJoCo: {rms(moved - own)} {unit} rms from casadical's own replay"
    assert log.command is not None
    before, after, same = (rms(log.position - angles) for angles in (log.command, moved, own))
    return (
        f"replay of {log.source} in MuJoCo alone: {before} {unit} rms before, {after} with this model "
        f"(casadical's own replay: {same})"
    )


def _each(drive: Drive, name: str, robot: Robot) -> Any:
    """Return a drive parameter of every joint, shape (n,) [SI]; zeros where it is not declared.

    name : attribute of `Drive`
    """
    value = drive.of_joints(name, robot.n)
    return np.zeros(robot.n) if value is None else value


def _unrepresented_drive_properties(robot: Robot) -> Iterator[str]:
    """Yield sentences on drive properties that MuJoCo's joints and actuators cannot represent."""
    drive = robot.drive
    assert drive is not None
    if drive.ki is not None:
        lag = 1e3 * float(np.max(robot.torque_scale / _each(drive, "kp", robot)))
        yield f"integral gain: at rest the model droops by up to {lag:.3g} mrad where the servo would not"
    if drive.joint_stiffness is not None:
        give = 1e3 * float(np.max(robot.torque_scale / _each(drive, "joint_stiffness", robot)))
        yield f"gear springs behind the motor's encoder: up to {give:.3g} mrad under gravity"
    if drive.speed_limit is not None:
        yield f"speed limit of {float(np.min(_each(drive, 'speed_limit', robot))):.3g} rad/s: joints may move faster"
    if drive.read_skew is not None:
        yield "readings of joints one after another: all are of one time here"


def omitted_drive_parameters(robot: Robot) -> tuple[str, ...]:
    """Return a tuple of one sentence on drive parameters that a URDF omits.

    It states the largest droop under gravity [mrad], the largest delay [ms] and the floor, if any.
    The tuple is empty unless `has_motion_parameters`.
    """
    if robot.drive is None or not has_motion_parameters(robot):
        return ()
    droop = 1e3 * float(np.max(robot.torque_scale / _each(robot.drive, "kp", robot)))
    delay_ms = 1e3 * float(np.max(_each(robot.drive, "delay", robot)))
    floor = "" if robot.drive.floor is None else f"; a surface where the tool is {1e3 * robot.drive.floor:.4g} mm high"
    lost = f"droop up to {droop:.3g} mrad under gravity, {delay_ms:.3g} ms{floor}"
    return (f"gains, armature and delay of the drives: {lost}",)


def actuators_of(robot: Robot) -> dict[str, Any]:
    """Return the drive parameters for other simulators: JSON key, then joint name, to number [SI].

    The keys are those of `REQUIRED_DRIVE_KEYS` and `OPTIONAL_DRIVE_KEYS`, and "robot" (its name).
    `stiffness` and `damping` are those of a PD law with zero target speed, stiffness (command - q)
    - damping q'.

    Raises InputError: the robot has no drive parameters, or a closed loop.
    """
    if robot.drive is None or not has_motion_parameters(robot):
        lacking = [name for name in REQUIRED_DRIVE_KEYS if robot.drive is None or getattr(robot.drive, name) is None]
        raise InputError(
            f"{robot.name}: its [drive] does not say how the joints follow their commands "
            f"(lacking: {', '.join(lacking) or 'an open chain'}); casadical diagnose ROBOT LOG "
            "--out DIR finds it from joint logs"
        )
    names = [row.name or f"joint{i}" for i, row in enumerate(robot.joints, 1)]
    given = {
        word: robot.drive.of_joints(name, robot.n)
        for name, word in {**REQUIRED_DRIVE_KEYS, **OPTIONAL_DRIVE_KEYS}.items()
    }
    columns = {word: [float(v) for v in values] for word, values in given.items() if values is not None}
    return {"robot": robot.name, **{word: dict(zip(names, v, strict=True)) for word, v in columns.items()}}
