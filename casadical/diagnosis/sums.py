"""Sums over poses of products of white columns, by which all causes are judged.

In the axes of a pose's joint repeatability its whitening at any rho is a weight for each of three rows, so that columns
are turned once and weighted for each rho. The products are added up some poses at a time, so that memory does not grow
with poses times columns, and when they are asked for. Sums of a few poses are taken off or added where these poses
turn out to be outliers, or none.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property

import numpy as np

from casadical.core.arrays import Array
from casadical.diagnosis.combinations import Combined, combined
from casadical.diagnosis.linearisation import EVERY, Columns, Factors, as_slice

# Columns that are in memory at a time, in bytes; at least so many poses.
BYTES, LEAST_POSES = 32_000_000, 64
# Groups of so many columns are added up one by one, at the rhos that are asked for.
WIDE = 64


def combined_of(E: Array | Columns, columns: Array) -> Combined:
    """Some columns, in rising order, with combinations for those of parts of effects."""
    return combined(columns, () if isinstance(E, np.ndarray) else E.directions)


def taken(E: Array | Columns, columns: Array, poses: Array | slice = EVERY, every: Combined | None = None) -> Array:
    """Some columns at some poses, or combinations of them, shape (poses, 3, columns or combinations)."""
    return E[poses][:, :, columns] if isinstance(E, np.ndarray) else E.take(columns, poses, every)


def _only(E: Array | Columns, columns: Array) -> Array | Columns:
    """Some columns in rising order, all those of an effect or none, made when asked for."""
    return E[:, :, columns] if isinstance(E, np.ndarray) else E.only(columns)


def _factors(E: Array | Columns, poses: slice) -> tuple[Factors, Array]:
    """Columns at some poses as factors of seams, and the derivative by the seams' variables, shape (n, 3, seams).

    Of columns that are given as an array the three coordinates are the seams.
    """
    if not isinstance(E, np.ndarray):
        return E.factors(poses), E.linear.S[poses]
    every = np.arange(E.shape[2])
    numbers = E.shape[1]
    blocks = tuple((i, every, E[poses, i].T) for i in range(numbers))
    return Factors(blocks, len(every)), np.broadcast_to(np.eye(numbers), (len(E[poses]), numbers, numbers))


def _add_products(total: Array, F: Factors, G: Factors, U: Array, weight: Array) -> None:
    """Add products of columns F with columns G at some poses, at some rhos, to an array of shape (F, rhos, G).

    U : derivative by the seams' variables in the axes of repeatability, shape (n, 3, seams); weight : of these axes,
    shape (rhos, n, 3)
    """
    for s, columns, values in F.blocks:
        # What the seam's variable does, times each column of G.
        across = np.zeros((len(weight), G.width, len(U)))
        shares = np.einsum("kni,ni,nit->tkn", weight, U[:, :, s], U[:, :, [t for t, _, _ in G.blocks]], optimize=True)
        for share, (_, own, factors) in zip(shares, G.blocks, strict=True):
            across[:, as_slice(own)] += share[:, None] * factors
        total[as_slice(columns)] += (values @ across.reshape(-1, len(U)).T).reshape(len(values), *total.shape[1:])


class Sums:
    """Of one problem: residuals, base model, candidates (see `Evidence`).

    base : products of the base model's columns and the residual, shape (rhos, P + 1, P + 1); zero at rhos that are not
        near, by their numbers
    log_det : log determinant of the noise's covariance in units of sigma, shape (rhos,)
    """

    def __init__(self, r: Array, J: Array, Jq: Array, E: Array | Columns, rhos: Array, near: Sequence[int]) -> None:
        self.E = E
        square, self._turn = np.linalg.eigh(Jq @ Jq.transpose(0, 2, 1))
        square = np.maximum(square, 0.0).reshape(-1)
        self._weight = 1 / (1 + np.outer(rhos**2, square))
        self.log_det = np.log1p(np.outer(rhos**2, square)).sum(axis=1)
        self._base = self._turned(np.concatenate([J, r[:, :, None]], axis=2), EVERY)
        self.base = np.zeros((len(rhos), *[self._base.shape[1]] * 2))
        for k in near:
            scaled = self._base * np.sqrt(self._weight[k, :, None])
            self.base[k] = scaled.T @ scaled
        self._own: dict[bytes, Array] = {}
        self._wide: dict[tuple[bytes, int], Array] = {}
        self._cross: dict[tuple[int, int, int], Kept] = {}

    @property
    def rows(self) -> int:
        """How many numbers were measured."""
        return len(self._base)

    @cached_property
    def columns(self) -> Array:
        """Products of all columns with the base model's and the residual, shape (columns, rhos, P + 1)."""
        return self._by_base(self.E)

    def together(self, columns: Array, ks: Sequence[int]) -> Array:
        """Products of the base model, some columns combined, and the residual, at some rhos, shape (rhos, p, p)."""
        every = combined_of(self.E, columns)
        P, p = self.base.shape[1] - 1, self.base.shape[1] + every.width
        outer, inner = np.append(np.arange(P), p - 1), np.arange(P, p - 1)
        total, crossed = np.zeros((len(ks), p, p)), self.crossed(columns, ks, columns) if len(columns) else {}
        for sums, k in zip(total, ks, strict=True):
            sums[np.ix_(outer, outer)] = self.base[k]
            if len(columns):
                sums[np.ix_(inner, inner)] = every.of(crossed[k].T)
                sums[np.ix_(outer, inner)] = across = every.of(self.columns[columns, k].T)
                sums[np.ix_(inner, outer)] = across.T
        return total

    def _by_base(self, E: Array | Columns) -> Array:
        rhos, numbers = self.base.shape[:2]
        total = np.zeros((E.shape[2], rhos * numbers))
        for poses in self._parts(E):
            F, U = self._at_seams(E, poses)
            base = self._base.reshape(len(self._turn), -1, numbers)[poses]
            for s, columns, values in F.blocks:
                # What the seam's variable does, times the base's columns, at each rho.
                across = np.einsum("kni,ni,nip->nkp", self._axes[:, poses], U[:, :, s], base, optimize=True)
                total[as_slice(columns)] += values @ across.reshape(len(U), -1)
        return total.reshape(-1, rhos, numbers)

    @property
    def _axes(self) -> Array:
        """Weights of the three axes of each pose, shape (rhos, n, 3)."""
        return self._weight.reshape(len(self._weight), *self._turn.shape[:2])

    def _parts(self, E: Array | Columns) -> Iterator[slice]:
        """The poses in parts whose columns take little memory."""
        n, step = len(self._turn), max(LEAST_POSES, BYTES // (8 * max(E.shape[2], 1)))
        return (slice(first, min(first + step, n)) for first in range(0, n, step))

    def _at_seams(self, E: Array | Columns, poses: slice) -> tuple[Factors, Array]:
        """Columns at some poses as factors, and the seams in the axes of repeatability, shape (n, 3, seams)."""
        F, S = _factors(E, poses)
        return F, np.asarray(self._turn[poses].transpose(0, 2, 1) @ S)

    def extend(self, known: Sums) -> None:
        """Take over sums of the same poses and the first of the columns."""
        width = known.E.shape[2]
        self._own, self._wide = dict(known._own), dict(known._wide)
        self._cross = {key: cross.of(self.E.shape[2]) for key, cross in known._cross.items()}
        columns = known.columns
        if self.E.shape[2] > width:
            new = self.E[:, :, width:] if isinstance(self.E, np.ndarray) else self.E.after(width)
            columns = np.concatenate([columns, self._by_base(new)])
        self.__dict__["columns"] = columns

    def move(self, known: Sums, lost: Sums, gained: Sums) -> None:
        """Take over sums of other poses: known ones without some that are lost, with some that are gained."""
        parts = [(sign, part) for sign, part in ((-1.0, lost), (1.0, gained)) if part.rows]
        self.__dict__["columns"] = known.columns + sum(sign * part.columns for sign, part in parts)
        groups = [np.frombuffer(key, dtype=np.int64) for key in known._own]
        for _, part in parts:
            part.add_own(groups)
        self._own = {k: own + sum(sign * part._own[k] for sign, part in parts) for k, own in known._own.items()}
        for (key, k), own in known._wide.items():
            group = np.frombuffer(key, dtype=np.int64)
            self._wide[key, k] = own + sum(sign * part.wide(group, k) for sign, part in parts)
        for (first, last, k), cross in known._cross.items():
            run, at = np.arange(first, last + 1), cross.known
            self._cross[first, last, k] = more = Kept(len(cross.place), cross.numbers)
            more.add(at, cross[at] + sum(sign * part.crossed(run, [k], at)[k] for sign, part in parts))

    def _turned(self, part: Array, poses: slice) -> Array:
        """Columns in the axes of each pose's repeatability, shape (rows, columns)."""
        turned = self._turn[poses].transpose(0, 2, 1) @ part
        return np.asarray(turned.reshape(-1, part.shape[2]))

    def _blocks(self, E: Array | Columns) -> Iterator[tuple[Array, slice]]:
        """All columns of some poses, turned, and the rows where they stand."""
        for poses in self._parts(E):
            F, U = self._at_seams(E, poses)
            yield F.columns_at(U).reshape(-1, E.shape[2]), slice(U.shape[1] * poses.start, U.shape[1] * poses.stop)

    def add_own(self, groups: Iterable[Array]) -> None:
        """Add up the products of each narrow group's columns among themselves, all in one go."""
        new = {g.tobytes(): g for g in groups if len(g) <= WIDE and g.tobytes() not in self._own}
        by_width: dict[int, list[Array]] = {}
        for g in new.values():
            by_width.setdefault(len(g), []).append(g)
        if not new:
            return
        stacks = {w: np.stack(gs) for w, gs in by_width.items()}
        totals = {w: np.zeros((len(self._weight), len(s), w, w)) for w, s in stacks.items()}
        used = np.unique(np.concatenate([which.ravel() for which in stacks.values()]))
        for E, rows in self._blocks(_only(self.E, used)):
            by_column = np.ascontiguousarray(E.T)
            for w, which in stacks.items():
                part = by_column[np.searchsorted(used, which)]
                for k, weight in enumerate(self._weight[:, rows]):
                    scaled = part * np.sqrt(weight)
                    totals[w][k] += scaled @ scaled.transpose(0, 2, 1)
        for w, which in stacks.items():
            for i, g in enumerate(which):
                self._own[g.tobytes()] = totals[w][:, i]

    def own(self, groups: Sequence[Array]) -> Array:
        """These products of groups of one width, shape (groups, rhos, width, width)."""
        return np.stack([self._own[g.tobytes()] for g in groups])

    def wide(self, group: Array, k: int) -> Array:
        """Products of a wide group's columns, combined, among themselves at one rho, shape (width, width)."""
        key = group.tobytes(), k
        if key not in self._wide:
            every, E = combined_of(self.E, group), _only(self.E, group)
            total = np.zeros((every.width, 1, every.width))
            for poses in self._parts(E):
                F, U = self._at_seams(E, poses)
                F = F.combined(every)
                _add_products(total, F, F, U, self._axes[[k], poses])
            self._wide[key] = total[:, 0]
        return self._wide[key]

    def widest(self, columns: Array) -> Array:
        """The widest group among some columns whose own products are known; none where there is none."""
        groups = [np.frombuffer(key, dtype=np.int64) for key, _ in self._wide]
        return max((g for g in groups if np.isin(g, columns).all()), key=len, default=columns[:0])

    def crossed(self, columns: Array, ks: Sequence[int], wanted: Array) -> dict[int, Array]:
        """Products of wanted columns with some others, combined, at some rhos, shape (wanted, width); kept by runs.

        wanted : in rising order, all columns of an effect or none
        """
        firsts, lasts = ([key[k] for key in self._cross] for k in (0, 1))
        apart = (np.diff(columns) != 1) | np.isin(columns[1:], firsts) | np.isin(columns[:-1], lasts)
        runs = np.split(columns, np.flatnonzero(apart) + 1)
        found: dict[int, list[Array]] = {k: [] for k in ks}
        for run in runs:
            keys = {k: (int(run[0]), int(run[-1]), k) for k in ks}
            for key in keys.values():
                if key not in self._cross:
                    every = combined_of(self.E, run)
                    self._cross[key] = Kept(self.E.shape[2], every.width)
                    if len(run) > WIDE:
                        self._cross[key].add(run, every.values(self.wide(run, key[2])))
            unknown = np.max([self._cross[key].place[wanted] < 0 for key in keys.values()], axis=0)
            if unknown.any():
                self._add_crossed(run, wanted[unknown], {k: self._cross[key] for k, key in keys.items()})
            for k, key in keys.items():
                found[k].append(self._cross[key][wanted])
        return {k: np.concatenate(parts, axis=1) for k, parts in found.items()}

    def _add_crossed(self, run: Array, new: Array, to: dict[int, Kept]) -> None:
        """Add up products of new columns with a run, at some rhos, in one go."""
        E, R, every = _only(self.E, new), _only(self.E, run), combined_of(self.E, run)
        total = np.zeros((E.shape[2], len(to), every.width))
        for poses in self._parts(E):
            F, U = self._at_seams(E, poses)
            G, _ = _factors(R, poses)
            _add_products(total, F, G.combined(every), U, self._axes[[*to], poses])
        for i, kept in enumerate(to.values()):
            kept.add(new, total[:, i])


class Kept:
    """Rows of some of the columns, as far as they are known.

    place : of each column among the rows, or -1, shape (columns,); count : of known rows; numbers : in each
    """

    def __init__(self, columns: int, numbers: int) -> None:
        self.place, self.count, self.numbers = np.full(columns, -1), 0, numbers
        self._rows = np.empty((0, numbers))

    @property
    def known(self) -> Array:
        """Numbers of the columns that are known."""
        return np.flatnonzero(self.place >= 0)

    def __getitem__(self, columns: Array) -> Array:
        """Rows of columns, shape (*columns.shape, numbers)."""
        return np.asarray(self._rows[self.place[columns]])

    def add(self, columns: Array, rows: Array) -> None:
        """Keep the rows of further columns."""
        more = self.count + len(rows)
        if not self.count:
            self._rows = rows
        elif more > len(self._rows):
            # Room for twice as much: rows are added many times.
            grown = np.empty((max(more, min(2 * len(self._rows), len(self.place))), rows.shape[1]))
            grown[: self.count] = self._rows[: self.count]
            self._rows = grown
        if self.count:
            self._rows[self.count : more] = rows
        self.place[columns] = np.arange(self.count, more)
        self.count = more

    def of(self, columns: int) -> Kept:
        """The same of at least as many columns."""
        more = Kept(columns, self.numbers)
        more.place[: len(self.place)] = self.place
        more._rows, more.count = self._rows[: self.count], self.count
        return more
