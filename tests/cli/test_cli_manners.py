"""All commands behave alike: the same flags in the same words, completion that works, progress only on a terminal."""

import os
import pty
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import pytest
import typer
from command_line import ROOT

from casadical.cli import app
from casadical.cli import options as o
from casadical.cli.terminal import DIAGNOSIS, share

BIN = Path(sys.executable).parent


def commands() -> Iterator[tuple[str, click.Command]]:
    """Every command that does something, by its words."""

    def walk(words: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
        inner = getattr(command, "commands", None)
        if inner is None:
            yield words, command
        for name, sub in (inner or {}).items():
            yield from walk(f"{words} {name}".strip(), sub)

    yield from walk("", typer.main.get_command(app))


ALL = dict(commands())


def options(command: click.Command) -> dict[str, click.Parameter]:
    return {name: p for p in command.params for name in p.opts if name.startswith("--")}


def test_the_commands_are_found() -> None:
    assert {"new", "check", "calibrate", "diagnose", "plan", "correct", "export c"} <= ALL.keys()


@pytest.mark.parametrize("name", ALL)
def test_every_command_can_be_quiet_and_keep_json_and_tells_all_about_itself(name: str) -> None:
    command = ALL[name]
    found = options(command)
    assert {"--quiet", "--json"} <= found.keys()
    assert "-q" in found["--quiet"].opts
    assert "Exit codes:" in (command.help or "")
    for option, parameter in found.items():
        assert getattr(parameter, "help", None), f"{name} {option} has no help"


def test_an_option_means_the_same_everywhere() -> None:
    words: dict[str, set[str]] = {}
    for command in ALL.values():
        for option, parameter in options(command).items():
            if option in ("--quiet", "--json", "--nominal", "--compensator", "--payload"):
                words.setdefault(option, set()).add(f"{parameter.metavar}: {parameter.help}")
    assert {option for option, texts in words.items() if len(texts) > 1} == set()


@pytest.mark.parametrize(
    ("complete", "begun", "offered"),
    [
        (o.methods, "IWO", ["IWO-NN-SKCM", "IWO-LM-NN-SKCM"]),
        (o.losses, "h", ["huber"]),
        (o.effects, "backlash,gear_e", ["backlash,gear_eccentricity"]),
        (o.languages, "c,str", ["c,structured_text"]),
    ],
)
def test_words_are_completed(complete: Callable[[str], list[str]], begun: str, offered: list[str]) -> None:
    assert complete(begun) == offered


@pytest.mark.slow
def test_bash_completes_commands_and_options(tmp_path: Path) -> None:
    """What bash, a real one, offers after these words."""
    if shutil.which("bash") is None:
        pytest.skip("no bash here")
    command = [BIN / "casadical", "--show-completion", "bash"]
    script = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for words, offered in (("casadical che", "check"), ("casadical calibrate --me", "--method")):
        lines = [
            f"PATH={BIN}:$PATH",
            script,
            f"COMP_WORDS=({words})",
            f"COMP_CWORD={len(words.split()) - 1}",
            "_casadical_completion casadical",
            'printf "%s\\n" "${COMPREPLY[@]}"',
        ]
        bash = ["bash", "--norc", "-c", "\n".join(lines)]
        done = subprocess.run(bash, capture_output=True, text=True, cwd=tmp_path, check=True)
        assert done.stderr == ""
        assert offered in done.stdout.split()


def on_terminal(*arguments: str | Path, output: str = "", **more: str) -> tuple[str, str]:
    """Standard output, and what a terminal on standard error shows, or on both; more : of the environment."""
    main, side = pty.openpty()
    environment = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "CI")} | {"TERM": "xterm", **more}
    with subprocess.Popen(
        [BIN / "casadical", *arguments],
        cwd=ROOT,
        env=environment,
        stdout=side if output else subprocess.PIPE,
        stderr=side,
    ) as process:
        os.close(side)
        shown = b""
        while True:
            try:
                part = os.read(main, 4096)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            shown += part
        out = process.stdout.read().decode() if process.stdout else ""
    os.close(main)
    return out, shown.decode()


