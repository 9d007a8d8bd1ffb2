"""The folder of small valid files that the fuzz works on."""

from __future__ import annotations

import json
import re
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

ROOT = Path(__file__).parents[2]
URDF = """<robot name="two"><link name="base"/><link name="one"/><link name="two"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.1" rpy="0 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0.4 0 0" rpy="0 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>
"""
DRIVE = "[drive]\ngear_ratio = [101.0, 51.0]\ntorque_constant_Nm_per_A = 0.1\nkp_Nm_per_rad = 800\ndelay_ms = 8\n"
DETAILS = (ROOT / "docs/certificate.md").read_text().split("```toml\n")[1].split("```")[0]
EFFECTS = """casadical = 2
[[definition]]
name = "play_of_mine"
acts_at = "joints"
needs = ["approach{joint}"]
signature = "a step"
settings.width = {default = 0.1, grid = [0.1, 0.2], about = "of the step"}
sizes = {half = [40e-6, "rad"]}
formulas.joint = "half * tanh(tau{joint} / width) * approach{joint}"
"""
ANSWER = '{"casadical_withheld": 1, "criterion": "bic"}\n'
WITHHELD = {"format": "casadical withheld 1", "key_sha256": "0" * 64, "campaigns": {"a": {"robot": "two"}}}


def world(place: Path) -> None:
    """Small valid files of every kind, in the folder `in`; `out` is empty."""
    from casadical import calibrate
    from casadical.compensator import Compensator, save_compensator

    folder = place / "in" / "p"
    folder.mkdir(parents=True)
    (place / "out").mkdir()
    planar = ROOT / "problems" / "planar"
    shutil.copy(planar / "robot.toml", folder)
    text = (planar / "problem.toml").read_text().replace("../../data/planar/planar.csv", "poses.csv")
    (folder / "problem.toml").write_text(text)
    table = (ROOT / "data" / "planar" / "planar.csv").read_text().splitlines()
    (folder / "poses.csv").write_text(
        "\n".join([f"{table[0]},payload_kg", *(f"{row},2.5" for row in table[1:])]) + "\n"
    )
    calibrate(folder).write(place / "in" / "results")
    texts = {
        "program.csv": "q1_deg,q2_deg,speed\n10,20,fast\n30,-40,slow\n",
        "dh.csv": "a_mm,alpha_deg,d_mm,theta_deg\n0,0,0,0\n400,0,0,0\n300,90,100,0\n",
        "room.toml": "casadical = 1\nfloor_mm = -2000\n[[joint]]\nnumber = 1\nlimits_deg = [-90, 90]\n",
        "places.csv": "x_mm,y_mm,z_mm\n900,0,300\n0,900,200\n-900,0,100\n0,-900,400\n",
        "arm.urdf": URDF, "drive.toml": DRIVE, "certificate.toml": DETAILS, "my.effect.toml": EFFECTS,
        "fleet.json": json.dumps({"robots": [{"changes": "joint_zero"}]}), "foreign.txt": "mine\n", "empty": "",
    }  # fmt: skip
    for name, content in texts.items():
        (place / "in" / name).write_text(content)
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (30, 2))
    save_compensator(Compensator.fit(q, np.sin(q @ np.ones((2, 3))), folds=2), place / "in" / "net.json")
    (place / "in" / "binary").write_bytes(bytes(range(256)))
    (place / "in" / "folder").mkdir()
    (place / "in" / "loop").symlink_to("loop")
    _measured(place / "in", table)
    logs(place / "in")


