"""The joint error curves of a diagnosis, each with its band, its share and its lines; as rows and as plain data."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.linear_gaussian.fit import Fit
from casadical.diagnosis.cross_validation import new_fit
from casadical.diagnosis.line_search import Background, Line, Scan, Search, Whole
from casadical.diagnosis.linear_problem import Case
from casadical.diagnosis.result import Cause, Diagnosis
from casadical.diagnosis.structure import sines
from casadical.effects.joint_error_curve import JointErrorCurve
from casadical.measurements.measurements import Noise

# Highest frequency that may be asked for [cycles a turn].
MOST = 2000
# Joints are gone through so often, the lines of the others in the model as far as they are known.
SWEEPS = 2
# Multiples of a line of at least so many cycles a turn are its harmonics; so are its fractions.
MULTIPLES, LEAST_FUNDAMENTAL = (2, 3, 4, 5), 3.0
# Frequencies are the same within this, or within two standard errors, but never beyond the second [cycles a turn].
SAME, SAME_AT_MOST = 0.02, 0.1
# Reductions of strain-wave gears that are sold [turns of the motor a turn of the joint].
REDUCTIONS = (30, 50, 80, 100, 101, 120, 160)
# Points of a curve over a turn.
POINTS = 721


@dataclass(frozen=True, eq=False)
class JointCurve:
    """One joint's error as a function of its reading.

    angle : over a turn, shape (k,) [rad]; value, error : the curve there with its standard error, shapes (k,) [rad]
    covered : mask of the angles near which there are readings, shape (k,); elsewhere the prior alone holds the curve
    rms, rms_error : of the curve and of its standard error at the readings [rad]
    lost : log evidence that is lost without it; share : of what is lost by all joints
    middle : frequencies between which the middle half of the curve's square lies [cycles a turn]
    lines : the strongest first; scan : before any line was taken up
    """

    joint: int
    angle: Array
    value: Array
    error: Array
    covered: Array
    rms: float
    rms_error: float
    lost: float
    share: float
    middle: tuple[float, float]
    lines: tuple[Line, ...]
    scan: Scan


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Curves and lines of all joints in their order; orders : highest harmonic of the curves.

    joints : curve and lines of each
    """

    joints: tuple[JointCurve, ...]
    orders: int

    @property
    def suggestions(self) -> tuple[str, ...]:
        """What lines may come from, in sentences: no more than suggestions."""
        lines = [line for joint in self.joints for line in joint.lines]
        return (*_shared(lines), *_geared(lines))


def spectrum(found: Diagnosis, highest: float | None = None) -> Spectrum:
    """The curves and lines of a diagnosis that names joint_error_curve.

    highest : up to which frequency lines are looked for [cycles a turn]; the curves' highest harmonic by default.
        Beyond that, a line need not stand out of the curve, only of the noise
    Raises InputError: where no joint_error_curve is among the causes, and for a frequency that cannot be.
    """
    effect = curve_of(found.causes)
    if highest is not None and not 1 <= highest <= MOST:
        raise InputError(f"highest is {highest}; give cycles a turn from 1 to {MOST}")
    if effect is None:
        named = ", ".join(c.label for c in found.causes) or "none"
        raise InputError(f"no joint error curve was found, so there is no spectrum of one; causes: {named}")
    return spectrum_of(found.case, effect, found.columns, found.noise, highest)


def curve_of(causes: Sequence[Cause]) -> JointErrorCurve | None:
    """The joint error curve among causes, if there is one."""
    effects = (e for c in causes for e in c.effects)
    return next((e for e in effects if isinstance(e, JointErrorCurve)), None)


