"""Writing an export: what is written, what is refused, what is said without a compiler."""

import hashlib
import json
import shutil
import subprocess
import sys

import casadi as ca
import export_models as models
import numpy as np
import pytest

from casadical.core.basics import CasadicalError, InputError
from casadical.export import load, write_c
from casadical.export.c.products import Command, Limits, NetworkFunction


def test_the_same_model_gives_the_same_bytes(tmp_path, network):
    first = write_c(network, tmp_path / "a", name="arm", real="float", vectors=1000)
    write_c(
        NetworkFunction(models.network(), models.LOWER, models.UPPER),
        tmp_path / "b",
        name="arm",
        real="float",
        vectors=1000,
    )
    for name in first.written:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    for name in set(first.written) - {"manifest.json"}:
        assert str(tmp_path) not in (tmp_path / "a" / name).read_text()


def test_manifest_lists_every_file_with_its_hash(exported):
    for folder in exported.values():
        manifest = json.loads((folder / "manifest.json").read_text())
        on_disk = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()} - {"manifest.json"}
        assert set(manifest["files"]) == on_disk
        for name, digest in manifest["files"].items():
            assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
        assert manifest["verified"] is True
        assert all(c["different"] == 0 for c in manifest["comparisons"])


def test_without_a_compiler_it_is_written_and_called_unverified(tmp_path, network, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    no_place = {tmp_path / ("x" * 300): "{}"}
    with pytest.raises(InputError, match="nothing was written"):
        write_c(network, tmp_path / "c", name="arm", also=lambda made: no_place)
    assert list(tmp_path.iterdir()) == []
    export = write_c(network, tmp_path, name="arm")
    assert not export.verified
    assert "UNVERIFIED" in export.blocks()[0].text
    assert json.loads((tmp_path / "manifest.json").read_text())["verified"] is False
    assert (tmp_path / "arm.c").exists()


def test_nothing_is_overwritten_or_deleted_unless_told_to(tmp_path, network):
    (tmp_path / "arm.c").write_text("mine")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"arm\.c is in the way"):
        write_c(network, tmp_path, name="arm", vectors=100)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.c", "notes.txt"]
    assert (tmp_path / "arm.c").read_text() == "mine"
    write_c(network, tmp_path, name="arm", vectors=100, overwrite=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    write_c(network, tmp_path, name="arm", vectors=100)  # all of it is ours now
    (tmp_path / "arm.h").write_text((tmp_path / "arm.h").read_text() + "\n/* edited by hand */\n")
    with pytest.raises(InputError, match=r"arm\.h is in the way"):
        write_c(network, tmp_path, name="arm", vectors=100)


def test_a_difference_stops_the_export(tmp_path, network, compiler, monkeypatch):
    """A compiler that computes otherwise: a sign in a polynomial."""
    (tmp_path / "bin").mkdir()
    wrong = tmp_path / "bin" / compiler.command
    change = "for file; do case $file in *arm.c) sed -i '0,/+ (z [*] /s//- (z * /' \"$file\";; esac; done"
    wrong.write_text(f'#!/bin/sh\n{change}\nexec {shutil.which(compiler.command)} "$@"\n')
    wrong.chmod(0o755)
    monkeypatch.setenv("PATH", str(wrong.parent), prepend=":")
    with pytest.raises(CasadicalError, match="nothing was written"):
        write_c(network, tmp_path / "out", name="arm", real="float", vectors=1000)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["Arm", "1arm", "arm-1", "", "a" * 25])
def test_names_that_c_cannot_use_are_refused(tmp_path, network, name):
    with pytest.raises(InputError, match="cannot prefix"):
        write_c(network, tmp_path, name=name)


def test_wrong_arguments_are_refused_with_what_is_allowed(tmp_path, network):
    with pytest.raises(InputError, match="'float' or 'double'"):
        write_c(network, tmp_path, name="arm", real="half")
    with pytest.raises(InputError, match="no sha256"):
        write_c(network, tmp_path, name="arm", model_sha256="abc")
    with pytest.raises(InputError, match="not empty"):
        NetworkFunction(models.network(), models.UPPER, models.LOWER)
    with pytest.raises(InputError, match="expected 5 joint angles"):
        NetworkFunction(models.network(), models.LOWER[:5], models.UPPER[:5])
    with pytest.raises(InputError, match="rate_rad_s is -1"):
        Limits(rate_rad_s=-1)
    with pytest.raises(InputError, match=r"a cycle of 4000 ms; allowed: 0.01 to 1000 ms"):
        Limits(cycle_s=4)
    with pytest.raises(InputError, match=r"a ramp of 0.001 s; with a cycle of 4 ms allowed: 0.004 to 400 s"):
        Limits(ramp_s=0.001)
    with pytest.raises(InputError, match=r"a rate of 100 rad/s; with a cycle of 4 ms allowed: 0.00025 to 37.5 rad/s"):
        Limits(rate_rad_s=100)
    with pytest.raises(InputError, match=r"allowed: 0\.1 to"):
        Limits(rate_rad_s=0.01, cycle_s=1e-5, ramp_s=0.1)
    q = ca.SX.sym("q", 6)
    plane = ca.Function("plane", [q], [q[:2]])
    with pytest.raises(InputError, match="3 or 12"):
        Command(models.nominal(), plane, models.LOWER, models.UPPER)
    with pytest.raises(InputError, match="1 to 10"):
        Command(models.nominal(), models.calibrated(), models.LOWER, models.UPPER, steps=0)


def test_a_changed_source_is_not_loaded(exported, tmp_path):
    folder = tmp_path / "copy"
    folder.mkdir()
    for path in exported["network", "float"].iterdir():
        if path.is_file():
            (folder / path.name).write_bytes(path.read_bytes())
    assert load(folder).network(np.zeros((1, 6)))[1].tolist() == [0]
    (folder / "arm.c").write_text((folder / "arm.c").read_text().replace("0x1p", "0x1.1p", 1))
    with pytest.raises(InputError, match=r"arm\.c is not the file that was exported"):
        load(folder)
    with pytest.raises(InputError, match=r"no manifest\.json"):
        load(tmp_path)


def test_the_exporter_knows_no_robot():
    code = (
        "import sys, casadical.export.c.write\n"
        "ours = {m for m in sys.modules if m.startswith('casadical.')}\n"
        "assert all(m.startswith(('casadical.core', 'casadical.export')) for m in ours), ours\n"
        "assert not {'pandas', 'pydantic', 'typer', 'scipy'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
