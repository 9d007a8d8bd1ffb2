"""Expected position error by instrument and number of poses: python docs/studies/expected_accuracy.py (minutes)

For the nominal robots of three problem folders, the root mean square of the position error that noise alone leaves
over the joints' whole ranges, for poses that are planned one by one (`forecast`, as `casadical plan` without -n).
Joints repeat to 25 urad. Unmodelled effects come on top; docs/studies/layers.txt has what they are on a real robot.
"""

from pathlib import Path

from casadical.identification.pose_selection.instruments import usual_places
from casadical.identification.pose_selection.pose_search import forecast, place_instrument
from casadical.measurements.measurements import Noise
from casadical.project.problem import read_campaign_robot

ROOT = Path(__file__).parents[2]
ROBOTS = ("ur5", "ur10e", "kr210")
REPEATABILITY_RAD = 25e-6
INSTRUMENTS_MM = {
    "laser tracker": 0.02,
    "measuring arm, photogrammetry": 0.1,
    "camera with a board": 0.5,
    "three draw wires": 0.05,
}
POSES = (20, 30, 40, 50, 60, 100)


def main() -> None:
    print("expected rms position error [mm]: noise alone, planned poses; the last column: poses after which ten")
    print("more gain less than a tenth\n")
    head = "".join(f"{n:>8}" for n in POSES)
    print(f"{'robot':6} {'reach [m]':>9}  {'instrument':30} {'sigma [mm]':>10}  {head}  enough")
    for name in ROBOTS:
        robot = read_campaign_robot(ROOT / "problems" / name)
        for instrument, sigma_mm in INSTRUMENTS_MM.items():
            noise = Noise(1e-3 * sigma_mm, REPEATABILITY_RAD)
            wires = None
            if "wires" in instrument:
                wires = place_instrument(robot, "wires", usual_places(robot, "wires"), 3, noise=noise, seed=0)
            ahead = forecast(robot, max(POSES), noise=noise, instrument=wires, pool=500, seed=0)
            errors_mm = dict(zip(ahead.poses.tolist(), 1e3 * ahead.error, strict=True))
            row = "".join(f"{errors_mm[n]:8.3f}" if n in errors_mm else f"{'-':>8}" for n in POSES)
            print(f"{name:6} {robot.reach:9.2f}  {instrument:30} {sigma_mm:10.2f}  {row}  {ahead.stop() or '-':>6}")


if __name__ == "__main__":
    main()
