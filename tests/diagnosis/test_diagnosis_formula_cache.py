"""Formulas of effects are read from the cache as they were composed, and composed anew where code or robot changed."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from cases import practice, robot

from casadical.core.basics import Array
from casadical.diagnosis import formula_cache
from casadical.diagnosis.formula_cache import PACKAGE_FOLDER, FormulaCache, code_hash
from casadical.diagnosis.linearisation import signatures
from casadical.diagnosis.seams import seams_of
from casadical.effects import Effect, TransmissionRipple
from casadical.effects.joint_error_curve import JointErrorCurve
from casadical.effects.play import Backlash

EFFECTS: list[Effect] = [Backlash(2), TransmissionRipple(3), JointErrorCurve(None)]


class Own(Backlash):
    """An effect of another package."""


Columns = Callable[..., Array]


@pytest.fixture
def columns(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Columns]:
    """Columns of effects as another process makes them, the cache at first empty."""
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path))

    def forget() -> None:
        for name in ("plan", "formula_of", "cached_formulas", "code_hash"):
            getattr(formula_cache, name).cache_clear()

    def made(effects: list[Effect] = EFFECTS, name: str = "kr210") -> Array:
        forget()
        r = robot(name)
        return signatures(r, effects, practice(f"{name}-P02"), r.parameters.values)[0]

    yield made
    forget()


def test_kept_formulas_give_the_same_bits_and_are_not_composed_again(columns, monkeypatch):
    first = columns()
    monkeypatch.delattr(formula_cache, "composed")
    np.testing.assert_array_equal(columns(), first)


def test_other_code_has_a_file_of_its_own(columns: Columns, tmp_path: Path) -> None:
    columns()
    s = seams_of(robot("kr210"))
    assert [*tmp_path.rglob("formulas-*.json")] == [FormulaCache(s, code_hash(PACKAGE_FOLDER)).path]
    assert FormulaCache(s, "other").path != FormulaCache(s, code_hash(PACKAGE_FOLDER)).path


def test_the_code_is_that_of_all_rooms_on_which_a_formula_depends(tmp_path: Path) -> None:
    hashes = {code_hash(tmp_path)}
    for k, room in enumerate(("core", "effects", "robot", "diagnosis/motion"), 1):
        (tmp_path / room).mkdir(parents=True)
        (tmp_path / room / "code.py").write_text("x = 1")
        code_hash.cache_clear()
        hashes.add(code_hash(tmp_path))
        assert len(hashes) == k + 1


def test_a_damaged_file_is_replaced(columns: Columns, tmp_path: Path) -> None:
    first = columns()
    (file,) = tmp_path.rglob("formulas-*.json")
    whole = file.read_text()
    file.write_text(whole[:1000])
    np.testing.assert_array_equal(columns(), first)
    assert file.read_text() == whole


def test_a_folder_that_cannot_be_written_costs_time_alone(columns, monkeypatch, tmp_path):
    first = columns()
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "file" / "below"))
    np.testing.assert_array_equal(columns(), first)


def test_effects_of_other_packages_and_learnt_sizes_are_not_kept(columns: Columns, tmp_path: Path) -> None:
    learnt = JointErrorCurve(None).with_sizes({1: 0.7})
    columns([Own(2), learnt])
    assert not list(tmp_path.rglob("formulas-*.json"))
