"""Joint logs with hidden causes, made in MuJoCo, and what `casadical diagnose ARM LOG` says of them.

python docs/studies/joint_logs.py make DIR (4 minutes), run DIR (10 of CPU), score DIR. Synthetic data. Further
arguments are another seed and number of logs, and "healthy" for logs without a cause, whose evidence `score` lists by
cause (by it thresholds of the diagnosis are set): 20261124 to 20261126 and 72, 20261127 and 96 are rounds on which
rules were developed.

Written without having read the diagnosis. Two arms: the six axes of problems/ur10e, with currents, and the SO-101 of
data/so101_logs, half with torques, half with commands and readings only. Causes act in the simulation (forces, servo),
those of the clock and of lost samples on the log. `make` prints the sha256 of the key before anything is diagnosed.
"""

import copy
import hashlib
import json
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
from scipy.signal import lfilter

from casadical.project.diagnosis import read_logs

ROOT = Path(__file__).parents[2]
SEED = int(sys.argv[3]) if len(sys.argv) > 3 else 20261201
LOGS = int(sys.argv[4]) if len(sys.argv) > 4 else 240
HEALTHY = sys.argv[5:] == ["healthy"]
STEP, ROW = 0.001, 8
LISTED = [
    *("payload", "coulomb_friction", "viscous_friction", "load_friction", "transport_delay", "lag"),
    *("torque_constant", "ripple", "saturation", "spring", "contact", "zero_offset_step"),
    *("servo_stiffness", "clock_scale", "lost_samples", "warm_up"),
]
# On no list: a stick one way near one angle; a push in a fixed rhythm; drag by another joint's motion; gusts.
UNLISTED = ["one_way_stick", "periodic_push", "drag_of_other", "gusts"]
INSTRUMENT = ("clock_scale", "lost_samples")
# Of logs with a listed cause every so many have a second one, at another joint.
EVERY_SECOND = 4
# What belongs to one cause of a day.
OF_CAUSE = ("kind", "joint", "size", "at", "sign", "phase", "other", "one_sided", "cog_n", "cog_at")
GLOBAL = ("payload", "clock_scale", "lost_samples", "warm_up")
TWINS = [{"transport_delay", "lag"}, {"payload", "link_mass"}]
ARMS = {
    "ur10e": {
        "kp": [24000.0, 26000.0, 9000.0, 2400.0, 2000.0, 1600.0],
        "kd": [900.0, 1000.0, 300.0, 55.0, 48.0, 40.0],
        "rotor": [1.63, 1.63, 0.82, 0.31, 0.31, 0.31],
        "limit": [330.0, 330.0, 150.0, 54.0, 54.0, 54.0],
        "dry": [14.0, 15.0, 9.0, 3.2, 3.0, 2.6],
        "viscous": [18.0, 19.0, 10.0, 3.0, 2.7, 2.2],
        "load": 0.045,
        "bristle": 6e-4,
        "delay": 0.004,
        "lag": 0.003,
        "quantum": 1e-4,
        "per_A": [12.524, 12.524, 10.504, 9.09, 9.09, 9.09],
        "noise": [1.3, 1.5, 0.8, 0.3, 0.28, 0.25],
        "range": [[-1.5, 1.5], [-2.2, -0.7], [-1.7, 1.7], [-2.0, 0.5], [-1.8, 1.8], [-2.0, 2.0]],
        "speed": 1.5,
        "payload": (0.15, 2.5),
    },
    "so101": {
        "kp": [15.0, 11.5, 9.0, 14.0, 15.0, 15.0],
        "kd": [0.6] * 6,
        "rotor": [0.028] * 6,
        "limit": [2.6] * 6,
        "dry": [0.10, 0.13, 0.10, 0.09, 0.07, 0.06],
        "viscous": [0.05] * 6,
        "load": 0.09,
        "bristle": 6e-3,
        "delay": 0.022,
        "lag": 0.004,
        "quantum": 0.001533981,
        "per_A": [1.0] * 6,
        "noise": [0.02] * 6,
        "range": [[-1.2, 1.2], [-1.2, 0.9], [-0.9, 1.2], [-1.2, 1.2], [-1.5, 1.5], [0.0, 1.2]],
        "speed": 1.6,
        "payload": (0.02, 0.25),
    },
}
# Sizes of causes from barely visible to clear; of those that are not here (0.3, 3.0).
RANGES = {
    "coulomb_friction": (0.12, 1.5),
    "viscous_friction": (0.2, 2.5),
    "load_friction": (0.5, 5.0),
    "warm_up": (0.1, 0.8),
    "transport_delay": (0.002, 0.05),
    "lag": (0.003, 0.08),
    "torque_constant": (0.03, 0.3),
    "servo_stiffness": (0.08, 0.5),
    "ripple": (0.08, 1.2),
    "spring": (0.15, 2.0),
    "contact": (0.5, 6.0),
    "zero_offset_step": (0.003, 0.04),
    "clock_scale": (0.003, 0.05),
    "lost_samples": (0.006, 0.08),
    "saturation": (0.03, 0.45),
}
LONG = {"ur10e": [0.2, 0.62, 0.57, 0.12, 0.12, 0.08], "so101": []}


