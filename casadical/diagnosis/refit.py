"""Nonlinear refit: base model and causes identified together by Ipopt."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadical.core.basics import Array
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.observations import row_slices, scales_of, with_combined_conditions
from casadical.effects import Effect
from casadical.identification.identification import calibrated, prepare
from casadical.identification.residuals import make_block
from casadical.identification.result import Identification
from casadical.measurements.derived_columns import derive
from casadical.measurements.kinds.position import PositionCovariance, typical_sigma, whitening
from casadical.measurements.kinds.registry import find_kind
from casadical.measurements.measurements import Measurements, Noise


def refit(case: Case, effects: Sequence[Effect], noise: Noise, use: Array | None = None) -> Identification:
    """Return the identification of base model and effects together, without linearisation.

    Data, noise and priors are those of the case's linear model: inlier poses, the noise that the
    diagnosis found, priors of the base parameters centred at the given robot. It starts from the
    base model calibrated on all poses, whichever are used: loads on a joint are unobservable while
    its compliance is zero, and the optimum does not depend on the start.
    effects : effects whose parameters are free and whose settings (knee, lag, cycles) are fixed
    use : mask over the inlier poses of those that are used, shape (n_inliers,); None: all
    """
    sets = refit_measurements(case, effects, noise)
    sets = sets if use is None else selected_rows(sets, use[case.rows])
    free = ("kinematic", "compliance", *case.free, *dict.fromkeys(e.label for e in effects))
    return calibrated(prepare(case.robot.with_effect(*effects), sets, case.prior), free, priors=_priors(case, effects))


def _priors(case: Case, effects: Sequence[Effect]) -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation [SI] of the priors of the refit, by name of the parameter.

    They are those of base parameters, except placement of the base, rotation of the tool and
    parameters with a prior from another campaign; and of effects if `Case.growth` enlarges them.
    """
    base = case.given.parameters
    each = zip(base.names, base.values.tolist(), case.base.prior[: len(base.names)].tolist(), strict=True)
    priors = {
        name: (mean, sigma)
        for name, mean, sigma in each
        if not name.startswith(("base_", "tool_r")) and name not in case.prior.means
    }
    for effect in (e for e in effects if e in case.columns and case.growth != 1.0):
        columns = case.columns[effect]
        sigmas = (case.sizes(columns) * case.whole.cause_prior_sigmas[columns]).tolist()
        priors |= {p.name: (0.0, sigma) for p, sigma in zip(effect.parameters(), sigmas, strict=True)}
    return priors


def selected_rows(sets: Sequence[Measurements], use: Array) -> tuple[Measurements, ...]:
    """Return the sets restricted to selected rows; sets without any are omitted.

    use : mask over the rows of all sets in order, shape (rows,)
    """
    parts = [(m, use[at]) for m, at in zip(sets, row_slices(sets), strict=True)]
    return tuple(m[own] for m, own in parts if own.any())


def refit_measurements(case: Case, effects: Sequence[Effect], noise: Noise) -> tuple[Measurements, ...]:
    """Return the sets' inlier rows with the columns of the effects and the estimated noise.

    For a single set of positions, instrument and joint repeatability together give a covariance at
    each pose; else each set has one sigma, the rms of both over its numbers.
    """
    m, _ = derive(case.m, [c for e in effects for c in e.conditions], case.robot.loads)
    seen = case.observations
    if not seen.plain:
        return selected_rows(
            _with_sigmas(case, with_combined_conditions(seen.sets, m, seen.stops), noise), case.inliers[seen.stops.of]
        )
    C = case.whole.covariance(noise)[case.inliers]
    m = replace(m.positions_alone()[case.inliers], kind=PositionCovariance.name, extra={"whitening": whitening(C)})
    return (replace(m, sigma=typical_sigma(C)),)


def row_errors(found: Identification, sets: Sequence[Measurements], test: Array) -> Array:
    """Return the reported error of selected rows under an identification, shape (k,) [m].

    It is the norm of the length residuals. Unknown points are at the identification's estimates,
    not refitted to these rows.
    test : mask over the rows of all sets in order, shape (rows,)
    """
    where, errors = found.unknown_points, []
    for k, (every, at) in enumerate(zip(sets, row_slices(sets), strict=True)):
        m, kind = every[test[at]], find_kind(every.kind)
        if len(m):
            points = np.array([where[f"{k}/{name}"] for name in kind.point_names(m.arrays)]).reshape(-1, 3)
            block = make_block(found.robot, m, (), 1.0, 1.0, points, np.arange(len(m)))
            r, _ = block.evaluate(np.zeros(0), np.zeros((len(m), 3)))
            errors.append(np.linalg.norm(r[:, : kind.lengths], axis=1))
    return np.concatenate(errors)


def _with_sigmas(case: Case, sets: Sequence[Measurements], noise: Noise) -> list[Measurements]:
    """Return copies of the sets whose sigmas are the rms of the estimated noise.

    There is one `sigma` [m] and one `sigma_angle` [rad] for each set: the rms, over its measured
    numbers, of the noise of instrument and joint repeatability together.
    """
    seen = case.observations
    square = np.diagonal(case.whole.covariance(noise), axis1=1, axis2=2) * seen.measured
    given = []
    for k, (m, poses, places) in enumerate(zip(sets, seen.layout.poses, seen.layout.places, strict=True)):
        count = np.count_nonzero(seen.measured[poses, places])
        usual = float(np.sqrt(square[poses, places].sum() / max(1, count)))
        length, angle = (usual / scale for scale in scales_of(seen.sigmas, k))
        given.append(replace(m, sigma=length, sigma_angle=angle))
    return given
