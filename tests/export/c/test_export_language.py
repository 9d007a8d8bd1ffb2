"""A language from another package: a module and its metadata in a folder, used by the command in a fresh process."""

import csv
import hashlib
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from plugin_site import ROOT, installed, run

from casadical.core.basics import InputError
from casadical.export import Sources, command_of, write_c

GROUP = "casadical.controller_languages"

# A row an operation: what it does, the rows that it takes, its constant; the last row names the outputs.
MODULE = """
import csv, io
from casadical.export import Language

class Rows(Language):
    name = "rows"

    def files(self, program, label):
        found = {}
        for key, tape in program.tapes.items():
            text = io.StringIO()
            writer = csv.writer(text, lineterminator="\\n")
            writer.writerows([node.op, " ".join(map(str, node.args)), node.value.hex()] for node in tape.nodes)
            writer.writerow(["outputs", " ".join(map(str, tape.outputs)), ""])
            found[f"{label.name}_{key}.csv"] = text.getvalue()
        return found
"""


OPERATIONS = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "sqrt": math.sqrt,
    "atan2": math.atan2,
    "sincos": lambda a: a,
    "sin": math.sin,
    "cos": math.cos,
}


def interpreted(path: Path, q: np.ndarray) -> list[float]:
    """The table's outputs, by Python's own floating point."""
    values: list[float] = []
    *nodes, last = csv.reader(path.read_text().splitlines())
    for op, places, constant in nodes:
        arguments = [values[int(k)] for k in places.split()]
        if op == "input":
            values.append(float(q[int(float.fromhex(constant))]))
        elif op == "const":
            values.append(float.fromhex(constant))
        elif op.startswith("guard"):
            values.append((max if op == "guard_min" else min)(arguments[0], float.fromhex(constant)))
        else:
            values.append(OPERATIONS[op](*arguments))
    return [values[int(k)] for k in last[1].split()]


def test_a_plug_in_writes_what_the_model_computes(tmp_path):
    site, out = installed(tmp_path, GROUP, "rows = toy:Rows", MODULE), tmp_path / "c"
    nominal = ROOT / "problems" / "hh800" / "robot.toml"
    done = run(site, "export", "c", nominal, "--nominal", nominal, "--name", "arm", "--out", out, "--language", "rows")
    assert (done.returncode, done.stderr) == (0, "")
    manifest = json.loads((out / "manifest.json").read_text())
    tables = {"arm_forward.csv", "arm_prepare.csv", "arm_advance.csv"}
    assert tables < set(manifest["files"])
    assert "arm.c" in manifest["files"]
    assert "arm.st" not in manifest["files"]
    assert manifest["files"]["arm_forward.csv"] == hashlib.sha256((out / "arm_forward.csv").read_bytes()).hexdigest()
    command = command_of(Sources(nominal, nominal))
    for q in np.random.default_rng(0).uniform(command.lower, command.upper, (20, 6)):
        expected = command.calibrated(q).full().ravel()
        if np.isfinite(expected).all():
            assert interpreted(out / "arm_forward.csv", q) == pytest.approx(expected, abs=1e-12)


def test_without_the_plug_in_its_name_is_refused_with_those_that_exist(tmp_path):
    nominal = ROOT / "problems" / "ur10" / "robot.toml"
    done = run(tmp_path, "export", "c", nominal, "--nominal", nominal, "--out", tmp_path / "c", "--language", "rows")
    assert done.returncode == 2
    assert "language 'rows' is not known; allowed: c, structured_text" in done.stderr
    assert not (tmp_path / "c").exists()


def test_the_c_alone(tmp_path, network):
    made = write_c(network, tmp_path, name="arm", languages=(), vectors=100)
    assert "arm.c" in made.written
    assert "arm.st" not in made.written


FAULTY = {
    "not there": (MODULE, "rows = toy:Row", "cannot be loaded"),
    "no language": ("Rows = 3", "rows = toy:Rows", "must be a subclass of casadical.export.c.language.Language"),
    "of another name": (MODULE, "tape = toy:Rows", "both need the same name"),
    "taken": (MODULE.replace('"rows"', '"c"'), "c = toy:Rows", "there is a 'c' already"),
    "files of the C": (MODULE.replace('_{key}.csv"]', '.c"]'), "rows = toy:Rows", "writes arm.c, which is"),
}


@pytest.mark.parametrize("case", FAULTY)
def test_a_faulty_plug_in_is_named(case, tmp_path, monkeypatch, network):
    module, point, message = FAULTY[case]
    monkeypatch.syspath_prepend(installed(tmp_path, GROUP, point, module))
    monkeypatch.delitem(sys.modules, "toy", raising=False)
    with pytest.raises(InputError, match=message):
        write_c(network, tmp_path / "c", name="arm", languages=("rows",), vectors=100)
    sys.modules.pop("toy", None)
    assert not (tmp_path / "c").exists()
