"""python docs/studies/next_poses.py 150 > docs/studies/next_poses.txt

What fifteen more poses are worth where a campaign of fifty could not distinguish two causes: chosen by next_poses, or
drawn at random. Truth comes from the simulator, whose physics is not the candidates'; campaigns are of two
robots in turn. Only campaigns count in which something was detected and no cause had a probability of .9. With the
rarer effects as rivals 23 of 150 were in doubt (commit e4e7bcd), 15 without them; those are harder.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from campaign_robots import plant_of

from casadical.blind_check.mujoco_physics import Plant, Warmup, perturb
from casadical.blind_check.mujoco_physics.stops import Stops, draw_poses, draw_stops
from casadical.core.basics import InputError
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.next_poses import next_poses
from casadical.diagnosis.posterior import Ranking, rank
from casadical.identification.identification import identify
from casadical.measurements.measurements import Measurements
from casadical.project.problem import read_campaign_robot
from casadical.robot.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # for the simulator in numpy

from numpy_physics import draw_disturbance
from numpy_physics.statics import positions

ROOT = Path(__file__).parents[2]
FIRST, MORE = 50, 15
NOISE, REPEATABILITY = 15e-6, 6e-6
JOINTED = ("backlash", "friction_windup", "nonlinear_stiffness", "gear_eccentricity", "axis_wobble", "joint_scale")
WHOLE = ("link_flexure", "base_compliance", "payload_error", "frame_drift", "thermal_growth")
NOTHING = np.zeros(0, dtype=np.int64)


def measured(built: Plant, stops: Stops, disturbance, seed: int) -> Measurements:
    """What the instrument sees at these stops."""
    # A stream each, so that further poses leave the noise of the first ones as it was.
    joints, instrument, other = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    jitter = REPEATABILITY * joints.standard_normal(stops.q.shape)
    xyz = positions(built, [disturbance], stops, jitter)
    xyz = disturbance.measured(xyz, stops, other) + NOISE * instrument.standard_normal(xyz.shape)
    conditions = {
        "pose": np.arange(1.0, len(stops) + 1),
        "time_s": stops.time_s,
        "temperature_degC": 20 + stops.warmth_K,
        "payload_kg": stops.payload_kg,
        **{f"approach{j}": stops.approach[:, j - 1] for j in range(1, 7)},
    }
    return Measurements(q=stops.q, kind="position", position=xyz, conditions=conditions)


def extended(stops: Stops, q: np.ndarray, approach: np.ndarray, payload: np.ndarray) -> Stops:
    """The campaign and some more poses at its end."""
    time = stops.time_s[-1] + 30.0 * np.arange(1, len(q) + 1)
    return replace(
        stops,
        q=np.vstack([stops.q, q]),
        time_s=np.concatenate([stops.time_s, time]),
        warmth_K=np.concatenate([stops.warmth_K, Warmup().course(time)]),
        payload_kg=np.concatenate([stops.payload_kg, payload]),
        approach=np.vstack([stops.approach, approach]),
    )


def judged(r: Robot, m: Measurements):
    case = make_case(identify(r, m, priors=True), candidates_of(r, "standard"))
    return case, rank(case, NOTHING)


def trial(r: Robot, seed: int) -> tuple[str, dict[str, Ranking]] | None:
    rng = np.random.default_rng(seed)
    name = str(rng.choice([*JOINTED, *WHOLE]))
    joint = int(rng.integers(2, 6)) if name in JOINTED else None
    disturbance = draw_disturbance(name, seed, joint=joint, scale=float(rng.uniform(0.4, 1.0)))
    truth = name if joint is None else f"{name}@{joint}"
    built = perturb(plant_of(r), seed)
    streams = np.random.SeedSequence(seed).spawn(2)
    q = draw_poses(built, FIRST + MORE, rng, built.ranges, None)
    stops = draw_stops(q[:FIRST], streams, (0.0, r.payload.mass), Warmup())
    case, first = judged(r, measured(built, stops, disturbance, seed))
    listed = [k for k in first.order if {c.label: c for c in case.candidates}[k].listed]
    if first.none > 0.05 or first.probability[listed[0]] > 0.9 * (1 - first.none):
        return None
    found = {"fifty poses": first}
    chosen = next_poses(case, MORE, listed[:2], seed)
    approach = rng.choice([-1.0, 1.0], (MORE, 6))
    for j in range(1, 7):
        if f"approach{j}" in chosen:
            approach[:, j - 1] = chosen[f"approach{j}"]
    best = np.deg2rad(chosen[[f"q{j}_deg" for j in range(1, 7)]].to_numpy())
    drawn = rng.choice([0.0, r.payload.mass], MORE)
    for kind, poses in (
        ("15 chosen", (best, approach, chosen["payload_kg"].to_numpy())),
        ("15 random", (q[FIRST:], rng.choice([-1.0, 1.0], (MORE, 6)), drawn)),
    ):
        longer = extended(stops, *poses)
        found[kind] = judged(r, measured(built, longer, disturbance, seed))[1]
    return truth, found


def main() -> None:
    campaigns = int(sys.argv[1]) if len(sys.argv) > 1 else 120
    robots = [read_campaign_robot(ROOT / "problems" / name) for name in ("kr210", "ur10e")]
    results: dict[str, list[tuple[bool, bool, bool, float]]] = {}
    for seed in range(campaigns):
        try:
            got = trial(robots[seed % 2], 1000 + seed)
        except InputError:
            got = None
        if got is None:
            continue
        truth, found = got
        for kind, ranking in found.items():
            top = ranking.order[0]
            claimed = ranking.probability[top] >= 0.9 * (1 - ranking.none)
            row = (top == truth, claimed, claimed and top == truth, ranking.probability.get(truth, 0.0))
            results.setdefault(kind, []).append(row)
    count = len(next(iter(results.values()), []))
    print(f"{campaigns} campaigns of {FIRST} poses, {count} of them in doubt; what they say with {MORE} more poses\n")
    print(f"{'':14s}{'top is true':>12s}{'claimed':>9s}{'of these right':>16s}{'mean probability of the truth':>32s}")
    for kind, rows in results.items():
        right, claimed, both, share = np.mean(np.array(rows, dtype=float), axis=0)
        correct = both / claimed if claimed else float("nan")
        print(f"{kind:14s}{right:12.2f}{claimed:9.2f}{correct:16.2f}{share:32.2f}")


if __name__ == "__main__":
    main()
