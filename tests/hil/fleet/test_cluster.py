"""A Dask cluster answers as one process does, survives its workers, and listens to nobody else."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from certificates import certificates
from fleet_jobs import NEEDS, job

from hil.errors import UnusableInputError
from hil.fleet.engine import one_by_one
from hil.fleet.job import Job, Outcome

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow


def outcomes(jobs: Iterable[Job], scheduler: str | None = None, told: list[str] | None = None) -> dict[str, Outcome]:
    from hil.fleet.cluster import on_cluster

    engine = on_cluster(scheduler, 2, [NEEDS], (told if told is not None else []).append)
    return {found.name: found for found in engine(jobs, threading.Event())}


def test_the_answers_are_those_of_one_process_and_failures_are_the_same(tmp_path: Path) -> None:
    jobs = [job("thirds", {"of": [float(number)]}, called=f"thirds {number}") for number in range(40)]
    jobs += [job("die"), job("hang", needs=replace(NEEDS, time_s=2.0)), job("fail")]
    alone = {found.name: found for found in one_by_one(jobs, threading.Event())}
    together = outcomes([*jobs, job("die_with_the_worker_once", {"mark": str(tmp_path / "died")})])
    assert together.pop("die_with_the_worker_once").value == "done"
    assert together.keys() == alone.keys()
    for name, found in alone.items():
        assert together[name].failure == found.failure
        if found.value is not None:
            assert together[name].value["thirds"] == found.value["thirds"]


def test_short_jobs_are_given_together(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []
    submit = distributed.Client.submit
    monkeypatch.setattr(
        distributed.Client, "submit", lambda client, *called, **how: given.append(how["key"]) or submit(client, *called, **how)
    )
    found = outcomes(job("thirds", {"of": [1.0]}, called=f"thirds {number}") for number in range(300))
    assert len(found) == 300
    assert len(given) < 100


def test_what_no_worker_offers_is_refused_instead_of_waited_for() -> None:
    from hil.fleet.cluster import on_cluster

    engine = on_cluster(None, 1, [replace(NEEDS, memory_GB=1e6)])
    with pytest.raises(UnusableInputError, match=r"no worker offers 1e\+06 GB"):
        list(engine([job("thirds")], threading.Event()))


def test_a_cancelled_run_keeps_what_is_finished_and_ends_what_hangs() -> None:
    from hil.fleet.cluster import on_cluster

    cancelled, found = threading.Event(), []
    jobs = [job("hang"), *(job("thirds", {"of": [1.0]}, called=f"thirds {number}") for number in range(5))]
    for outcome in on_cluster(None, 2, [NEEDS])(jobs, cancelled):
        found.append(outcome)
        cancelled.set()
    assert found
    assert all(outcome.value["thirds"] == [1.0 / 3.0] for outcome in found)


def listening() -> set[tuple[str, int]]:
    """Addresses and ports on which this process and its children listen."""
    import psutil

    here = psutil.Process()
    processes = [here, *here.children(recursive=True)]
    connections = [each for process in processes for each in process.net_connections(kind="tcp")]
    return {(each.laddr.ip, each.laddr.port) for each in connections if each.status == psutil.CONN_LISTEN}


def test_a_local_cluster_listens_on_the_loopback_interface_alone() -> None:
    from hil.fleet.cluster import on_cluster

    found: list[set[tuple[str, int]]] = []

    def jobs() -> Iterable[Job]:
        found.append(listening())
        yield job("thirds", {"of": [1.0]})

    before = listening()
    list(on_cluster(None, 1, [NEEDS])(jobs(), threading.Event()))
    assert {address for address, _ in found[0] - before} == {"127.0.0.1"}


def started(*arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")
def test_over_tls_only_who_has_a_certificate_gets_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import dask.config

    files = certificates(tmp_path)
    of_tls = [f"--tls-{name}{'-file' if name == 'ca' else ''}={path}" for name, path in files.items()]
    said = tmp_path / "scheduler.json"
    python_path = {"PYTHONPATH": ":".join(sys.path)}
    for name, value in python_path.items():
        monkeypatch.setenv(name, value)
    scheduler = started(
        "distributed.cli.dask_scheduler",
        "--protocol=tls",
        "--host=127.0.0.1",
        "--port=0",
        "--no-dashboard",
        f"--scheduler-file={said}",
        *of_tls,
    )
    worker = started(
        "distributed.cli.dask_worker",
        f"--scheduler-file={said}",
        "--no-nanny",
        "--no-dashboard",
        "--resources=memory=1e9 threads=1",
        *of_tls,
    )
    try:
        address = address_in(said, scheduler)
        assert address.startswith("tls://127.0.0.1:")
        with dask.config.set(settings(files)):
            assert outcomes([job("thirds", {"of": [1.0]})], address)["thirds"].value["thirds"] == [1.0 / 3.0]
        other = certificates(tmp_path / "other")
        with dask.config.set(settings(other) | {"distributed.comm.timeouts.connect": "2s"}), pytest.raises(UnusableInputError):
            outcomes([job("thirds", {"of": [1.0]})], address)
    finally:
        for process in (worker, scheduler):
            process.terminate()
            process.wait()


def settings(files: dict[str, Path]) -> dict[str, Any]:
    """Dask's configuration with these certificates."""
    tls = "distributed.comm.tls"
    who = {f"{tls}.client.{name}": str(files[name]) for name in ("cert", "key")}
    return {"distributed.comm.require-encryption": True, f"{tls}.ca-file": str(files["ca"]), **who}


def address_in(path: Path, scheduler: subprocess.Popen[bytes]) -> str:
    """The address that a scheduler writes when it listens."""
    for _ in range(600):
        if path.exists() and (text := path.read_text(encoding="utf-8")):
            return str(json.loads(text)["address"])
        assert scheduler.poll() is None
        threading.Event().wait(0.1)
    raise AssertionError("no scheduler after a minute")


def test_an_open_scheduler_that_others_reach_is_told_of() -> None:
    from hil.fleet.cluster import on_cluster

    told: list[str] = []
    on_cluster("tcp://127.0.0.1:8786", 0, [], told.append)
    assert told == []
    on_cluster("tcp://scheduler.hospital:8786", 0, [], told.append)
    assert "use tls://" in told[0]


def test_an_address_that_is_none_is_refused() -> None:
    from hil.fleet.cluster import on_cluster

    with pytest.raises(UnusableInputError, match=r"must be tcp://HOST:PORT or tls://HOST:PORT"):
        on_cluster("scheduler:8786", 0, [])
