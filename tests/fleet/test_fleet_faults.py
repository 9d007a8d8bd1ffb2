"""What goes wrong around a fleet is said, and nothing that was computed is lost."""

import errno
import os
import re
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from fleet_plants import planar

import casadical
from casadical import InputError, report
from casadical.fleet.campaigns import compare_files
from casadical.fleet.cluster import Limits, SchedulerLostError, client_of, results
from casadical.fleet.run import robots_in, run_fleet
from casadical.fleet.store import NOTHING, add, each, one_robot, parts, rows

distributed = pytest.importorskip("distributed", reason="distributed (Dask) is not installed")
psutil = pytest.importorskip("psutil", reason="psutil (of Dask) is not installed")
pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
METRES = ["x_mm", "y_mm", "z_mm"]


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three arms, the first one with later campaigns."""
    folder = tmp_path_factory.mktemp("arms")
    for k in range(3):
        planar(folder / f"arm{k}", k, campaigns=3 * (k == 0))
    return folder


@pytest.fixture(scope="module")
def first(arms: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the arm with later campaigns, to be spoilt."""
    return Path(shutil.copytree(arms / "arm0", tmp_path_factory.mktemp("first") / "arm"))


def spoil(table: Path, start: int, columns: list[str], factor: float) -> None:
    found = pd.read_csv(table)
    found.loc[start:, columns] *= factor
    found.to_csv(table, index=False)


def _kept(dask_worker: Any) -> tuple[bool, bool]:
    return "profile" in dask_worker.periodic_callbacks, signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.fixture(scope="module")
def own() -> Iterator[Any]:
    """A client of a process of this machine."""
    with client_of(None, 1) as client:
        yield client


def test_workers_keep_no_call_stacks_and_leave_an_interrupt_to_the_command(own: Any) -> None:
    assert list(own.run(_kept).values()) == [(False, True)]


def test_no_port_is_open_beyond_loopback(own: Any) -> None:
    """All that the command and its processes listen on: scheduler, worker, their dashboards."""
    this = psutil.Process()
    asked = [c for p in (this, *this.children(recursive=True)) for c in p.net_connections("inet")]
    listening = {c.laddr.ip for c in asked if c.status == psutil.CONN_LISTEN}
    assert listening == {"127.0.0.1"}


def test_a_worker_with_another_version_is_said(own: Any) -> None:
    own.run(_grow_old)
    with pytest.raises(InputError, match=r"has casadical 0\.0\.1; this is casadical .*: install the same one there"):
        _connect(own.cluster.scheduler_address)


def _grow_old() -> None:
    """In a worker's process: as if an older casadical were installed there."""
    casadical.__version__ = "0.0.1"


def here(workers: int = 1) -> Any:
    """A cluster within this process, which takes no time to begin."""
    options = {"processes": False, "protocol": "tcp://", "dashboard_address": "127.0.0.1:0"}
    return distributed.LocalCluster(n_workers=workers, threads_per_worker=1, **options)


@pytest.fixture(scope="module")
def near() -> Iterator[str]:
    """Address of a scheduler with a worker."""
    with here() as cluster:
        yield cluster.scheduler_address


def test_an_interrupt_says_what_is_kept(arms: Path, tmp_path: Path, near: str) -> None:
    store = tmp_path / "fleet.parquet"

    def stop(text: str) -> None:
        if text.startswith("robot 1 "):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match=r"interrupted; 1 of 3 robots are in .*: run the same command again"):
        run_fleet([arms], store, scheduler=near, with_diagnosis=False, show=stop)
    assert list(rows(store)["status"]) == ["ok"]


def test_files_of_a_store_that_were_cut_or_deleted_are_said_and_their_robots_computed_again(arms, tmp_path, near):
    store = tmp_path / "fleet.parquet"
    for k in range(3):
        add(store, [one_robot(str(arms / f"arm{k}"), False)])
    cut, deleted, _ = parts(store)
    cut.write_bytes(cut.read_bytes()[:300])
    with pytest.raises(InputError, match="is no part of a store"):
        rows(store)

    def delete(text: str) -> None:
        if text == "robot 2 of 3":
            deleted.unlink()

    found = run_fleet([arms], store, scheduler=near, with_diagnosis=False, show=delete)
    assert list(found.robots["robot"]) == ["arm0", "arm2"]
    said, gone = found.notes
    assert said.startswith(str(cut))
    assert said.endswith("the robots in it are computed again; remove it")
    assert gone.startswith("rows of 1 robots are gone")