def spectrum_of(
    case: Case, effect: JointErrorCurve, columns: Array, noise: Noise, highest: float | None = None
) -> Spectrum:
    """The same of an effect in the model of a case.

    columns : of all causes, in order, shape (k,), as whole numbers; highest : see `spectrum`
    """
    e, q = case.evidence, case.m.q[case.kept]
    fit = new_fit(e, columns, noise, combined=False)
    place = e.model.base.shape[2] + np.searchsorted(columns, case.columns[effect])
    own = {j: place[part] for j, part in effect.parts.items()}
    units = {j: case.sizes(case.columns[effect][part]) for j, part in effect.parts.items()}
    lost = _evidence_lost(fit, own)
    lines, scans = _lines(fit, effect, own, q, e.Jq, highest, lost)
    total = sum(max(v, 0.0) for v in lost.values()) or 1.0
    angle, orders = np.linspace(-np.pi, np.pi, POINTS), range(1, effect.orders + 1)
    joints = []
    for j, places in own.items():
        x, cov = fit.x[places], fit.covariance[np.ix_(places, places)]
        value, error = _valued(sines(angle, orders) * units[j], x, cov)
        there, band = _valued(sines(q[:, j - 1], orders) * units[j], x, cov)
        square = ((x * units[j]) ** 2).reshape(-1, 2).sum(axis=1).cumsum()
        low, high = (float(1 + np.searchsorted(square, part * square[-1])) for part in (0.25, 0.75))
        joints.append(
            JointCurve(
                joint=j,
                angle=angle,
                value=value,
                error=error,
                covered=_covered(angle, q[:, j - 1], np.pi / effect.orders),
                rms=float(np.sqrt((there**2).mean())),
                rms_error=float(np.sqrt((band**2).mean())),
                lost=lost[j],
                share=max(lost[j], 0.0) / total,
                middle=(low, high),
                lines=with_multiples(lines[j]),
                scan=scans[j],
            )
        )
    return Spectrum(tuple(joints), effect.orders)


def _lines(
    fit: Fit,
    effect: JointErrorCurve,
    own: Mapping[int, Array],
    q: Array,
    Jq: Array,
    highest: float | None,
    lost: Mapping[int, float],
) -> tuple[dict[int, tuple[Line, ...]], dict[int, Scan]]:
    """Lines of each joint beside those of the others, the joint of the greatest evidence first."""
    sizes = np.array([size for size, _ in effect.sizes().values()])
    top = float(effect.orders if highest is None else highest)
    arms = {j: (fit.W @ Jq[:, :, j - 1, None])[:, :, 0] for j in own}
    lines: dict[int, tuple[Line, ...]] = dict.fromkeys(own, ())
    scans: dict[int, Scan] = {}
    for sweep in range(SWEEPS):
        known = [line for j in own for line in lines[j]]
        if sweep and not known:
            break
        whole = Whole(fit, arms, q, known)
        for j in sorted(own, key=lambda j: -lost[j]):
            if sweep and all(line.joint == j for line in known):
                continue
            background = Background(whole, j, own[j], q[:, j - 1], arms[j], max(top, effect.orders))
            harmonics = sines(background.nodes, range(1, effect.orders + 1))
            curve = background.columns(harmonics * sizes[effect.parts[j]], 1.0)
            search = Search(background, j, curve, top, len(own))
            lines[j], scans[j] = search.lines(), search.scan()
    return lines, scans


def _valued(shapes: Array, x: Array, covariance: Array) -> tuple[Array, Array]:
    """A curve and its standard error, shapes (k,)."""
    return shapes @ x, np.sqrt(((shapes @ covariance) * shapes).sum(axis=1))


def _covered(angle: Array, q: Array, reach: float) -> Array:
    """Whether there is a reading within reach of each angle, around the turn."""
    around = np.sort((q + np.pi) % (2 * np.pi)) - np.pi
    around = np.concatenate([[around[-1] - 2 * np.pi], around, [around[0] + 2 * np.pi]])
    after = np.searchsorted(around, angle).clip(1, len(around) - 1)
    return np.asarray(np.minimum(angle - around[after - 1], around[after] - angle) <= reach)


