"""Public docstrings say what a caller must know: shapes and units of arrays, errors raised, sources of methods."""

import ast
import inspect
import re
from collections.abc import Iterator
from functools import cache

import pytest
from test_docs_reference import OURS, documented
from walk import ROOT

from casadical.compensator.trainers import registry as trainers
from casadical.effects import registry as effects

# Members of families, public by their line in a registry.
MEMBERS = {
    f"casadical.{room}.{name}": kind
    for room, registry in (("effects", effects), ("compensator", trainers))
    for name, kind in vars(registry).items()
    if inspect.isclass(kind)
}
ARRAY = re.compile(r"\b(?:Array|NDArray|ArrayLike|Vector|ndarray|Buffer)\b")
SHAPE = re.compile(r"shapes? \(|\((?:(?:\w+|\.{3}), ?)*\w*\d?,?\)|see `|see :func|as of `|inverse of `")
UNIT = re.compile(r"\[[^\]]+\]|_mm\b|\bSI\b|boolean|bool|degrees|radians|see `|see :func|as of `")
# Arrays without a unit, as what they hold has none.
UNITLESS = {
    *("casadical.compensator.Layout.layers", "casadical.compensator.Layout.weights"),
    *("casadical.Effect.parts", "casadical.effects.Effect.parts", "casadical.effects.JointErrorCurve.parts"),
}


def public() -> Iterator[tuple[str, object]]:
    """Every name of the reference and of the registries, and the classes' own public methods and properties."""
    for name, thing in (documented() | MEMBERS).items():
        yield name, thing
        for key, member in vars(thing).items() if inspect.isclass(thing) else ():
            function = underlying(member)
            if not key.startswith("_") and inspect.isfunction(function):
                yield f"{name}.{key}", function


def underlying(member: object) -> object:
    """The function of a property or class method."""
    for attribute in ("func", "fget", "__func__"):
        member = getattr(member, attribute, member)
    return member


PUBLIC = dict(public())


def doc(thing: object) -> str:
    return inspect.getdoc(thing) or ""


def test_all_have_a_docstring() -> None:
    """Of methods, those that are no more than their name (`label`, `name`) and overridden ones may go without."""
    assert [name for name, thing in PUBLIC.items() if inspect.isclass(thing) and not thing.__doc__] == []
    assert [name for name, thing in PUBLIC.items() if name.count(".") < 3 and not doc(thing)] == []


def takes_arrays(thing: object) -> bool:
    if inspect.isclass(thing):
        return any(ARRAY.search(str(a)) for a in vars(thing).get("__annotations__", {}).values())
    return any(ARRAY.search(str(a)) for a in getattr(thing, "__annotations__", {}).values())


WITH_ARRAYS = sorted(name for name, thing in PUBLIC.items() if takes_arrays(thing))


@pytest.mark.parametrize("name", WITH_ARRAYS)
def test_shapes_and_units_of_arrays_are_told(name: str) -> None:
    text = doc(PUBLIC[name])
    assert SHAPE.search(text), f"{name} does not say the shape of its arrays:\n{text}"
    assert name in UNITLESS or UNIT.search(text), f"{name} does not say their unit:\n{text}"


@cache
def of_the_files() -> list[tuple[str, ast.Module | ast.ClassDef | ast.FunctionDef]]:
    """Everything in the package that may have a docstring, named by file and line."""
    return [
        (f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}", node)
        for path in sorted((ROOT / "casadical").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    ]


OTHER_STYLES = re.compile(
    r"^ *(-{3,}|(Args|Arguments|Parameters|Returns|Raises|Attributes|Yields):?|:\w+[^:]*:.*)$", re.M
)
SECTIONED = re.compile(r"\n\n(Parameters|Returns|Raises|Attributes|References|Examples)\n-+\n.*", re.S)


def test_one_style() -> None:
    """Text first; then numpydoc's sections or lines `name : meaning, shape, unit`, whichever inform; errors may be a
    sentence, `Raises InputError ...`.
    """
    docs = {place: ast.get_docstring(node) or "" for place, node in of_the_files()}
    assert [place for place, text in docs.items() if OTHER_STYLES.search(SECTIONED.sub("", text))] == []
    functions = [place for place, node in of_the_files() if isinstance(node, ast.FunctionDef)]
    assert [place for place in functions if re.match(r"\w+ : ", docs[place])] == []  # a class may begin with its fields


def test_functions_of_every_module_tell_their_errors() -> None:
    """Those that raise one of ours themselves. A command's docstring is its help, and exit codes are told elsewhere."""
    without = []
    for place, node in of_the_files():
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and "casadical/cli" not in place:
            raised = [n.exc.func for n in ast.walk(node) if isinstance(n, ast.Raise) and isinstance(n.exc, ast.Call)]
            text = ast.get_docstring(node) or "Raises"  # without one it overrides a method that tells it
            if {getattr(f, "id", "") for f in raised} & OURS and "Raises" not in text:
                without.append(f"{place} {node.name}")
    assert without == []


def test_methods_from_the_literature_name_their_source() -> None:
    """By module: a year or an equation of the paper."""
    modules = [
        *(f"robot.{name}" for name in ("fourbar", "kinematics", "robot")),
        *(f"identification.{name}" for name in ("identifiability", "identification", "placement")),
        *(f"compensator.{name}" for name in ("iwo", "network", "trainers.levenberg_marquardt", "trainers.distilled")),
        *("pose_selection.information", "pose_selection.experimental_design", "diagnosis.evidence", "core.statistics"),
    ]
    without = []
    for module in modules:
        text = (ROOT / "casadical" / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")
        if not re.search(r"\b(?:19|20)\d\d\b|paper, |eqs?\. ?\d", text):
            without.append(module)
    assert without == []


def test_every_effect_states_its_physics() -> None:
    from casadical.effects.plugins import known_effects

    listed = {name: kind for name, kind in known_effects().items() if kind.on_list != "unknown"}
    assert len(listed) > 25
    assert [name for name, kind in listed.items() if not (kind.physics and kind.signature)] == []