@pytest.mark.slow
def test_a_message_is_as_wide_as_the_terminal_and_all_faults_are_one_table(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text("\n".join(["angle,bend", *["1,2"] * 12]))
    robot = ROOT / "problems" / "planar" / "robot.toml"
    _, shown = on_terminal("calibrate", str(robot), str(tmp_path / "poses.csv"), COLUMNS="60")
    lines = shown[shown.index("casadical:") :].splitlines()
    assert len(lines) > 3
    assert max(map(len, lines)) <= 60
    text = ["q1_deg,q2_deg,x_mm,y_mm,z_mm", *(f"{k},{2 * k},{k},2,3" for k in range(30)), "900,-999,1,2,3", "1,2,x,,5"]
    (tmp_path / "poses.csv").write_text("\n".join(text))
    (tmp_path / "other.csv").write_text("\n".join([*text[:-2], "1,2,3,4,up"]))
    arguments = ["calibrate", robot, tmp_path / "poses.csv", tmp_path / "other.csv"]
    done = subprocess.run([BIN / "casadical", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    said = [line.split() for line in done.stderr.splitlines()]
    assert [line[:3] for line in said if line[0].endswith(".csv")] == [
        ["poses.csv", "33", "x_mm"], ["poses.csv", "33", "y_mm"], ["poses.csv", "32", "q1"], ["poses.csv", "32", "q2"],
        ["other.csv", "32", "z_mm"],
    ]  # fmt: skip


@pytest.mark.slow
def test_lines_of_an_export_break_between_words_on_a_terminal(tmp_path: Path) -> None:
    arguments = ["export", "model", "problems/ur10/robot.toml", "--overwrite", "--out", str(tmp_path / "arm.urdf")]
    whole, _ = on_terminal(*arguments, COLUMNS="40")
    _, shown = on_terminal(*arguments, COLUMNS="40", output="terminal")
    said = "nothing is left out: the robot is rigid and has no effects"
    assert said in whole.splitlines()
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown).splitlines()
    assert said not in lines
    assert said in " ".join(" ".join(lines).split())


@pytest.mark.slow
def test_progress_is_shown_on_a_terminal_and_nowhere_else() -> None:
    out, shown = on_terminal("calibrate", "problems/planar")
    assert "planar: part 1 of 1: KM iteration" in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown)
    assert "iteration" not in out
    done = subprocess.run(
        [BIN / "casadical", "calibrate", "problems/planar"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    assert "iteration" not in done.stdout
    assert on_terminal("calibrate", "problems/planar", "--quiet") == ("", "")


def test_the_share_done_grows_with_the_steps_of_a_run() -> None:
    told = ["calibrating the base model", "signatures of the candidates", "cause 1: evidence of 90 candidates"]
    told += [
        "cause 5: evidence of 3 candidates",
        "refit of all poses",
        "refits without a fifth each",
        "poses to measure next",
    ]
    shares = [share(text, DIAGNOSIS) for text in told]
    assert shares == sorted(shares)
    assert shares[0] == 0
    assert max(shares) < 1
    assert share("30 of 60 (campaign)", {}) == 0.5
    solves = [share(f"part {k} of 2: SKCM iteration {i}, cost 1", {}) for k in (1, 2) for i in (0, 8, 99)]
    assert solves == sorted(solves)
    assert solves[:2] == [0, 0.25]
    assert share("reading", {}) == 0


@pytest.mark.slow
def test_a_reader_that_goes_away_loses_no_file(tmp_path: Path) -> None:
    """As `| head -1` does."""
    command = [BIN / "casadical", "calibrate", "problems/planar", "--details", "--out", tmp_path / "out"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (0, b"")
    assert (tmp_path / "out" / "result.json").exists()


def test_linear_algebra_has_one_thread_unless_the_environment_says_how_many() -> None:
    code = (
        "import os, sys; from casadical import cli; assert 'numpy' not in sys.modules\n"
        "sys.argv = ['casadical', '--help']\n"
        "try: cli.main()\n"
        "except SystemExit: print(os.environ['OMP_NUM_THREADS'], os.environ.get('OPENBLAS_NUM_THREADS'))"
    )
    bare = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    for given, expected in (({}, "1 1"), ({"OMP_NUM_THREADS": "3"}, "3 None")):
        run = subprocess.run(
            [sys.executable, "-c", code], env={**bare, **given}, capture_output=True, text=True, check=True
        )
        assert run.stdout.splitlines()[-1] == expected
