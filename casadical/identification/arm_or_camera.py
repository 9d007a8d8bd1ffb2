"""Whether the arm or the camera is wrong, and by how much, of poses that a camera measured.

The model is linear about an identification: the arm's geometry departs from nominal with one
unknown size (see `prior`), and the camera has a wrong focal length, scale of its board, or
distortion, each absent or with a normal prior of unknown size; base and tool are free. The
posterior is the average over all these sizes by evidence, with everything else integrated out;
noise is that of the camera's axes, estimated in turns with the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np

from casadical.core.basics import Array
from casadical.core.reporting.plain import IN_MM, WRITTEN, Key, written
from casadical.core.reporting.result import Shown
from casadical.identification.least_squares import FRAME_GROUPS
from casadical.identification.prior import DRAWN_GROUPS, PRIOR_PROBABILITY_OF_NONE
from casadical.identification.result import Identification
from casadical.measurements.camera_noise import (
    Camera,
    CameraNoise,
    lines_of_sight,
    moved_by_errors,
    refined,
    spread_of_place,
    to_camera_axes,
    whitening,
)
from casadical.measurements.corners import CameraErrors
from casadical.measurements.measurements import Measurements

# Error of the camera -> prior probability, prior standard deviations, poses that would show it.
_CAUSES: dict[str, tuple[float, tuple[float, ...], str]] = {
    "focal length": (0.3, (0.001, 0.003, 0.01), "stations at half and at twice the distance"),
    "scale of the board": (0.15, (0.001, 0.003, 0.01), "a calliper on the board"),
    "distortion": (0.15, (0.01, 0.05), "stations with the board in the image's corners"),
}
# Probability from which arm or camera is reported as wrong (or as right), and a step as sure.
_CONFIDENCE = 0.9


@dataclass(frozen=True)
class Share(Shown):
    """Error of the target's position in the camera that arm or camera causes, base and tool fitted.

    size, low, high : posterior median of its rms over the poses [m], and 95 % interval [m]
    probability : posterior probability that it exceeds a quarter of the camera's noise
    """

    line: ClassVar[str] = " {{ it.in_words() }}"

    size: float = field(metadata=IN_MM)
    low: float = field(metadata=IN_MM)
    high: float = field(metadata=IN_MM)
    probability: float = field(metadata=WRITTEN)

    def in_words(self) -> str:
        """Return size and interval [mm]."""
        return f"{1e3 * self.size:.2g} mm ({1e3 * self.low:.2g} to {1e3 * self.high:.2g})"


@dataclass(frozen=True)
class CameraError(Shown):
    """An error of the camera: relative for focal length and board's scale, else the coefficient k1.

    name : "focal length", "scale of the board" or "distortion"
    value, low, high : posterior median given that it exists, and 95 % interval, dimensionless
    probability : posterior probability that it exists
    tellable : whether its posterior standard deviation is below half of the mean prior one
    """

    line: ClassVar[str] = " {{ it.name }}"

    name: str = field(metadata=WRITTEN)
    value: float = field(metadata=WRITTEN)
    low: float = field(metadata=WRITTEN)
    high: float = field(metadata=WRITTEN)
    probability: float = field(metadata=WRITTEN)
    tellable: bool = field(metadata=WRITTEN)

    def in_words(self) -> str:
        """Return the error with its interval; relative ones in percent."""
        factor, unit = (1, "") if self.name == "distortion" else (100, " %")
        value, low, high = (f"{factor * v:+.2g}" for v in (self.value, self.low, self.high))
        return f"{self.name} {value}{unit}, {low} to {high}"


@dataclass(frozen=True)
class Moved(Shown):
    """What moved at once between two poses.

    what : camera, board or pedestal, in words; before, after : rows of the two poses in the table
    probability : that something moved; shift, turn : how far [m], and by what angle [rad]
    """

    line: ClassVar[str] = " {{ it.in_words() }}"

    what: str = field(metadata=WRITTEN)
    before: int = field(metadata=WRITTEN)
    after: int = field(metadata=WRITTEN)
    probability: float = field(metadata=WRITTEN)
    shift: float = field(metadata=IN_MM)
    turn: float = field(metadata=written(unit="mrad"))

    def in_words(self) -> str:
        """Return a sentence with rows, shift [mm] and angle [mrad]."""
        return (
            f"Between rows {self.before} and {self.after} {self.what} moved by {1e3 * self.shift:.2g} mm and "
            f"{1e3 * self.turn:.2g} mrad."
        )

    def doubt_in_words(self) -> str:
        """Return a sentence that nothing moved between two rows, or that this is undecided."""
        if self.probability <= 1 - _CONFIDENCE:
            return "Hand-eye or board moved between two rows: no."
        return (
            f"Hand-eye or board moved between two rows: not tellable (rows {self.before} and {self.after}: "
            f"probability {self.probability:.2g})."
        )


@dataclass(frozen=True)
class ArmOrCamera(Shown):
    """Which of arm and camera is wrong, by how much.

    total : rms position error of the target with the nominal arm, base and tool fitted [m]
    noise : rms of the camera's noise in this error [m]; arm, camera : their contributions to it
    errors : of the camera; parameters : names of at most two of the arm that contribute most
    moved : most probable step of camera, board or pedestal, None where no step was sought; from a
        probability of `_CONFIDENCE` on, arm and camera are judged without it
    ratios, sigmas : the camera's noise, and its sigmas of lengths [m] and angles [rad]
    sure : errors that are probable enough to be removed, others zero; None without any
    """

    line: ClassVar[str] = " {{ it.in_words() }}"
    derived: ClassVar[tuple[Key, ...]] = (Key("wrong"), Key("in_words", lambda it: it.in_words()))

    total: float = field(metadata=IN_MM)
    noise: float = field(metadata=IN_MM)
    arm: Share = field(metadata=WRITTEN)
    camera: Share = field(metadata=WRITTEN)
    errors: tuple[CameraError, ...] = field(metadata=WRITTEN)
    parameters: tuple[str, ...] = field(metadata=WRITTEN)
    moved: Moved | None = field(metadata=WRITTEN)
    ratios: CameraNoise = field(metadata=WRITTEN)
    sigmas: tuple[float, float]
    sure: CameraErrors | None = None

    @property
    def _sides(self) -> tuple[bool | None, bool | None]:
        """Return whether the arm and whether the camera is wrong; None where that is undecided."""
        p = (self.arm.probability, self.camera.probability)
        arm, camera = (True if each >= _CONFIDENCE else False if each <= 1 - _CONFIDENCE else None for each in p)
        return arm, camera

    @property
    def wrong(self) -> str:
        """Return what is wrong: "arm", "camera", "both" or "neither"; "" if one is undecided."""
        names = {(True, False): "arm", (False, True): "camera", (True, True): "both", (False, False): "neither"}
        arm, camera = self._sides
        return "" if arm is None or camera is None else names[arm, camera]

    def in_words(self) -> str:
        """Return sentences on both shares, probable errors of the camera, and what is undecided."""
        head = {
            "arm": "The arm is wrong, not the camera",
            "camera": "The camera is wrong, not the arm",
            "both": "Arm and camera are wrong",
            "neither": "Neither arm nor camera is visibly wrong",
            "": "Whether arm or camera is wrong is not tellable from these poses",
        }[self.wrong]
        for side, other, (found, unknown) in (("arm", "camera", self._sides), ("camera", "arm", self._sides[::-1])):
            if found is not None and unknown is None:
                verb = "is wrong" if found else "is not visibly wrong"
                head = f"The {side} {verb}; whether the {other} is, is not tellable from these poses"
        named = "; ".join(e.in_words() for e in self.errors if e.probability >= 0.5)
        errors = f" ({named})" if named else ""
        most = f" ({', '.join(self.parameters)})" if self.parameters else ""
        text = (
            f"{head}. Of {1e3 * self.total:.2g} mm rms, camera: {self.camera.in_words()}{errors}; arm: "
            f"{self.arm.in_words()}{most}; noise: {1e3 * self.noise:.2g} mm."
        )
        if self.moved and self.moved.probability >= _CONFIDENCE:
            text = f"{self.moved.in_words()} {text}"
        elif self.moved:
            text += f" {self.moved.doubt_in_words()}"
        if not self.wrong:
            unsure = [_CAUSES[e.name][2] for e in self.errors if 0.05 < e.probability < _CONFIDENCE]
            more = unsure if self._sides[1] is None and unsure else ["more stations"]
            text += f" It would take {' or '.join(more)}."
        return text


def arm_or_camera(found: Identification) -> ArmOrCamera | None:
    """Return which of arm and camera is wrong by the poses of an identification.

    None where no camera measured the poses, they are fewer than twelve, other measurements were
    fitted too, or fewer than ten variables of base and tool are free.
    """
    problem = found.problem
    (m, *others) = problem.sets
    own = [problem.robot.parameters[n] for n in problem.names]
    frames = np.array([p.group in FRAME_GROUPS for p in own])
    # Of fewer stations the noise is too uncertain: a right arm was called wrong.
    if others or m.noise is None or frames.sum() < 10 or len(m) < 12:
        return None
    r, J = _linear(found)
    nominal = r - J @ found.solution.v
    drawn = np.array([p.group in DRAWN_GROUPS for p in own])
    widths = np.array([0.0 if p.group in DRAWN_GROUPS else max(p.prior / p.scale, 1e-6) for p in own])[~frames]
    names = [p.name for p in own]
    groups = np.array([p.group for p in own])[frames]
    some = J[:, :, frames]
    model = _Model(m, nominal, some, J[:, :, ~frames], drawn[~frames], widths, np.array(names)[~frames])
    answer = model.settled(m.noise, problem.sigmas[0])
    moved = model.step(answer, groups)
    if moved and moved[0].probability >= _CONFIDENCE:
        # What moved has a frame of its own from then on.
        own_frame = some[:, :, groups == moved[1]] * (m.row >= moved[0].after)[:, None, None]
        answer = model._replace(frames=np.dstack([some, own_frame])).settled(answer.ratios, answer.sigmas)
    return replace(answer, moved=moved[0] if moved else None)


def _linear(found: Identification) -> tuple[Array, Array]:
    """Return residuals of kind pose, (n, 6) [m, rad], and their derivatives by the variables, (n, 6, k)."""
    problem = found.problem
    sets = (replace(problem.sets[0], noise=None),)
    plain = replace(problem, sets=sets, sigmas=((1.0, 1.0),), loss="linear", priors=False, correlated=())
    (r,), J = plain.evaluate(found.solution.v)
    return r, J.reshape(len(r), 6, -1)


def evidence_of(found: Identification, camera: Camera) -> tuple[float, CameraNoise]:
    """Return the restricted log-likelihood of poses whose noise is that of a camera, and this noise.

    Base, tool and geometry are free. Source of the likelihood: Patterson and Thompson 1971.

    found : an identification of these poses alone; camera : where it is taken to be
    """
    r, J = _linear(found)
    view = replace(found.problem.sets[0], camera=camera).view
    noise, sigmas = CameraNoise(distance=float(np.median(lines_of_sight(view, CameraNoise())[1]))), (1e-3, 1e-3)
    for last in [False] * 8 + [True]:  # by then the estimates have converged
        W = whitening(view, noise) / np.repeat(sigmas, 3)[:, None]
        Q, triangle = np.linalg.qr((W @ J).reshape(r.size, -1))
        y = (W @ r[:, :, None]).ravel()
        e, freedom = (y - Q @ (Q.T @ y)).reshape(r.shape), 1 - (Q**2).sum(axis=1).reshape(r.shape)
        if not last:
            noise, sigmas = refined(view, noise, e, freedom, sigmas)
    unit = noise.relative(lines_of_sight(view, noise)[1]) * np.repeat(sigmas, 3)
    likelihood = -np.log(unit).sum() - np.log(np.abs(np.diag(triangle))).sum() - 0.5 * (e**2).sum()
    return float(likelihood), noise


class _Model(NamedTuple):
    """Linear model of a camera's residuals about an identification, in residuals of kind pose.

    m : the poses; nominal : residuals with the nominal geometry, shape (n, 6) [m, rad]
    frames, arm : derivatives by the variables of base and tool, and of the arm, shape (n, 6, k)
    drawn : mask of the arm's variables that a drawing gives, shape (k,)
    widths : prior standard deviations of its other variables, shape (k,), in their units
    names : of the arm's variables, shape (k,)
    """

    m: Measurements
    nominal: Array
    frames: Array
    arm: Array
    drawn: Array
    widths: Array
    names: Array

    def settled(self, noise: CameraNoise, sigmas: tuple[float, float]) -> ArmOrCamera:
        """Return the answer with the noise estimated in four rounds (see `refined`)."""
        for _ in range(4):  # by then the estimates have converged
            noise, sigmas = self.refined(noise, sigmas)
        return self.answer(noise, sigmas)

    def step(self, answer: ArmOrCamera, groups: Array) -> tuple[Moved, str] | None:
        """Return the most probable step of tool or base frame between rows, and its group, or None.

        Prior: probability 0.1, sigmas of 0.5 mm and 1 mrad or of 3 mm and 8 mrad. None with fewer
        than eight poses, or where a frame has parameters that are not free.
        """
        y, frames, rest = self.whitened(answer.ratios, answer.sigmas)
        Q = np.linalg.qr(frames)[0]
        sd = np.concatenate([np.where(self.drawn, 1.0, self.widths), [5e-3, 5e-3, 5e-3, 0.03]])
        A = (rest - Q @ (Q.T @ rest)) * sd
        inverse = np.linalg.inv(A.T @ A + np.eye(len(sd)))
        y = y - Q @ (Q.T @ y)
        y = (y - A @ (inverse @ (A.T @ y)))[: 6 * len(self.m)]
        Q, A = Q[: len(y)], A[: len(y)]
        places, gains, moves = [], [], []
        for group in ("tool", "base"):
            columns = frames[: len(y), groups == group].reshape(len(self.m), 6, -1)
            for k in range(4, len(self.m) - 3):
                S = (columns * (np.arange(len(self.m)) >= k)[:, None, None]).reshape(len(y), -1)
                S = S - Q @ (Q.T @ S)
                G, h = S.T @ S - (S.T @ A) @ inverse @ (A.T @ S), S.T @ y
                gain = []
                for shift, turn in ((0.5, 1.0), (3.0, 8.0)):
                    width = np.array([shift] * 3 + [turn] * (S.shape[1] - 3))
                    K = np.eye(len(width)) + width[:, None] * G * width
                    gain.append(0.5 * (width * h) @ np.linalg.solve(K, width * h) - 0.5 * np.linalg.slogdet(K)[1])
                move = width * np.linalg.solve(K, width * h)
                moves.append(1e-3 * np.array([np.linalg.norm(move[:3]), np.linalg.norm(move[3:])]))
                places.append((group, k))
                gains.append(np.logaddexp(*gain) - np.log(2))
        if not gains or (groups == "tool").sum() < 6 or (groups == "base").sum() < 6:
            return None
        log_odds = float(np.log(0.1 / 0.9) + np.logaddexp.reduce(gains) - np.log(len(gains)))
        best = int(np.argmax(gains))
        (group, k), (shift, turn) = places[best], moves[best]
        rows = int(self.m.row[k - 1]), int(self.m.row[k])
        probability = float(1 / (1 + np.exp(-log_odds)))
        return Moved(
            {
                "in hand": {"tool": "the camera on the flange", "base": "the board or the robot's pedestal"},
                "to base": {"tool": "the board on the flange", "base": "the camera or the robot's pedestal"},
            }[self.m.camera][group],
            *rows,
            probability,
            float(shift),
            float(turn),
        ), group

    def whitened(self, noise: CameraNoise, sigmas: tuple[float, float]) -> tuple[Array, Array, Array]:
        """Return whitened residuals (6 n,), columns of frames (6 n, f), of errors (6 n, k + 4).

        The errors are those of the arm and, in the last four columns, `CameraErrors`. With corners
        in images four rows are appended, of the latter alone: C and c of `Images.reduced`.
        """
        view = self.m.view
        W = whitening(view, noise) / np.repeat(sigmas, 3)[:, None]
        camera = np.linalg.solve(to_camera_axes(view), moved_by_errors(view, np.array(noise.point)))
        y, frames, rest = (W @ a for a in (self.nominal[:, :, None], self.frames, np.dstack([self.arm, camera])))
        y, frames, rest = -y.ravel(), frames.reshape(y.size, -1), rest.reshape(y.size, -1)
        if view.images is None:
            return y, frames, rest
        *_, C, c = view.images.reduced(view.T)
        pixel = noise.pixel[0] / sigmas[0]
        more = np.hstack([np.zeros((len(C), self.arm.shape[2])), pixel * C])
        return np.append(y, pixel * c), np.pad(frames, ((0, len(C)), (0, 0))), np.vstack([rest, more])

    def refined(self, noise: CameraNoise, sigmas: tuple[float, float]) -> tuple[CameraNoise, tuple[float, float]]:
        """Return better estimates of the camera's noise and of its sigmas, from residuals of a fit.

        Frames, arm and camera errors are fitted, and the prior sigma of the arm's departures
        (expectation maximisation).
        noise, sigmas : estimates so far; sigmas of lengths [m] and of angles [rad]
        """
        y, frames, rest = self.whitened(noise, sigmas)
        A, size = np.hstack([frames, rest]), 1.0
        for _ in range(20):
            sd = np.concatenate([np.where(self.drawn, size, self.widths), [5e-3, 5e-3, 5e-3, 0.03]])
            P = np.concatenate([np.zeros(frames.shape[1]), 1 / sd**2])
            C = np.linalg.inv(A.T @ A + np.diag(P))
            x = C @ (A.T @ y)
            own = frames.shape[1] + np.flatnonzero(self.drawn)
            size = max(float(np.sqrt(np.mean(x[own] ** 2 + np.diag(C)[own]))), 0.01) if len(own) else size
        freedom = 1 - np.einsum("ij,jk,ik->i", A, C, A)
        e, freedom = (a[: 6 * len(self.m)].reshape(-1, 6) for a in (y - A @ x, freedom))
        return refined(self.m.view, noise, e, freedom, sigmas)

    def answer(self, noise: CameraNoise, sigmas: tuple[float, float]) -> ArmOrCamera:
        """Return the posterior errors of arm and camera by sampling."""
        y, frames, rest = self.whitened(noise, sigmas)
        Q = np.linalg.qr(frames)[0]
        y, rest = y - Q @ (Q.T @ y), rest - Q @ (Q.T @ rest)
        count, k = len(y) - frames.shape[1], self.drawn.size
        sd, log_prior, present = _settings(self.drawn, self.widths)
        G, h, square = rest.T @ rest, rest.T @ y, float(y @ y)
        value, V = np.linalg.eigh(sd[:, :, None] * G * sd[:, None, :])
        value, score = np.maximum(value, 0.0), np.einsum("sij,si->sj", V, sd * h)
        # Factors on the sigmas of the noise, over which the posterior is averaged, too.
        factors = np.geomspace(0.75, 1.5, 6)
        log_weight = np.stack(
            [
                log_prior
                - 0.5 * np.log1p(value / f**2).sum(axis=1)
                - count * np.log(f)
                - 0.5 * (square - (score**2 / (value + f**2)).sum(axis=1)) / f**2
                for f in factors
            ],
            axis=1,
        )
        weight = np.exp(log_weight - log_weight.max())
        rng = np.random.default_rng(0)
        s, f = np.unravel_index(rng.choice(weight.size, 1000, p=weight.ravel() / weight.sum()), weight.shape)
        root = factors[f, None] / np.sqrt(value[s] + factors[f, None] ** 2)
        z = score[s] * (root / factors[f, None]) ** 2 + root * rng.normal(size=root.shape)
        x = sd[s] * np.einsum("sij,sj->si", V[s], z)
        unit, first = sigmas[0] * spread_of_place(self.m.view, noise), slice(6 * len(self.m))
        lengths = unit @ rest[first].reshape(len(self.m), 6, -1)[:, :3]
        own = float(np.sqrt((unit**2).sum(axis=(1, 2)).mean()))
        arm, camera = (
            np.sqrt((np.einsum("nij,sj->sni", lengths[:, :, part], x[:, part]) ** 2).sum(axis=2).mean(axis=1))
            for part in (slice(0, k), slice(k, None))
        )
        total = float(np.sqrt(((unit @ y[first].reshape(-1, 6)[:, :3, None]) ** 2).sum(axis=(1, 2)).mean()))
        errors, certain = [], np.zeros(4)
        for i, (name, (_, widths, _)) in enumerate(_CAUSES.items()):
            there = present[s, i]
            columns = ((0, 1), (2,), (3,))[i]
            at = x[:, k + columns[0]]
            some = at[there] if there.sum() > 20 else np.array([0.0])
            low, middle, high = np.quantile(some, [0.025, 0.5, 0.975])
            tellable = float(np.std(some)) < 0.5 * float(np.mean(widths)) and there.sum() > 20
            errors.append(
                CameraError(name, float(middle), float(low), float(high), float(there.mean()), bool(tellable))
            )
            for column in columns if tellable and there.mean() >= _CONFIDENCE else ():
                certain[column] = float(x[there, k + column].mean())
        each = np.sqrt((lengths[:, :, :k] ** 2).sum(axis=1).mean(axis=0)) * np.abs(x[:, :k].mean(axis=0))
        sure = np.abs(x[:, :k].mean(axis=0)) > 3 * x[:, :k].std(axis=0)
        largest = [int(i) for i in np.argsort(-each)[:2] if sure[i] and 4 * each[i] > own]
        shares = _share(arm, own), _share(camera, own)
        named = tuple(str(self.names[i]) for i in largest)
        taken = CameraErrors(*map(float, certain)) if certain.any() and shares[1].probability >= _CONFIDENCE else None
        return ArmOrCamera(total, own, *shares, tuple(errors), named, None, noise, sigmas, taken)


def _share(samples: Array, noise: float) -> Share:
    """Return median, 95 % interval and probability of relevance of the error of arm or camera.

    samples : posterior samples of its rms over the poses [m]; noise : rms noise of the camera [m]
    """
    low, median, high = (float(v) for v in np.quantile(samples, [0.025, 0.5, 0.975]))
    return Share(median, low, high, float(np.mean(samples > noise / 4)))


def _settings(drawn: Array, widths: Array) -> tuple[Array, Array, Array]:
    """Return s combinations of prior widths (s, k + 4), log priors, masks of causes (s, 3)."""
    # Prior sigmas of the arm's departures, over which the posterior is averaged [mm, mrad].
    sizes = np.geomspace(0.03, 10.0, 18)
    arms = [
        (0.0, PRIOR_PROBABILITY_OF_NONE),
        *((size, (1 - PRIOR_PROBABILITY_OF_NONE) / len(sizes)) for size in sizes),
    ]
    causes = [[(0.0, 1 - p), *((sd, p / len(sds)) for sd in sds)] for p, sds, _ in _CAUSES.values()]
    sd, log_prior, present = [], [], []
    for (size, p), *errors in product(arms, *causes):
        focal, board, distortion = (width for width, _ in errors)
        sd.append([*np.where(drawn, size, widths), focal, focal, board, distortion])
        log_prior.append(np.log(p) + sum(np.log(q) for _, q in errors))
        present.append([width > 0 for width, _ in errors])
    return np.array(sd), np.array(log_prior), np.array(present)
