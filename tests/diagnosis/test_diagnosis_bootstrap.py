"""The bootstrap of noise alone: the same odds as the full judgement, chance-level p-values, reproducible."""

from dataclasses import replace

import numpy as np
import pytest
from cases import case, diagnose, practice, robot

from casadical import InputError
from casadical.diagnosis import bootstrap
from casadical.diagnosis.posterior import rank

NOTHING = np.zeros(0, dtype=np.int64)
FEW = ("backlash@2", "friction_windup@2", "gear_eccentricity@3")


def odds_in_full(c, r: np.ndarray) -> float:
    """Log odds of some cause by the judgement that a diagnosis makes, for another residual."""
    e = replace(c.evidence, r=r, delta0=np.zeros_like(c.evidence.delta0))
    none = rank(replace(c, whole=e, kept=np.ones(len(r), dtype=bool)), NOTHING).none
    return float(np.log1p(-none) - np.log(none))


def test_odds_of_noise_are_those_of_the_full_judgement() -> None:
    """But for sizes of noise that the data exclude, which are left out."""
    c = case("kr210-P08", *FEW)
    share = np.exp(c.evidence.log_base() - np.logaddexp.reduce(c.evidence.log_base(), axis=None))
    drawn = bootstrap.noise_alone(c.evidence, share, 6, np.random.default_rng(3))
    (odds,) = bootstrap.noise_odds(c, 6, np.random.default_rng(3))
    assert odds == pytest.approx([odds_in_full(c, r) for r in np.moveaxis(drawn, 2, 0)], abs=0.2)


def test_p_value_counts_draws_beyond_the_data() -> None:
    c = case("kr210-P08", *FEW)
    ranking = rank(c, NOTHING)
    heard: list[str] = []
    p = bootstrap.p_value(c, ranking, 700, 0, heard.append)
    assert p == bootstrap.p_value(c, ranking, 700, 0, heard.append)
    assert 0.05 < p <= 1
    assert len(heard) == 4
    assert bootstrap.p_value(c, replace(ranking, none=1e-12), 100, 0, heard.append) == pytest.approx(1 / 101)


@pytest.mark.slow
def test_diagnosis_with_a_bootstrap() -> None:
    d = diagnose(robot("ur10e"), practice("ur10e-P06"), ["friction_windup", "backlash"], bootstrap=200)
    assert d.p_nothing == pytest.approx(1 / 201)
    assert d.verdict == "explained"
    d = diagnose(robot("kr210"), practice("kr210-P08"), list(FEW), bootstrap=200)
    assert d.p_nothing > 0.01
    assert d.verdict == "none"


def test_interrupted_bootstrap_leaves_nothing_behind() -> None:
    c = case("kr210-P08", *FEW)
    ranking = rank(c, NOTHING)

    def stop(_text: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bootstrap.p_value(c, ranking, 700, 0, stop)
    assert rank(c, NOTHING).none == ranking.none


def test_negative_number_of_draws_is_refused() -> None:
    with pytest.raises(InputError, match="bootstrap is -1"):
        diagnose(robot("kr210"), practice("kr210-P08"), list(FEW), bootstrap=-1)
