"""Campaigns of one robot in files, and their order in time.

A campaign is a robot file, a folder of results, a problem folder or a table of measurements.
"""

import os
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import date
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from casadical.core.basics import CasadicalError, InputError, Show, shown, silent
from casadical.core.reading import missing, read_bytes
from casadical.core.reporting.result import plain_text
from casadical.fleet.changes import Comparison
from casadical.fleet.comparison import compare
from casadical.fleet.estimates import Estimate, estimate, estimate_of_file
from casadical.identification.prior import refuse_another
from casadical.project.acceptance.verification import promised_rms, verify
from casadical.project.problem import read_campaign, read_campaign_robot, read_problem, tool_as_measured
from casadical.project.problem_file import own_tables, result_in
from casadical.project.targets import with_targets_of_rows
from casadical.robot.robot import Robot
from casadical.robot.robot_file import read_robot

# Name of the folder of a problem's later campaigns.
CAMPAIGNS_FOLDER = "campaigns"
# Type of the items of `without_copies`.
Item = TypeVar("Item")


def compare_files(
    paths: Sequence[str | Path],
    robot: str | Path | None = None,
    *,
    same_tool: bool = False,
    same_frame: bool = False,
    show: Show = silent,
) -> Comparison:
    """Return what changed in a robot between campaigns in files.

    They are ordered by their dates, or else as they are given.

    paths : robot files with a covariance, folders of results, problem folders, or tables of
        measurements; or one problem folder, whose later campaigns are the tables in its folder
        `campaigns`
    robot : problem folder or robot file by which tables are understood; None: the first of `paths`
        that is no table
    same_tool : whether the same point of the same tool was measured, so that a tool that moved is a
        change
    same_frame : whether all positions are in one measuring frame, so that a base that moved is a
        change
    show : function that is called with each line of progress
    Returns what changed; of three campaigns or more, unusable ones are dropped and named in its
    notes
    Raises InputError: fewer than two campaigns that can be used, with what is wrong in them; a
    robot without tables.

    Examples
    --------
    >>> casadical.compare_files(["problems/planar", "problems/planar"]).changed
    False
    """
    files, begun, day = [Path(path) for path in paths], None, None
    if len(files) == 1 and (files[0] / CAMPAIGNS_FOLDER).is_dir():
        begun = files[0]
        later, day = later_tables(begun)
        files = [begun, *later]
    if robot and all(path.is_dir() or path.suffix in (".toml", ".urdf") for path in files):
        raise InputError("--robot is that by which tables are understood, and none is given; leave it out")
    # Tables are read with the robot and columns of the first campaign that is none.
    robots = (f for f in files if f.suffix in (".toml", ".urdf") or f.is_dir())
    own = next(robots, None)
    arm = robot or (result_in(own) if own and own.is_dir() and not (own / "problem.toml").exists() else own)
    estimates = estimates_of(files, arm, show)
    usable = [e for e in estimates if isinstance(e, Estimate)]
    errors = [(path, e) for path, e in zip(files, estimates, strict=True) if isinstance(e, CasadicalError)]
    if errors and len(files) == 2:
        path, error = errors[0]
        if arm is not None and Path(arm).suffix == ".toml" and "numbers were measured" in str(error):
            with suppress(CasadicalError):
                found = plain_text(verify(arm, [path]).blocks()[:1]).strip()
                error = InputError(
                    f"{shown(path)}: too few poses to tell what changed; they tell how accurate the robot "
                    f"is (casadical verify {shown(arm)} {shown(path)}): {found}"
                )
        raise error
    faults = [f"{shown(path)} is left out: {error}" for path, error in errors]
    if len(usable) < 2:
        where = (
            "; ".join(faults) or f"Give more, or a problem folder with later tables in its folder {CAMPAIGNS_FOLDER}."
        )
        raise InputError(f"{len(usable)} of {len(files)} campaigns can be used; two are needed. {where}")
    if day is not None and isinstance(estimates[0], Estimate):
        usable[0] = replace(usable[0], day=day)
    ordered, said = in_order(usable, begun=begun is not None)
    show("what changed")
    notes = (*faults, *said, *other_regions(ordered))
    compared = compare(ordered, same_tool=same_tool, same_frame=same_frame, notes=notes)
    path_of = {e.label: path for path, e in zip(files, estimates, strict=True) if isinstance(e, Estimate)}
    last = path_of[ordered[-1].label]
    sources = (Path(arm), last) if arm and last.is_file() and last.suffix != ".toml" else ()
    return replace(compared, name=name_of(files, begun or robot), sources=sources)


def later_tables(folder: Path) -> tuple[list[Path], float | None]:
    """Return the tables in a problem's folder `campaigns`, and the day of the problem's own table.

    Copies of the own table are not returned. The day is that in the name of the last copy, in days
    since 1970; None without one.
    """
    own = {read_bytes(table) for table in own_tables(folder)}
    tables = sorted((folder / CAMPAIGNS_FOLDER).glob("*.csv"))
    copies = [path for path in tables if path.is_file() and read_bytes(path) in own]
    return [path for path in tables if path not in copies], next((day_of(path) for path in reversed(copies)), None)


