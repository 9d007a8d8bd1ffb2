"""python docs/studies/correction_steps.py [POSES] > docs/studies/correction_steps.txt (default: 20,000 poses; minutes)

What remains of the tool's error after the exported correction, by steps, number type, and whether the orientation is
corrected too. Five robots of `problems` with planted errors in every length, angle
and spring (synthetic), random poses anywhere within the joint limits. The correction is the reference that every
exported C equals bit for bit; errors are of the robots' models in double. "ok": share of status OK; errors are of these
poses: 99 % below, and the largest.
"""

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "export" / "controller"))

from controller_arms import nominal_path, planted  # noqa: E402

from casadical.export import Sources, Status, command_of  # noqa: E402
from casadical.export.c.c_source import inside  # noqa: E402
from casadical.export.c.products import mapped  # noqa: E402
from casadical.export.c.reference import correct  # noqa: E402
from casadical.export.c.tape_program import tape_program  # noqa: E402

NAMES = ("ur10", "hh800", "kr210", "ur10e", "panda_1")
TARGETS = {2: 20.0, 3: 1.0}  # um: after two steps, and after three in float


def case(name, steps, kind, orientation, poses):
    """Mean error before [mm], share OK, and of OK poses: 99 % and largest error [um], largest of orientation [urad]."""
    command = command_of(Sources(planted(name), nominal_path(name)), steps, orientation=orientation)
    program = tape_program(command, kind)
    q = inside(program, poses)
    dq, status = correct(program, q)
    exact, ok = q.astype(float), status == Status.OK
    wanted, before = mapped(command.nominal, exact), mapped(command.calibrated, exact)
    after = mapped(command.calibrated, exact + dq.astype(float))
    start = np.linalg.norm((before - wanted)[:, :3], axis=1)
    rest = 1e6 * np.linalg.norm((after - wanted)[ok, :3], axis=1)
    turned = 1e6 * np.linalg.norm((after - wanted)[ok, 3:], axis=1).max(initial=0.0) / np.sqrt(2)
    return 1e3 * float(np.nanmean(start)), float(ok.mean()), float(np.quantile(rest, 0.99)), float(rest.max()), turned


if __name__ == "__main__":
    poses = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    print(f"{poses} poses a row; targets of the largest: 20 um after two steps, 1 um after three in float")
    print("robot    reaches   type    before, mm  steps     ok   99 %, um  largest, um  orientation, urad")
    for name in NAMES:
        for orientation in (False, True):
            for kind in ("double", "float"):
                for steps in (1, 2, 3):
                    start, ok, usual, most, turned = case(name, steps, kind, orientation, poses)
                    target = TARGETS.get(steps, np.inf) if steps < 3 or kind != "double" else np.inf
                    print(
                        f"{name:8} {'pose' if orientation else 'position':9} {kind:7} {start:10.2f} {steps:6d}{ok:8.2%}"
                        f"{usual:11.4f} {most:12.4f} {f'{turned:12.2f}' if orientation else '':12}"
                        f"{'' if most <= target else '  MISSED'}".rstrip(),
                        flush=True,
                    )