def test_a_copy_of_a_folder_is_no_robot_also_where_the_first_was_renamed(arms, tmp_path, near):
    plant, store = tmp_path / "plant", tmp_path / "fleet.parquet"
    shutil.copytree(arms / "arm1", plant / "arm1")
    shutil.copytree(arms / "arm1", plant / "arm1-copy")
    shutil.copytree(arms / "arm2", plant / "arm2")
    found = run_fleet([plant], store, scheduler=near, with_diagnosis=False)
    assert list(found.robots["robot"]) == ["arm1", "arm2"]
    copy = "{} has the same files as {}: a copy, counted once, without a row; remove one"
    assert found.notes == (copy.format("arm1-copy", "arm1"),)
    shutil.copytree(plant / "arm2", plant / "a-copy")  # what the store knows is no copy
    (plant / "arm1").rename(plant / "eins")
    (plant / "arm1-copy").rename(plant / "zwei")
    found = run_fleet([plant], store, scheduler=near, with_diagnosis=False)
    assert list(found.robots["robot"]) == ["arm2", "eins"]
    assert sorted(found.notes) == [
        copy.format("a-copy", "arm2"),
        "eins has the files of arm1, whose folder is not there: taken for it, renamed",
        copy.format("zwei", "eins"),
    ]
    assert found.computed == 0


