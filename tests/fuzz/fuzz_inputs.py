"""Hostile inputs for every command, by a grammar: values at the edge of what can be, command lines, changed files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")
Choose = Callable[[Sequence[Any]], Any]

NUMBERS = (
    "0", "-0.0", "1", "-1", "0.5", "1e-300", "-1e-320", "1e300", "1e308", "-1e308", "1e400", "nan", "inf", "-inf",
    "9" * 30, "9" * 400, "1_000", "0x10", "2,5", "25 kg", "", "true", '"1"', "[1]", "{}", "1e-12", "179.9", "360",
    "-720", "2147483648", "-3", "10000000000",
)  # fmt: skip
WORDS = (
    "", "a", "[/x]", "[bold red]x", "\\u0001", "\x01", "\x1b[31m", "\t", "\n", "'", '"', "\\", "*/ x", "-->",
    "<script>", "é", "\u202e", "\U0001f916", "..", "../x", "/", "~", "$HOME", "%s", "{0}", "x" * 300, "x" * 5000, "KM",
    "a\x00b", "SKCM", "GP-NN-SKCM", "linear", "huber", "standard", "extended", "backlash", "backlash@2", "all", "q1",
)  # fmt: skip
FORMS = ("mjcf", "urdf", "ur", "standard_dh", "modified_dh", "xacro", "yaml", "")
PATHS = (
    "in/log.csv", "in/drive.toml", "in/sage", "in/bag-db3", "in/2026-03-01.csv", "in/iso.csv", "in/certificate.toml",
    "in/my.effect.toml", "in/w", "in/stdin.csv", "in/live", "in/lerobot/data/episode.parquet", "in/log.parquet",
    "in/p", "in/p/robot.toml", "in/p/poses.csv", "in/p/problem.toml", "in/results", "in/results/KM.robot.toml",
    "in/results/result.json", "in/program.csv", "in/dh.csv", "in/arm.urdf", "in/room.toml", "in/net.json", "in/none",
    "in/loop", "in/empty", "in/folder", "in/binary", "", ".", "/dev/null", "/dev/full", "x" * 5000, "a[/x]", "in",
)  # fmt: skip
OUTPUTS = (
    "out/a", "out/b.json", "out/b.csv", "out/deep/er/c.html", "out/c.xml", "out/a", "out/[/x]", "out/é \u202e",
    "in/p/robot.toml",
    "in/foreign.txt", "/dev/full", "/dev/null", "out", "in/loop", "out/" + "x" * 300, "/proc/none/x", "in/empty/x",
)  # fmt: skip

# Commands with arguments that are always given, and options: a value of this kind, or None for a flag.
PROBLEM, ROBOT, TABLE = ("in/p",), ("in/results/KM.robot.toml", "in/p/robot.toml"), ("in/p/poses.csv",)
LOGS = ("in/log.csv", "in/log.csv", "in/rtde.csv", "in/sage", "in/log.parquet", "in/bag-db3", "in/bag-mcap")
DAYS = ("in/2026-03-01.csv", "in/2026-03-02.csv", "in/iso.csv")
COMMANDS: dict[tuple[str, ...], tuple[tuple[Sequence[str], ...], dict[str, str | None]]] = {
    ("check",): ((PROBLEM,), {"--noise-mm": "number", "--strict": None, "--json": "out", "-q": None}),
    ("calibrate",): (
        (PROBLEM,),
        {
            "--out": "out", "--json": "out", "--report": "out", "--method": "word", "--loss": "word", "--frozen": None,
            "--seed": "number", "--prior": "path", "--prior-effects": "word", "-q": None,
        },
    ),
    ("plan",): (
        (PROBLEM + ROBOT,),
        {
            "-n": "small", "--out": "out", "--for": "word", "--room": "path", "--measured": "path",
            "--payloads": "number", "--repeats": "small", "--noise-mm": "number", "--min-distance": "number",
            "--isolability": None, "--target-mm": "number", "--no-order": None, "--seed": "number", "-q": None,
            "--json": "out",
        },
    ),
    ("new",): (
        (("out/new", "out/[/x]", "out/é", "in/p", "in/empty"),),
        {"--dh": "dh", "--data": "path", "--urdf": "path", "--convention": "word", "--yes": None, "--json": "out"},
    ),
    ("correct",): (
        ((*ROBOT, "in/results"), ("in/program.csv",)),
        {
            "--out": "out", "--nominal": "path", "--compensator": "path", "--payload": "number", "--steps": "small",
            "--tool": "word", "--trust": None, "--leave-out": None, "--overwrite": None, "--json": "out",
        },
    ),
    ("export", "model"): ((ROBOT + PROBLEM,), {
        "--out": "out", "--to": "form", "--leave-out": None, "--overwrite": None, "--nominal": "path",
        "--json": "out"}),
    ("withheld", "score"): ((("in/w", "in/p"), ("in/w", "in/p"), ("in/w/answers.jsonl", *TABLE)), {"--json": "out"}),
    ("diagnose",): ((PROBLEM, TABLE + LOGS), {
        "--effects": "effects", "--seed": "number", "--laws": None, "--json": "out", "--drive": "path",
        "--reference": "path", "--out": "out"}),
    ("verify",): ((("in/results", *ROBOT), DAYS, DAYS), {
        "--touches": None, "--fleet": "path", "--tolerance-mm": "number", "--noise-mm": "number",
        "--chart": "out", "--update": "out", "--json": "out", "--promised-mm": "number", "--iso9283": None}),
    ("certificate",): ((("in/results",),), {
        "--details": "path", "--problem": "path", "--iso9283": "path", "--out": "out", "--json": "out"}),
    ("compare",): ((("in/results", *ROBOT), (*TABLE, *ROBOT)), {
        "--robot": "path", "--same-tool": None, "--same-frame": None, "--json": "out"}),
    ("measure",): ((("in/live",),), {
        "--target-mm": "number", "--room": "path", "--finish": None, "--program": "word", "--json": "out"}),
    ("withheld", "predict"): ((("in/w", "in/p"),), {"--out": "out", "--by": "word", "--workers": "small"}),
}  # fmt: skip
# Of each command: `out` is needed by these.
NEEDS_OUT = {("correct",), ("export", "model")}
ALWAYS = {("measure",): ["--follow", "-", "--no-page"]}
# So often is each drawn: those that are quick more often.
WEIGHTS = {("diagnose",): 3, ("plan",): 2, ("calibrate",): 4, ("check",): 4, ("new",): 3, ("correct",): 3}
CHANGED = (
    "p/robot.toml", "p/problem.toml", "p/poses.csv", "results/KM.robot.toml", "program.csv", "dh.csv", "arm.urdf",
    "room.toml", "net.json", "results/result.json", "log.csv", "log.csv", "rtde.csv", "drive.toml",
    "sage/state_motor.csv", "sage/joint_list.txt", "2026-03-01.csv", "iso.csv", "certificate.toml", "my.effect.toml",
    "fleet.json", "stdin.csv", "live/measured.jsonl", "live/problem.toml", "w/withheld.json", "w/key.json",
    "w/answers.jsonl", "places.csv",
)  # fmt: skip


@dataclass(frozen=True)
class Hostile:
    """One input: the words of the command line, and changes of files (name, kind, place, what is put there)."""

    command: tuple[str, ...]
    changes: tuple[tuple[str, str, int, str], ...]

    def __str__(self) -> str:
        words = " ".join(ascii(w)[1:-1][:60] for w in self.command)
        return f"{words} | " + "; ".join(f"{n} {k} {p} {ascii(v)[:40]}" for n, k, p, v in self.changes)


def draw(choose: Choose) -> Hostile:
    """An input; choose : takes one of a sequence, `random.Random.choice` or one of hypothesis."""
    names = [name for name in COMMANDS for _ in range(WEIGHTS.get(name, 2))]
    name = choose(names)
    arguments, options = COMMANDS[name]
    words = list(name)
    for valid in arguments:
        words.append(choose(valid) if choose(range(8)) else choose(PATHS))
    given = [option for option in options if not choose(range(4))]
    if name in NEEDS_OUT and "--out" not in given:
        given.append("--out")
    words += ALWAYS.get(name, [])
    for option in given:
        words += [option, *_value(options[option], choose)]
    changes = []
    for _ in range(choose((0, 1, 1, 1, 2))):
        kind = choose(
            ("number", "number", "number", "word", "word", "drop line", "double line", "cut", "put", "replace")
        )
        value = choose(NUMBERS) if kind == "number" else choose(WORDS)
        changes.append((choose(CHANGED), kind, choose(range(400)), value))
    return Hostile(tuple(w.replace("\x00", "") for w in words), tuple(changes))


def _value(kind: str | None, choose: Choose) -> list[str]:
    if kind is None:
        return []
    if kind == "small":
        return [choose((*NUMBERS, "3", "4", "5", "6"))]
    if kind == "dh":
        return [choose(("in/dh.csv", "in/dh.csv", "in/dh.csv", *PATHS))]
    if kind == "effects":
        return [choose(("in/my.effect.toml", *WORDS))]
    values = {"number": NUMBERS, "word": WORDS, "form": FORMS, "path": PATHS, "out": OUTPUTS[:4] * 4 + OUTPUTS}
    return [choose(values[kind])]
