"""OMP_NUM_THREADS=1 python docs/studies/confusable_pairs.py [CAMPAIGNS [PAIR]] > docs/studies/confusable_pairs.txt

Pairs of effects that a campaign of 40 poses cannot distinguish, and what 40 more poses say: those that `next_poses`
proposes for the pair, and others drawn at random over everything that the robot can do. Measured in MuJoCo
(`casadical.blind_check.mujoco_physics`), the truth being the one and the other effect of the pair in turn, each
robot built again. The first campaign is poor in one way each: joint ranges, payload, temperature.

Isolated: of all causes on the standard list, and of the smooth unknown ones, the most probable is the true one, joint
included. Claimed: with a probability of .9; wrong claims: of another cause. The pair: of the two alone, the truth is
the more probable.
"""

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
from campaign_robots import machine as drawn_robot

from casadical.blind_check.mujoco_physics import draw_effect, measure, perturb
from casadical.diagnosis.candidates import candidates_of
from casadical.diagnosis.linear_problem import make_case
from casadical.diagnosis.next_poses import next_poses
from casadical.diagnosis.posterior import rank
from casadical.diagnosis.settings import SETTINGS
from casadical.identification.identification import identify
from casadical.measurements.reading import from_table
from casadical.pose_selection import Workspace
from casadical.pose_selection.candidates import draw

ROOT = Path(__file__).parents[2]
CAMPAIGNS, FIRST, MORE = 30, 40, 40
COLD, WARM = 20.0, 27.0
JOINTS = range(1, 7)
READINGS = [f"q{j}_deg" for j in JOINTS]
SIDES = [f"approach{j}" for j in JOINTS]
NOTHING = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Pair:
    """Two causes and the campaign that is too poor to tell them.

    ranges : of joints [deg]; payloads : share of the robot's; rise : of the temperature [K]
    scale : of the effects' usual sizes
    """

    robot: str
    causes: tuple[str, str]
    poor: str
    ranges: dict[int, tuple[float, float]] = field(default_factory=dict)
    payloads: tuple[float, ...] = (0.0, 1.0)
    rise: float = WARM - COLD
    scale: float = 1.0


PAIRS = {
    "scale": Pair("kr210", ("joint_scale@1", "gear_eccentricity@1"), "joint 1 within 70 deg", {1: (-35, 35)}),
    "windup": Pair("kr210", ("friction_windup@5", "backlash@5"), "no payload", payloads=(0.0,)),
    "warmth": Pair(
        "kr210", ("thermal_growth", "thermal_zero_drift@3"), "small ranges of joints 1 to 3, arm warming up by 2 K",
        {1: (-20, 20), 2: (-70, -50), 3: (10, 40)}, rise=2.0,
    ),
    "pedestal": Pair(
        "kr210", ("base_compliance", "axis_wobble@1"), "one reach, joint 1 within 80 deg, no payload",
        {1: (-40, 40), 2: (-50, -35), 3: (20, 35)}, (0.0,), scale=2.0,
    ),
    "coupling": Pair(
        "kr210", ("link_flexure", "joint_coupling@5"), "small ranges of joints 2 to 4, no payload",
        {2: (-70, -40), 3: (0, 40), 4: (-10, 10)}, (0.0,), scale=2.0,
    ),
    "spring": Pair(
        "kr210", ("gravity_compensator@2", "gear_eccentricity@2"), "joint 2 within 60 deg", {2: (-110, -50)}
    ),
}  # fmt: skip


def hidden(machine, label, scale, rng):
    """An effect of the engine in the joint of the label."""
    name, _, joint = label.partition("@")
    drawn = draw_effect(machine, name, rng)
    if name == "axis_wobble":
        drawn = replace(drawn, size={**drawn.size, "cycles": 1})
    if name == "joint_coupling":
        drawn = replace(drawn, size={**drawn.size, "source": int(joint) - 1})
    drawn = replace(drawn, size={**drawn.size, "size": scale * drawn.size["size"]})
    return drawn if drawn.joint is None else replace(drawn, joint=int(joint))


def table_of(q_deg, degC, payload_kg, sides):
    table = pd.DataFrame(q_deg, columns=READINGS)
    table[SIDES] = sides
    table["time_s"] = 30.0 * np.arange(1, len(table) + 1)
    table["temperature_degC"] = degC
    table["payload_kg"] = payload_kg
    return table


