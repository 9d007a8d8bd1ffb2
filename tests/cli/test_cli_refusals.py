"""A user's mistake ends in one message that says what to do, in exit code 2, and in no file."""

import shlex
from pathlib import Path

import pytest
from command_line import ROOT, run

from casadical import InputError
from casadical.cli.outputs import _is_output, _refuse_unusable

ARM = "problems/hh800/robot.toml"
TABLE = "data/campaigns/practice/ur10e-P03.csv"
# Command lines in a folder that has problems/ and data/, and what is said.
REFUSED = [
    ("calibrate problems/none", "problems/none: no such problem folder"),
    ("plan problems/plnar", "problems/plnar: no such problem folder; did you mean problems/planar"),
    ("diagnose problems/planar/robt.toml", "no such robot file; did you mean problems/planar/robot.toml"),
    ("compare none/a.toml problems/planar", "none/a.toml: no such file"),
    ("verify problems/planar data/planar/planar.csv", "is a problem folder; give its results"),
    ("verify problems/planar", "which poses?"),
    ("calibrate problems/planar --method BP", "--method BP: unknown; allowed: KM, SKCM"),
    ("calibrate problems/planar --seed -1", "greater than or equal to 0"),
    ("calibrate problems/planar ./problems/planar", "one after the other"),
    ("calibrate problems/planar --metod KM", "--metod"),
    ("calibrate data/planar/planar.csv", "whose poses?"),
    ("calibrate problems/planar/robot.toml", "is a robot alone"),
    ("check --repair problems/planar/robot.toml data/planar/planar.csv", "--repair writes problem.toml"),
    ("calibrate problems/planar/robot.toml lost.csv", "lost.csv: no such file"),
    ("calibrate problems/planar --frozen", "--frozen: needs the robot file that --prior names"),
    # Options of another mode.
    ("plan problems/ur10e --isolability --measured poses.csv", "--measured: is for poses to calibrate with"),
    ("plan problems/ur10e --isolability --seed 0", "--seed: is for poses to calibrate with"),
    ("plan problems/ur10e --iso9283 --repeats 2", "--repeats: is for poses to calibrate with"),
    (f"plan problems/ur10e {TABLE}", "POSES: is for --isolability"),
    ("plan problems/ur10e --touches 5 --json a.json", "not for --touches"),
    ("plan problems/fr3_camera --camera --view 1,2,3,4", "--view: is for --camera of a robot file"),
    (f"verify problems/ur10e {TABLE} --mujoco --chart a.csv", "--chart: is for --touches"),
    (f"verify problems/ur10e {TABLE} --update a.toml", "--update: is for --touches"),
    ("verify problems/planar x.csv --seed 1", "--seed: is for --mujoco or --touches"),
    (f"diagnose problems/ur10e {TABLE} --reference {TABLE}", "--reference: is for joint logs"),
    (f"diagnose problems/ur10e {TABLE} --unlisted", "give --out DIR"),
    ("new arm --example --convention standard", "--convention: is for --dh, not for an example"),
    ("new arm --dh dh.csv --tip-link tip", "--tip-link: is for --urdf, not for --dh"),
    ("new arm --urdf a.urdf --dh b.csv", "--dh: not together with --urdf; leave one of the two out"),
    # Diagnoses.
    ("diagnose problems/ur10e none.csv", "none.csv: no such file"),
    ("diagnose problems/ur10e/robot.toml", "a robot file has no measurements; give their tables after it"),
    ("diagnose data/campaigns/practice", "no problem.toml is in it, which would name tables; give them after it"),
    (f"diagnose problems/ur10e {TABLE} --effects backlsh", "no effect 'backlsh'"),
    (f"diagnose problems/ur10e {TABLE} --effects none.effect.toml", "none.effect.toml"),
    ("diagnose problems/ur10e problems/ur10e/robot.toml", "not a readable CSV table"),
    # Exports and programs.
    ("export model none --out x.xml", "no such problem folder or robot file"),
    ("export model problems/planar --out x.xml --into y.xml", "belong together"),
    (f"export model {ARM} --out x.xml --into y.xml --joints a,b", "give --nominal, or the problem folder"),
    (f"export model {ARM} --out x.urdf", "casadical export model --to mjcf"),
    ("export model problems/planar --out x.txt", "give --to mjcf|urdf|actuators|ur|"),
    ("export model problems/planar --out x.urdf --campaign c.csv", "give --to mjcf"),
    (f"export c {ARM} --out x", "--nominal NOMINAL.toml"),
    (f"export c {ARM} --out x --what network", "--compensator"),
    (f"export c {ARM} --out x --what network --payload 3", "--payload: is for --what command"),
    (f"export c {ARM} --out x --nominal {ARM} --name 1-2", "cannot prefix"),
    (f"export c {ARM} --out x --what curves --correct pose", "is for --what command"),
    ("correct nowhere job.csv --out x", "no such folder"),
    ("correct problems job.csv --out x", "no manifest.json"),
    (f"correct problems job.csv --out x --nominal {ARM}", "--nominal: is for a robot file"),
    ("correct problems job.csv --out x --steps 3", "--steps: is for a robot file, not for a folder"),
    # Sessions.
    ("measure problems/planar --no-page", "--follow FILE, DIR or -, or --simulate N: give one of them"),
    ("measure problems/planar --no-page --follow t.csv --simulate 3", "give one of them"),
    ("measure problems/planar --no-page --follow t.csv --every 5", "--every: is for --simulate, not for readings"),
    ("measure problems/planar --no-page --simulate 1 --port 8000", "--port: is for the page, not for --no-page"),
    ("measure none --no-page --simulate 1", "none/problem.toml: no such file"),
    # Paths.
    ("new ''", "a path is empty"),
    ("check problems/planar --json ''", "a path is empty"),
    ("plan problems/planar -n 6 --for ''", "is empty; give a value, or leave it out"),
    ("new a\x1bb", "its name holds the control character"),
    ("new n --dh /dev/full", "/dev/full: is a device; name a file"),
    ("fleet nothing --store s.parquet", "nothing: neither a problem folder nor a folder of such"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("refused")
    for name in ("problems", "data"):
        (place / name).symlink_to(ROOT / name)
    return place


@pytest.mark.parametrize(("command", "words"), REFUSED, ids=[command for command, _ in REFUSED])
def test_a_mistake_ends_in_a_message_and_2(command: str, words: str, folder: Path) -> None:
    done = run(*shlex.split(command), folder=folder, width=400)
    said = " ".join(done.stderr.split())
    assert done.returncode == 2, done.stdout + done.stderr
    assert words in said
    assert "Traceback" not in said
    assert {path.name for path in folder.iterdir()} == {"problems", "data"}


def test_a_device_is_no_input() -> None:
    for given in ("/dev/zero", ["plain.csv", "/dev/zero"]):
        paths = [Path(one) for one in given] if isinstance(given, list) else Path(given)
        with pytest.raises(InputError, match="/dev/zero: is a device; name a file"):
            _refuse_unusable({"data": paths}, ())
        _refuse_unusable({"data": paths}, ("data",))


@pytest.mark.parametrize(
    ("text", "own"), [("name,value\na,1", True), ("q1_deg,x_mm,y_mm\n1,2,3", False), ("one column\n1", False)]
)
def test_a_table_is_an_output_of_ours_unless_it_holds_measurements(text: str, own: bool) -> None:
    assert _is_output(Path("a.csv"), text) is own
