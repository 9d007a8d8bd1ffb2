"""Tables of effects and knowledge in files: [[effect]], [learnt], [[covariance]], [remaining].

They belong to robot files of version 2; values are in SI, ranges of joints in deg and mm. Effect
files have the first three alone, to be put into any robot or to be a candidate.
"""

import io
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from pydantic import Field

from casadical import __version__
from casadical.core.basics import Array, InputError, errors_of
from casadical.core.parts import Arm
from casadical.core.reading import archive_of, foreign, load_toml, read_bytes
from casadical.core.schema import Pair, TomlTable, check
from casadical.core.statistics import rounded_at
from casadical.effects import Effect
from casadical.effects.definition import Definition, DefinitionFile
from casadical.effects.plugins import defined_in_files, find_effect, new_effects
from casadical.robot.robot import MAX_BLOCK_PARAMETERS, Covariance, Knowledge, RemainingErrors, Robot

# Number of significant digits of a covariance, and of a factor in [remaining], as text in a file:
# enough for correlations of 1 - 1e-9, with a quarter less text than all digits.
COVARIANCE_DIGITS = 12
# Number of digits after the first digit of its standard error up to which a value is rounded in a
# reproducible file; further ones depend on the rounding of the processor.
REPRODUCIBLE_DIGITS = 6


class Value(TomlTable):
    """Value and standard error of a parameter of an effect, in its SI `unit`."""

    value: float
    unit: str
    std_error: float | None = Field(default=None, ge=0)


class EffectTable(TomlTable):
    """One effect with its joint (from 1; None: none or all), settings and values."""

    name: str = Field(min_length=1)
    joint: int | None = Field(default=None, ge=1)
    settings: dict[str, Any] = Field(default={})
    values: dict[str, Value] = Field(default={})

    def effect(self, own: Sequence[type[Effect]]) -> Effect:
        """Return the effect that the table describes, without its values.

        own : classes of effects in addition to the installed ones
        Raises InputError: no such effect, setting or parameter, too many of the latter, a sigma
        that is not above 0, or a value in another unit.
        """
        effect = find_effect(self.name, own).from_dict({"joint": self.joint, "settings": self.settings})
        sizes = effect.sizes()
        if len(sizes) > 3000:  # more than an error curve has for all joints
            raise InputError(f"settings: {len(sizes)} parameters; allowed: up to 3000")
        if wrong := [name for name, (size, _) in sizes.items() if not (size > 0 and math.isfinite(size))]:
            raise InputError(f"settings: one sigma of {wrong[0]} is {sizes[wrong[0]][0]:g}; it must be above 0")
        for name, given in self.values.items():
            if name not in sizes:
                raise InputError(f"values.{name}: no parameter of {effect.label}; there are {', '.join(sizes)}")
            if given.unit != sizes[name][1]:
                raise InputError(f"values.{name}.unit = {given.unit!r}; allowed: {sizes[name][1]!r}")
        return effect


def effects_of(
    tables: Sequence[EffectTable], definitions: Sequence[Definition], own: Sequence[type[Effect]]
) -> tuple[tuple[Effect, ...], dict[str, float], dict[str, float]]:
    """Return effects, and the given values and standard errors of their parameters [SI].

    Both are by full name, label.name; what a table does not give is absent.

    own : classes of effects in addition to the installed ones and to those that the file defines
    Raises InputError that names the key.
    """
    kinds = (*own, *new_effects(definitions))
    effects, values, errors = [], {}, {}
    for k, table in enumerate(tables, 1):
        with errors_of(f"effect[{k}]."):
            effect = table.effect(kinds)
        effects.append(effect)
        for name, given in table.values.items():
            values[f"{effect.label}.{name}"] = given.value
            if given.std_error is not None:
                errors[f"{effect.label}.{name}"] = given.std_error
    return tuple(effects), values, errors


