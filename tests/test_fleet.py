"""`bms-ukf replay` over many recordings: all cores, a Dask cluster, what is resumed, what a failure may not stop."""

from __future__ import annotations

import csv
import json
import logging
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import deadly
import measured
import numpy as np
import pyarrow.parquet
import pytest
from distributed import LocalCluster

from bms_ukf import Tuning
from bms_ukf.replay import workers
from bms_ukf.replay.batch import Job
from bms_ukf.replay.rerun import Options

CELL = ["--cell", "lgm50_chen2020", "--current-positive", "charge"]


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    return measured.record([{"rest_s": 30}, {"current_A": 3.0, "duration_s": 270}], 0.9)


@pytest.fixture
def fleet(tmp_path: Path, rows: np.ndarray) -> Path:
    """Six recordings that can be read and one that cannot."""
    folder = tmp_path / "fleet"
    folder.mkdir()
    for k in range(6):
        measured.write(folder / f"vehicle{k}.csv", rows[: 120 + 30 * k])
    (folder / "torn.csv").write_text("x,y\n1,2\n")
    return folder


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    settings = {"dashboard_address": None, "host": "127.0.0.1", "silence_logs": logging.CRITICAL}
    with LocalCluster(n_workers=2, threads_per_worker=1, **settings) as cluster:
        # Its scheduler is a thread of this process, and would write into the capture of whichever test runs.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        yield cluster


def job(recording: Path) -> Job:
    return Job(recording, None, None, Options(), Tuning(), None, None, None, None)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--scheduler", "tcp://127.0.0.1:9"], "--scheduler is 'tcp://127.0.0.1:9'; expected a Dask scheduler"),
        (["--scheduler", "nonsense://x"], "--scheduler is 'nonsense://x'; expected a Dask scheduler"),
    ],
)
def test_a_scheduler_that_is_not_there_is_one_line(bms_ukf, fleet, tmp_path, monkeypatch, arguments, told):
    monkeypatch.setattr(workers, "CONNECT_S", 1)
    assert told in bms_ukf("replay", fleet, *CELL, "--out", tmp_path / "out", *arguments).line


def test_a_result_in_parquet_holds_the_columns_and_the_summary_of_the_csv_and_the_json(bms_ukf, fleet, tmp_path):
    one = fleet / "vehicle5.csv"
    assert bms_ukf("replay", one, *CELL, "--out", tmp_path / "e.csv", "--json", tmp_path / "e.json").code == 0
    assert bms_ukf("replay", one, *CELL, "--out", tmp_path / "e.parquet", "--format", "parquet").code == 0
    table = pyarrow.parquet.read_table(tmp_path / "e.parquet")
    with (tmp_path / "e.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert table.column_names == list(rows[0])
    for name in table.column_names:
        values = table.column(name).to_pylist()
        if name in {"status", "faults"}:
            assert values == [row[name] for row in rows]
        else:
            np.testing.assert_allclose(values, [float(row[name] or "nan") for row in rows], rtol=1e-8, err_msg=name)
    written = json.loads((tmp_path / "e.json").read_text())
    told = json.loads(table.schema.metadata[b"bms_ukf.summary"])
    assert {k: v for k, v in told.items() if k != "steps_per_s"} == {
        k: v for k, v in written.items() if k != "steps_per_s"
    }


def test_a_second_run_keeps_what_is_done_and_redoes_what_changed_or_is_torn(bms_ukf, fleet, tmp_path):
    out = tmp_path / "out"
    command = ["replay", fleet, *CELL, "--out", out, "--format", "parquet", "--jobs", "1"]
    assert "torn.csv: time_s is 'x,y'" in bms_ukf(*command).line
    made = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert sorted(made) == [f"vehicle{k}.parquet" for k in range(6)]
    (out / "vehicle1.parquet").write_bytes((out / "vehicle1.parquet").read_bytes()[:500])
    (fleet / "vehicle2.csv").write_bytes((fleet / "vehicle3.csv").read_bytes())
    (out / "vehicle4.parquet").unlink()
    again = bms_ukf(*command)
    now = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert {name for name in made if now[name] != made[name]} == {f"vehicle{k}.parquet" for k in (1, 2, 4)}
    assert "3 of 7 kept from an earlier run" in again.out
    other = bms_ukf(*command, "--current-offset", "0.1")
    assert "kept" not in other.out, "another question is not answered by the results of this one"


def test_a_recording_that_kills_its_process_is_named_and_the_others_are_run(tmp_path):
    names = ["a", "deadly", "b", "c"]
    done = list(workers.here([job(tmp_path / f"{name}.csv") for name in names], 2, deadly.work))
    assert [found.recording.stem for found in done] == names
    assert [found.mistake is None for found in done] == [True, False, True, True]
    assert done[1].mistake == f"{tmp_path / 'deadly.csv'}: {workers.DIED}"


def test_a_cluster_runs_the_fleet_though_one_of_its_workers_is_killed(bms_ukf, cluster, fleet, tmp_path):
    out, victim = tmp_path / "out", cluster.workers[0].pid

    def kill() -> None:
        while not list(out.glob("*.parquet")):
            time.sleep(0.01)
        os.kill(victim, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    ended = bms_ukf("replay", fleet, *CELL, "--out", out, "--scheduler", cluster.scheduler_address)
    killer.join()
    assert ended.code == 2
    assert "torn.csv: time_s is 'x,y'" in ended.err
    assert sorted(path.name for path in out.iterdir()) == [f"vehicle{k}.parquet" for k in range(6)]


def test_a_recording_that_kills_every_worker_it_is_given_to_is_named(cluster, tmp_path):
    names = ["a", "deadly", "b"]
    jobs = [job(tmp_path / f"{name}.csv") for name in names]
    done = {found.recording.stem: found for found in workers.cluster(jobs, cluster.scheduler_address, deadly.work)}
    assert sorted(done) == sorted(names)
    assert {name for name, found in done.items() if found.mistake} == {"deadly"}
    assert workers.DIED in str(done["deadly"].mistake)


def test_results_in_parquet_need_a_place(bms_ukf, fleet):
    assert "--out: expected where the results are to go" in bms_ukf("replay", fleet, *CELL, "--format", "parquet").line