def poor_campaign(robot, pair, n, rng):
    """n poses of the kind that cannot tell."""
    lower, upper = (np.array([getattr(j, side) for j in robot.joints]) for side in ("lower", "upper"))
    for joint, (low, high) in pair.ranges.items():
        lower[joint - 1], upper[joint - 1] = np.deg2rad([low, high])
    q = np.rad2deg(draw(robot, n, Workspace(lower, upper), rng))
    kg = robot.payload.mass * np.array(pair.payloads)[np.arange(n) * 2 * len(pair.payloads) // n % len(pair.payloads)]
    degC = COLD + pair.rise * -np.expm1(-30.0 * np.arange(1, n + 1) / 1200.0)
    return table_of(q, degC, kg, rng.choice([-1, 1], (n, 6)))


def later(first, q_deg, warm, payload_kg, sides):
    """The campaign and more poses: warm ones after three hours of work, then cold ones the next morning."""
    order = np.argsort(~warm, kind="stable")
    more = table_of(q_deg[order], np.where(warm[order], WARM, COLD), payload_kg[order], sides[order])
    pause = np.where(warm[order], 3 * 3600.0, 18 * 3600.0)
    more["time_s"] += first["time_s"].iloc[-1] + pause
    return pd.concat([first, more], ignore_index=True)


def chosen(case, ranking, pair, first, seed, rng):
    """As next_poses proposes them for the pair."""
    others = [k for k in ranking.order if k not in pair.causes][:1]
    table = next_poses(case, MORE, list(pair.causes), seed, beside=["none", *others])
    sides = rng.choice([-1, 1], (MORE, 6))
    for k, name in enumerate(SIDES):
        if name in table:
            sides[:, k] = table[name]
    warm = (table["state"] == "warm").to_numpy() if "state" in table else np.ones(MORE, dtype=bool)
    return later(first, table[READINGS].to_numpy(), warm, table["payload_kg"].to_numpy(), sides), table


def drawn(robot, first, rng):
    """At random over the robot's ranges, payloads, approaches and states."""
    q = np.rad2deg(draw(robot, MORE, Workspace(), rng))
    kg = rng.choice([0.0, robot.payload.mass], MORE)
    return later(first, q, rng.random(MORE) < 0.5, kg, rng.choice([-1, 1], (MORE, 6)))


def judged(robot, machine, effect, readings, seed):
    """Case and ranking of what the engine measures at these readings."""
    table = measure(machine, [effect], readings, noise_mm=0.015, repeatability_urad=5.0, seed=seed)
    case = make_case(identify(robot, from_table(table, 6), priors=True), candidates_of(robot, "standard"))
    return case, rank(case, NOTHING)


def trial(robot, pair, number):
    """Rows of results by kind of further poses, and the columns of the table that asked for them."""
    seed = 7000 + number
    rng = np.random.default_rng(seed)
    machine = perturb(drawn_robot(pair.robot)[1], seed)
    truth, rival = pair.causes[number % 2], pair.causes[1 - number % 2]
    effect = hidden(machine, truth, pair.scale, rng)
    first = poor_campaign(robot, pair, FIRST, rng)
    case, ranking = judged(robot, machine, effect, first, seed)
    found = {"before": ranking}
    readings, proposal = chosen(case, ranking, pair, first, seed, rng)
    found["chosen"] = judged(robot, machine, effect, readings, seed)[1]
    found["random"] = judged(robot, machine, effect, drawn(robot, first, rng), seed)[1]
    rows = {}
    for kind, r in found.items():
        top, p = r.order[0], r.probability[truth]
        claims = r.none < SETTINGS.max_p_nothing and r.probability[top] >= SETTINGS.min_claim * (1 - r.none)
        rows[kind] = (top == truth, claims, claims and top != truth, p > r.probability[rival], p, top)
    return rows, proposal


def show(name, pair, results, asked):
    print(f"\n{name}: {pair.causes[0]} or {pair.causes[1]}, {pair.robot}; the first {FIRST} poses: {pair.poor}")
    print(f"{'':22s}{'isolated':>10s}{'claimed':>10s}{'wrong claims':>14s}{'pair':>8s}{'mean probability':>18s}")
    for kind, rows in results.items():
        isolated, claims, wrong, of_pair, p, _ = zip(*rows, strict=True)
        words = f"{FIRST} poses" if kind == "before" else f"{MORE} {kind} more"
        print(
            f"{words:22s}{np.mean(isolated):10.1%}{np.mean(claims):10.1%}{sum(wrong):14d}{np.mean(of_pair):8.1%}"
            f"{np.mean(p):18.3f}"
        )
    print("asked for:", "; ".join(f"{what} in {share:.0%}" for what, share in asked.items()), flush=True)


def wants(proposals):
    """What the poses ask for that the campaign had not: share of all poses."""
    news = [part for table in proposals for text in table["new"] for part in text.split("; ") if part]
    kinds = pd.Series([part.split(" kg")[0] for part in news]).str.replace(r"by \d+ K", "", regex=True).str.strip()
    kinds = kinds.where(~kinds.str.startswith("range"), "a wider range")
    shares = kinds.value_counts() / (MORE * len(proposals))
    states = pd.concat([t["state"] for t in proposals]) if "state" in proposals[0] else pd.Series(dtype=str)
    found = shares.to_dict() | {f"{k} arm": v for k, v in states.value_counts(normalize=True).items()}
    return found | {"repeated poses": float(np.mean([r != "" for t in proposals for r in t["repeats"]]))}


def main() -> None:
    campaigns = int(sys.argv[1]) if len(sys.argv) > 1 else CAMPAIGNS
    names = sys.argv[2:] or list(PAIRS)
    print(f"{campaigns} campaigns a pair, the truth in turn; 0.015 mm of noise a coordinate, 5 urad a joint")
    for name in names:
        pair = PAIRS[name]
        robot = drawn_robot(pair.robot)[0]
        results, proposals = {}, []
        for number in range(campaigns):
            rows, proposal = trial(robot, pair, number)
            proposals.append(proposal)
            for kind, row in rows.items():
                results.setdefault(kind, []).append(row)
            print(name, number, {k: (v[5], round(v[4], 3)) for k, v in rows.items()}, file=sys.stderr, flush=True)
        show(name, pair, results, wants(proposals))


if __name__ == "__main__":
    main()
