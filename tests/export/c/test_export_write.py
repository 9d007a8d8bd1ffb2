"""Writing an export and loading it again: what is written, what is refused, whose C is run."""

import hashlib
import inspect
import json
import shutil
from pathlib import Path

import casadi as ca
import export_models as models
import numpy as np
import pytest

from casadical.core.basics import CasadicalError, InputError
from casadical.export import load, write_c
from casadical.export.c.kernel import Manifest, compilers
from casadical.export.c.products import Command, Limits, NetworkFunction

AT_LOAD = "__attribute__((constructor)) static void at_load(void)"


@pytest.fixture(scope="module")
def place(tmp_path_factory, network, compiler):
    """An export, `c`, and the cache that knows it, `cache`."""
    place = tmp_path_factory.mktemp("exported")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CASADICAL_CACHE", str(place / "cache"))
        write_c(network, place / "c", name="arm", real="float", vectors=100)
    return place


@pytest.fixture
def folder(place, tmp_path, monkeypatch):
    """A copy of it, with a cache of its own."""
    shutil.copytree(place, tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "c"


def planted(folder: Path, text: str) -> None:
    """Foreign C in an export folder, with a hash that fits."""
    source = folder / "arm.c"
    source.write_text(text + source.read_text())
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"]["arm.c"] = hashlib.sha256(source.read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_the_same_model_gives_the_same_bytes_and_a_manifest_with_their_hashes(place, tmp_path):
    product = NetworkFunction(models.network(), models.LOWER, models.UPPER)
    made = write_c(product, tmp_path, name="arm", real="float", vectors=100)
    for name in made.written:
        assert (place / "c" / name).read_bytes() == (tmp_path / name).read_bytes(), name
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert {*manifest["files"], "manifest.json"} == set(made.written)
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest
        assert str(tmp_path) not in (tmp_path / name).read_text()
    assert manifest["verified"] is True
    assert inspect.signature(write_c).parameters["vectors"].default == 100_000  # where no test asks for few
    assert all(c["different"] == 0 for c in manifest["comparisons"])


def test_without_a_compiler_it_is_written_and_called_unverified(tmp_path, network, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    no_place = {tmp_path / ("x" * 300): "{}"}
    with pytest.raises(InputError, match="nothing was written"):
        write_c(network, tmp_path / "c", name="arm", also=lambda made: no_place)
    assert list(tmp_path.iterdir()) == []
    export = write_c(network, tmp_path, name="arm", languages=())
    assert not export.verified
    assert "UNVERIFIED" in export.blocks()[0].text
    assert json.loads((tmp_path / "manifest.json").read_text())["verified"] is False
    assert "arm.c" in export.written
    assert "arm.st" not in export.written


def test_nothing_is_overwritten_or_deleted_unless_told_to(tmp_path, network, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))  # no compiler: what is written is the same
    (tmp_path / "arm.c").write_text("mine")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"arm\.c is in the way"):
        write_c(network, tmp_path, name="arm")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.c", "notes.txt"]
    assert (tmp_path / "arm.c").read_text() == "mine"
    write_c(network, tmp_path, name="arm", overwrite=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    write_c(network, tmp_path, name="arm")  # all of it is ours now
    (tmp_path / "arm.h").write_text((tmp_path / "arm.h").read_text() + "\n/* edited by hand */\n")
    with pytest.raises(InputError, match=r"arm\.h is in the way"):
        write_c(network, tmp_path, name="arm")


def test_a_difference_stops_the_export(tmp_path, network, compiler, monkeypatch):
    """A compiler that computes otherwise: a sign in a polynomial."""
    (tmp_path / "bin").mkdir()
    wrong = tmp_path / "bin" / compiler
    change = "for file; do case $file in *arm.c) sed -i '0,/+ (z [*] /s//- (z * /' \"$file\";; esac; done"
    wrong.write_text(f'#!/bin/sh\n{change}\nexec {shutil.which(compiler)} "$@"\n')
    wrong.chmod(0o755)
    monkeypatch.setenv("PATH", str(wrong.parent), prepend=":")
    with pytest.raises(CasadicalError, match="nothing was written"):
        write_c(network, tmp_path / "out", name="arm", real="float", vectors=1000)
    assert not (tmp_path / "out").exists()


def test_wrong_arguments_are_refused_with_what_is_allowed(tmp_path, network):
    for name in ("Arm", "1arm", "arm-1", "", "a" * 25):
        with pytest.raises(InputError, match="cannot prefix"):
            write_c(network, tmp_path, name=name)
    for words, message in (
        ({"languages": ["rows"]}, "language 'rows' is unknown; allowed: c, structured_text"),
        ({"real": "half"}, "'float' or 'double'"),
        ({"model_sha256": "abc"}, "no sha256"),
    ):
        with pytest.raises(InputError, match=message):
            write_c(network, tmp_path, name="arm", **words)
    with pytest.raises(InputError, match="not empty"):
        NetworkFunction(models.network(), models.UPPER, models.LOWER)
    with pytest.raises(InputError, match="expected 5 joint angles"):
        NetworkFunction(models.network(), models.LOWER[:5], models.UPPER[:5])
    for limits, message in (
        ({"rate_rad_s": -1}, "rate_rad_s is -1"),
        ({"cycle_s": 4}, r"a cycle of 4000 ms; allowed: 0.01 to 1000 ms"),
        ({"ramp_s": 0.001}, r"a ramp of 0.001 s; with a cycle of 4 ms allowed: 0.004 to 400 s"),
        ({"rate_rad_s": 100}, r"a rate of 100 rad/s; with a cycle of 4 ms allowed: 0.00025 to 37.5"),
        ({"rate_rad_s": 0.01, "cycle_s": 1e-5, "ramp_s": 0.1}, r"allowed: 0\.1 to"),
    ):
        with pytest.raises(InputError, match=message):
            Limits(**limits)
    q = ca.SX.sym("q", 6)
    plane = ca.Function("plane", [q], [q[:2]])
    with pytest.raises(InputError, match="3 or 12"):
        Command(models.nominal(), plane, models.LOWER, models.UPPER)
    with pytest.raises(InputError, match="1 to 10"):
        Command(models.nominal(), models.calibrated(), models.LOWER, models.UPPER, steps=0)


def test_own_exports_are_loaded_when_they_were_moved_and_not_when_they_were_changed(folder, tmp_path):
    shutil.move(folder, tmp_path / "moved")
    assert load(tmp_path / "moved").network(np.zeros((1, 6)))[1].tolist() == [0]
    source = tmp_path / "moved" / "arm.c"
    source.write_text(source.read_text().replace("0x1p", "0x1.1p", 1))
    with pytest.raises(InputError, match=r"arm\.c is not the file that was exported"):
        load(tmp_path / "moved")
    with pytest.raises(InputError, match=r"no manifest\.json"):
        load(tmp_path)


def test_one_compiler_is_enough(folder, monkeypatch):
    found = compilers()[:1]
    monkeypatch.setattr("casadical.export.c.kernel.compilers", lambda: found)
    assert load(folder).network(np.zeros((1, 6)))[1].tolist() == [0]


def test_foreign_code_does_not_run_without_consent(folder, tmp_path):
    trace = tmp_path / "trace"
    planted(folder, f'#include <stdio.h>\n{AT_LOAD} {{ fclose(fopen("{trace}", "w")); }}\n')
    with pytest.raises(InputError, match="was not exported here by you"):
        load(folder)
    assert not trace.exists()
    load(folder, trust=True)
    assert trace.exists(), "the planted code must be one that runs"


def test_an_export_from_elsewhere_needs_consent(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "of another user"))
    with pytest.raises(InputError, match="--trust"):
        load(folder)
    assert load(folder, trust=True).self_test() == 0