def _evidence_lost(fit: Fit, own: Mapping[int, Array]) -> dict[int, float]:
    """Log evidence lost by leaving out one joint's curve, the level of the noise fitted again."""
    square = float((fit.rest**2).sum() + (((fit.x - fit.mean) / fit.prior) ** 2).sum())
    lost = {}
    for j, places in own.items():
        scaled = fit.covariance[np.ix_(places, places)] / np.outer(fit.prior[places], fit.prior[places])
        x = fit.x[places] / fit.prior[places]
        more = float(x @ np.linalg.solve(scaled, x))
        lost[j] = 0.5 * float(np.linalg.slogdet(scaled)[1]) + 0.5 * len(fit.y) * float(np.log1p(more / square))
    return lost


def with_multiples(lines: Sequence[Line]) -> tuple[Line, ...]:
    """Lines of one joint, the strongest first; those that are a harmonic or a fraction of a stronger one say so."""
    stronger: list[Line] = []
    for line in sorted(lines, key=lambda line: -line.amplitude):
        factors = [
            (factor, strong.frequency)
            for strong in stronger
            for factor in (*MULTIPLES, *(1 / k for k in MULTIPLES))
            if strong.multiple_of is None
            and min(line.frequency, strong.frequency) >= LEAST_FUNDAMENTAL
            and _same(line, strong, factor)
        ]
        stronger.append(replace(line, factor=factors[0][0], multiple_of=factors[0][1]) if factors else line)
    return tuple(stronger)


def _same(a: Line, b: Line, factor: float = 1.0) -> bool:
    """Whether a frequency is so many times another, as far as they are known."""
    error = float(np.hypot(a.frequency_error, factor * b.frequency_error))
    return abs(a.frequency - factor * b.frequency) <= min(max(SAME, 2 * error), SAME_AT_MOST)


def _shared(lines: Sequence[Line]) -> Iterator[str]:
    """Frequencies, and multiples of them, at which several joints have lines."""
    said: list[Line] = []
    for line in sorted(lines, key=lambda line: -line.amplitude):
        for factor in (1, *MULTIPLES):
            others = sorted({a.joint for a in lines if a.joint != line.joint and _same(a, line, factor)})
            if others and not any(_same(a, line, factor) for a in said):
                said += [a for a in lines if _same(a, line, factor)]
                times = "" if factor == 1 else f", {factor} times {line.frequency:.2f} of joint {line.joint}"
                joints = sorted({*others, line.joint}) if factor == 1 else others
                yield (
                    f"{factor * line.frequency:.2f} cycles a turn in joint{'s' * (len(joints) > 1)} "
                    f"{', '.join(map(str, joints))}{times}: this suggests parts of one make"
                )


def _geared(lines: Sequence[Line]) -> Iterator[str]:
    """Lines at once or twice the motor turns that a strain-wave gear of a known reduction makes."""
    for line in lines:
        tolerance = min(max(SAME, 2 * line.frequency_error), SAME_AT_MOST)
        for reduction in REDUCTIONS:
            for times in (1, 2):
                if abs(line.frequency - times * reduction) <= tolerance:
                    yield (
                        f"joint {line.joint}: {line.frequency:.2f} cycles a turn suggests a strain-wave gear of ratio "
                        f"{reduction}, {'once' if times == 1 else 'twice'} a motor turn"
                    )


COLUMNS = ("joint", "rms [urad]", "share", "lines: cycles a turn (amplitude in urad)")
# Lines of a joint, and suggestions, that are shown; JSON has them all.
MOST_SHOWN, MOST_SUGGESTED = 4, 3
# A curve is seen from so many standard errors on; a line of which more other frequencies explain as much has none.
CERTAIN, MOST_RIVALS = 2.0, 2


def curve_rows(s: Spectrum) -> list[tuple[str, str, str, str]]:
    """A row for each joint under `COLUMNS`, the greatest share first."""
    return [
        (str(c.joint), _size(c), f"{100 * c.share:.0f} %", lines_of(c))
        for c in sorted(s.joints, key=lambda c: -c.share)
    ]


def _size(c: JointCurve) -> str:
    """The curve's rms with its standard error; how large it may be where it is not seen."""
    rms, error = 1e6 * c.rms, 1e6 * c.rms_error
    return f"{rms:.0f} +- {error:.0f}" if seen(c) else f"< {rms + CERTAIN * error:.0f}"