def test_a_full_or_read_only_disk_is_said(tmp_path: Path, arms: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = {**NOTHING, "robot": "a"}
    add(tmp_path, [row])
    with monkeypatch.context() as patch:
        patch.setattr("os.write", _full)
        patch.setattr("os.replace", _full)
        with pytest.raises(InputError, match=r"No space left.*of 2 robots; those written before are kept"):
            add(tmp_path, [row, row])
    assert len(rows(tmp_path)) == 1
    monkeypatch.setattr("os.access", lambda _path, _mode: False)
    with pytest.raises(InputError, match="this store cannot be written to"):
        run_fleet([arms], tmp_path, workers=1)


def _full(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_an_address_that_is_none_and_no_worker_are_said() -> None:
    for address in ("nonsense", "http://localhost:80"):
        with (
            pytest.raises(InputError, match=f"--scheduler {address}: .* an address is tcp://host:8786"),
            client_of(address, None),
        ):
            pass
    with here(workers=0) as cluster:
        with pytest.raises(InputError, match="no worker is connected; start one there: dask worker tcp://"):
            _connect(cluster.scheduler_address)
        cluster.scale(1)
        with distributed.Client(cluster) as client:
            client.wait_for_workers(1)
        _connect(cluster.scheduler_address)


def _after(seconds: float) -> dict[str, object]:
    time.sleep(seconds)
    return dict(NOTHING)


@pytest.mark.parametrize("seconds_before", [0.0, 0.5])
def test_workers_that_all_leave_are_said(seconds_before: float) -> None:
    """While they work, and when they are done with what was not fetched yet."""
    with here() as cluster, client_of(cluster.scheduler_address, None) as client:
        done = results(client, _after, [(0.05,)] * 40, Limits(patience=0.3, lonely=1.0))
        next(done)
        time.sleep(seconds_before)
        cluster.scale(0)
        with pytest.raises(SchedulerLostError, match="the scheduler has had no worker for 1 s"):
            list(done)


def test_what_a_worker_had_done_when_it_left_is_done_again() -> None:
    with here() as cluster, client_of(cluster.scheduler_address, None) as client:
        done = results(client, _after, [(0.05,)] * 12)
        next(done)
        time.sleep(0.5)  # the worker is done with all that it was given
        cluster.scale(0)
        while client.scheduler_info(n_workers=-1)["workers"]:
            time.sleep(0.05)
        cluster.scale(1)
        assert [found.keys() for _, found in done if isinstance(found, dict)] == [NOTHING.keys()] * 11


def _all_but(number: int, bad: int) -> dict[str, object]:
    if number == bad:
        raise ValueError(f"robot {number}")
    return {"robot": str(number)}


def test_with_very_many_workers_a_task_is_several_robots_and_a_bad_one_is_lost_alone(
    monkeypatch,
):
    five_times = Limits(workers=0.2)  # of one worker
    tasks, sizes = [(k, 13) for k in range(30)], []
    with here() as cluster, client_of(cluster.scheduler_address, None) as client:
        submit = client.submit

        def counted(function: Any, *args: Any, **options: Any) -> Any:
            sizes.append(len(args[1]))
            return submit(function, *args, **options)

        monkeypatch.setattr(client, "submit", counted)
        done = {task[0]: found for task, found in results(client, _all_but, tasks, five_times)}
    assert sorted(done) == list(range(30))
    assert {k for k, found in done.items() if not isinstance(found, dict)} == {13}
    assert all(done[k] == {"robot": str(k)} for k in done if k != 13)
    assert sorted(sizes) == [1] * 5 + [5] * 6


def _connect(address: str) -> None:
    with client_of(address, None):
        pass


def test_a_folder_whose_name_is_not_utf_8_stops_nobody(first: Path, tmp_path: Path) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/M\xfcller"))
    shutil.copytree(first, folder)
    row = one_robot(str(folder), False)
    assert row["status"] == "failed"
    assert row["error"].endswith("a name that is not UTF-8; rename the folder")
    assert list(robots_in([tmp_path, tmp_path])) == [row["robot"]]
    add(tmp_path / "store", [row])
    assert len(rows(tmp_path / "store")) == 1


def test_a_table_whose_name_is_not_utf_8_has_a_page_and_one_that_is_not_there_is_said(first, tmp_path):
    tables = [first / "campaigns" / "2026-01-01.csv", Path(os.fsdecode(os.fsencode(tmp_path) + b"/M\xe4rz.csv"))]
    with pytest.raises(InputError, match="no such file or folder"):
        compare_files(tables, first)
    shutil.copy(first / "campaigns" / "2026-02-01.csv", tables[1])
    assert "M\\udce4rz" in report([compare_files(tables, first).page(tables)]).encode().decode()


def test_units_that_change_within_a_table_are_said_with_their_rows(first: Path, tmp_path: Path) -> None:
    whole, spoilt = first / "campaigns" / "2026-02-01.csv", tmp_path / "2026-05-01.csv"
    told = pd.read_csv(whole)
    end = len(told) - 1
    for begin, last in ((20, end), (13, end), (0, 18), (9, 30)):
        wrong = told.copy()
        wrong.loc[begin:last, METRES] *= 1e-3
        wrong.to_csv(spoilt, index=False)
        said = f"2026-05-01.csv: rows {begin + 2} to {last + 2} are in another unit than the others"
        with pytest.raises(InputError, match=said):
            compare_files([whole, spoilt], first)
    shutil.copy(whole, spoilt)
    spoil(spoilt, 28, ["q1_deg", "q2_deg"], 3.14159265 / 180)
    found = compare_files([whole, spoilt], first)
    assert found.campaigns[1].notes[0].startswith("12 poses left out as outliers, rows 30 to 41 one after another")
    apart = pd.read_csv(spoilt)
    apart.loc[26, ["q1_deg", "q2_deg"]] *= 3.14159265 / 180
    apart.to_csv(spoilt, index=False)
    assert compare_files([whole, spoilt], first).campaigns[1].notes[0] == "13 poses left out as outliers"


def test_the_first_campaign_needs_no_day_and_its_copy_gives_one(first: Path) -> None:
    row = one_robot(str(first), False)
    assert (row["campaigns"], row["notes"]) == (4, "")
    shutil.copy(first / "poses.csv", first / "campaigns" / "2025-12-01.csv")
    again = one_robot(str(first), False)
    assert (again["campaigns"], again["notes"]) == (4, "")
    assert again["days"][0] == again["days"][1] - 31
    assert again["changes"] == row["changes"]


def test_an_encrypted_scheduler_is_refused_with_a_way_out() -> None:
    with (
        pytest.raises(InputError, match="an encrypted one asks for certificates"),
        client_of("tls://here:8786", None),
    ):
        pass


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda t: t.drop_columns(["robot"]), "column 'robot' is missing"),
        (lambda t: t.drop_columns(["fingerprint"]), "column 'fingerprint' is missing"),
        (lambda t: t.set_column(t.column_names.index("robot"), "robot", pyarrow.array([["a"]])), "is of type list<"),
        (lambda t: t.set_column(t.column_names.index("names"), "names", pyarrow.array(["a"])), "is of type string"),
        (
            lambda t: t.set_column(2, "status", pyarrow.array([None], pyarrow.string())),
            "a cell of column 'status' is e",
        ),
        (
            lambda t: t.set_column(2, "status", pyarrow.array([b"\xff"]).view(pyarrow.string())),
            "UTF8",
        ),
        (lambda t: t.take([0] * 10_001), "it has 10001 rows; at most 10000 are read"),
    ],
    ids=[
        "robot",
        "fingerprint",
        "a list for a word",
        "a word for a list",
        "an empty cell",
        "no text",
        "rows",
    ],
)
def test_a_part_of_a_store_that_is_none_is_said(spoil, said, tmp_path: Path) -> None:
    add(tmp_path, [{**NOTHING, "robot": "a"}])
    add(tmp_path, [{**NOTHING, "robot": "b"}])
    part, _ = parts(tmp_path)
    pyarrow.parquet.write_table(spoil(pyarrow.parquet.read_table(part)), part)
    with pytest.raises(InputError, match=f"is no part of a store: .*{said}"):
        rows(tmp_path)
    damaged: list[str] = []
    assert list(rows(tmp_path, damaged=damaged)["robot"]) == ["b"]
    assert re.search(said, damaged[0])
    assert [row["robot"] for row in each(tmp_path, ["a", "b"])] == ["b"]


def test_a_folder_of_other_files_is_no_store(arms: Path) -> None:
    before = sorted(p.name for p in (arms / "arm1").iterdir())
    with pytest.raises(InputError, match=r"arm1: holds poses.csv, which is no part of a store"):
        run_fleet([arms], arms / "arm1", workers=1, with_diagnosis=False)
    assert sorted(p.name for p in (arms / "arm1").iterdir()) == before
