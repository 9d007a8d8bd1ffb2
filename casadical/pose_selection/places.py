"""Where to put the anchors of wires, or sockets, and which poses to read then: chosen in turn."""

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from casadical.core.basics import Array
from casadical.measurements.noise import Noise
from casadical.pose_selection.candidates import Circumstances, reached
from casadical.pose_selection.design_problem import prepare
from casadical.pose_selection.information import Criterion
from casadical.pose_selection.instruments import Instrument, best_places
from casadical.pose_selection.pose_search import select_poses
from casadical.pose_selection.selection import Selection
from casadical.pose_selection.workspace import Workspace
from casadical.robot.robot import Robot

# Random poses on which the first places are judged, and how often places are chosen again for the poses.
POOL, ROUNDS = 300, 3


def place_instrument(
    robot: Robot,
    kind: Literal["wires", "sockets"],
    places: Array,
    count: int,
    *,
    known: bool = False,
    workspace: Workspace | None = None,
    q: Array | None = None,
    free: Iterable[str] | None = None,
    task: Array | None = None,
    noise: Noise | None = None,
    seed: int = 0,
) -> Instrument:
    """The places, of those given, from which readings at random poses determine the robot best.

    robot : base and tool as far as they are known
    kind : as of `Instrument`
    places : shape (K, 3) [m]: candidates, in the measuring frame
    count : how many are wanted
    known : whether they will be measured, too
    workspace : which poses can be measured
    q : shape (n, joints) [rad or m]: poses that will be read by wires; None: random ones
    free : as of `select_poses`
    task : shape (T, joints) [rad or m]: as of `select_poses`
    noise : of a distance, or of a coordinate in a socket
    seed : of the random generator
    Raises InputError: too few candidates, or a socket out of reach.

    Examples
    --------
    >>> corners = np.array([[1.0, 1.0, 0.5], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0]])
    >>> casadical.pose_selection.place_instrument(robot, "wires", corners, 2).places.shape
    (2, 3)
    """
    room, rng = workspace or Workspace(), np.random.default_rng(seed)
    if kind == "sockets":
        places = reached(robot, places, count, room, rng)
    noise, every = noise or Noise(), Instrument(kind, places, known)
    size = max(POOL, 4 * len(places))
    problem = prepare(
        robot, size, "V", candidates=q, workspace=room, circumstances=Circumstances(),
        measured=None, free=free, interest=(), task=task, noise=noise, pool=size,
        rng=rng, instrument=every,
    )  # fmt: skip
    p = len(problem.names)
    best = best_places(
        robot, kind, places, count, known, problem.names, problem.pool.measurements(robot), noise,
        problem.weight[:p, :p],
    )  # fmt: skip
    return Instrument(kind, places[best], known)


def select_with_places(
    robot: Robot,
    n: int,
    criterion: Criterion,
    kind: Literal["wires", "sockets"],
    places: Array,
    count: int,
    *,
    known: bool = False,
    workspace: Workspace | None = None,
    free: Iterable[str] | None = None,
    noise: Noise | None = None,
    seed: int = 0,
    **options: Any,
) -> Selection:
    """Places and poses in turn, until the places stay or the expected error grows; arguments as of `select_poses`."""
    best: Selection | None = None
    q = None
    for _ in range(ROUNDS):
        instrument = place_instrument(
            robot, kind, places, count, known=known, workspace=workspace, q=q, free=free, noise=noise, seed=seed
        )
        if best is not None and best.instrument and np.array_equal(best.instrument.places, instrument.places):
            break
        chosen = select_poses(
            robot, None, n, criterion, workspace=workspace, free=free, noise=noise, seed=seed, instrument=instrument,
            **options,
        )  # fmt: skip
        if best is not None and chosen.accuracy >= best.accuracy:
            break
        best = chosen
        if kind == "sockets":
            break
        q = chosen.q
    assert best is not None
    return best