def lines_of(c: JointCurve) -> str:
    """A joint's lines in words; where none stands out, what there is instead."""
    if not seen(c):
        return "nothing seen in these readings"
    if not c.lines:
        k = c.scan.strongest
        strongest = "" if k is None else f"; strongest near {c.scan.frequency[k]:.1f} ({1e6 * c.scan.amplitude[k]:.0f})"
        return f"no line stands out{strongest}, half of it from {c.middle[0]:.0f} to {c.middle[1]:.0f}"
    more = len(c.lines) - MOST_SHOWN
    return ", ".join(map(_line, c.lines[:MOST_SHOWN])) + (f" and {more} more" if more > 0 else "")


def seen(c: JointCurve) -> bool:
    """Whether the readings show anything of a joint's curve."""
    return bool(c.lines) or (c.lost > 0 and c.rms > CERTAIN * c.rms_error)


def _line(line: Line) -> str:
    size = f"({1e6 * line.amplitude:.0f} +- {1e6 * line.amplitude_error:.0f})"
    if len(line.rivals) > MOST_RIVALS:
        low, *_, high = sorted((line.frequency, *line.rivals))
        return f"one of {1 + len(line.rivals)} frequencies from {low:.1f} to {high:.1f} {size}"
    rivals = "".join(f" or {f:.1f}" for f in line.rivals)
    return f"{line.frequency:.{decimals_of(line)}f}{rivals}{_relation(line)} {size}"


def decimals_of(line: Line) -> int:
    return 2 if line.frequency_error < 0.05 else 1


def _relation(line: Line) -> str:
    if line.multiple_of is None:
        return ""
    return f" = {line.factor:.0f} x" if line.factor > 1 else f" = 1/{1 / line.factor:.0f}"


def as_json(s: Spectrum) -> dict[str, Any]:
    """Curves and lines as plain data; angles in degrees, errors in urad."""
    return {
        "harmonics": s.orders,
        "joints": [
            {
                "joint": c.joint,
                "rms_urad": _urad(c.rms),
                "rms_error_urad": _urad(c.rms_error),
                "share": round(c.share, 4),
                "log_evidence_lost": round(c.lost, 2),
                "covered_deg": [[round(float(np.rad2deg(v)), 1) for v in part] for part in covered_parts(c)],
                **_strongest(c),
                "middle_half_cycles": list(c.middle),
                "lines": [_line_as_json(line) for line in c.lines],
            }
            for c in s.joints
        ],
        "suggestions": list(s.suggestions),
    }


def _strongest(c: JointCurve) -> dict[str, float]:
    """The one sine that explains most, a line or not."""
    k = c.scan.strongest
    if k is None:
        return {}
    return {
        "strongest_cycles": round(float(c.scan.frequency[k]), 2),
        "strongest_urad": _urad(float(c.scan.amplitude[k])),
    }


def _line_as_json(line: Line) -> dict[str, Any]:
    return {
        "cycles": round(line.frequency, 3),
        "cycles_error": round(line.frequency_error, 3),
        "amplitude_urad": _urad(line.amplitude),
        "amplitude_error_urad": _urad(line.amplitude_error),
        "phase_deg": round(float(np.rad2deg(line.phase)), 1),
        "phase_error_deg": round(float(np.rad2deg(line.phase_error)), 1),
        "p": float(f"{line.p:.3g}"),
        "rivals": [round(f, 2) for f in line.rivals],
        **({} if line.multiple_of is None else {"multiple_of": round(line.multiple_of, 3), "factor": line.factor}),
    }


def covered_parts(c: JointCurve) -> list[tuple[float, float]]:
    """Stretches of a turn near which there are readings [rad]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], c.covered, [False]])))
    return [(float(c.angle[a]), float(c.angle[b - 1])) for a, b in edges.reshape(-1, 2)]


def _urad(value: float) -> float:
    return round(1e6 * value, 2)
