"""A saved network whose checksum was computed again still is checked: types, shapes, and the size of its correction."""

import json
from pathlib import Path

import numpy as np
import pytest

from casadical.compensator import Compensator, load_compensator, save_compensator
from casadical.compensator.saving import checksummed
from casadical.core.basics import InputError


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (60, 2))
    residual = np.stack([np.sin(q[:, 0]), q[:, 1] ** 2, q[:, 0] * q[:, 1]], axis=1)
    made = Compensator.fit(q, residual, folds=2)
    assert made.network is not None
    path = tmp_path_factory.mktemp("net") / "net.json"
    save_compensator(made, path)
    return path


def resealed(saved: Path, tmp_path: Path, change, kind: str = "casadical-compensator", version: object = 1) -> Path:
    """A copy with a change and a checksum that fits."""
    body = json.loads(saved.read_text())
    for key in ("format", "version", "sha256"):
        body.pop(key)
    change(body)
    path = tmp_path / "changed.json"
    path.write_text(checksummed(kind, version, body))
    return path


def test_an_unchanged_copy_is_read(saved: Path, tmp_path: Path) -> None:
    q = np.array([[0.1, 0.2]])
    copy = load_compensator(resealed(saved, tmp_path, lambda body: None))
    assert np.array_equal(copy.correction_mm(q), load_compensator(saved).correction_mm(q))


def test_a_network_that_corrects_nothing_of_no_error_is_read(saved: Path, tmp_path: Path) -> None:
    def without_error(body) -> None:
        body["network"]["weights"] = [0.0] * len(body["network"]["weights"])
        body["training"]["before"]["max_mm"] = 0.0

    assert not load_compensator(resealed(saved, tmp_path, without_error)).correction_mm(np.zeros((1, 2))).any()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda b: b["network"].update(weights=[1e308] * len(b["network"]["weights"])), "corrects by up to"),
        (lambda b: b["network"].update(output_scale_mm=1e6), "corrects by up to"),
        (lambda b: b["network"].update(output_scale_mm=1e308), "corrects by up to"),
        (lambda b: b["network"].update(weights=["1.0"] * len(b["network"]["weights"])), "valid number"),
        (lambda b: b["network"].update(weights=[True] * len(b["network"]["weights"])), "valid number"),
        (lambda b: b["network"]["weights"].pop(), "weights; the array's shape"),
        (lambda b: b["layout"].update(hidden=[5.7]), "valid integer"),
        (lambda b: b["layout"].update(hidden=[10**9]), "weights"),
        (lambda b: b["layout"].update(joints=True), "valid integer"),
        (lambda b: b["network"]["box_rad"].update(lower=[0.0]), "box"),
        (lambda b: b["training"]["before"].update(max_mm="large"), "valid number"),
        (lambda b: b.pop("layout"), "Field required"),
        (lambda b: b.update(network=[]), "network"),
        (lambda b: b["layout"].update(surprise=1), "surprise"),
        (lambda b: b["network"].update(output_scale_mm=-1.0), "output_scale_mm"),
    ],
)
def test_what_is_no_such_network_is_refused(saved: Path, tmp_path: Path, change, told: str) -> None:
    with pytest.raises(InputError, match=told):
        load_compensator(resealed(saved, tmp_path, change))


@pytest.mark.parametrize(
    ("kind", "version", "told"),
    [
        ("casadical-compensator", True, "has version True"),
        ("casadical-compensator", 99, "version 99"),
        ("other", 1, "not a casadical-compensator"),
    ],
)
def test_format_and_version_are_those_of_this_package(saved: Path, tmp_path: Path, kind, version, told) -> None:
    with pytest.raises(InputError, match=told):
        load_compensator(resealed(saved, tmp_path, lambda body: None, kind, version))