def estimates_of(
    paths: Sequence[Path], robot: str | Path | None = None, show: Show = silent
) -> list[Estimate | CasadicalError]:
    """Return for each campaign its estimate, or the error because of which it cannot be used.

    paths : campaigns
    robot : problem folder or robot file with whose robot and columns tables are read
    """
    estimates: list[Estimate | CasadicalError] = []
    for k, path in enumerate(paths, 1):
        show(f"campaign {k} of {len(paths)}")
        try:
            first = next((e.robot for e in estimates if isinstance(e, Estimate)), None)
            estimate = campaign_estimate(path, robot, first)
            if first:
                refuse_another(first, estimate.robot, "campaign")
            estimates.append(estimate)
        except CasadicalError as error:
            estimates.append(error)
    return estimates


def name_of(paths: Sequence[Path], robot: str | Path | None = None) -> str:
    """Return the name of the folder that holds a robot's campaigns, or of its problem folder.

    The latter is returned if the campaigns are in the current folder or inside the problem folder.

    paths : campaigns
    robot : problem folder or robot file; None: unknown
    """
    folder = Path(os.path.commonpath([(p if p.is_dir() else p.parent).resolve() for p in paths]))
    folder = folder.parent if folder.name == CAMPAIGNS_FOLDER else folder
    if robot is None:
        return folder.name
    problem = Path(robot).resolve()
    problem = problem.parent if problem.is_file() else problem
    return problem.name if folder == Path.cwd() or folder.is_relative_to(problem) else folder.name


def campaign_estimate(path: Path, robot: str | Path | None = None, other: Robot | None = None) -> Estimate:
    """Return the estimate of one campaign. Raises CasadicalError: it cannot be used.

    path : robot file, folder of results, problem folder or table
    robot : problem folder or robot file with whose robot and columns a table is read
    other : robot of another campaign, whose targets (points on the tool) replace those of `robot`
    """
    if not path.exists():
        raise missing(path, "file or folder")
    label, day = path.name.removesuffix(".robot.toml").removesuffix(".csv"), day_of(path)
    if path.suffix == ".toml":
        label = path.parent.name if label in ("KM", "SKCM", "diagnosed", "discovered") else label
        return _estimate_of_file(path, label or path.name, day)
    if (path / "problem.toml").exists():
        problem = read_problem(path, campaign=True)
        if fault := problem.unnamed_targets:
            raise InputError(fault)
        own = day_of(Path(Path(str(problem.tables[0]["file"])).name)) if problem.tables else None
        day = day_of(problem.folder.resolve()) if own is None else own
        return estimate((problem.robot, [m for _, m in problem.parts()]), label, day)
    if path.is_dir():
        return _estimate_of_file(result_in(path), label, day)
    if robot is None:
        raise InputError(f"{shown(path)}: a table needs --robot, the problem folder by which it is understood")
    arm = read_campaign_robot(robot)
    if other and other.targets:
        arm = replace(arm, tool=other.tool, tool_name=other.tool_name, targets=other.targets)
    m = read_campaign(robot, path, arm, later=True)
    arm, sets, notes = with_targets_of_rows(tool_as_measured(arm, Path(robot), [m]), [m])
    estimated = estimate((arm, sets), label, day)
    return replace(estimated, notes=(*estimated.notes, *notes))


