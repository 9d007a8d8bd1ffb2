"""Cached formulas of each effect: derivatives of its insertion points' variables (seams).

One formula, at zero effect, serves all settings of an effect. The formulas for robots of one
structure are stored in the user's cache, because composing them takes a second.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casadical.core.basics import Array, InputError
from casadical.core.files import private_folder, write_whole
from casadical.core.reading import MAX_JSON_BYTES, read_text
from casadical.core.sx_instructions import SxInstructions
from casadical.diagnosis.seams import Seams
from casadical.effects import Effect
from casadical.robot.kinematics import deflections, gravity_torques


@lru_cache(maxsize=4096)
def formula_of(s: Seams, template: Effect, settings: tuple[str, ...]) -> Formula | None:
    """Return the result of `composed` for the same arguments, from the disk cache if possible."""
    cache = cached_formulas(s)
    return cache.formula(template, settings) if cache.is_cacheable(template) else composed(s, template, settings)


def composed(s: Seams, template: Effect, settings: tuple[str, ...]) -> Formula | None:
    """Return the derivative of all insertion points' variables by an effect's parameters.

    The formula is for zero effect; None if it cannot be composed for symbolic settings.
    template : the effect; settings : names of its settings that are inputs of the formula
    """
    symbols: dict[str, Any] = {name: ca.SX.sym(name) for name in settings}
    conditions = tuple(dict.fromkeys((*s.exact.conditions, *template.conditions)))
    q, own, phi, constants = s.inputs
    w = ca.vertcat(own, ca.SX.sym("w", len(conditions) - own.numel()))
    logged = dict(zip(conditions, ca.vertsplit(w) if conditions else [], strict=True))
    try:
        effect = replace(template, **symbols) if symbols else template
        derivative = ca.sparsify(_seam_derivative(effect, s, logged))
    except Exception:
        if symbols:
            return None
        raise
    inputs = [q, w, phi, constants, s.seen, ca.vertcat(*symbols.values())]
    function = ca.Function("formula", [ca.SX(i) for i in inputs], [derivative])
    rows, columns = (np.array(k, dtype=np.int64) for k in derivative.sparsity().get_triplet())
    return Formula(SxInstructions.read(function), conditions, rows, columns)


def _seam_derivative(effect: Effect, s: Seams, logged: dict[str, ca.SX]) -> ca.SX:
    """Return the derivative of all insertion points' variables by an effect's parameters at zero.

    Its shape is (seams, parameters) [SI]. logged : symbols of logged and derived columns by name
    """
    parameters = effect.parameters()
    theta = ca.SX.sym("theta", len(parameters))
    own = dict(zip((p.name for p in parameters), ca.vertsplit(theta), strict=True))
    exact, context = (replace(c, values={**c.values, **own}, conditions=logged) for c in (s.exact, s.free))
    angle = ca.SX(effect.joint_angle(context))
    energy = ca.SX(effect.energy(replace(exact, torque=None)))
    if ca.depends_on(energy, theta):
        angle += deflections(context.arm, gravity_torques(exact, energy), context.values)
    seams, n = [angle], context.arm.n
    seams += [screw(effect.link(i, context)) for i in range(1, n + 1)] if _acts(effect, "link") else [ca.SX(6 * n, 1)]
    seams += [screw(effect.base(context)) if _acts(effect, "base") else ca.SX(6, 1)]
    seams += [screw(effect.tool(context)) if _acts(effect, "tool") else ca.SX(6, 1)]
    seams += [effect.measurement(s.point, context) - s.point if _acts(effect, "measurement") else ca.SX(3, 1)]
    derivative = ca.jacobian(ca.vertcat(*seams), theta)
    return ca.substitute(derivative, theta, ca.SX.zeros(theta.numel()))


def _acts(effect: Effect, seam: str) -> bool:
    """Return whether the effect's class overrides the method of a seam: link, base, tool, ...

    Composing seams that it does not override would cost a fifth of all formulas' time.
    """
    return getattr(type(effect), seam) is not getattr(Effect, seam)


def screw(T: ca.SX) -> ca.SX:
    """Return translation [m] and rotation vector [rad] of a near-identity transform, shape (6,)."""
    T = ca.SX(T)
    turn = 0.5 * ca.vertcat(T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1])
    return ca.vertcat(T[:3, 3], turn)


@dataclass(frozen=True, eq=False)
class Part:
    """Effects that share a formula.

    formula : derivative of the seam variables by an effect's parameters
    settings : values of each setting that is an input of the formula, shape (effects,) each
    starts : index of the first column of each effect, shape (effects,)
    width : number of columns of one effect, that of its parameters
    """

    formula: Formula
    settings: list[Array]
    starts: Array
    width: int


@lru_cache(maxsize=32)
def plan(s: Seams, effects: tuple[Effect, ...]) -> tuple[Part, ...]:
    """Return groups of effects that share a formula; the columns follow the order of `effects`.

    New formulas are written to the cache on disk.
    """
    starts = np.cumsum([0, *(len(e.sizes()) for e in effects)])
    parts = []
    for (template, names), which in _templates(effects).items():
        width = len(template.sizes())
        if formula := formula_of(s, template, names):
            settings = [np.array([getattr(effects[k], name) for k in which]) for name in names]
            parts.append(Part(formula, settings, starts[which], width))
            continue
        for k in which:
            own_formula = formula_of(s, effects[k], ())
            assert own_formula
            parts.append(Part(own_formula, [], starts[[k]], width))
    cached_formulas(s).write()
    return tuple(parts)


def _templates(effects: Sequence[Effect]) -> dict[tuple[Effect, tuple[str, ...]], list[int]]:
    """Return the indices of the effects that share a template, by (template, names of settings).

    They differ only in the values of these settings, which are floats and on which neither their
    conditions nor the names of their parameters depend.
    """
    first: dict[Any, tuple[Effect, tuple[str, ...]]] = {}
    templates: dict[tuple[Effect, tuple[str, ...]], list[int]] = {}
    for k, effect in enumerate(effects):
        values = {f.name: getattr(effect, f.name) for f in fields(effect)}
        names = tuple(n for n, v in values.items() if isinstance(v, float))
        rest = tuple((n, v) for n, v in values.items() if n not in names)
        key = (type(effect), rest, effect.conditions, tuple(effect.sizes()))
        ones: dict[str, Any] = dict.fromkeys(names, 1.0)
        template = first.setdefault(key, (replace(effect, **ones), names))
        templates.setdefault(template, []).append(k)
    return templates


# Folder of the package casadical, whose code is hashed.
PACKAGE_FOLDER = Path(__file__).parents[1]


@dataclass(frozen=True, eq=False)
class Formula:
    """Derivative of the seam variables by one effect's parameters, with its settings as inputs.

    function : instructions that evaluate the nonzeros, from q, w, phi, constants, seen and settings
    conditions : names of logged and derived columns in the order of the formula's input w
    rows, columns : indices of seam variable and parameter of each nonzero, shape (nonzeros,)
    """

    function: SxInstructions
    conditions: tuple[str, ...]
    rows: Array
    columns: Array

    def as_data(self) -> list[Any]:
        """Return the formula as data that JSON can store."""
        f = self.function
        function = [f.name, f.instructions, f.places, f.nonzeros]
        return [function, self.conditions, self.rows.tolist(), self.columns.tolist()]

    @classmethod
    def from_data(cls, data: list[Any]) -> Formula:
        """Return the formula that `as_data` stored."""
        (name, steps, places, nonzeros), conditions, rows, columns = data
        function = SxInstructions(name, tuple(map(tuple, steps)), places, tuple(nonzeros))
        return cls(function, tuple(conditions), np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64))


class FormulaCache:
    """Cache of the formulas of one structure in one file; None is cached, too.

    The file's name contains the hash of the structure and of the code that composes formulas, so
    that it is never stale.
    """

    def __init__(self, s: Seams, code: str) -> None:
        self._seams = s
        name = hashlib.sha256(f"{ca.CasadiMeta.version()} {code} {s.key}".encode()).hexdigest()[:32]
        folder = private_folder()
        self.path = None if folder is None else folder / f"formulas-{name}.json"
        self._cached: dict[str, Any] = {}
        self._new = False
        if self.path is not None:
            with suppress(OSError, ValueError):
                digest, _, text = read_text(self.path, MAX_JSON_BYTES).partition("\n")
                # A damaged file is made again.
                if digest == hashlib.sha256(text.encode()).hexdigest():
                    self._cached = json.loads(text)

    def is_cacheable(self, template: Effect) -> bool:
        """Return whether the formulas of an effect may be stored in the file.

        They may for effects of the package's own code that are on a list of candidates and, if they
        have parts, have the prior sizes of a candidate.
        """
        own = all(kind.__module__.startswith("casadical.") for kind in type(template).__mro__[:-1])
        if not (own and template.on_list):
            return False
        return not template.parts or template in type(template).candidates(self._seams.exact.arm)

    def formula(self, template: Effect, settings: tuple[str, ...]) -> Formula | None:
        """Return the result of `composed`, from the cache if it is there; a new one is added."""
        key = repr((template, settings))
        if key not in self._cached:
            made = composed(self._seams, template, settings)
            self._cached[key], self._new = made and made.as_data(), True
        data = self._cached[key]
        return data and Formula.from_data(data)

    def write(self) -> None:
        """Write the cache's file, atomically, if there are new formulas; a failure is ignored."""
        if not self._new or self.path is None:
            return
        self._new = False
        text = json.dumps(self._cached)
        with suppress(InputError):
            write_whole(self.path, f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


@lru_cache(maxsize=16)
def cached_formulas(s: Seams) -> FormulaCache:
    """Return the formula cache of one robot structure for the package's present code."""
    return FormulaCache(s, code_hash(PACKAGE_FOLDER))


@lru_cache(maxsize=1)
def code_hash(package: Path) -> str:
    """Return the SHA-256 hash [hex] of the code that composes formulas; package : its folder."""
    # A formula depends on the code of these subpackages.
    files = sorted(
        path
        for room in ("core", "effects", "robot", "diagnosis")
        for kind in ("*.py", "*.toml")
        for path in (package / room).rglob(kind)
    )
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
