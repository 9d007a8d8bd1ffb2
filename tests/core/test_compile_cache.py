"""Compiled kernels are trusted only from a folder of one's own, as they were made, and after a trial elsewhere."""

import shutil
import stat
import time
from pathlib import Path

import casadi as ca
import numpy as np
import platformdirs
import pytest

from casadical.core import subprocesses
from casadical.core.mapped_function import compiled, compiler

X = ca.SX.sym("x", 2)
CRASH = "__attribute__((constructor)) static void f(void) { __builtin_trap(); }"
F = ca.Function("twice", [X], [2 * ca.sin(X), ca.log(-X)])

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


@pytest.fixture
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("CASADICAL_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "casadical"


def fake_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, script: str) -> None:
    """A compiler by the name of $CC; in its script $OUT is the output's path, GCC the real compiler."""
    path = tmp_path / "fakecc"
    real = shutil.which("gcc") or compiler()
    head = "#!/bin/bash\nwhile [ $# -gt 0 ]; do case $1 in -o) OUT=$2;; *.c) SRC=$2$1;; esac; shift; done\n"
    path.write_text(head.replace("$2$1", "$1") + script.replace("GCC", str(real)))
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))


def test_the_cache_is_the_users_own(cache: Path) -> None:
    assert compiled(F) is not None
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700


def test_a_library_is_found_by_its_function_without_the_source(cache: Path, monkeypatch) -> None:
    compiled(F)
    monkeypatch.delattr("casadical.core.mapped_function.source")
    assert compiled(F) is not None
    assert compiled(ca.Function("twice", [X], [3 * ca.sin(X), ca.log(-X)]), make=False) is None


@pytest.mark.parametrize("size", [0, 100, 9000])
def test_a_damaged_library_is_made_again(cache: Path, size: int) -> None:
    compiled(F)
    (library,) = cache.iterdir()
    whole = library.read_bytes()
    library.unlink()  # what is loaded stays whole
    library.write_bytes(whole[:size])
    again = compiled(F)
    assert again is not None
    assert library.read_bytes() == whole
    assert again(np.array([[0.5], [1.0]]))[0][0, 0] == float(F([0.5, 1.0])[0][0])


@pytest.mark.parametrize("n", [1, 2, 5])
def test_machine_code_gives_the_bits_of_casadi(cache: Path, n: int) -> None:
    x, a = ca.SX.sym("x", 2), ca.SX.sym("a", 3)
    u, v = ca.vertsplit(x)
    ones = [
        ca.exp, ca.log, ca.sqrt, ca.sin, ca.cos, ca.tan, ca.atan, ca.sinh, ca.cosh, ca.tanh, ca.fabs, ca.sign, ca.floor,
        ca.ceil, ca.log1p, ca.expm1, ca.logic_not, lambda u: ca.asin(u / 9), lambda u: ca.acos(u / 9),
    ]  # fmt: skip
    twos = [
        ca.fmin, ca.fmax, ca.atan2, ca.hypot, ca.fmod, ca.copysign, ca.power, lambda u, v: u / v, lambda u, v: u < v,
        lambda u, v: u <= v, lambda u, v: ca.logic_or(u < v, v > 2), lambda u, v: ca.logic_and(u < v, u > 0.1),
        lambda u, v: ca.if_else(u < v, 3 * u, -u), lambda u, v: (u == v) + (u != v), lambda u, v: u**2 + 2 * v - 1 / u,
    ]  # fmt: skip
    first = ca.vertcat(*(f(u) for f in ones), *(f(u, v) for f in twos), ca.SX(0.1), ca.SX(-ca.inf))
    f = ca.Function("many", [x, a], [first, ca.densify(a @ x.T)])
    points, shared = np.random.default_rng(n).uniform(0.2, 3, (2, n)), np.array([0.3, -1.2, 5.0])
    code = compiled(f)
    assert code is not None
    found = code(points, shared)
    expected = f.map("all", "serial", n, [1], [])(points, shared)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other.full())
    with pytest.raises(ValueError, match="inputs have shapes"):
        code(points, shared[:2])


def test_what_has_no_counterpart_in_c_is_not_compiled(cache: Path) -> None:
    assert compiled(ca.Function("erf", [X], [ca.erf(X)])) is None


def test_libraries_in_a_folder_that_others_could_write_to_are_not_used(cache: Path) -> None:
    compiled(F)
    (library,) = cache.iterdir()
    before = library.stat().st_ino
    cache.chmod(0o777)
    (cache / "notes.txt").write_text("mine")
    assert compiled(F) is not None
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert library.stat().st_ino != before
    assert (cache / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    "script",
    [
        'echo junk > "$OUT"',  # no library
        'GCC -shared -fPIC -x c -o "$OUT" - <<< "int nothing;"',  # a library without the function
        'sed "s/(sin,/(cos,/g" "$SRC" > "$OUT.c"; GCC -O1 -shared -fPIC -o "$OUT" "$OUT.c" -lm',  # computes wrong
        f'GCC -shared -fPIC -x c -o "$OUT" - <<< "{CRASH}"',
        'GCC -O1 -shared -fPIC -o "$OUT" "$SRC" -lm; exit 1',
    ],
)
def test_what_a_bad_compiler_makes_is_neither_kept_nor_used(cache: Path, monkeypatch, tmp_path, script: str) -> None:
    fake_compiler(monkeypatch, tmp_path, script)
    assert compiled(F) is None
    assert list(cache.iterdir()) == []


def test_the_same_fake_with_an_honest_script_is_used(cache: Path, monkeypatch, tmp_path) -> None:
    fake_compiler(monkeypatch, tmp_path, 'GCC -O1 -shared -fPIC -o "$OUT" "$SRC" -lm')
    assert compiled(F) is not None


def test_a_compiler_that_does_not_start_gives_nothing(cache: Path, monkeypatch, tmp_path) -> None:
    (tmp_path / "cc").write_text("#!/no/such/shell\n")
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("CC", str(tmp_path / "cc"))
    assert compiled(F) is None


def test_a_program_that_does_not_end_is_stopped_with_what_it_started(tmp_path) -> None:
    began = time.monotonic()
    assert subprocesses.run_within(["sh", "-c", f"(sleep 1; touch {tmp_path / 'survived'}) & wait"], 0.3) is None
    assert time.monotonic() - began < 1
    time.sleep(1)
    assert not (tmp_path / "survived").exists()


def test_a_program_that_does_not_start_or_aborts_gives_nothing() -> None:
    assert subprocesses.run_within(["/no/such/program"], 1) is None
    assert subprocesses.tried("import os; os.abort()") is None
    assert subprocesses.tried("print(6 * 7)") == "42\n"


def test_without_a_home_nothing_is_made_in_the_working_folder(monkeypatch, tmp_path) -> None:
    monkeypatch.delenv("CASADICAL_CACHE", raising=False)
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda name: f"~/.cache/{name}")
    monkeypatch.chdir(tmp_path)
    assert compiled(F) is None
    assert list(tmp_path.iterdir()) == []
