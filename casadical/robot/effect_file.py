"""Effect files: effects alone, with values, covariance and range, to be put into any robot or be a candidate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import tomlkit
from pydantic import Field

from casadical import __version__
from casadical.core.errors import InputError
from casadical.core.reading import load_toml
from casadical.core.schema import check
from casadical.effects import Effect
from casadical.effects.definition import DefinitionFile
from casadical.effects.plugins import new_effects
from casadical.robot.effect_tables import CovarianceTable, EffectTable, LearntTable, effects_of, text_of
from casadical.robot.robot import Robot

VERSION = 2


class _EffectFile(DefinitionFile):
    written_by: str = ""
    robot: str = ""
    effect: list[EffectTable] = Field(default=[])
    learnt: LearntTable = LearntTable()
    covariance: list[CovarianceTable] = Field(default=[])


@dataclass(frozen=True)
class Effects:
    """Effects and the values of their parameters [SI].

    robot : name of that on which they were found; kinds : effects that the file defines
    """

    effects: tuple[Effect, ...]
    values: Mapping[str, float]
    robot: str = ""
    kinds: tuple[type[Effect], ...] = ()


def read_effects(path: str | Path, effects: Sequence[type[Effect]] = ()) -> Effects:
    """Effects from a file, and those that it defines; its formulas are parsed and never executed.

    effects : classes of your own, as of `read_robot`. Raises InputError that names file, key and what is allowed.
    """
    path = Path(path)
    file = check(_EffectFile, load_toml(path), path.name)
    if not (file.effect or file.definition):
        raise InputError(f"{path.name}: neither [[effect]] nor [[definition]]; one at least is needed")
    try:
        known, values, _ = effects_of(file.effect, file.definition, effects)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None
    return Effects(known, values, file.robot, new_effects(file.definition))


def effects_toml(robot: Robot, effects: Sequence[Effect], comment: str = "", *, known_alone: bool = False) -> str:
    """Some effects of a robot as the text of an effect file, with what is known of their values."""
    names = {p.name for e in effects for p in e.parameters()}
    known = robot.knowledge.without(set(robot.parameters.names) - names) if robot.knowledge else None
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += [f"casadical = {VERSION}", f'written_by = "casadical {__version__}"']
    lines.append(f"robot = {tomlkit.item(robot.name).as_string()}")
    return "\n".join([*lines, *text_of(robot, effects, robot.effect_values, known, known_alone=known_alone), ""])
