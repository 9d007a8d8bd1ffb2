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
    ("load_hysteresis", "friction_windup"),
    ("link_flexure", "cross_coupling"),
    ("base_compliance", "axis_wobble"),
    ("thermal_growth", "thermal_zero_drift"),
    ("thermal_zero_drift", "frame_drift"),
    ("nonlinear_stiffness", "backlash"),
]
HIDDEN = ("gravity_compensator", "nonlinear_stiffness", "link_flexure", "payload_error", "base_compliance", "backlash")
SEEN = ("joint_coupling", "friction_windup", "gear_mesh", "transmission_ripple", "thermal_growth", "tracker_scale")


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
    print("\nShare of an effect's signal that the base model absorbs")
    print(f"{'effect':53s}{heads}")
    for cause in (*HIDDEN, *SEEN):
        print(f"{cause:53s}" + "".join(f"{d.effects.loc[cause, 'absorbed']:18.3f}" for d in found.values()))


if __name__ == "__main__":
    main()
