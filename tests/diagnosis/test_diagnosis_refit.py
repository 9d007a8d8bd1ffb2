"""The robot with its causes: one recipe for users, exports and the blind check, with the evidence's data and priors."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from cases import PRACTICE, ROOT, diagnosed, practice, robot

from casadical.blind_check import prediction
from casadical.core.basics import Array
from casadical.diagnosis.refit import refit
from casadical.export.model_file import robot_to_write
from casadical.identification.accuracy import predicted
from casadical.identification.identification import identify
from casadical.measurements.derived_columns import derive
from casadical.robot.robot import Robot
from casadical.robot.robot_file import to_toml


class Recorded(prediction.Session):
    """A session without unseen poses that keeps the robots which were to predict them."""

    def at_unseen(self, robot: Robot) -> Array:
        ROBOTS[self.name] = robot
        return np.zeros((0, 3))


ROBOTS: dict[str, Robot] = {}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hh800-P01", "kr210-P02"])
def test_user_export_and_blind_check_have_the_same_robot(name: str) -> None:
    """Three ways to the robot with its causes: `apply`, the MJCF of a campaign, the predictor of a blind check."""
    found, folder = diagnosed(name), ROOT / "problems" / name.split("-")[0]
    applied = found.apply()
    exported = robot_to_write(folder, PRACTICE / f"{name}.csv")
    table = pd.read_csv(PRACTICE / f"{name}.csv")
    s = prediction.session(name, to_toml(robot(name.split("-")[0])), table, table[:0])
    prediction.diagnosis(Recorded(s.name, s.robot, s.everything, s.seen))
    m, _ = derive(practice(name), applied.conditions)
    there = predicted(applied, m)[0]
    assert np.abs(there - predicted(exported, m)[0]).max() < 1e-9
    if applied.effects:  # the predictor shows the base model where there is no cause
        assert np.abs(there - predicted(ROBOTS[name], m)[0]).max() < 1e-9
        assert np.abs(there - predicted(found.identification.robot, m)[0]).max() > 1e-6


def test_refit_has_the_priors_of_the_evidence() -> None:
    """The optimum's gradient, from the data and from the robot that was given, by differences of our own."""
    found = diagnosed("ur10e-P03")
    fit = found.refit()
    given = found.case.given
    assert "c5" in fit.names
    at_optimum = fit.robot

    def cost(values: dict[str, float]) -> float:
        moved = at_optimum.with_values(values)
        m = fit.measurements[0]
        total = ((predicted(moved, m)[0] - m.position) ** 2).sum() / found.noise.sigma**2
        for p, sigma in zip(given.parameters, found.case.base.prior, strict=True):
            if p.name in fit.names and not p.name.startswith("base_"):
                total += ((moved.parameters[p.name].value - p.value) / sigma) ** 2
        return float(total) / 2

    for name in ("c2", "c5", "theta5", "d4"):
        k = fit.names.index(name)
        value, error = fit.estimate[k], fit.standard_errors[k]
        up, down = (cost({name: value + step * error}) for step in (0.5, -0.5))
        # At an optimum of this cost, steps of half a standard error cost alike either way.
        assert up > cost({}) < down
        assert abs(up - down) < 0.02 * (up + down - 2 * cost({}))
    wide = identify(found.case.robot.with_effect(*found.effects()), fit.measurements[0], fit.names, priors=True)
    assert wide.standard_errors[wide.names.index("c5")] > fit.standard_errors[fit.names.index("c5")]


def test_refit_leaves_out_outliers() -> None:
    found = diagnosed("ur10e-P06")
    kept = np.arange(len(found.case.m)) != 3
    case = replace(found.case, kept=found.case.kept & kept)
    wild = replace(case.m, position=case.m.position + np.where(kept, 0.0, 0.01)[:, None])
    first, second = (refit(replace(case, m=m), found.effects(), found.noise).robot for m in (case.m, wild))
    assert first.parameters.values == pytest.approx(second.parameters.values, abs=1e-12)
