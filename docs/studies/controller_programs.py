"""Run `python docs/studies/controller_programs.py [PROGRAMS [FORM [LANGUAGE]]]`: random programs, corrected.

KR 210 (KRL, RAPID, FANUC) and UR10 (URScript) with planted errors in every length, angle and spring (synthetic), two
tools and two bases. Per language and form: programs, targets, targets with each status, bytes changed outside of the
numbers of targets, and how far the real tool is off the nominal one before and after, by scipy: the pose that is
written is solved with the nominal robot near to the joints that the target was drawn with, and the real robot's tool
is at those joints. Programs have 6 to 18 targets, 40 % of them joints, in a random layout: order of data, spaces,
indents, comments, keywords, external axes that stand off zero (`--external-still`).
Default: 25 programs, `position` and `pose`, all languages.
"""

import re
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [
    str(ROOT / "tests" / "export" / "controller"),
    str(ROOT / "tests" / "export" / "controller" / "programs"),
]

import program_texts as texts  # noqa: E402
from controller_arms import nominal_path, planted, poses  # noqa: E402

from casadical.export import Sources  # noqa: E402
from casadical.export.controller.commands import in_own_frame  # noqa: E402
from casadical.export.controller.programs.correction import Cell  # noqa: E402
from casadical.export.controller.programs.program import corrected_program, read_target_program  # noqa: E402
from casadical.export.controller.programs.target import Given  # noqa: E402
from casadical.robot.robot_file import read_robot  # noqa: E402

SUFFIX = {"krl": ".dat", "rapid": ".mod", "urscript": ".script", "fanuc": ".ls"}
NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|'B[01]+'"


def robots(name):
    """Real and rigid nominal robot, both in the robot's own base frame, and both as given."""
    real, nominal = planted(name), read_robot(nominal_path(name))
    stiff = replace(nominal, joints=tuple(replace(j, compliance=None) for j in nominal.joints))
    return in_own_frame(real, nominal)[0], in_own_frame(stiff, nominal)[0], real, nominal


def drawn(language, robot, seed):
    rng = np.random.default_rng(seed)
    points = []
    for q in poses(robot, int(rng.integers(6, 19)), seed):
        tool, base = (0, 1) if language == "urscript" else rng.integers(2, size=2)
        points.append(texts.Point(q, bool(rng.random() < 0.4), int(tool), int(base)))
    held = [texts.held(robot, p.q, texts.matrix(texts.TOOLS[p.tool])) for p in points]
    return points, [np.linalg.inv(texts.matrix(texts.BASES[p.base])) @ T for p, T in zip(points, held, strict=True)]


def outside(old, new):
    """Bytes that differ where no number of a target stands: the texts between numbers, and lines without targets."""
    between = zip(re.split(NUMBER, old), re.split(NUMBER, new), strict=True)
    changed = sum(a != b for a, b in between)
    words = rb"XP\d+=|target|MoveL \[|p\[|movej\(\[|^\t"
    lines = zip(old.splitlines(), new.splitlines(), strict=True)
    return changed + sum(a != b for a, b in lines if not re.search(words, a))


def judged(language, points, in_base, content, result, real, nominal):
    """Off the nominal tool before and after [mm], of the corrected targets."""
    new, rows = result.content(), []
    for k, (point, _) in enumerate(zip(points, in_base, strict=True), 1):
        if texts.read(language, content, k, point.joints) == texts.read(language, new, k, point.joints):
            continue
        values, tool = texts.read(language, new, k, point.joints), texts.matrix(texts.TOOLS[point.tool])
        if point.joints:
            q = np.array(values) * (1 if language == "urscript" else np.pi / 180)
        else:
            T = texts.matrix(texts.BASES[point.base]) @ texts.pose_of(language, values)
            q = texts.joints_of(nominal, T, tool, point.q)
        wanted = texts.held(nominal, point.q, tool)
        pair = [texts.held(real, x, tool) for x in (point.q, q)]
        rows.append([1e3 * np.linalg.norm(T[:3, 3] - wanted[:3, 3]) for T in pair])
    return rows


def study(language, pose, count):
    real, nominal, *files = robots("ur10" if language == "urscript" else "kr210")
    cell = Cell(Sources(*files), steps=3, orientation=pose, external_still=True, leave_unreached=True)
    status, rows, changed = Counter(), [], 0
    for seed in range(count):
        points, in_base = drawn(language, nominal, 100 + seed)
        rng = np.random.default_rng(seed)
        content = texts.write(language, points, in_base, rng, "\r\n" if seed % 2 else "\n")
        content = texts.loosened(language, content, rng)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"p{SUFFIX[language]}"
            path.write_bytes(content)
            frames = [{str(k): texts.matrix(v) for k, v in enumerate(f, 1)} for f in (texts.TOOLS, texts.BASES)]
            program = read_target_program(path, Given(*frames) if language == "fanuc" else Given(), 6)
            result = corrected_program(program, cell)
        status.update(r.status for r in result.results)
        changed += outside(content, result.content())
        rows += judged(language, points, in_base, content, result, real, nominal)
    before, after = np.array(rows).T
    counts = ", ".join(f"{k} {v}" for k, v in status.most_common())
    print(f"{language}, {'pose' if pose else 'position'}: {count} programs, {status.total()} targets, {counts}; "
          f"changed outside of targets: {changed}")  # fmt: skip
    print(f"    position off the nominal tool's, mm: before {before.mean():.4f} mean, {before.max():.4f} max; "
          f"after {after.mean():.4f} mean, {after.max():.4f} max", flush=True)  # fmt: skip


if __name__ == "__main__":
    forms = sys.argv[2:3] or ["position", "pose"]
    for form in forms:
        for each in sys.argv[3:4] or SUFFIX:
            study(each, form == "pose", int(sys.argv[1]) if len(sys.argv) > 1 else 25)
