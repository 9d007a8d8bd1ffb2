"""The structured text and the FMU: run by other means than the exporter's own."""

import math
import re
import zipfile

import export_models as models
import numpy as np
import pytest

from casadical.export import Command, Status
from casadical.export.c.language import Label
from casadical.export.c.structured_text import structured_text
from casadical.export.c.tape_program import tape_program

# A few lines of an IEC 61131-3 interpreter: structured text turned into Python source, block by block.
_WORDS = {"MOD": "%", "NOT": "not", "AND": "and", "OR": "or", "TRUE": "True", "FALSE": "False"}
_LIBRARY = {
    "SIN": math.sin, "COS": math.cos, "SQRT": math.sqrt, "EXP": math.exp, "ATAN": math.atan, "ABS": abs, "MAX": max,
    "MIN": min, "TRUNC": int, "DINT_TO_REAL": float, "DINT_TO_LREAL": float,
    "LIMIT": lambda low, x, high: min(max(low, x), high), "SEL": lambda g, a, b: b if g else a,
}  # fmt: skip


def _expression(text, names):
    text = re.sub(r"\b(MOD|NOT|AND|OR|TRUE|FALSE)\b", lambda m: _WORDS[m.group(1)], text)
    text = re.sub(r"(?<![<>:])=", "==", text)
    return re.sub(r"(?<![\w.])([a-z]\w*)", lambda m: f"self.{m.group(1)}" if m.group(1) in names else m.group(1), text)


def _lines(body, names, result):
    depth = 2
    body = re.sub(r"\(\*.*?\*\)", "", body, flags=re.S)
    for raw in body.replace("; END_IF", ";\nEND_IF").replace("THEN ", "THEN\n").split("\n"):
        line = raw.strip()
        pad = "    " * depth
        if not line:
            continue
        if m := re.fullmatch(r"IF (.*) THEN", line):
            yield f"{pad}if {_expression(m[1], names)}:"
            depth += 1
        elif m := re.fullmatch(r"ELSIF (.*) THEN", line):
            yield f"{'    ' * (depth - 1)}elif {_expression(m[1], names)}:"
        elif line == "ELSE":
            yield f"{'    ' * (depth - 1)}else:"
        elif line in ("END_IF;", "END_FOR;"):
            depth -= 1
        elif m := re.fullmatch(r"FOR (\w+) := (.*) TO (.*) DO", line):
            yield f"{pad}for self.{m[1]} in range({m[2]}, {m[3]} + 1):"
            depth += 1
        elif m := re.fullmatch(r"(\w+)\((.*)\);", line):
            for pair in m[2].split(","):
                name, value = pair.split(":=")
                yield f"{pad}self.{m[1]}.{name.strip()} = _copy({_expression(value.strip(), names)})"
            yield f"{pad}self.{m[1]}()"
        else:
            m = re.fullmatch(r"(.*?) := (.*);", line)
            target = "self._result" if m[1] == result else _expression(m[1], names)
            yield f"{pad}{target} = {_expression(m[2], names)}"


def interpreted(text):
    """Python classes of the function blocks in a structured text."""
    space = dict(_LIBRARY) | {"_copy": lambda v: list(v) if isinstance(v, list) else v}
    block_text = r"^(FUNCTION_BLOCK|FUNCTION) (\w+)( : \w+)?\n(.*?)^END_\1$"
    for kind, name, _, body in re.findall(block_text, text, flags=re.S | re.M):
        declared = re.findall(r"^    (\w+) : ([^;:]+?)(?: := ([^;]+))?;", body, flags=re.M)
        code = re.sub(r"^VAR.*?^END_VAR\n", "", body, flags=re.S | re.M)
        names = {d[0] for d in declared}
        source = [f"class {name}_block:", "    def __init__(self):"]
        for variable, type_, start in declared:
            if array := re.match(r"ARRAY\[0\.\.(\d+)\]", type_):
                value = start or f"[0.0] * {int(array[1]) + 1}"
            elif type_ in ("REAL", "LREAL", "INT", "DINT", "BOOL"):
                value = {"TRUE": "True", "FALSE": "False"}.get(start, start) or "0"
            else:
                value = f"{type_}_block()"
            source.append(f"        self.{variable} = {value}")
        source += ["    def __call__(self):", *_lines(code, names, name)]
        exec("\n".join(source), space)
        if kind == "FUNCTION":
            arguments = re.search(r"VAR_INPUT\n(.*?)END_VAR", body, flags=re.S)[1]
            order = re.findall(r"(\w+) :", arguments)
            block = space[f"{name}_block"]

            def function(*values, block=block, order=order):
                it = block()
                for key, value in zip(order, values, strict=True):
                    setattr(it, key, value)
                it()
                return it._result

            space[name] = function
    return space


