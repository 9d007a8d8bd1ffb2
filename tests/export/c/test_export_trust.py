"""The C of an export folder is compiled and run only if it was exported here, or with consent."""

import hashlib
import json
import shutil
from pathlib import Path

import export_models as models
import numpy as np
import pytest

from casadical.core.basics import CasadicalError, InputError
from casadical.export import load, write_c
from casadical.export.c.products import Command, NetworkFunction

AT_LOAD = "__attribute__((constructor)) static void at_load(void)"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, network, compiler) -> Path:
    """An export, `c`, and the cache that knows it, `cache`."""
    place = tmp_path_factory.mktemp("exported")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CASADICAL_CACHE", str(place / "cache"))
        write_c(network, place / "c", name="arm", vectors=100)
    return place


@pytest.fixture
def folder(place: Path, tmp_path: Path, monkeypatch) -> Path:
    """A copy of it, with a cache of its own."""
    shutil.copytree(place, tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "c"


def planted(folder: Path, trace: Path) -> None:
    """Foreign C in an export folder, with hashes that fit: it leaves a trace when it is loaded."""
    source = folder / "arm.c"
    text = f'#include <stdio.h>\n{AT_LOAD} {{ fclose(fopen("{trace}", "w")); }}\n'
    source.write_text(text + source.read_text())
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"]["arm.c"] = hashlib.sha256(source.read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_own_exports_are_loaded_also_when_they_were_moved(folder: Path, tmp_path: Path) -> None:
    shutil.move(folder, tmp_path / "moved")
    assert load(tmp_path / "moved").self_test() == 0


def test_foreign_code_does_not_run_without_consent(folder: Path, tmp_path: Path) -> None:
    planted(folder, tmp_path / "trace")
    with pytest.raises(InputError, match="was not exported here by you"):
        load(folder)
    assert not (tmp_path / "trace").exists()
    load(folder, trust=True)
    assert (tmp_path / "trace").exists(), "the planted code must be one that runs"


def test_an_export_from_elsewhere_needs_consent(folder: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "of another user"))
    with pytest.raises(InputError, match="--trust"):
        load(folder)
    assert load(folder, trust=True).self_test() == 0


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (("kernel", "name"), "../arm"),
        (("kernel", "name"), "arm; rm x"),
        (("kernel", "joints"), "6"),
        (("kernel", "joints"), -1),
        (("kernel", "real"), "quad"),
        (("kernel", "outputs"), {"system": 3}),
        (("kernel", "outputs"), {"network": True}),
        (("kernel",), None),
        (("files",), []),
    ],
)
def test_a_manifest_of_another_form_is_refused(folder: Path, key: tuple[str, ...], value: object) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    table = manifest if len(key) == 1 else manifest[key[0]]
    table[key[-1]] = value
    path.write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"manifest\.json is damaged"):
        load(folder, trust=True)


@pytest.mark.parametrize("text", ["", "[" * 5000, "null", '{"kernel": NaN}', "\xff"])
def test_a_manifest_that_is_no_json_is_refused(folder: Path, text: str) -> None:
    (folder / "manifest.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"manifest\.json is damaged"):
        load(folder, trust=True)


def test_code_that_crashes_when_loaded_ends_in_a_message(folder: Path) -> None:
    source = folder / "arm.c"
    source.write_text(f"{AT_LOAD} {{ __builtin_trap(); }}\n{source.read_text()}")
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"]["arm.c"] = hashlib.sha256(source.read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(CasadicalError, match="cannot be loaded"):
        load(folder, trust=True)


def test_a_correction_that_converges_nowhere_is_not_called_verified(tmp_path: Path, compiler, monkeypatch) -> None:
    """A planar arm cannot correct an error that lifts the tool."""
    import casadi as ca

    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "cache"))
    q = ca.SX.sym("q", 2)
    point = ca.vertcat(ca.cos(q[0]) + ca.cos(q[0] + q[1]), ca.sin(q[0]) + ca.sin(q[0] + q[1]), 0)
    lifted = point + ca.DM([0, 0, 0.01])
    box = (np.full(2, -1.0), np.full(2, 1.0))
    nominal, real = (ca.Function(name, [q], [p]) for name, p in (("nominal", point), ("calibrated", lifted)))
    command = Command(nominal, real, *box)
    made = write_c(command, tmp_path / "c", name="flat", vectors=100)
    assert made.figures["share_converged"] == 0
    assert not made.verified
    assert "UNVERIFIED: the correction converges at 0 %" in made.blocks()[0].text
    assert json.loads((tmp_path / "c" / "manifest.json").read_text())["verified"] is False
    network = NetworkFunction(models.network(), models.LOWER, models.UPPER)
    assert write_c(network, tmp_path / "n", name="n", vectors=100).verified
