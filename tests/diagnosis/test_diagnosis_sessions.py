"""Campaigns of two sessions: what changed between them is a cause."""

from dataclasses import replace

import numpy as np
from cases import diagnose, robot, simulated

from casadical.core.parts import Sessions
from casadical.core.transforms import frame, from_rpy
from casadical.measurements.measurements import Measurements


def in_two_sessions(m: Measurements, moved: np.ndarray) -> Measurements:
    """The second half of a campaign measured from another place; moved : (4, 4) of the instrument."""
    later = np.arange(len(m)) >= len(m) // 2
    p = np.where(later[:, None], m.position @ moved[:3, :3].T + moved[:3, 3], m.position)
    return replace(m, position=p, conditions={**m.conditions, "session_a": 1.0 - later, "session_b": 1.0 * later})


def test_base_and_tool_of_each_session_are_part_of_the_base_model() -> None:
    far = frame(from_rpy(np.array([0.0, 0.0, 1.2])), np.array([1.5, -0.4, 0.2]))
    d = diagnose(robot("ur10e"), in_two_sessions(simulated("ur10e", 21, n=70), far), ["backlash", "joint_zero_step"])
    assert (d.verdict, d.causes) == ("none", ())
    assert "session_b.x" in d.case.given.parameters.names


def test_a_moved_foot_is_a_cause_where_the_base_is_said_to_be_shared() -> None:
    near = frame(from_rpy(np.array([2e-4, -1e-4, 1e-4])), np.array([1e-4, 2e-4, -1e-4]))
    shared = replace(robot("ur10e"), sessions=Sessions("shared", "shared", "shared"))
    d = diagnose(shared, in_two_sessions(simulated("ur10e", 21, n=70), near))
    assert (d.verdict, [c.label for c in d.causes]) == ("explained", ["frame_step"])