def called(block, q):
    block.q = list(map(float, q))
    block()
    return block.status


def test_structured_text_computes_what_the_c_computes(command, kernels):
    space = interpreted(structured_text(tape_program(command, "double"), Label("arm")))
    rng = np.random.default_rng(8)
    q = rng.uniform(models.LOWER, models.UPPER, (40, 6))
    q[5] *= 4
    q[6, 2] = np.nan
    q[7, 1] = np.inf
    network, correct = space["arm_network_block"](), space["arm_correct_block"]()
    expected, statuses = kernels["command", "double"].network(q)
    moved, moved_statuses = kernels["command", "double"].correct(q)
    for k in range(len(q)):
        assert called(network, q[k]) == statuses[k]
        np.testing.assert_allclose(network.dp_mm, expected[k], rtol=0, atol=1e-12)
        assert called(correct, q[k]) == moved_statuses[k]
        np.testing.assert_allclose(correct.dq, moved[k], rtol=0, atol=1e-11)
    assert {Status.OK, Status.CLAMPED, Status.NOT_FINITE} <= set(moved_statuses.tolist())


def test_structured_text_ramps_like_the_c(command, kernels):
    space = interpreted(structured_text(tape_program(command, "double"), Label("arm")))
    n = 60
    q = np.linspace(models.LOWER * 0.5, models.UPPER * 0.5, n)
    q[20] = np.nan
    enable = np.arange(n) < 45
    expected, statuses = kernels["command", "double"].steps(q, enable)
    step = space["arm_step_block"]()
    for k in range(n):
        step.enable = bool(enable[k])
        assert called(step, q[k]) == statuses[k]
        np.testing.assert_allclose(step.dq, expected[k], rtol=0, atol=1e-11)


def test_structured_text_of_a_loop_has_its_own_atan2():
    product = Command(models.nominal(), models.with_loop(), models.LOWER, models.UPPER)
    space = interpreted(structured_text(tape_program(product, "double"), Label("arm")))
    for angle in np.linspace(-3.1, 3.1, 25):
        assert math.isclose(space["arm_atan2"](math.sin(angle), math.cos(angle)), angle, abs_tol=1e-14)
    assert space["arm_atan2"](0.0, 0.0) == 0.0
    forward = space["arm_forward_values_block"]()
    q = np.random.default_rng(9).uniform(models.LOWER, models.UPPER, 6)
    forward.x = q.tolist()
    forward()
    np.testing.assert_allclose(forward.y, np.array(models.with_loop()(q)).ravel(), atol=1e-12)


def test_the_fmu_is_an_archive_with_sources_and_no_dates(exported):
    with zipfile.ZipFile(exported["command", "float"] / "arm.fmu") as archive:
        names = archive.namelist()
        assert {"modelDescription.xml", "sources/arm.c", "sources/arm_fmu.c"} <= set(names)
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert archive.read("sources/arm.c") == (exported["command", "float"] / "arm.c").read_bytes()


@pytest.mark.parametrize(("kind", "real"), [("network", "double"), ("command", "float")])
@pytest.mark.filterwarnings("default")
def test_fmpy_checks_builds_and_simulates_the_fmu(exported, kernels, tmp_path, kind, real):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed (pip install fmpy)")
    build = pytest.importorskip("fmpy.build", reason="this FMPy has no fmpy.build")
    validation = pytest.importorskip("fmpy.validation")
    import shutil

    if shutil.which("cmake") is None:
        pytest.skip("no cmake on this machine")
    assert validation.validate_fmu(str(exported[kind, real] / "arm.fmu")) == []
    fmpy.extract(str(exported[kind, real] / "arm.fmu"), str(tmp_path))
    build.build_platform_binary(str(tmp_path))
    result = fmpy.simulate_fmu(str(tmp_path), stop_time=1.2, step_size=0.004, output_interval=0.004)
    middle = ((models.LOWER + models.UPPER) / 2)[None, :]
    function, names = ("network", "dp_mm") if kind == "network" else ("correct", "dq")
    values, status = kernels[kind, real].rows(function, middle)
    found = [result[f"{names}[{i + 1}]"][-1] for i in range(values.shape[1])]
    np.testing.assert_allclose(found, values[0], rtol=1e-6)
    assert result["status"][-1] == status[0]
    if kind == "command":
        assert max(abs(np.diff(result["dq[1]"]))) <= 0.5 * 0.004 * 1.001
        assert result["dq[1]"][0] == 0