class CovarianceTable(TomlTable):
    """A covariance as its lower triangle, row by row, in the table or in an NPZ file next to it."""

    names: list[str] = Field(min_length=1)
    lower: list[list[float]] | None = Field(default=None, min_length=1)
    file: str | None = Field(default=None, pattern=r"^[^/\\]+\.npz$")

    def covariance(self, folder: Path) -> Covariance:
        """Return the covariance of the table.

        folder : that of the file with the table, in which `file` is looked for
        Raises InputError for rows that make no triangle, for a file that is missing or has another
        covariance, and what `Covariance` raises.
        """
        k = len(self.names)
        if (self.lower is None) == (self.file is None):
            raise InputError(f"names = {self.names[:3]}: give the rows `lower`, or the `file` that has them")
        matrix = np.zeros((k, k))
        if self.file is not None:
            matrix[np.tril_indices(k)] = _triangle_in(folder / self.file, self.names[0], k * (k + 1) // 2)
        elif [len(row) for row in self.lower or ()] != list(range(1, k + 1)):
            sizes = [len(row) for row in self.lower or ()]
            raise InputError(f"lower: rows of {sizes} numbers; of {k} names: 1 to {k}")
        else:
            matrix[np.tril_indices(k)] = np.concatenate([np.array(row) for row in self.lower or ()])
        return Covariance(tuple(self.names), matrix + np.tril(matrix, -1).T)


def _triangle_in(path: Path, name: str, count: int) -> Array:
    """Return the lower triangle of a covariance from an NPZ file, shape (count,) [SI]."""
    if not path.is_file():
        raise InputError(
            f"file = {path.name!r}: is not in the folder of the robot file; the covariance that was written with the "
            "robot is in it: copy both together, or take the tables with `file` out, without the covariance"
        )
    with foreign(f"file = {path.name!r}: not a readable NPZ file"):
        arrays = np.load(archive_of(read_bytes(path), path.name), allow_pickle=False)
        lower = arrays[name] if name in arrays else np.zeros(0)
    if lower.dtype != np.float64 or lower.shape != (count,):
        raise InputError(
            f"file = {path.name!r}: {lower.shape} numbers of {name}; the covariance has {count}: it belongs to another "
            "robot file"
        )
    return np.asarray(lower)


class LearntTable(TomlTable):
    """Origin of the values: campaign, number of poses, ranges of the data; see `Knowledge`."""

    campaign: str = ""
    poses: int = Field(default=0, ge=0)
    readings: dict[str, Pair] = Field(default={})
    conditions: dict[str, Pair] = Field(default={})
    misfit: float = Field(default=1.0, ge=1)
    robots: int = Field(default=0, ge=0)

    def ranges(self, arm: Arm) -> Array:
        """Return each joint variable's range in the identified poses, shape (n, 2) [rad or m].

        The shape is (0, 2) if the table states none. Raises InputError for keys of other joints or
        units, and if a joint is missing.
        """
        factors = arm.reading_units
        if not self.readings:
            return np.zeros((0, 2))
        if odd := [key for key in self.readings if key not in factors]:
            raise InputError(f"learnt.readings.{odd[0]}: unknown key; allowed: {', '.join(factors)}")
        if missing := [key for key in factors if key not in self.readings]:
            raise InputError(f"learnt.readings.{missing[0]}: is missing")
        return np.array([np.multiply(self.readings[key], factor) for key, factor in factors.items()])


class RemainingTable(TomlTable):
    """Remaining errors of a calibrated robot (see `RemainingErrors`)."""

    rest: float
    poses: int = Field(default=0, ge=0)
    names: list[str] = Field(min_length=1)
    factor: list[list[float]] = Field(min_length=1)

    def errors(self) -> RemainingErrors:
        """Return the position errors that a calibrated robot still has, as the table states them.

        Raises InputError for rows of different lengths, and what `RemainingErrors` raises.
        """
        if len({len(row) for row in self.factor}) > 1:
            raise InputError(
                f"remaining.factor: rows of {sorted({len(row) for row in self.factor})} numbers; all alike"
            )
        return RemainingErrors(tuple(self.names), np.array(self.factor), self.rest, self.poses)


def knowledge_of(
    arm: Arm,
    names: Collection[str],
    learnt: LearntTable,
    covariance: Sequence[CovarianceTable],
    errors: Mapping[str, float],
    folder: Path,
) -> Knowledge | None:
    """Return the covariances and ranges in the tables of a file, None if they are empty.

    names : of the robot's parameters, which all names in covariances must be among
    errors : parameter -> standard error given next to its value [SI]; one that is in no covariance
        makes a block of its own, one in a covariance must agree with it
    Raises InputError that names the key.
    """
    parts = []
    for k, table in enumerate(covariance, 1):
        with errors_of(f"covariance[{k}]."):
            parts.append(table.covariance(folder))
    for block in parts:
        for name in block.names:
            if name not in names:
                raise InputError(f"covariance: no parameter {name!r}; there are {', '.join(names)}")
    stated = {name: float(np.sqrt(v)) for c in parts for name, v in zip(c.names, np.diag(c.matrix), strict=True)}
    for name, given in errors.items():
        # A standard error and the variance of its parameter agree within a relative 1e-6.
        if abs(stated.setdefault(name, given) - given) > 1e-6 * given:
            raise InputError(
                f"{name}: std_error = {given:.6g}, but its [[covariance]] says {stated[name]:.6g}; leave one out"
            )
        if all(name not in c.names for c in parts):
            parts.append(Covariance((name,), np.array([[given**2]])))
    ranges = learnt.ranges(arm)
    if not (parts or learnt.model_fields_set):
        return None
    conditions = {name: (pair[0], pair[1]) for name, pair in learnt.conditions.items()}
    return Knowledge(tuple(parts), learnt.campaign, learnt.poses, ranges, conditions, learnt.misfit, learnt.robots)


def text_of(
    robot: Robot,
    effects: Sequence[Effect],
    knowledge: Knowledge | None,
    remaining: RemainingErrors | None = None,
    reproducible: bool = False,
    companion: str = "",
) -> Iterator[str]:
    """Yield the tables of effects and knowledge as lines of TOML.

    They are [[definition]], [[effect]], [learnt], [[covariance]] and [remaining], where they apply.

    reproducible : as of `to_toml`; companion : name of the file of `large_covariances`; "" without it
    """
    knowledge = knowledge or Knowledge()
    for definition in defined_in_files(effects):
        yield from ("", "[[definition]]", *_entries(definition.model_dump(exclude_defaults=True)))
    for effect in effects:
        yield from _effect_lines(effect, robot.effect_values, knowledge.std_errors, reproducible)
    if knowledge:
        yield from _learnt_lines(robot, knowledge)
    own = {p.name for e in effects for p in e.parameters()}
    for block in knowledge.covariance:
        # The variance of a single parameter is already written as std_error next to its value.
        if len(block.names) > 1 or block.names[0] not in own:
            yield from ("", "[[covariance]]", f"names = {_text(block.names)}")
            if companion and len(block.names) > MAX_BLOCK_PARAMETERS:
                yield f"file = {_text(companion)}"
                continue
            yield from ("lower = [", *(f"    {_text(row)}," for row in _triangle(block, reproducible)), "]")
    if remaining:
        rest = rounded_at(remaining.rest, remaining.rest, REPRODUCIBLE_DIGITS) if reproducible else remaining.rest
        numbers = {"rest": rest, "poses": remaining.poses, "names": remaining.names}
        yield from ("", "[remaining]", *_entries(numbers), "factor = [")
        yield from (f"    {_text([float(f'{v:.{COVARIANCE_DIGITS}g}') for v in row])}," for row in remaining.factor)
        yield "]"


def large_covariances(knowledge: Knowledge | None, reproducible: bool) -> bytes:
    """Return the covariances of more than `MAX_BLOCK_PARAMETERS` parameters as an NPZ file's bytes.

    Each is an array of the lower triangle row by row, named by its first parameter [SI]. Where
    there is none, no bytes are returned.
    """
    triangles: dict[str, Array] = {}
    for block in (knowledge or Knowledge()).covariance:
        if len(block.names) > MAX_BLOCK_PARAMETERS:
            sizes, digits = _sizes_and_digits(block)
            C = block.matrix
            if reproducible and digits < COVARIANCE_DIGITS:
                unit = 10.0 ** (digits - np.floor(np.log10(np.where(sizes > 0, sizes, 1.0))))
                C = np.rint(C * unit) / unit
            triangles[block.names[0]] = C[np.tril_indices(len(C))]
    stream = io.BytesIO()
    if triangles:
        np.savez(stream, **triangles)  # type: ignore[arg-type]
    return stream.getvalue()


def _triangle(block: Covariance, reproducible: bool) -> Iterator[list[float]]:
    """Yield the lower triangle of a covariance [SI], row by row, rounded as a text has it."""
    sizes, digits = _sizes_and_digits(block)
    for i, row in enumerate(block.matrix):
        if reproducible and digits < COVARIANCE_DIGITS:
            yield [rounded_at(v, s, digits) for v, s in zip(row[: i + 1], sizes[i], strict=False)]
        else:
            yield [float(f"{v:.{COVARIANCE_DIGITS}g}") for v in row[: i + 1]]


def _sizes_and_digits(block: Covariance) -> tuple[Array, int]:
    """Return products of standard deviations, (k, k) [SI], and digits after their first to keep.

    Correlations need more digits than their smallest eigenvalue has zeros, and get at least 6.
    """
    scale = np.sqrt(np.diag(block.matrix))
    sizes = np.outer(scale, scale)
    least = np.linalg.eigvalsh(block.matrix / np.where(sizes > 0, sizes, 1.0))[0]
    return sizes, max(3 - math.floor(math.log10(max(least, 10.0**-COVARIANCE_DIGITS))), REPRODUCIBLE_DIGITS)


def _effect_lines(
    effect: Effect, values: Mapping[str, float], errors: Mapping[str, float], reproducible: bool
) -> Iterator[str]:
    """Yield the TOML lines of one effect's table with its values.

    values, errors : parameter -> value (0 if missing) and standard error [SI]
    """
    yield from ("", "[[effect]]", *_entries(effect.to_dict()), "[effect.values]")
    for name, (_, unit) in effect.sizes().items():
        parameter = f"{effect.label}.{name}"
        entry: dict[str, Any] = {"value": float(values.get(parameter, 0.0)), "unit": unit}
        if parameter in errors:
            entry["std_error"] = errors[parameter]
        if reproducible:
            size = errors.get(parameter, 0.0) or 1e-3 * entry["value"]
            entry |= {k: rounded_at(v, size, REPRODUCIBLE_DIGITS) for k, v in entry.items() if k != "unit"}
        yield f"{_key(name)} = {_text(entry)}"


def _learnt_lines(arm: Arm, knowledge: Knowledge) -> Iterator[str]:
    """Yield the lines of the table [learnt]."""
    yield from ("", "[learnt]", f"campaign = {_text(knowledge.campaign)}", f"poses = {knowledge.poses}")
    if knowledge.misfit > 1:
        yield f"misfit = {rounded_at(knowledge.misfit, knowledge.misfit, REPRODUCIBLE_DIGITS)!r}"
    if knowledge.robots:
        yield f"robots = {knowledge.robots}"
    if len(knowledge.readings):
        units = zip(arm.reading_units.items(), knowledge.readings, strict=True)
        yield from ("[learnt.readings]", *_entries({key: (pair / factor).tolist() for (key, factor), pair in units}))
    if knowledge.conditions:
        pairs = {name: [float(v) for v in pair] for name, pair in knowledge.conditions.items()}
        yield from ("[learnt.conditions]", *_entries(pairs))


def _entries(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield each key and value of a table as a line of TOML."""
    return (f"{_key(key)} = {_text(value)}" for key, value in table.items())


def _key(name: str) -> str:
    """Return a key as TOML, quoted where necessary."""
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else _text(name)


def _text(value: Any) -> str:
    """Return a value as TOML; numbers are the shortest that read back to the last bit."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_text, value)) + "]"
    return str(tomlkit.item(value).as_string())


# Newest version of robot and effect files; from 2 on they have effects and their covariances.
FILE_VERSION = 2


class _EffectFile(DefinitionFile):
    """The schema of an effect file."""

    written_by: str = ""
    robot: str = ""
    effect: list[EffectTable] = Field(default=[])
    learnt: LearntTable = LearntTable()
    covariance: list[CovarianceTable] = Field(default=[])


@dataclass(frozen=True)
class Effects:
    """Content of an effect file: effects and the values of their parameters.

    effects : of the file; values : parameter name -> value [SI], as far as the file gives them
    robot : name of the robot on which they were identified; kinds : classes that the file defines
    """

    effects: tuple[Effect, ...]
    values: Mapping[str, float]
    robot: str = ""
    kinds: tuple[type[Effect], ...] = ()


def read_effects(path: str | Path, effects: Sequence[type[Effect]] = ()) -> Effects:
    """Read the effects and values of an effect file, and the effects that it defines.

    Its formulas are parsed and never executed; standard errors, [learnt] and [[covariance]] are not
    returned.

    effects : classes of your own, as of `read_robot`
    Raises InputError that names file, key and what is allowed.
    """
    path = Path(path)
    file = check(_EffectFile, load_toml(path), path.name)
    if not (file.effect or file.definition):
        raise InputError(f"{path.name}: neither [[effect]] nor [[definition]]; one at least is needed")
    with errors_of(f"{path.name}: "):
        chosen, values, _ = effects_of(file.effect, file.definition, effects)
    return Effects(chosen, values, file.robot, new_effects(file.definition))


def effects_toml(robot: Robot, effects: Sequence[Effect], comment: str = "", *, reproducible: bool = False) -> str:
    """Return some effects of a robot, with values and covariance, as the text of an effect file.

    comment : text at the head of the file; reproducible : as of `to_toml`
    """
    names = {p.name for e in effects for p in e.parameters()}
    knowledge = robot.knowledge.without(set(robot.parameters.names) - names) if robot.knowledge else None
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += [f"casadical = {FILE_VERSION}", f'written_by = "casadical {__version__}"']
    lines.append(f"robot = {tomlkit.item(robot.name).as_string()}")
    return "\n".join([*lines, *text_of(robot, effects, knowledge, reproducible=reproducible), ""])
