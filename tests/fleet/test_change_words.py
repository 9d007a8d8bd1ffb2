"""What a change is said to mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadical.fleet import Candidate, Change
from casadical.fleet.candidates import FREQUENCY
from casadical.fleet.comparison import _courses
from casadical.fleet.meaning import MEANT

ZERO = Candidate("joint_zero", 2, ("theta2",), np.ones((1, 1)), np.array([3e-4]))
JUMP = Change(ZERO, "jump", 1, (1, 1), 1.0, 1.0, 9.0, (), (), np.zeros((2, 2)))


def test_a_drift_of_a_zero_is_no_crash() -> None:
    assert JUMP.words == "the zero of joint 2 is another: a crash, a slipped belt or a lost reference"
    drift = replace(JUMP, course="drift").words
    assert "crash" not in drift
    assert "wear" in drift


def test_each_kind_of_change_has_words_for_the_courses_that_it_may_have() -> None:
    for kind in FREQUENCY:
        possible = {course for course, *_ in _courses(kind, np.arange(4) / 12, dated=True)}
        assert possible == {course for course, words in MEANT.items() if kind in words}