def test_code_that_crashes_when_loaded_ends_in_a_message(folder):
    planted(folder, f"{AT_LOAD} {{ __builtin_trap(); }}\n")
    with pytest.raises(CasadicalError, match="cannot be loaded"):
        load(folder, trust=True)


DAMAGED = [
    (("kernel", "name"), "../arm"),
    (("kernel", "name"), "arm; rm x"),
    (("kernel", "joints"), "6"),
    (("kernel", "joints"), 0),
    (("kernel", "real"), "quad"),
    (("kernel", "outputs"), {"system": 3}),
    (("kernel", "outputs"), {"network": True}),
    (("kernel", "units"), ["rad"]),
    (("kernel",), None),
    (("files",), []),
]


def test_a_damaged_manifest_is_refused(folder):
    path = folder / "manifest.json"
    texts = ["", "[" * 5000, "null", '{"kernel": NaN}', "\xff"]
    for key, value in DAMAGED:
        manifest = json.loads(path.read_text())
        table = manifest if len(key) == 1 else manifest[key[0]]
        table[key[-1]] = value
        texts.append(json.dumps(manifest))
    for text in texts:
        path.write_bytes(text.encode("latin-1"))
        with pytest.raises(InputError, match=r"manifest\.json is damaged"):
            Manifest.read(folder)


def test_a_correction_that_converges_nowhere_is_not_called_verified(tmp_path, compiler, monkeypatch):
    """A planar arm cannot correct an error that lifts the tool."""
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "cache"))
    q = ca.SX.sym("q", 2)
    point = ca.vertcat(ca.cos(q[0]) + ca.cos(q[0] + q[1]), ca.sin(q[0]) + ca.sin(q[0] + q[1]), 0)
    lifted = point + ca.DM([0, 0, 0.01])
    functions = (ca.Function(name, [q], [p]) for name, p in (("nominal", point), ("calibrated", lifted)))
    made = write_c(Command(*functions, np.full(2, -1.0), np.full(2, 1.0)), tmp_path / "c", name="flat", vectors=100)
    assert made.figures["share_converged"] == 0
    assert not made.verified
    assert "UNVERIFIED: the correction converges at 0 %" in made.blocks()[0].text
    assert json.loads((tmp_path / "c" / "manifest.json").read_text())["verified"] is False
