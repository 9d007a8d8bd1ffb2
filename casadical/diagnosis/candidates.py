"""Candidate causes: listed effects, whole and per joint, on a grid of settings; unlisted forms."""

import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import groupby
from typing import Literal

from casadical.core.basics import InputError
from casadical.effects import Effect
from casadical.effects.definition import DefinedEffect
from casadical.effects.formula_effect import MOTION_SEAMS
from casadical.effects.plugins import effects_by_name
from casadical.measurements.derived_columns import Loads, derive
from casadical.measurements.measurements import Measurements, same_readings
from casadical.robot.effect_tables import read_effects
from casadical.robot.robot import Robot

# Name or label of an effect to consider, an effect, or a class of effects.
EffectName = str | Effect | type[Effect]
# Choice of candidate causes: the name of a list, or effects.
EffectChoice = Literal["standard", "extended"] | Sequence[EffectName]
# Classes of user-defined effects that are causes in joint logs.
OwnCauses = tuple[type[DefinedEffect], ...]


@dataclass(frozen=True)
class Candidate:
    """One possible cause.

    label : name, or name@joint; name : name under which the effect is reported
    joint : its joint, 1-based, or None
    variants : its possible settings; each variant is one or more effects that act together
    listed : whether it may be named as a cause; False for unlisted forms
    """

    label: str
    name: str
    joint: int | None
    variants: tuple[tuple[Effect, ...], ...]
    listed: bool = True

    @property
    def together(self) -> bool:
        """Return whether it is a listed effect of several joints, each with a size of its own."""
        return self.listed and len(_joints(self.variants[0])) > 1

    @property
    def covers(self) -> frozenset[str]:
        """Return the names of the effects that are no candidates once this one is in the model.

        They are its effect's `covers` and, if it acts at several joints, its own name, which stands
        for the effect at single joints.
        """
        first = self.variants[0][0]
        return first.covers | ({first.name} if self.together else frozenset())


def all_effects() -> tuple[str, ...]:
    """Return the names of all effects that are on a list of candidate causes, sorted."""
    return tuple(sorted(kind.name for kind in effects_by_name().values() if kind.on_list != "unknown"))


def candidates_of(robot: Robot, effects: EffectChoice) -> list[Candidate]:
    """Return the candidates of a choice of effects, without those that the robot has already.

    effects : "standard", "extended", or names, labels, own effects and their classes
    Raises InputError for a name that is no effect, effects of joint logs, and if the robot has all.
    """
    chosen = [effects] if isinstance(effects, str) else list(effects)
    own_ones = [Candidate(e.label, e.name, e.joint, ((e,),)) for e in chosen if isinstance(e, Effect)]
    own_ones += _of_kinds([e for e in chosen if isinstance(e, type)], robot)
    seams = {c.label: {*getattr(c.variants[0][0], "formulas", ("",))} for c in own_ones if c.variants}
    if of_logs := [label for label, seam in seams.items() if seam <= {*MOTION_SEAMS}]:
        raise InputError(f"{of_logs[0]}: acts at {', '.join(MOTION_SEAMS)}, in joint logs; name effects of poses")
    standard = named(robot, [e for e in chosen if isinstance(e, str)], own_ones)
    if not robot.effects:
        return standard
    # Parameters of effects that the robot has already are fixed.
    own = set(robot.parameters.names)
    new = {
        c.label: tuple(v for v in c.variants if own.isdisjoint([p.name for effect in v for p in effect.parameters()]))
        for c in standard
    }
    if not any(new[c.label] for c in standard if c.listed):
        words = ", ".join(e if isinstance(e, str) else e.label if isinstance(e, Effect) else e.name for e in chosen)
        raise InputError(f"{words}: robot {robot.name!r} has it already, held at its value; name other effects")
    return [replace(c, variants=new[c.label]) for c in standard if new[c.label]]


def own_causes(files: Sequence[str]) -> OwnCauses:
    """Return the causes of joint logs that effect files define.

    files : paths of effect files (`.toml`)
    Raises InputError for a word that is no file, and for effects of measured poses.
    """
    kinds: list[type[DefinedEffect]] = []
    for word in files:
        if not word.strip().endswith(".toml"):
            raise InputError(f"--effects {word}: of joint logs every cause of the list is judged; own ones are files")
        file = read_effects(word.strip())
        own = [k for k in file.kinds if issubclass(k, DefinedEffect) and {*k.definition.formulas} <= {*MOTION_SEAMS}]
        other = [k.name for k in file.kinds if k not in own] + [e.name for e in file.effects]
        if other:
            raise InputError(f"{word}: {other[0]} is of poses; causes of joint logs act at {', '.join(MOTION_SEAMS)}")
        kinds += own
    return tuple(kinds)


def choose(
    candidates: Sequence[Candidate], m: Measurements, loads: Loads | None = None
) -> tuple[tuple[Candidate, ...], dict[str, tuple[str, ...]]]:
    """Return the candidates whose columns were logged, and the missing columns of the others.

    Missing columns are given by label of a listed candidate. Variants that replace others where a
    column is missing are excluded if it was logged (`Effect.only_without`).
    loads : function that returns the joint loads of the robot, see `derive`
    Raises InputError where columns are missing for every listed candidate.
    """
    _, missing = derive(m, [c for k in candidates for v in k.variants for e in v for c in e.conditions], loads)
    distinct = [int(same_readings(q[:, None]).max()) + 1 for q in m.q.T]
    possible, without = [], {}
    for candidate in candidates:
        lacking = [tuple(c for e in v for c in e.conditions if c in missing) for v in candidate.variants]
        allowed = [not any(c in m.conditions for e in v for c in e.only_without) for v in candidate.variants]
        if not any(allowed):
            continue
        usable = (v for v, lack, yes in zip(candidate.variants, lacking, allowed, strict=True) if yes and not lack)
        resolved = (tuple(e.for_poses(len(m), distinct) for e in v) for v in usable)
        variants = tuple(v for v in resolved if all(e.sizes() for e in v))
        if variants:
            possible.append(Candidate(candidate.label, candidate.name, candidate.joint, variants, candidate.listed))
        elif candidate.listed and not candidate.variants[0][0].from_kind and any(lacking):
            without[candidate.label] = tuple(dict.fromkeys(c for lack in lacking for c in lack))
    if without and not any(c.listed for c in possible):
        words = "; ".join(f"{label} needs {', '.join(lack)}" for label, lack in without.items())
        raise InputError(f"none of the chosen effects can be tried, for the table lacks columns: {words}")
    return tuple(possible), without


