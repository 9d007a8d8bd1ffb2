"""The robot with its causes: base model and causes identified together by Ipopt, from the data of the evidence."""

from collections.abc import Sequence
from dataclasses import replace

from casadical.core.arrays import Array
from casadical.diagnosis.cross_validation import covariance
from casadical.diagnosis.linear_problem import Case
from casadical.effects import Effect
from casadical.identification.identification import Identification, identify
from casadical.measurements.derived_columns import derive
from casadical.measurements.kinds.position_covariance import PositionCovariance, typical_sigma, whitening
from casadical.measurements.measurements import Measurements
from casadical.measurements.noise import Noise


def refit(case: Case, effects: Sequence[Effect], noise: Noise, use: Array | None = None) -> Identification:
    """Base model and effects identified together: the evidence's model without its linearisation.

    The data, their noise and the priors are the evidence's: positions of the poses that are no outliers, the sigma
    that the diagnosis found, base parameters that depart from the robot that was given. It starts from the base model
    calibrated on all poses, whichever are used: what loads a joint shows nothing while the joint's compliance is zero,
    and the optimum does not depend on the start.
    effects : with their settings (knee, lag, cycles), which stay; their parameters are free
    use : mask over the kept poses of those to identify from, all by default
    """
    m = refit_measurements(case, effects, noise)
    m = m if use is None else m[use]
    free = ("kinematic", "compliance", *case.free, *dict.fromkeys(e.label for e in effects))
    priors = _priors(case) | _priors_of_effects(case, effects)
    return identify(case.robot.with_effect(*effects), m, free, priors=priors, prior=case.prior)


def _priors(case: Case) -> dict[str, tuple[float, float]]:
    """Mean and one sigma of the evidence's prior of each base parameter; the base frame stays where it was placed."""
    values = zip(case.given.parameters.values.tolist(), case.whole.prior.tolist(), strict=True)
    priors = zip(case.given.parameters.names, values, strict=True)
    own = {name: prior for name, prior in priors if not name.startswith("base_")}
    return {name: prior for name, prior in own.items() if name not in case.prior.means}


def _priors_of_effects(case: Case, effects: Sequence[Effect]) -> dict[str, tuple[float, float]]:
    """Mean and one sigma of the effects' parameters where these are larger than usual."""
    if case.growth == 1.0:
        return {}
    found: dict[str, tuple[float, float]] = {}
    for effect in (e for e in effects if e in case.columns):
        columns = case.columns[effect]
        sigma = case.sizes(columns) * case.whole.width_in_model(columns)
        names = (p.name for p in effect.parameters())
        found |= {name: (0.0, float(s)) for name, s in zip(names, sigma, strict=True)}
    return found


def refit_measurements(case: Case, effects: Sequence[Effect], noise: Noise) -> Measurements:
    """Kept poses as positions, with every column that the effects need, and the noise that was found.

    Instrument and joint repeatability together are a covariance at each pose.
    """
    m, _ = derive(case.m, [c for e in effects for c in e.conditions])
    C = covariance(case.whole, noise)[case.kept]
    m = replace(m.positions_alone()[case.kept], kind=PositionCovariance.name, extra={"whitening": whitening(C)})
    return replace(m, sigma=typical_sigma(C))