def _measured(into: Path, table: list[str]) -> None:
    """Days of touches, a test by ISO 9283, what `measure` reads and keeps, a blind check."""
    head, rows = table[0], table[1:]
    for day in (1, 2, 3):
        (into / f"2026-03-0{day}.csv").write_text("\n".join([head, *rows[5 * day : 5 * day + 5]]) + "\n")
    visits = [f"accuracy,{k % 3 + 1},0,0,{rows[k % 3]},{','.join(rows[k % 3].split(',')[2:])}" for k in range(9)]
    (into / "iso.csv").write_text(f"test,pose,path,group,{head},cx_mm,cy_mm,cz_mm\n" + "\n".join(visits) + "\n")
    shutil.copytree(into / "p", into / "live")
    text = (into / "p" / "problem.toml").read_text()
    (into / "live" / "problem.toml").write_text(re.sub(r"\[\[measurements\]\].*?\n\n|\[sets\].*", "", text, flags=re.S))
    (into / "live" / "poses.csv").unlink()
    (into / "stdin.csv").write_text("\n".join(table[:9]) + "\n")
    events: list[dict[str, Any]] = [{"do": "begin", "header": head.split(","), "units": [], "data": "real"}]
    events += [{"do": "read", "cells": row.split(","), "from": "a, line 2"} for row in rows[9:15]]
    events += [{"do": "strike", "id": 2, "why": "bumped"}, {"do": "restore", "id": 2}]
    lines = [json.dumps({"at": "2026-11-23T10:00:00+00:00", **event}) for event in events]
    (into / "live" / "measured.jsonl").write_text("\n".join(lines) + "\n")
    (into / "w" / "robots").mkdir(parents=True)
    shutil.copy(into / "p" / "robot.toml", into / "w" / "robots" / "two.toml")
    (into / "w" / "withheld.json").write_text(json.dumps(WITHHELD))
    (into / "w" / "a.csv").write_text((into / "p" / "poses.csv").read_text())
    (into / "w" / "answers.jsonl").write_text(ANSWER * 2)
    (into / "w" / "key.json").write_text(json.dumps({"salt": "a", "seed": 1, "campaigns": {}}))


def logs(into: Path) -> None:
    """A joint log in the forms of several systems."""
    t = np.arange(300) / 50
    q = np.column_stack([0.8 * np.sin(2 * t), 0.5 * np.sin(1.3 * t + 1)])
    names = {"command{}_rad": q, "q{}_rad": q - 0.01, "current{}_A": np.cos(q), "temperature{}_degC": 30 + 0 * q}
    ours = pd.DataFrame({"time_s": t} | {n.format(k + 1): v[:, k] for n, v in names.items() for k in range(2)})
    ours.round(5).to_csv(into / "log.csv", index=False)
    ours.to_parquet(into / "log.parquet")
    rtde = {"target_q_{}": q, "actual_q_{}": q - 0.01, "actual_current_{}": np.cos(q)}
    columns = {"timestamp": t} | {n.format(k): v[:, k] for n, v in rtde.items() for k in range(2)}
    pd.DataFrame(columns).round(5).to_csv(into / "rtde.csv", index=False, sep=" ")
    data = into / "lerobot" / "data"
    data.mkdir(parents=True)
    deg = np.rad2deg(3 * q)
    frame = {"action": [*deg], "observation.state": [*(deg - 0.5)], "timestamp": t, "episode_index": (t > 3) + 0}
    pd.DataFrame(frame).to_parquet(data / "episode.parquet")
    (into / "lerobot" / "meta").mkdir()
    about = {"features": {"observation.state": {"names": ["a.pos", "b.pos"]}}}
    (into / "lerobot" / "meta" / "info.json").write_text(json.dumps(about))
    (into / "sage").mkdir()
    (into / "sage" / "joint_list.txt").write_text("j1\nj2\n")
    for name, own in (("state_motor", q - 0.01), ("control", q)):
        rows = [f'{int(1e6 * a)},"{[round(float(v), 4) for v in p]}"' for a, p in zip(t, own, strict=True)]
        (into / "sage" / f"{name}.csv").write_text("timestamp,positions\n" + "\n".join(rows) + "\n")
    with suppress(ImportError):
        _bags(into, t[:40], q)


def _bags(into: Path, t: np.ndarray, q: np.ndarray) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types["sensor_msgs/msg/JointState"]
    stamp, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    for plugin, end in ((StoragePlugin.SQLITE3, "db3"), (StoragePlugin.MCAP, "mcap")):
        with Writer(into / f"bag-{end}", version=9, storage_plugin=plugin) as bag:
            topics = [bag.add_connection(n, kind.__msgtype__, typestore=store) for n in ("/joint_states", "/command")]
            for time, row in zip(1e9 + t, q, strict=False):
                head = header(stamp(int(time), int(1e9 * (time % 1))), "")
                message = kind(head, ["j1", "j2"], row, row, row)
                for topic in topics:
                    data = store.serialize_cdr(message, kind.__msgtype__)
                    bag.write(topic, int(1e9 * time), data)
