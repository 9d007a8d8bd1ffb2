"""Every result that a calibration writes is compared with the table that it was made of, and with five rows of it."""

from dataclasses import replace
from pathlib import Path

import pytest
from marks import slow

from casadical import InputError, calibrate, compare_files, read_problem
from casadical.project.problem_file import own_tables

PROBLEMS = Path(__file__).parents[2] / "problems"
MEASURED = [path.parent.name for path in sorted(PROBLEMS.glob("*/problem.toml")) if "\nfile = " in path.read_text()]


@pytest.mark.parametrize("name", ["planar", *slow(*(name for name in MEASURED if name != "planar"))])
def test_no_result_of_a_shipped_problem_fails_to_be_compared(name: str, tmp_path: Path) -> None:
    problem = replace(read_problem(PROBLEMS / name), networks=())
    calibrate(problem).write(tmp_path)
    (table, *_) = sorted(own_tables(PROBLEMS / name))
    (tmp_path / "five.csv").write_text("\n".join(table.read_text().splitlines()[:6]) + "\n")
    files = sorted(tmp_path.glob("*.robot.toml"))
    assert [f.name.removesuffix(".robot.toml") for f in files] == sorted(problem.methods)
    for file in files:
        assert compare_files([file, table]).blocks()
        few = [file, tmp_path / "five.csv"]
        if name == "planar":
            assert compare_files(few).blocks()
        else:
            with pytest.raises(InputError, match=r"too few poses to tell what changed|numbers were measured"):
                compare_files(few)
