"""Quantiles that the standard library does not have."""

from statistics import NormalDist


def student_t(probability: float, degrees_of_freedom: int) -> float:
    """Quantile of Student's t distribution, by the Cornish-Fisher series (Abramowitz and Stegun 26.7.5).

    Accurate to 0.5 % from 3 degrees of freedom at 97.5 %, to 1e-5 from 15.
    """
    z, n = NormalDist().inv_cdf(probability), max(1, degrees_of_freedom)
    g1 = (z**3 + z) / 4
    g2 = (5 * z**5 + 16 * z**3 + 3 * z) / 96
    g3 = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    g4 = (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160
    return z + g1 / n + g2 / n**2 + g3 / n**3 + g4 / n**4
