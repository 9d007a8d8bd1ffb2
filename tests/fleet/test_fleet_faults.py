"""What goes wrong around a fleet is said, and nothing that was computed is lost."""

import errno
import os
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from fleet_plants import planar

from casadical import InputError, report
from casadical.fleet.campaigns import compare_files
from casadical.fleet.run import EMPTY_ROW, add, client_of, one_robot, robots_in, rows, run_fleet

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
    assert "ok" in list(rows(store)[0]["status"])


@pytest.mark.parametrize("robots", [0, 1])
def test_a_full_disk_says_what_is_kept(arms: Path, tmp_path: Path, near: str, monkeypatch, robots: int) -> None:
    def fill(text: str) -> None:
        if text.startswith(f"robot {robots} "):
            monkeypatch.setattr("os.fsync", _full)

    with pytest.raises(InputError, match="No space left") as error:
        run_fleet([arms], tmp_path / "fleet.parquet", scheduler=near, with_diagnosis=False, show=fill)
    assert ("; 1 of 3 robots are in" in str(error.value)) == bool(robots)


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
    assert found.robots["robot"].to_dict() == {0: "arm2", 1: "eins"}
    assert sorted(found.notes) == [
        copy.format("a-copy", "arm2"),
        "eins has the files of arm1, whose folder is not there: taken for it, renamed",
        copy.format("zwei", "eins"),
    ]
    assert found.computed == 0


def test_an_address_that_is_none_and_no_worker_are_said() -> None:
    for address in ("nonsense", "http://localhost:80"):
        with pytest.raises(InputError, match=f"--scheduler {address}: .* an address is tcp://host:8786"):
            _connect(address)
    with pytest.raises(InputError, match="an encrypted one asks for certificates"):
        _connect("tls://here:8786")
    with here(workers=0) as cluster:
        with pytest.raises(InputError, match="no worker is connected; start one there: dask worker tcp://"):
            _connect(cluster.scheduler_address)
        cluster.scale(1)
        with distributed.Client(cluster) as client:
            client.wait_for_workers(1)
        _connect(cluster.scheduler_address)


def test_a_worker_with_another_version_is_said(near: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for version in ("0.0.1", "99.9"):
        monkeypatch.setattr("casadical.fleet.run.__version__", version)
        with pytest.raises(InputError, match=f"has casadical .*; this is casadical {version}: install the same one"):
            _connect(near)


@pytest.mark.slow
def test_workers_of_this_machine_listen_on_loopback_alone_and_leave_an_interrupt_to_the_command() -> None:
    this = psutil.Process()
    with client_of(None, 1) as client:
        asked = [c for p in (this, *this.children(recursive=True)) for c in p.net_connections("inet")]
        assert {c.laddr.ip for c in asked if c.status == psutil.CONN_LISTEN} == {"127.0.0.1"}
        assert list(client.run(_kept).values()) == [(False, True)]


def _kept(dask_worker: Any) -> tuple[bool, bool]:
    return "profile" in dask_worker.periodic_callbacks, signal.getsignal(signal.SIGINT) is signal.SIG_IGN


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
    add(tmp_path / "store", row)
    assert len(rows(tmp_path / "store")[0]) == 1


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


def test_a_file_of_a_store_that_holds_no_row_is_said_and_its_robot_computed_again(arms, tmp_path, near):
    store = tmp_path / "fleet.parquet"
    for k in range(3):
        add(store, one_robot(str(arms / f"arm{k}"), False))
    (store / "arm0.parquet").write_bytes((store / "arm0.parquet").read_bytes()[:300])
    pd.DataFrame({"robot": ["arm1"]}).to_parquet(store / "arm1.parquet")
    (kept,), damaged = rows(store)[0]["robot"], rows(store)[1]
    assert kept == "arm2"
    assert [re.sub(": (.*);", ":;", words) for words in damaged] == [
        f"{store / name}.parquet:; its robot is computed again" for name in ("arm0", "arm1")
    ]
    found = run_fleet([arms], store, scheduler=near, with_diagnosis=False)
    assert list(found.robots["status"]) == ["ok"] * 3
    assert (found.computed, found.notes, rows(store)[1]) == (2, tuple(damaged), [])


def test_a_place_that_is_no_store_is_refused(arms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = {**EMPTY_ROW, "robot": "a"}
    add(tmp_path / "full", row)
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", _full)
        with pytest.raises(InputError, match="No space left"):
            add(tmp_path / "full", {**row, "robot": "b"})
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["a.parquet"]
    (tmp_path / "file.parquet").write_text("")
    before = sorted(p.name for p in (arms / "arm1").iterdir())
    for place, said in (
        (arms / "arm1", "arm1: holds poses.csv, which is no part of a store"),
        (tmp_path / "file.parquet", "file.parquet: cannot be written: .*exists"),
    ):
        with pytest.raises(InputError, match=said):
            run_fleet([arms], place, workers=1, with_diagnosis=False)
    assert sorted(p.name for p in (arms / "arm1").iterdir()) == before
    with pytest.raises(InputError, match="neither a problem folder"):
        run_fleet([tmp_path], tmp_path / "new.parquet")
    monkeypatch.setattr("os.access", lambda _path, _mode: False)
    with pytest.raises(InputError, match="this store cannot be written to"):
        run_fleet([arms], tmp_path / "full", workers=1)


def _full(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
