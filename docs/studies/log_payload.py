"""Payloads found from joint logs: a UR10e in MuJoCo with a load that nobody declared, with and without a known day.

    python docs/studies/log_payload.py > docs/studies/log_payload.txt

Synthetic, by the simulator of joint_logs.py (masses off by 4 % a link, torque constants by 1 %, frictions that differ
from day to day): 12 arms, 0.3 to 3 kg. With a reference: the same arm on another day, without a load, which is one
known load. Without: the robot file's masses and constants alone. To be reached: 3 %, with an honest interval.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from joint_logs import arm_of, day_of, drive_of, simulate, urdf_of, written

from casadical import read_urdf
from casadical.core.drive import read_drive
from casadical.diagnosis.motion.result import diagnose_log
from casadical.measurements.logs.reading import read_log

ARMS, LEAST, MOST = 12, 0.3, 3.0
SEED = 20261130


def main() -> None:
    sizes, days = np.geomspace(LEAST, MOST, ARMS), []
    for k, kg in enumerate(sizes):
        rng = np.random.default_rng([SEED, k])
        truth = arm_of("ur10e", rng)
        day, other = day_of(truth, "ur10e", rng), day_of(truth, "ur10e", rng)
        days += [day | {"payload": float(kg), "kind": "payload", "size": float(kg), "sign": 1.0}, other | {"sign": 1.0}]
    logs = simulate(days)
    print(__doc__.splitlines()[0])
    print("synthetic; kg beyond what is declared, one sigma, error in % and in sigmas")
    print(f"{'true':>6}   {'with a known day':^32}   {'robot file alone':^32}")
    errors: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "arm.urdf").write_text(urdf_of("ur10e"))
        (place / "arm.drive.toml").write_text(drive_of("ur10e"))
        robot = read_urdf(place / "arm.urdf")
        robot = replace(robot, drive=read_drive(place / "arm.drive.toml", robot.n))
        for k, kg in enumerate(sizes):
            for i, name in enumerate(("log", "known")):
                written(days[2 * k + i], logs[2 * k + i], place / f"{name}.csv.gz")
            log, known = (read_log(place / f"{name}.csv.gz", robot) for name in ("log", "known"))
            line = []
            for reference in (known, None):
                found = diagnose_log(robot, log, reference).payload()
                assert found is not None
                value, sigma = found
                errors[reference is not None].append(((value - kg) / kg, (value - kg) / sigma))
                line.append(f"{value:7.3f} {sigma:6.3f} {100 * (value / kg - 1):+7.1f} % {(value - kg) / sigma:+6.1f}")
            print(f"{kg:6.3f}   {line[0]}   {line[1]}", flush=True)
    for title, key in (("with a known day", True), ("robot file alone", False)):
        share, z = np.array(errors[key]).T
        print(
            f"{title}: median error {100 * np.median(np.abs(share)):.1f} %, from 1 kg on "
            f"{100 * np.median(np.abs(share[sizes >= 1])):.1f} %; within two sigmas {(np.abs(z) < 2).sum()} of {len(z)}"
        )


if __name__ == "__main__":
    main()
