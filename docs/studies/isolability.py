"""python docs/studies/isolability.py > docs/studies/isolability.txt

Which causes look alike, from the design alone: the first practice campaign's poses of each robot, no position looked
at.
"""

from pathlib import Path

from casadical.diagnosis.isolability import isolability
from casadical.measurements.reading import read_measurements
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
DESIGNS = ("hh800-P01", "kr210-P02", "ur10e-P03")
PAIRS = [
    ("gravity_compensator", "gear_eccentricity"),
    ("joint_scale", "gear_eccentricity"),
    ("link_flexure", "cross_coupling"),
]


def main() -> None:
    found = {}
    for design in DESIGNS:
        robot = read_campaign_robot(ROOT / "problems" / design.split("-")[0])
        m = read_measurements(ROOT / "data" / "campaigns" / "practice" / f"{design}.csv", robot.n)
        found[f"{design} ({len(m)})"] = isolability(robot, m, "extended", whole=True)
    heads = "".join(f"{name:>18s}" for name in found)
    print("Share of the visible signal that a rival reproduces, each effect in all its joints together")
    print(f"{'cause':22s}{'rival':31s}{heads}")
    for cause, rival in PAIRS:
        shares = "".join(f"{d.alike.loc[cause, rival]:18.2f}" for d in found.values())
        print(f"{cause:22s}{rival:31s}{shares}")
    scale = "".join(f"{d.effects.loc['tracker_scale', 'absorbed']:18.3f}" for d in found.values())
    print(f"\nShare of an effect's signal that the base model absorbs\n{'tracker_scale':53s}{scale}")


if __name__ == "__main__":
    main()