def _estimate_of_file(path: Path, label: str, day: float | None) -> Estimate:
    """Return the estimate of a robot file, and the error of held-out poses in its folder."""
    found = estimate_of_file(read_robot(path), label, day)
    with suppress(InputError):
        rms, poses = promised_rms(path)
        return replace(found, held_out=(float(rms / np.sqrt(3)), poses or found.poses // 3))
    return found


def other_regions(campaigns: Sequence[Estimate]) -> list[str]:
    """Return a list of one sentence on campaigns that cover other joint ranges than the first one.

    It is empty if there are none. Where the ranges differ, errors of the model differ too and may
    look like a change.
    """
    said, first = [], campaigns[0]
    for other in campaigns[1:]:
        if first.readings is None or other.readings is None:
            continue
        (a, b), (c, d) = first.readings.T, other.readings.T
        shared = (np.minimum(b, d) - np.maximum(a, c)) / np.maximum(np.maximum(b, d) - np.minimum(a, c), 1e-9)
        # A joint's range counts as another one if less than half of it is shared.
        if few := [f"joint {j + 1}" for j in np.flatnonzero(shared < 0.5)]:
            said.append(f"{other.label} ({', '.join(few)})")
    if not said:
        return []
    more = f" and {len(said) - 3} more" if len(said) > 3 else ""
    return [
        f"other regions of the joints than in {first.label} were measured in "
        f"{', '.join(said[:3])}{more}: errors that the model leaves there may look like a change; "
        "measure the same poses in each campaign"
    ]


def day_of(path: Path) -> float | None:
    """Return the first date in a file's or else its folder's name, in days since 1970, or None.

    A month without a day counts as its first day.
    """
    # Pattern of a date in a file's name: 2026-03-14, 2026_03_14, 20260314 or 2026-03. A clock that
    # was not set gives 1970.
    date_pattern = re.compile(r"(?<!\d)(1970|20\d\d)[-_.]?([01]\d)(?:[-_.]?([0-3]\d))?(?!\d)")
    # Proleptic Gregorian ordinal of 1970-01-01, from which days are counted [d].
    epoch_ordinal = date(1970, 1, 1).toordinal()
    for name in (path.name, path.parent.name):
        for year, month, day in date_pattern.findall(name):
            with suppress(ValueError):
                return float(date(int(year), int(month), int(day or 1)).toordinal() - epoch_ordinal)
    return None


def in_order(given: Sequence[Estimate], *, begun: bool = False) -> tuple[list[Estimate], list[str]]:
    """Return the campaigns in the order of time, without copies, and sentences on what is unusual.

    If the day of any is unknown, they stay in the given order and all days are dropped.

    begun : whether the first one is certainly the earliest; it then stays first without a day
    """

    def same(a: Estimate, b: Estimate) -> bool:
        """Return whether two campaigns are copies: equal values and information."""
        return np.array_equal(a.values, b.values) and np.array_equal(a.information, b.information)

    campaigns, copies = without_copies(given, same)
    alike = "is left out: the same measurements as"
    said = [f"{c.label} {alike} {k.label}, to the last digit" for c, k in copies]
    if copies and len(campaigns) == 1:
        campaigns = list(given)
        said = ["all campaigns are the same measurements, to the last digit: no change can be seen"]
    if begun and len(campaigns) > 1 and campaigns[0].day is None:
        later, more = in_order(campaigns[1:])
        return [campaigns[0], *later], [*said, *more]
    names = {c.robot.name for c in campaigns}
    if len(names) > 1:
        said.append(f"the robot is called {' and '.join(sorted(map(repr, names)))}: taken for one, renamed")
    days = [c.day for c in campaigns]
    if len(days) == 1:
        return campaigns, said
    dated = [d for d in days if d is not None]
    if not dated:
        return campaigns, [*said, "no dates in the names: the campaigns are in the order given"]
    if len(dated) < len(days):
        lost = ", ".join(c.label for c in campaigns if c.day is None)
        said.append(
            f"no date in the name of {lost}: the campaigns are in the order given, and dates are "
            "not used; put the day into the name of the table (2026-03-14.csv)"
        )
        return [replace(c, day=None) for c in campaigns], said
    if dated != sorted(dated):
        back = [f"{a.label}, then {b.label}" for a, b in pairwise(campaigns) if (a.day or 0) > (b.day or 0)]
        said.append(f"dates go back ({'; '.join(back[:3])}): the campaigns are put in the order of their dates")
    ordered = sorted(campaigns, key=lambda c: c.day or 0.0)
    steps = np.diff(sorted(dated))
    twice = [b.label for b, step in zip(ordered[1:], steps, strict=True) if step == 0]
    if twice:
        said.append(f"two campaigns of one day, both used: {', '.join(twice)}")
    for (a, b), step in zip(pairwise(ordered), steps, strict=True):
        # Two campaigns more than three years [d] apart more likely have a wrong date than a pause.
        if step > 1100.0:
            said.append(
                f"{b.label} is {step / 365.25:.1f} years after {a.label}, by their names: if a "
                "clock was wrong, rename the file; drifts are counted in these years"
            )
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    # Campaigns seem to be missing where a gap is more than 1.75 times the median one.
    far = (step > 1.75 * usual > 0 for step in steps)
    gaps = [(a.label, b.label) for (a, b), gap in zip(pairwise(ordered), far, strict=True) if gap]
    if len(ordered) > 3 and gaps:
        listed = ", ".join(f"{a} and {b}" for a, b in gaps[:3])
        said.append(f"campaigns seem to be missing between {listed}; a change there is dated to the later one")
    return ordered, said


def without_copies(
    items: Iterable[Item], same: Callable[[Item, Item], bool]
) -> tuple[list[Item], list[tuple[Item, Item]]]:
    """Return the items without copies, and a pair (copy, item that it repeats) for each copy.

    The first of equal items counts as the original.

    same : function that returns whether two items are equal
    """
    distinct: list[Item] = []
    copies: list[tuple[Item, Item]] = []
    for item in items:
        first = next((k for k in distinct if same(k, item)), None)
        if first is None:
            distinct.append(item)
        else:
            copies.append((item, first))
    return distinct, copies