def urdf_of(arm: str) -> str:
    """What the user has: the SO-101's file without shapes; the UR10e of its robot file, links as rods."""
    if arm == "so101":
        tree = ET.parse(ROOT / "data/so101_logs/so101.urdf").getroot()
        for link in tree.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)
        return ET.tostring(tree, encoding="unicode")
    with (ROOT / "problems/ur10e/robot.toml").open("rb") as file:
        joints = tomllib.load(file)["joint"]
    text = ['<robot name="ur10e"><link name="base"/>']
    for i, joint in enumerate(joints):
        body, alpha = joint["body"], np.radians(joint.get("alpha_deg", 0.0))
        a, d, mass = joint.get("a_mm", 0.0) / 1e3, joint.get("d_mm", 0.0) / 1e3, body["mass_kg"]
        xyz = [a, -np.sin(alpha) * d, np.cos(alpha) * d]
        thin, slim = mass * 0.06**2 / 2, mass * (0.06**2 / 4 + LONG[arm][i] ** 2 / 12)
        com = " ".join(f"{x / 1e3:.6f}" for x in body["com_mm"])
        inertia = (thin, slim, slim) if i in (1, 2) else (slim, slim, slim)
        diagonal = " ".join(f'{axis}="{value:.6g}"' for axis, value in zip(("ixx", "iyy", "izz"), inertia, strict=True))
        at, parent = " ".join(f"{x:.6f}" for x in xyz), f"link_{i}" if i else "base"
        text += [
            f'<link name="link_{i + 1}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>',
            f'<inertia {diagonal} ixy="0" ixz="0" iyz="0"/></inertial></link>',
            f'<joint name="joint_{i + 1}" type="revolute"><parent link="{parent}"/><child link="link_{i + 1}"/>',
            f'<origin xyz="{at}" rpy="{alpha:.8f} 0 0"/><axis xyz="0 0 1"/>',
            '<limit lower="-6.2" upper="6.2" effort="330" velocity="3"/></joint>',
        ]
    return "\n".join([*text, "</robot>"])


def drive_of(arm: str) -> str:
    """What the user knows of the drives, as a table [drive]."""
    of = ARMS[arm]
    lines = [
        "[drive]",
        'servo = "position, P and D"',
        f"kp_Nm_per_rad = {of['kp']}",
        f"kd_Nms_per_rad = {of['kd']}",
        f"torque_limit_Nm = {of['limit']}",
        f"rotor_inertia_at_joint_kgm2 = {of['rotor']}",
        'encoder_side = "joint"',
        f"encoder_quantum_rad = {of['quantum']}",
        f"delay_s = {of['delay']}",
        f"command_filter_s = {of['lag']}",
        "log_rate_Hz = 125",
    ]
    if arm == "ur10e":
        constants = [round(k / 101, 6) for k in of["per_A"]]
        lines += ["gear_ratio = 101", f"torque_constant_Nm_per_A = {constants}", "current_quantum_A = 0.01"]
        forward = "feed-forward of the rigid bodies of this URDF along the command"
        lines[1] = f'servo = "position: kp e + kd (command_v - v), and {forward}"'
    return "\n".join(lines) + "\n"


def model_of(arm: str, *days: dict) -> mujoco.MjModel:
    """MuJoCo's model of one arm of each day, side by side, with its masses and payload; of the URDF without a day."""
    whole = mujoco.MjSpec()
    whole.option.timestep = STEP
    for k, day in enumerate(days or ({"spread": None, "payload": 0.0},)):
        one = mujoco.MjSpec.from_string(physical_urdf(arm, day["spread"], day["payload"]))
        whole.attach(one, prefix=f"{k}_", frame=whole.worldbody.add_frame())
    model = whole.compile()
    model.dof_armature[:] = np.tile(ARMS[arm]["rotor"], max(len(days), 1))
    model.jnt_limited[:] = 0
    model.dof_damping[:] = model.dof_frictionloss[:] = 0
    return model


def physical_urdf(arm: str, spread: dict | None, payload: float) -> str:
    """The URDF, masses and mass centres off by `spread`; with a payload on the last link."""
    tree = ET.fromstring(urdf_of(arm))
    options = {"fusestatic": "true", "balanceinertia": "true", "boundinertia": "1e-7", "boundmass": "1e-6"}
    ET.SubElement(ET.SubElement(tree, "mujoco"), "compiler", options)
    if payload:
        child, side = ("joint_6", "child") if arm == "ur10e" else ("gripper", "parent")
        last = next(j.find(side).get("link") for j in tree.iter("joint") if j.get("name") == child)
        link = ET.SubElement(ET.SubElement(tree, "link", name="load"), "inertial")
        ET.SubElement(link, "origin", xyz="0.01 0 0.06" if arm == "ur10e" else "0 0 -0.06")
        ET.SubElement(link, "mass", value=f"{payload}")
        small = f"{payload * 0.0009}"
        ET.SubElement(link, "inertia", ixx=small, iyy=small, izz=small, ixy="0", ixz="0", iyz="0")
        held = ET.SubElement(tree, "joint", name="holds", type="fixed")
        ET.SubElement(held, "parent", link=last)
        ET.SubElement(held, "child", link="load")
    if spread:
        heavy = [x for x in tree.iter("link") if x.find("inertial/mass") is not None]
        for link, factor, shift in zip(heavy, spread["mass"], spread["com"], strict=False):
            if link.get("name") == "load":
                continue
            mass, inertia, origin = (link.find(f"inertial/{x}") for x in ("mass", "inertia", "origin"))
            mass.set("value", f"{float(mass.get('value')) * factor}")
            for key, value in inertia.attrib.items():
                inertia.set(key, f"{float(value) * factor}")
            at = np.array(origin.get("xyz", "0 0 0").split(), float) + shift
            origin.set("xyz", " ".join(f"{x:.7f}" for x in at))
    return ET.tostring(tree, encoding="unicode")