def named(robot: Robot, names: Iterable[str], extra: Iterable[Candidate] = ()) -> list[Candidate]:
    """Return candidates chosen by list (standard), name (backlash) or label (backlash@5).

    Smooth forms are appended as unlisted candidates and, with the list standard, extended effects.
    extra : a user's own effects, which replace those of the lists with the same label
    Raises InputError for a name that is no effect, or an own effect of a joint the robot lacks.
    """
    standard = _of_list("standard", robot)
    extended = [*standard, *_of_list("extended", robot)]
    every = [*extended, *_of_list("", robot)]
    lists = {"standard": standard, "extended": extended}
    chosen = list(extra)
    for effect in (e for candidate in chosen for variant in candidate.variants for e in variant):
        effect.refuse_joints(robot)
    for name in names:
        hit = lists.get(name) or [c for c in every if name in (c.name, c.label)]
        if not hit:
            choices = ", ".join([*lists, *sorted({c.name for c in every})])
            raise InputError(f"no effect {name!r} of this robot; there are {choices}; with a joint: backlash@5")
        chosen += hit
    # A user's own effect replaces the listed one with the same label.
    unique = {c.label: c for c in reversed(chosen)}
    # Extended effects without a setting that only a user can know are rivals of standard ones.
    rivals = [
        replace(c, listed=False)
        for c in extended[len(standard) :]
        if "standard" in names
        and c.label not in unique
        and not any(f.metadata.get("given") for f in fields(c.variants[0][0]))
    ]
    smooth = [replace(c, name="unknown", joint=None, listed=False) for c in _of_list("unknown", robot)]
    return [*unique.values()][::-1] + rivals + smooth


def _of_list(which: str, robot: Robot) -> list[Candidate]:
    """Return the candidates of the effects on a list (`Effect.on_list`), ordered as registered.

    Neighbouring effects of single joints are ordered joint by joint.
    """
    return _of_kinds([kind for kind in effects_by_name().values() if kind.on_list == which], robot)


def _of_kinds(kinds: Iterable[type[Effect]], robot: Robot) -> list[Candidate]:
    """Return the candidates of some classes of effects, one for each label."""
    variants = [v for kind in kinds for v in kind.variants(robot)]
    runs = groupby(variants, key=lambda v: v[0].joint is None)
    by_label: dict[str, list[tuple[Effect, ...]]] = {}
    for variant in (v for _, run in runs for v in sorted(run, key=lambda v: (len(_joints(v)), v[0].joint or 0))):
        first = variant[0]
        name = first.answers_as or first.name
        label = name if len(_joints(variant)) > 1 else first.label.replace(first.name, name)
        by_label.setdefault(label, []).append(variant)

    def candidate(label: str, own: list[tuple[Effect, ...]]) -> Candidate:
        """Return the candidate of the variants of one label."""
        first, alone = own[0][0], len(_joints(own[0])) == 1
        return Candidate(label, first.answers_as or first.name, first.joint if alone else None, tuple(own))

    return [candidate(label, own) for label, own in by_label.items()]


def _joints(variant: tuple[Effect, ...]) -> set[int | None]:
    """Return the joints (1-based) of a variant's effects, None for an effect of no joint."""
    return {e.joint for e in variant}


def columns_to_log(missing: Mapping[str, Sequence[str]], logged: Container[str]) -> dict[str, tuple[str, ...]]:
    """Return the columns to log, as a table names them, by label of the effect that lacks them.

    missing : missing conditions by label, some of which are derived (see `derived_columns.derive`)
    logged : names of the columns that were logged
    """
    warmth = ("temperature_degC",) if "time_s" in logged else ("temperature_degC", "time_s")
    made_of = {"progress": ("time_s",), "warmth": warmth, "heat": ("time_s",), "head": ("x_mm", "y_mm", "z_mm")}

    def named(condition: str) -> tuple[str, ...]:
        """Return the columns from which a condition is made, as a table names them."""
        made = re.fullmatch("progress|(warmth|heat|head)[0-9]*_.*", condition)
        return made_of[made[1] or "progress"] if made else (condition,)

    return {label: tuple(dict.fromkeys(n for c in lacking for n in named(c))) for label, lacking in missing.items()}


def gathered_by_columns(missing: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the effects that lack columns as text, by a text of these columns.

    missing : columns by label, as of `columns_to_log`
    """
    labels_of: dict[str, list[str]] = {}
    for label, columns in missing.items():
        labels_of.setdefault(" with ".join(columns), []).append(label)
    return {columns: gathered(labels) for columns, labels in labels_of.items()}


def gathered(labels: Iterable[str]) -> str:
    """Return labels as text with the joints of each effect together, as in "backlash@2,3"."""
    joints: dict[tuple[str, str], list[str]] = {}
    for label in map(str, labels):
        name, at, joint = label.partition("@")
        joints.setdefault((name, at), []).append(joint)
    return ", ".join(f"{name}{at}{','.join(js)}" for (name, at), js in joints.items())
