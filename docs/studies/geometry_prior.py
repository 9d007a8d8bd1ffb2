"""Few tracker poses of simulated arms: frames alone, free geometry, and geometry as calibrate frees it.

    python docs/studies/geometry_prior.py [--arms 60] [--noise 0.1] [--keep FILE --seconds 500]

Simulated UR5e arms whose geometry is off by normal errors of one size (0, 0.1, 0.3 or 1 mm and mrad) or, "zeros", whose
joint zeros are off by 3 mrad and all else by 0.1; tracker positions with normal noise of so many millimetres a
coordinate. Base and tool are unknown. Errors are means over 400 poses that were held out, without noise, in mm, and
over the arms; "of better" is the error as calibrate frees the geometry over the better of the other two.
"""

import argparse
from dataclasses import replace

import camera
import kept
import numpy as np

from casadical.core.parts import Placement
from casadical.core.transforms import frame, from_rpy
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.measurements.measurements import Measurements
from casadical.robot.robot import Robot

HELD_OUT = 400
SIZES = {"right": 0.0, "0.1": 0.1, "0.3": 0.3, "1": 1.0, "zeros": 0.1}
TRACKER = frame(from_rpy(np.array([2.5, -0.8, 1.9])), np.array([2.1, -3.4, 0.7]))


def scene(robot: Robot, size: str, poses: int, noise: float, seed: int) -> tuple[Measurements, Measurements]:
    """Measured poses of an arm as built, and exact ones that are held out."""
    rng, values = np.random.default_rng(seed), {}
    for p in robot.parameters:
        if p.group == "tool":
            values[p.name] = p.value + 5e-3 * rng.normal()
        elif p.group == "geometry":
            off = 3.0 if size == "zeros" and p.name.startswith("theta") else SIZES[size]
            values[p.name] = p.value + 1e-3 * off * rng.normal()
    built = replace(robot.with_values(values), base=replace(robot.base, T=TRACKER))
    low, high = robot.limits
    q = rng.uniform(0.8 * low, 0.8 * high, (poses + HELD_OUT, robot.n))
    p, _ = predicted(built, Measurements(q, "position", position=np.zeros((len(q), 3))))
    seen = p[:poses] + rng.normal(0, 1e-3 * noise, (poses, 3))
    return Measurements(q[:poses], "position", position=seen), Measurements(q[poses:], "position", position=p[poses:])


def judged(entry: tuple[str, int, float, int]) -> kept.Row:
    """Held-out errors [mm] of one arm; entry : size, poses, noise [mm], seed."""
    tool = Placement(frame(np.eye(3), np.array([0.05, 0.08, 0.12])), "position")
    robot = replace(camera.arm("UR5e", 2.8), tool=tool)
    fit, held_out = scene(robot, *entry)
    fits = {
        "frames": identify(robot, fit, ["placement"]),
        "free": identify(robot, fit, ["kinematic"], priors=False),
        "chosen": identify(robot, fit, ["kinematic"]),
    }
    row: kept.Row = {}
    for name, found in fits.items():
        assert held_out.position is not None
        off = predicted(found.robot, held_out)[0] - held_out.position
        row[name] = 1e3 * float(np.linalg.norm(off, axis=1).mean())
    return row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=60)
    parser.add_argument("--noise", type=float, default=0.1)
    kept.add_options(parser, "geometry_prior")
    given = parser.parse_args()
    todo = kept.named(
        (size, poses, given.noise, arm) for arm in range(given.arms) for size in SIZES for poses in (15, 25, 40)
    )
    rows = kept.rows_of(todo, judged, given)
    head = "".join(f"{name:>9s}" for name in ("frames", "free", "chosen"))
    print(f"{'geometry off by':18s}{'poses':>6s}{'arms':>6s}{head}{'of better':>11s}")
    for size in SIZES:
        for poses in (15, 25, 40):
            own = [row for row in rows if row["name"].startswith(f"{size}/{poses}/{given.noise}/")]
            if own:
                frames, free, chosen = (np.mean([row[name] for row in own]) for name in ("frames", "free", "chosen"))
                figures = f"{frames:9.4f}{free:9.4f}{chosen:9.4f}{chosen / min(frames, free):11.3f}"
                print(f"{size:18s}{poses:6d}{len(own):6d}{figures}")


if __name__ == "__main__":
    main()