def arm_of(arm: str, rng: np.random.Generator) -> dict:
    """One arm as it truly is."""
    of, n = ARMS[arm], 6
    scale = np.mean(LONG[arm] or 0.1)
    return {
        "spread": {"mass": np.exp(rng.normal(0, 0.04, 12)), "com": rng.normal(0, 0.01, (12, 3)) * scale},
        "dry": np.array(of["dry"]) * np.exp(rng.normal(0, 0.2, n)),
        "asymmetry": rng.normal(0, 0.03, n),
        "viscous": np.array(of["viscous"]) * np.exp(rng.normal(0, 0.2, n)),
        "load": of["load"] * np.exp(rng.normal(0, 0.25, n)),
        "static": 1 + rng.uniform(0.05, 0.3, n),
        "stribeck": rng.uniform(0.02, 0.06, n),
        "bristle": of["bristle"] * rng.uniform(0.6, 1.6, n),
        "ripple": np.array(of["dry"]) * rng.uniform(0.01, 0.05, n),
        "ripple_n": rng.choice([1.0, 2.0, 4.0, 100.0], n),
        "ripple_at": rng.uniform(0, 6.28, n),
        "kt": 1 + rng.normal(0, 0.01, n),
        "kp": np.array(of["kp"]) * (1 + rng.normal(0, 0.05 if arm == "so101" else 0.0, n)),
        "kd": np.array(of["kd"]) * 1.0,
    }


def day_of(truth: dict, arm: str, rng: np.random.Generator) -> dict:
    """The same arm on one day: frictions some 10 % otherwise, noise, warmth, motion; and no cause."""
    of, day = ARMS[arm], copy.deepcopy(truth)
    for what in ("dry", "viscous", "load"):
        day[what] = day[what] * np.exp(rng.normal(0, 0.05) + rng.normal(0, 0.07, 6))
    warm = rng.uniform(0.5, 3.0)
    day |= {"arm": arm, "warm": warm, "cold": 0.0, "cold_s": 20.0, "limit": np.array(of["limit"])}
    day |= {"payload": 0.0, "noise": rng.uniform(0.7, 1.5), "delay": of["delay"] + rng.normal(0, 0.0005, 6)}
    day |= {"lag": of["lag"] + np.zeros(6), "kind": "", "joint": 0, "size": 0.0, "at": 0.0}
    day |= {"seed": int(rng.integers(1 << 31)), "torque": True}
    return day


def motion(arm: str, seed: int) -> np.ndarray:
    """Commands of six joints at 250 Hz: (samples, 6). Three runs of 16 to 19 s, one second of rest between them."""
    rng, of = np.random.default_rng([seed, 1]), ARMS[arm]
    lengths = rng.uniform(16, 19, 3) + 1
    total = int(sum(lengths) * 250)
    low, high = np.array(of["range"]).T
    out, home = np.empty((total, 6)), rng.uniform(low, high)
    for j in range(6):
        t, q, row = 0, home[j], []
        while t < total:
            ends = np.cumsum(lengths) * 250
            left = min((e for e in ends if e > t), default=total) - t
            target = rng.uniform(low[j], high[j])
            duration = max(1.9 * abs(target - q) / (of["speed"] * rng.choice([0.25, 0.6, 1.0])), 0.5)
            n, rest = int(duration * 250), int(rng.choice([0.0, 0.1, 0.6]) * 250)
            if n + rest > left - 270:
                n, target, rest = 1, q, int(left) - 1
            s = np.linspace(0, 1, n + 1)[1:]
            row += [q + (target - q) * s**3 * (10 - 15 * s + 6 * s * s), np.full(max(rest, 0), target)]
            t, q = t + n + max(rest, 0), target
        out[:, j] = np.concatenate(row)[:total]
    return out


def ends_of(seed: int) -> np.ndarray:
    """Times (s) at which the three runs end."""
    return np.cumsum(np.random.default_rng([seed, 1]).uniform(16, 19, 3) + 1)


def shaped(command: np.ndarray, day: dict) -> np.ndarray:
    """The command as the servo has it: delayed and filtered."""
    t, out = np.arange(len(command)) / 250, np.empty_like(command)
    for j in range(6):
        u = np.interp(t - day["delay"][j], t, command[:, j])
        lag = max(day["lag"][j], 1e-4)
        keep = np.exp(-0.004 / lag)
        ahead = 1 - lag / 0.004 * (1 - keep)  # exact for a command that is linear between samples
        out[:, j] = u[0] + lfilter([ahead, 1 - keep - ahead], [1, -keep], u - u[0])
    return out


