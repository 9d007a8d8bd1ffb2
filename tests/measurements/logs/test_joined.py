"""Several logs of one arm as one: runs are numbered on, and channels that one of them lacks are left out."""

import numpy as np
import pytest

from casadical import InputError
from casadical.measurements.logs.log import JointLog, joined


def log(names=("a", "b"), runs=(1, 1, 2, 2), **more):
    position = np.arange(len(runs) * len(names), dtype=float).reshape(len(runs), -1)
    return JointLog(np.array([0.0, 1.0, 0.0, 1.0]), names, position, position + 1, run=np.array(runs), **more)


def test_runs_are_numbered_on_and_missing_channels_left_out():
    one, other = log(torque=np.ones((4, 2)), source="one"), log(runs=(3, 3, 7, 7), findings=("odd",), source="other")
    both = joined([one, other])
    assert (len(both), both.source, both.findings) == (8, "one, other", ())
    assert both.torque is None
    assert [tuple(run.position[:, 0]) for run in both.runs()] == [(0, 2), (4, 6)] * 2
    assert len(set(both.run.tolist())) == 4
    with pytest.raises(InputError, match="other: joints c, d; one: a, b"):
        joined([one, log(names=("c", "d"), source="other")])