def rigid(model: mujoco.MjModel, u: np.ndarray) -> np.ndarray:
    """Torques of the rigid bodies along u, 250 Hz, shape (samples, joints of all arms)."""
    data, v = mujoco.MjData(model), np.gradient(u, 0.004, axis=0)
    a, out = np.gradient(v, 0.004, axis=0), np.empty_like(u)
    for k in range(len(u)):
        data.qpos[:], data.qvel[:], data.qacc[:] = u[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def put(day: dict, kind: str, joint: int, level: float, top: np.ndarray, rng: np.random.Generator) -> dict:
    """A day with one more cause, from barely visible (level 0) to clear (1). `top`: greatest torques (N m)."""
    d, of, j = copy.deepcopy(day), ARMS[day["arm"]], joint
    if d["kind"]:
        d["also"] = {k: d[k] for k in OF_CAUSE if k in d}
    sign = float(rng.choice([-1, 1]))
    low, high = of["payload"] if kind == "payload" else RANGES.get(kind, (0.3, 3.0))
    size = float(low * (high / low) ** level)
    at = float(rng.uniform(*np.array(of["range"])[j] * 0.6))
    d |= {"kind": kind, "joint": j, "size": size, "at": at, "sign": sign}
    if kind in ("coulomb_friction", "viscous_friction", "load_friction"):
        d[{"c": "dry", "v": "viscous", "l": "load"}[kind[0]]][j] *= 1 + size
    elif kind == "transport_delay":
        d["delay"][j] += size
    elif kind == "lag":
        d["lag"][j] += size
    elif kind == "torque_constant":
        d["kt"][j] *= 1 + sign * size
    elif kind == "servo_stiffness":
        d["kp"][j], d["kd"][j] = d["kp"][j] * (1 + sign * size), d["kd"][j] * (1 + sign * size)
    elif kind == "warm_up":
        d |= {"cold": size, "warm": 12 * size, "cold_s": float(rng.uniform(12, 40))}
    elif kind == "payload":
        d["payload"] = size
    elif kind == "saturation":
        d["limit"] = d["limit"].copy()
        d["limit"][j] = (1 - size) * top[j]
    elif kind == "ripple":
        d["cog_n"] = float(rng.choice([1, 2, 3, 6, 8, 101 if day["arm"] == "ur10e" else 20]))
        d["cog_at"] = float(rng.uniform(0, 6.28))
    elif kind in ("contact", "one_way_stick", "gusts", "periodic_push", "drag_of_other", "spring"):
        d["phase"] = float(rng.uniform(0, 1))
        d["other"] = (j + int(rng.integers(1, 5))) % 6
        d["one_sided"] = bool(rng.integers(2))
    return d


def causes_of(day: dict) -> list[dict]:
    """The causes of a day, of which most have one."""
    return [day, day["also"]] if "also" in day else [day]


def outside(days: list[dict], t: float, q: np.ndarray, v: np.ndarray, gust: np.ndarray) -> np.ndarray:
    """Torques (logs, 6) of what touches the arms: spring, hose, contact, cogging, and what is on no list."""
    out = np.zeros_like(q)
    for i, own, d in [(k, x, c) for k, x in enumerate(days) for c in causes_of(x)]:
        kind, j = d["kind"], d["joint"]
        scale = d["size"] * ARMS[own["arm"]]["dry"][j]
        x = q[i, j] - d["at"]
        if kind == "spring":
            out[i, j] -= scale * (max(x, 0.0) * 2 if d["one_sided"] else x)
        elif kind == "contact":
            start = ends_of(own["seed"])[1] - 17 + 8 * d["phase"] if "start" not in d else d["start"]
            d["start"] = start
            if start < t < start + 4:
                out[i, j] -= np.clip(60 * scale * max(d["sign"] * x, 0.0), 0, 3 * scale) * d["sign"]
        elif kind == "ripple":
            out[i, j] += scale * np.sin(d["cog_n"] * q[i, j] + d["cog_at"])
        elif kind == "one_way_stick":
            out[i, j] -= 2 * scale * d["sign"] * np.exp(-((x / 0.12) ** 2)) * np.clip(d["sign"] * v[i, j] / 0.01, 0, 1)
        elif kind == "periodic_push":
            out[i, j] += d["sign"] * scale * ((t / (1.3 + 2 * d["phase"])) % 1 < 0.15)
        elif kind == "drag_of_other":
            out[i, j] -= scale * np.tanh(v[i, d["other"]] / 0.1)
        elif kind == "gusts":
            out[i, j] += scale * gust[i]
    return out


def simulate(days: list[dict]) -> list[dict]:
    """All days of one arm at once, at 1 kHz: logged rows (time, run, command, q, v, torque) without noise."""
    arm, n = days[0]["arm"], len(days)
    model = model_of(arm, *days)
    data = mujoco.MjData(model)
    commands = [motion(arm, d["seed"]) for d in days]
    servo = [shaped(c, d) for c, d in zip(commands, days, strict=True)]
    total = max(map(len, servo))

    def hold(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x, np.repeat(x[-1:], total + 1 - len(x), 0)])

    u = np.stack([hold(x) for x in servo], 1)
    speed = np.gradient(u, 0.004, axis=0)
    forward = np.zeros_like(u)
    if arm == "ur10e":
        nominal = model_of(arm, *[{"spread": None, "payload": 0.0}] * n)
        forward = rigid(nominal, u.reshape(len(u), -1)).reshape(u.shape)
    numbers = set.intersection(*map(set, days)) - {"spread", "arm", "kind", "also"}
    p = {k: np.stack([np.broadcast_to(d[k], 6) for d in days]) for k in numbers}
    q, v, z, gust = u[0].copy(), np.zeros((n, 6)), np.zeros((n, 6)), np.zeros(n)
    load, ends = np.abs(forward[0]), np.stack([ends_of(d["seed"]) for d in days])
    rngs, rows = [np.random.default_rng([d["seed"], 2]) for d in days], np.empty((total * 4 // ROW, n, 18))
    zero = np.zeros((n, 6))
    for i, c in [(i, c) for i, d in enumerate(days) for c in causes_of(d) if c["kind"] == "zero_offset_step"]:
        zero[i, c["joint"]] += c["sign"] * c["size"]
    behind = ends[:, :1]
    for k in range(total * 4 // ROW * ROW):
        t, at, part = k * STEP, k // 4, (k % 4) / 4
        want, rate = (w[at] + (w[at + 1] - w[at]) * part for w in (u, speed))
        seen = q.copy()
        if arm == "ur10e":  # the encoder of the servo itself jumps; that of the SO-101 jumps against the host
            seen += zero * (t > behind)
        push = p["kp"] * (want - seen) + p["kd"] * (rate - v) + forward[at] + (forward[at + 1] - forward[at]) * part
        push = np.clip(push, -p["limit"], p["limit"])
        if k % ROW == 0:
            logged = seen.copy()
            if arm == "so101":
                logged += zero * (t > behind)
            rows[k // ROW] = np.concatenate([logged, v, push], 1)
        if k % 20 == 0:
            gust = 0.97 * gust + 0.24 * np.array([r.normal() for r in rngs])
        friction, z = bristles(p, t, q, v, z, load)
        torque = p["kt"] * push - friction + outside(days, t, q, v, gust)
        data.qfrc_applied[:] = torque.ravel()
        if k == 0:
            data.qpos[:] = q.ravel()
        mujoco.mj_step(model, data)
        q, v = data.qpos.reshape(n, 6).copy(), data.qvel.reshape(n, 6).copy()
        load += 0.05 * (np.abs(data.qfrc_bias.reshape(n, 6)) - load)
    return [table(rows[:, i], commands[i], ends[i]) for i in range(n)]


def bristles(
    p: dict, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, load: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Friction (N m) by LuGre with Stribeck's dip, load and warmth, and the bristles' deflections after this step."""
    cold = 1 + p["cold"] * np.exp(-t / p["cold_s"])
    slide = (p["dry"] + p["load"] * load) * cold * (1 + p["asymmetry"] * np.sign(v))
    level = slide * (1 + (p["static"] - 1) * np.exp(-((v / p["stribeck"]) ** 2)))
    stiff = p["dry"] / p["bristle"]
    new = (z + v * STEP) / (1 + STEP * stiff * np.abs(v) / level)
    warmed = 1 - 0.006 * p["warm"] * (1 - np.exp(-t / 40))
    curved = p["viscous"] * cold * warmed * v * (1 - 0.12 * np.abs(v) / (1 + np.abs(v)))
    own = p["ripple"] * np.sin(p["ripple_n"] * q + p["ripple_at"])
    return stiff * new + 0.002 * stiff * (new - z) / STEP + curved + own, new


def table(rows: np.ndarray, command: np.ndarray, ends: np.ndarray) -> dict:
    """Rows of one log, without noise: those in the pauses between runs are not logged."""
    t = np.arange(len(rows)) * STEP * ROW
    run, starts = np.searchsorted(ends, t, side="right"), np.concatenate([[0], ends])
    used = (run < 3) & (t < ends[np.minimum(run, 2)] - 0.6)
    c = np.stack([np.interp(t, np.arange(len(command)) / 250, command[:, j]) for j in range(6)], 1)
    since = (t - starts[np.minimum(run, 3)])[used]
    return {"time": since, "run": run[used] + 1, "all": t[used], "c": c[used], "x": rows[used]}


def written(day: dict, clean: dict, path: Path) -> None:
    """The log as a controller writes it: autocorrelated noise, quanta, jitter, lost rows; faults of the clock."""
    of, rng = ARMS[day["arm"]], np.random.default_rng([day["seed"], 3])
    n, x = len(clean["time"]), clean["x"]
    keep, noise = rng.uniform(0.5, 0.9), rng.normal(size=(n, 6))
    noise[0] = 0.0
    follow = lfilter([np.sqrt(1 - keep**2)], [1, -keep], noise, axis=0)
    drift = np.cumsum(rng.normal(0, 1, (n, 6)), 0) / np.sqrt(n) * 0.25
    scatter = np.array(of["noise"]) * day["noise"] * (0.8 * follow + 0.5 * rng.normal(size=(n, 6)) + drift)
    jitter = rng.normal(0, 2e-5, n)
    factor = 1 + day["sign"] * day["size"] if day["kind"] == "clock_scale" else 1.0
    out = {"time_s": (clean["time"] + jitter) * factor, "run": clean["run"]}
    for j in range(6):
        step, unit = of["quantum"], of["per_A"][j]
        out[f"command{j + 1}_rad"] = clean["c"][:, j].round(6)
        out[f"q{j + 1}_rad"] = (np.round((x[:, j] + rng.normal(0, step / 3, n)) / step) * step).round(7)
        out[f"v{j + 1}_rad_s"] = (x[:, 6 + j] + rng.normal(0, 0.002 + step * 3, n)).round(4)
        if day["arm"] == "ur10e":
            out[f"current{j + 1}_A"] = (np.round((x[:, 12 + j] + scatter[:, j]) / unit / 0.01) * 0.01).round(3)
            warmth = 25 + day["warm"] * (1 - np.exp(-clean["all"] / 40)) - 12 * day["cold"]
            out[f"temperature{j + 1}_degC"] = (np.round((warmth + rng.normal(0, 0.05, n)) * 4) / 4).round(2)
        elif day["torque"]:
            out[f"torque{j + 1}_Nm"] = (np.round((x[:, 12 + j] + scatter[:, j]) / 0.01) * 0.01).round(3)
    frame = pd.DataFrame(out)
    lost = rng.random(n) < 0.001
    if day["kind"] == "lost_samples":
        length = int(rng.integers(4, 25))
        for start in rng.integers(0, n - length, max(int(day["size"] * n / length), 1)):
            lost[start : start + length] = True
    frame[~lost].to_csv(path, index=False)


def windows(what: np.ndarray) -> np.ndarray:
    """Averages over 0.1 s."""
    n = len(what) // 12 * 12
    return what[:n].reshape(-1, 12, *what.shape[1:]).mean(1)


def visible(day: dict, log: dict, twin: dict, reference: bool) -> bool:
    """Whether an ideal observer would see the cause, from two simulations that differ in nothing else.

    In one channel of one joint (torque, position error), in windows of 0.1 s, the cause changes at least half of the
    usual noise, and an observer who knows the priors of masses, frictions (12 % from day to day with a reference,
    50 % without), gains and delay sees it at 4 sigma with 0.07 effective samples a row.
    """
    if day["kind"] == "clock_scale":
        return bool(day["size"] >= 0.005)
    if day["kind"] == "lost_samples":
        return bool(day["size"] >= 0.01)
    of, daily = ARMS[day["arm"]], 0.12 if reference else 0.5
    v, tau = windows(twin["x"][:, 6:12]), windows(twin["x"][:, 12:])
    a = np.gradient(v, 0.096, axis=0)
    for j in range(6):
        dry = np.tanh(v[:, j] / 0.03)
        low = tau[:, j] - of["dry"][j] * dry - of["viscous"][j] * v[:, j]
        rubbing = np.stack([of["dry"][j] * dry, of["viscous"][j] * v[:, j], of["load"] * np.abs(low) * dry], 1)
        moving = 0.08 * np.stack([low, (of["rotor"][j] + 0.02 * of["limit"][j] / 10) * a[:, j]], 1)
        base = np.column_stack([of["noise"][j] + 0 * dry, daily * rubbing, moving])
        change = [("e", windows(log["x"][:, j] - log["c"][:, j]) - windows(twin["x"][:, j] - twin["c"][:, j]))]
        if day["torque"]:
            change.append(("torque", windows(log["x"][:, 12 + j]) - tau[:, j]))
        for channel, delta in change:
            if channel == "torque":
                # some 3 % of friction and a third of the scatter stay in windows of a good base model
                columns, noise = base, np.hypot(0.5 * of["noise"][j] * day["noise"], 0.08 * of["dry"][j])
            else:
                gain = np.stack([0.15 * tau[:, j] / of["kp"][j], 0.001 * v[:, j], 0.0003 * a[:, j]], 1)
                columns = np.concatenate([base / of["kp"][j], gain], 1)
                noise = np.hypot(0.3 * of["quantum"], 0.08 * of["dry"][j] / of["kp"][j])
            sigma = noise / np.sqrt(0.07 * 12)
            system = np.concatenate([columns / sigma, np.eye(columns.shape[1])])
            target = np.concatenate([delta / sigma, np.zeros(columns.shape[1])])
            rest = target - system @ np.linalg.lstsq(system, target, rcond=None)[0]
            if np.sqrt(np.mean(delta**2)) >= 0.5 * noise and np.sum(rest**2) >= 16:
                return True
    return False


def drawn() -> list[dict]:
    """All logs: arm, cause, joint, level, with a reference or not."""
    rng = np.random.default_rng(SEED)
    clean, other = (LOGS, 0) if HEALTHY else (LOGS // 3, LOGS // 8)
    named = LOGS - clean - other
    kinds = [""] * clean + [str(x) for _ in range(1 + LOGS // 32) for x in rng.permutation(UNLISTED)][:other]
    kinds += [str(x) for _ in range(1 + LOGS // 24) for x in rng.permutation(LISTED)][:named]
    order = rng.permutation(LOGS)
    with_reference, shuffled = rng.permutation(np.arange(LOGS) % 2 == 0), [kinds[k] for k in order]
    out = []
    for i, kind in enumerate(shuffled):
        out.append({"id": f"J{i + 1:03}", "arm": ("ur10e", "so101")[i % 2], **one_of(kind, rng)})
        out[-1] |= {"reference": bool(with_reference[i]), "torque": i % 4 != 1}
    listed = [x for x in out if x["kind"] in LISTED and x["kind"] not in INSTRUMENT]
    rng = np.random.default_rng([SEED, LOGS, 2])
    for entry in listed[::EVERY_SECOND]:
        again = one_of(str(rng.choice([k for k in LISTED if k not in (*INSTRUMENT, entry["kind"])])), rng)
        while again["kind"] not in GLOBAL and again["joint"] == entry["joint"]:
            again = one_of(again["kind"], rng)
        entry["also"] = again
    return out


def one_of(kind: str, rng: np.random.Generator) -> dict:
    """A cause of a kind, at a joint where it can act."""
    joint = int(rng.choice([0, 1, 2, 3, 4] if kind not in ("payload", "warm_up") else [1]))
    if kind in ("load_friction", "torque_constant", "saturation", "servo_stiffness", "zero_offset_step"):
        joint = int(rng.choice([1, 2, 3]))  # where a load acts
    return {"kind": kind, "joint": joint, "level": float(rng.uniform())}


def make(folder: Path, arm: str) -> None:
    """Logs and key of one arm."""
    todo, days, slots = [x for x in drawn() if x["arm"] == arm], [], []
    for entry in todo:
        rng = np.random.default_rng([SEED, int(entry["id"][1:])])
        truth = arm_of(arm, rng)
        day, other = day_of(truth, arm, rng), day_of(truth, arm, rng)
        day["torque"] = other["torque"] = entry["torque"]
        top = np.abs(rigid(model_of(arm, day), motion(arm, day["seed"]))).max(0) + 0.5 * day["dry"]
        hidden, also, alone = day, entry.get("also"), day
        if entry["kind"]:
            hidden = put(day, entry["kind"], entry["joint"], entry["level"], top, rng)
        if also:
            own, first = [SEED, int(entry["id"][1:]), 2], hidden
            hidden, alone = (
                put(x, also["kind"], also["joint"], also["level"], top, np.random.default_rng(own))
                for x in (hidden, day)
            )
        slot = {"log": len(days)}
        days.append(hidden)
        for name, extra, wanted in (
            ("twin", alone, entry["kind"] and entry["kind"] not in INSTRUMENT),
            ("second", first if also else day, also),
            ("reference", other, entry["reference"]),
        ):
            if wanted:
                slot[name] = len(days)
                days.append(extra)
        slots.append(slot)
    logs, key = simulate(days), []
    (folder / f"{arm}.urdf").write_text(urdf_of(arm))
    (folder / f"{arm}.drive.toml").write_text(drive_of(arm))
    for entry, slot in zip(todo, slots, strict=True):
        day, log = days[slot["log"]], logs[slot["log"]]
        written(day, log, folder / f"{entry['id']}.csv.gz")
        if entry["reference"]:
            written(days[slot["reference"]], logs[slot["reference"]], folder / f"{entry['id']}.reference.csv.gz")
        seen = bool(entry["kind"]) and visible(day, log, logs[slot.get("twin", slot["log"])], entry["reference"])
        key.append(entry | {"size": causes_of(day)[-1]["size"], "visible": seen})
        if "also" in entry:
            seen = visible(day, log, logs[slot["second"]], entry["reference"])
            key[-1]["also"] |= {"size": day["size"], "visible": seen}
    (folder / f"key-{arm}.json").write_text(json.dumps(key, indent=1))


def healthy(folder: Path) -> None:
    """The five greatest log evidences of each cause in logs without one, with a reference | without.

    Those of logs of commands alone follow, likewise.
    """
    found: dict[str, list[list[float]]] = {}
    for entry in key_of(folder):
        answer = json.loads((folder / f"{entry['id']}.answer.json").read_text())
        for cause in answer["ranking"]:
            lists = found.setdefault(cause["effect"], [[], [], [], []])
            lists[2 * (not entry["torque"]) + (not entry["reference"])].append(cause.get("log_evidence", np.inf))
    for name, lists in sorted(found.items(), key=lambda x: -max(sum(x[1], [-np.inf]))):
        greatest = (" ".join(f"{e:4.0f}" for e in sorted(x)[:-6:-1]) for x in lists)
        print(f"{name:52s}" + " | ".join(greatest))


def diagnosed(folder: Path, entry: dict) -> None:
    """The answer of one log."""
    name, arm = entry["id"], entry["arm"]
    reference = folder / f"{name}.reference.csv.gz" if entry["reference"] else None
    campaign = read_logs(folder / f"{arm}.urdf", [folder / f"{name}.csv.gz"], reference, folder / f"{arm}.drive.toml")
    assert campaign is not None
    answer = campaign.diagnosed()
    fits = [{"effect": f.label.partition("@")[0], "joint": int(f.label.partition("@")[2] or 0)} for f in answer.fitting]
    faults = [c for c in answer.causes if {"effect": c["effect"], "joint": c["joint"] or 0} not in fits]
    kept = {"verdict": answer.verdict, "causes": [*faults, *fits], "ranking": answer.ranking}
    (folder / f"{name}.answer.json").write_text(json.dumps(kept))


def hidden_of(entry: dict) -> list[dict]:
    """The causes of a log of the key, each with its arm."""
    return [entry, {**entry, **entry["also"]}] if "also" in entry else [entry]


def right(claim: dict, entry: dict) -> bool:
    """Whether a claim is a hidden cause, at its joint; twin names as the documentation has them."""
    return any(same_cause(claim, cause) for cause in hidden_of(entry))


def same_cause(claim: dict, entry: dict) -> bool:
    """Whether a claim is one hidden cause."""
    twins = (
        [*TWINS, {"servo_stiffness", "torque_constant"}] if entry["arm"] == "so101" and not entry["torque"] else TWINS
    )
    same = claim["effect"] == entry["kind"] or any({claim["effect"], entry["kind"]} <= pair for pair in twins)
    return same and (entry["kind"] in GLOBAL or claim["joint"] == entry["joint"] + 1)


def score(folder: Path) -> None:
    """Everything, printed."""
    key, table = key_of(folder), []
    print(ABOUT)
    for entry in key:
        path = folder / f"{entry['id']}.answer.json"
        if not path.exists():
            continue
        answer = json.loads(path.read_text())
        claims = answer["causes"]
        channel = "current" if entry["arm"] == "ur10e" else "torque" if entry["torque"] else "command"
        answer |= {"claims": claims, "right": [right(c, entry) for c in claims], "channel": channel}
        table.append(entry | answer)
        said = ", ".join(f"{c['effect']}@{c['joint']}" if c["joint"] else c["effect"] for c in claims)
        hidden, *also = (
            f"{c['kind']}@{c['joint'] + 1}" if c["kind"] not in ("", *GLOBAL) else c["kind"] or "-"
            for c in hidden_of(entry)
        )
        mark = "".join("+" if r else "x" for r in table[-1]["right"])
        print(
            f"{entry['id']} {entry['arm']:5} {channel:7} {'ref' if entry['reference'] else '-':3} "
            f"{hidden:20} {entry['size']:7.3g} "
            f"{'visible' if entry['visible'] else '-':7} {answer['verdict']:9} {mark:3} {said}"
        )
        if also:
            second = f"{entry['also']['size']:7.3g} {'visible' if entry['also']['visible'] else '-'}"
            print(f"{'and':24} {also[0]:20} {second}")
    for channel in dict.fromkeys(x["channel"] for x in table):
        summary(channel, [x for x in table if x["channel"] == channel])
    print("\ncause                 logs visible named(visible) named right  wrong claims  other verdicts")
    for kind in ["", *LISTED, *UNLISTED]:
        of = [x for x in table if x["kind"] == kind and "also" not in x]
        if not of:
            continue
        seen = [x for x in of if x["visible"]]
        wrong = Counter(f"{c['effect']}" for x in of for c, r in zip(x["claims"], x["right"], strict=True) if not r)
        rest = Counter(x["verdict"] for x in of if not x["claims"])
        print(
            f"{kind or 'clean':20} {len(of):5} {len(seen):7} {named(seen):14} {named(of):11}  "
            f"{counted(wrong)}; {counted(rest)}"
        )


def of_pairs(table: list[dict]) -> str:
    """Recall and precision of logs with two causes."""
    pairs = [x for x in table if "also" in x]
    seen = [(x, c) for x in pairs for c in hidden_of(x) if c["visible"]]
    found = [any(same_cause(claim, c) for claim in x["claims"]) for x, c in seen]
    both = [x for x in pairs if all(c["visible"] for c in hidden_of(x))]
    whole = sum(all(any(same_cause(claim, c) for claim in x["claims"]) for c in hidden_of(x)) for x in both)
    claims = [r for x in pairs for r in x["right"]]
    return (
        f"two causes, {len(pairs)} logs: {sum(found)} of {len(found)} visible causes named, "
        f"both of {whole} of {len(both)} where both are visible; claims right {sum(claims)} of {len(claims)}"
    )


def named(table: list[dict]) -> int:
    """Logs whose hidden cause is among the claims."""
    return sum(any(x["right"]) for x in table)


def counted(what: Counter) -> str:
    return ", ".join(f"{k} {n}" for k, n in what.items()) or "-"


def summary(channel: str, table: list[dict]) -> None:
    """The figures of the logs with a channel."""
    claims = [r for x in table for r in x["right"]]
    clean, other = [x for x in table if not x["kind"]], [x for x in table if x["kind"] in UNLISTED]
    single = [x for x in table if x["kind"] in LISTED and "also" not in x]
    seen = [x for x in single if x["visible"]]
    alone = [r for x in single for r in x["right"]]
    hidden, strange = [x for x in single if not x["visible"]], [x for x in other if x["visible"]]
    lines = [
        f"\n{channel}, {len(table)} logs",
        f"claims right {sum(claims)} of {len(claims)}",
        f"those of logs with one listed cause {sum(alone)} of {len(alone)}",
        f"false alarms on clean logs {sum(bool(x['claims']) for x in clean)} of {len(clean)}",
        f"unlisted claimed as listed {sum(bool(x['claims']) for x in other)} of {len(other)}",
        f"named where visible {named(seen)} of {len(seen)} (not visible, named {named(hidden)} of {len(hidden)})",
        f"unknown or ambiguous where an unlisted cause is visible "
        f"{sum(x['verdict'] in ('unknown', 'ambiguous') for x in strange)} of {len(strange)}",
    ]
    print("\n".join([*lines, of_pairs(table)]))


ABOUT = f"""Three runs a log, 50 s, 125 Hz; {LOGS // 3} clean, {LOGS // 8} with a cause on no list. + right, x wrong.
One cause a log, or two at different joints (the second in a line below).
Columns: log, arm, channel, reference, hidden cause@joint, size, visible or not, verdict, claims.
Sizes: share by which friction, gain or constant is off; s (delay, lag); rad (zero); kg (payload); share of rows or time
(lost samples, clock); part of the greatest torque (saturation); of the joint's dry friction (what else is a torque).
Visible: from two simulations that differ in the cause alone, see visible() of joint_logs.py; no diagnosis enters.
"""


def key_of(folder: Path) -> list[dict]:
    """The key of both arms, ordered."""
    keys = (folder / f"key-{arm}.json" for arm in ARMS)
    return sorted((x for key in keys if key.exists() for x in json.loads(key.read_text())), key=lambda x: x["id"])


def main() -> None:
    task, folder = sys.argv[1], Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    if task == "make":
        seed = [str(folder), str(SEED), str(LOGS)]
        jobs = [subprocess.Popen([sys.executable, __file__, f"make-{arm}", *seed]) for arm in ARMS]
        if any(job.wait() for job in jobs):
            sys.exit(1)
    elif task.startswith("make-"):
        make(folder, task[5:])
    elif task == "run":
        for entry in key_of(folder):
            if not (folder / f"{entry['id']}.answer.json").exists():
                diagnosed(folder, entry)
    if task in ("make", "score"):
        digest = hashlib.sha256(json.dumps(key_of(folder), sort_keys=True).encode()).hexdigest()
        print(f"{LOGS} logs (synthetic), seed {SEED}; sha256 of the key {digest}")
    if task == "score" and HEALTHY:
        healthy(folder)
    elif task == "score":
        score(folder)


if __name__ == "__main__":
    main()
