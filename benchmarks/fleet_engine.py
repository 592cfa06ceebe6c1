"""What a fleet's engine costs, how it scales, and what becomes of faults.

    python benchmarks/fleet_engine.py cost   --work WORK --json OUT
    python benchmarks/fleet_engine.py overhead --work WORK --json OUT
    python benchmarks/fleet_engine.py diagnosis --work WORK --json OUT
    python benchmarks/fleet_engine.py faults --work WORK --json OUT

Each keeps in OUT what the others measured. `cost` measures the time that the engine adds to a task, two workers beside one, a sample of a
night of 200 machines with three recordings of 10 s each, and simulates 4 to 256 workers from the times that were measured. `overhead`
measures the first of these alone: on a busy computer under `chrt --rr 1`, so that it does not wait for a processor. `diagnosis` measures
the diagnosis of a machine's night. `faults` ends workers at random, fills the disk, restarts the scheduler, spoils recordings, starts two
runs at once, and ends a run by Ctrl-C.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import json
import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

import hil
from hil.fleet.engine import one_by_one
from hil.fleet.job import Job, Needs

MACHINES, SAMPLE, SETS = 200, 6, 2
NEEDS = Needs(memory_GB=2.0, threads=1, time_s=600.0)
EMPTY_JOBS = 1000
KILLED_AMONG = 24
ROWS = 40
"""Rows that a check of the C-arm has."""

FLEET = """
format = 1
[every]
file = "carm"
recordings = "recordings/{name}"
repeats = ["shake_*"]
tasks = ["check", "identify"]
"""


def nothing(argument: dict[str, Any]) -> dict[str, Any]:
    """An empty job that has a check's rows for an answer."""
    row = {"quantity": "q", "value": 1.0 / 3.0, "unit": "1", "verdict": "agrees", "message": "", "group": "", "covariance": [], "place": 0}
    return {"software": "none", "notes": [], "rows": [row] * ROWS}


def spin(argument: dict[str, Any]) -> dict[str, float]:
    """Compute for so many seconds of processor time; return what it took on the wall."""
    began_s = time.perf_counter()
    until_s = time.process_time() + argument["seconds"]
    while time.process_time() < until_s:
        pass
    return {"wall_s": time.perf_counter() - began_s}


def killed(argument: dict[str, Any]) -> float:
    """End the Dask worker whose job this is, the first time, where that was drawn; then answer."""
    mark = Path(argument["mark"])
    if argument["kills"] and not mark.exists():
        mark.touch()
        os.kill(os.getppid(), signal.SIGKILL)
        threading.Event().wait()
    return argument["number"] / 3.0


def hang(argument: dict[str, Any]) -> None:
    """Give no answer."""
    threading.Event().wait()


def fill(argument: dict[str, Any]) -> None:
    """Take four gigabytes and keep them."""
    taken = np.ones(1 << 29)
    threading.Event().wait(float(taken[0]) * 1e6)


def measured(argument: dict[str, Any]) -> dict[str, Any]:
    """A fleet's own job, with its processor time, time on the wall and peak memory."""
    from hil.fleet.work import work

    wall_s, processor_s = time.perf_counter(), time.process_time()
    answer = work(argument)
    used = {"wall_s": time.perf_counter() - wall_s, "processor_s": time.process_time() - processor_s}
    return {**answer, **used, "peak_GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9}


def on(workers: int, scheduler: str | None = None, told: list[str] | None = None) -> Any:
    from hil.fleet.cluster import on_cluster

    return on_cluster(scheduler, workers, [NEEDS], (told if told is not None else []).append)


def job(name: str, function: str, argument: dict[str, Any] | None = None, needs: Needs = NEEDS) -> Job:
    return Job(name, f"{Path(__file__).stem}:{function}", argument or {}, needs)


def recordings(work: Path) -> Path:
    """Two sets of three recordings of 10 s, and folders of the sample's machines with them."""
    made = work / "made"
    carm = hil.open_machine("carm")
    shaken = hil.Multisine(period_s=2.0, periods=4, settle_periods=1, jog=None)
    moved = hil.Scan(axis="roll", start=-0.3, stop=0.3)
    for number in range(SETS):
        if (made / str(number)).exists():
            continue
        draft = made / f"{number}.draft"
        draft.mkdir(parents=True, exist_ok=True)
        first, second = carm.run(shaken, bus="lockstep:", seed=number)
        scan = carm.run(moved, bus="lockstep:", seed=number)
        for name, recording in (("shake_1", first), ("shake_2", second), ("scan", scan.part(slice(0, first.rows)))):
            hil.write_recording(recording, draft / f"{name}.mf4")
        draft.rename(made / str(number))
    return made


def fleet_of(work: Path, machines: int) -> Path:
    """A fleet whose machines have the sets in turn."""
    made = recordings(work)
    folder = work / f"fleet_{machines}"
    shutil.rmtree(folder, ignore_errors=True)
    names = [f"machine_{number:03d}" for number in range(machines)]
    for number, name in enumerate(names):
        shutil.copytree(made / str(number % SETS), folder / "recordings" / name / "2026-11-27")
    (folder / "fleet.toml").write_text(FLEET + "".join(f'[[machine]]\nname = "{name}"\n' for name in names), encoding="utf-8")
    return folder


def overhead(work: Path) -> dict[str, float]:
    """Time per task of giving a job to a worker, taking its answer and writing the rows, for jobs that do nothing.

    It is counted from the first answer, so that starting a cluster is not in it, until all is on the disk.
    """
    found = {}
    for name in ("dask", "without_dask"):
        wall_s, processor_s = empty_jobs(work / f"overhead_{name}", name)
        found[f"{name}_wall_ms"] = 1e3 * wall_s / (EMPTY_JOBS - 1)
        found[f"{name}_client_and_scheduler_processor_ms"] = 1e3 * processor_s / (EMPTY_JOBS - 1)
    return found


def empty_jobs(store: Path, name: str) -> tuple[float, float]:
    """Do jobs that do nothing; return the time on the wall, and this process's own on its processor [s]."""
    from hil.fleet.keep import Keeper
    from hil.fleet.new_work import FleetRun, _rows_of

    argument = {"machine": "m", "night": "2026-11-27T00:00:00+00:00", "task": "check", "experiment": "e", "recordings": [], "held_out": []}
    argument["machine_file"] = {"text": hil.open_machine("carm").text, "hash": "h"}
    names = [f"machine=m/date=2026-11-27/check-{number:032d}.parquet" for number in range(EMPTY_JOBS)]
    jobs = {each: job(each, "nothing", argument) for each in names}
    shutil.rmtree(store, ignore_errors=True)
    run = FleetRun(store)
    outcomes = {"dask": on(1), "without_dask": one_by_one}[name](iter(jobs.values()), threading.Event())
    with Keeper(store) as keeper:
        for place, outcome in enumerate(itertools.islice(outcomes, EMPTY_JOBS)):
            keeper.keep(outcome.name, _rows_of(jobs[outcome.name], outcome, run, print))
            if place == 0:
                began_s, here_s = time.perf_counter(), time.process_time()
    wall_s, here_s = time.perf_counter() - began_s, time.process_time() - here_s
    assert not list(outcomes)
    return wall_s, here_s


def two_beside_one() -> dict[str, float]:
    """Time of the same jobs with one worker and with two, and what jobs themselves took, which on a busy computer is more with two."""
    found: dict[str, float] = {}
    for workers in (1, 2):
        ended, own = [], []
        for outcome in on(workers)([job(f"spin {number}", "spin", {"seconds": 0.25}) for number in range(41)], threading.Event()):
            ended.append(time.perf_counter())
            own.append(outcome.value["wall_s"])
        elapsed = ended[-1] - ended[workers - 1]
        found[f"wall_s_{workers}"] = elapsed
        found[f"efficiency_{workers}"] = sum(own[workers:]) / (workers * elapsed)
    found["speed_up"] = found["wall_s_1"] / found["wall_s_2"]
    return found


def night(work: Path) -> dict[str, Any]:
    """A sample of a night's machines on two workers, by the fleet's own tasks; extrapolated to the whole night."""
    from dataclasses import replace

    from hil.fleet.file import read_fleet
    from hil.fleet.plan import plan_fleet

    folder = fleet_of(work, SAMPLE)
    plan = plan_fleet(read_fleet(folder / "fleet.toml"), folder / "store")
    kinds = {task.name: task.kind for task in plan.tasks}
    jobs = [replace(task.job, function=f"{Path(__file__).stem}:measured") for task in plan.tasks]
    by_kind: dict[str, list[dict[str, float]]] = {}
    began_s = ended_s = 0.0
    busy = list(on(2)(jobs, threading.Event()))
    for outcome in busy:
        by_kind.setdefault(kinds[outcome.name], []).append(outcome.value)
    began_s = time.perf_counter()
    run = hil.run_fleet(folder / "fleet.toml", workers=2, store=folder / "night")
    ended_s = time.perf_counter()
    files = [path.stat().st_size for path in run.store.rglob("*.parquet")]
    tasks = {
        kind: {
            "processor_s": float(np.median([one["processor_s"] for one in found])),
            "first_processor_s": float(max(one["processor_s"] for one in found)),
            "wall_s": float(np.median([one["wall_s"] for one in found])),
            "peak_GB": float(max(one["peak_GB"] for one in found)),
            "tasks_per_machine": len(found) / SAMPLE,
        }
        for kind, found in by_kind.items()
    }
    per_machine_s = sum(one["processor_s"] * one["tasks_per_machine"] for one in tasks.values())
    return {
        "sample_machines": SAMPLE,
        "sample_wall_s": ended_s - began_s,
        "failures": run.failures,
        "tasks": tasks,
        "processor_s_per_machine": per_machine_s,
        "night_of_200_on_two_cores_s": MACHINES * per_machine_s / 2.0,
        "recording_bytes": int(np.mean([path.stat().st_size for path in folder.rglob("*.mf4")])),
        "result_bytes": int(np.mean(files)),
    }


def diagnosis(work: Path) -> dict[str, dict[str, Any]]:
    """The friction fit of a night of one machine, in a process that has just begun, and then its diagnosis."""
    from dataclasses import replace

    from hil.fleet.file import read_fleet
    from hil.fleet.plan import plan_fleet

    folder = fleet_of(work, 1)
    file = folder / "fleet.toml"
    text = file.read_text(encoding="utf-8").replace('["check", "identify"]', '["friction", "diagnose"]')
    file.write_text(text.replace('repeats = ["shake_*"]', 'repeats = ["shake_*"]\nheld_out = ["scan"]'), encoding="utf-8")
    tasks = plan_fleet(read_fleet(file), folder / "store").tasks
    jobs = [replace(task.job, function=f"{Path(__file__).stem}:measured") for task in tasks]
    values = [outcome.value for outcome in one_by_one(jobs, threading.Event())]
    kept = ("wall_s", "processor_s", "peak_GB")
    return {
        task.kind: {"verdict": one["rows"][0]["verdict"], **{key: one[key] for key in kept}}
        for task, one in zip(tasks, values, strict=True)
    }


def simulated(tasks: dict[str, dict[str, float]], serial_s: float, diagnosis_s: float, diagnosed: int) -> dict[str, float]:
    """Efficiency by number of workers: each takes the next task as it is free, and one process hands out and keeps them one by one."""
    rng = np.random.default_rng(0)
    times = [one["processor_s"] for one in tasks.values() for _ in range(int(one["tasks_per_machine"]))] * MACHINES
    times += [diagnosis_s] * diagnosed
    times = list(rng.permutation(times) * rng.lognormal(0.0, 0.2, len(times)))
    found = {}
    for workers in (1, 2, 4, 8, 16, 32, 64, 128, 256):
        free, client_s, last = [0.0] * workers, 0.0, 0.0
        for task_s in times:
            client_s = max(client_s, heapq.heappop(free)) + serial_s
            heapq.heappush(free, client_s + task_s)
            last = max(last, client_s + task_s)
        found[str(workers)] = sum(times) / (workers * last)
    return found


def workers_killed(work: Path) -> dict[str, Any]:
    """Thirty in a hundred jobs end their worker."""
    marks = work / "marks"
    shutil.rmtree(marks, ignore_errors=True)
    marks.mkdir(parents=True)
    kill = random.Random(0).sample(range(KILLED_AMONG), round(0.3 * KILLED_AMONG))
    jobs = [
        job(f"job {number}", "killed", {"number": number, "kills": number in kill, "mark": str(marks / str(number))})
        for number in range(KILLED_AMONG)
    ]
    outcomes = list(on(2)(jobs, threading.Event()))
    right = {f"job {number}": number / 3.0 for number in range(len(jobs))}
    return {
        "jobs": len(jobs),
        "workers_killed": len(list(marks.iterdir())),
        "right": sum(right[one.name] == one.value for one in outcomes),
        "lost": len(set(right) - {one.name for one in outcomes}),
        "doubled": len(outcomes) - len({one.name for one in outcomes}),
    }


def hung_and_greedy() -> dict[str, Any]:
    """One that hangs and one that takes too much memory, among sound ones."""
    short, small = Needs(1.0, 1, 3.0), Needs(1.0, 1, 120.0)
    jobs = [job(f"sound {number}", "spin", {"seconds": 0.01}) for number in range(6)]
    jobs[3:3] = [job("hangs", "hang", needs=short), job("is greedy", "fill", needs=small)]
    found = {one.name: one for one in on(2)(jobs, threading.Event())}
    return {
        "sound": sum(not one.failure for one in found.values()),
        "named": {name: one.failure for name, one in found.items() if one.failure},
    }


def scheduler_restarted(work: Path) -> dict[str, Any]:
    """A scheduler of its own, ended in the midst of a run, and started again with new workers at the same address."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    address, told, processes = f"tcp://127.0.0.1:{port}", [], []
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}

    def start() -> None:
        common = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
        scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
        worker = ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
        worker += ["--resources", "memory=8e9 threads=1"]
        for command in (scheduler, worker, worker):
            processes.append(subprocess.Popen([sys.executable, "-m", *command], **common))

    def end() -> None:
        while processes:
            process = processes.pop()
            process.kill()
            process.wait()

    start()
    jobs = [job(f"job {number}", "spin", {"seconds": 0.05}) for number in range(40)]
    outcomes = []
    try:
        for outcome in on(0, address, told)(jobs, threading.Event()):
            outcomes.append(outcome)
            if len(outcomes) == 10:
                end()
                start()
    finally:
        end()
    names = [one.name for one in outcomes]
    return {"jobs": len(jobs), "done": sum(not one.failure for one in outcomes), "doubled": len(names) - len(set(names)), "told": told}


def disk_full(work: Path) -> dict[str, Any]:
    """A store on a file system of 200 kB, which is made larger afterwards; only root can make one."""
    store = work / "small"
    store.mkdir(parents=True, exist_ok=True)
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=100k", "tmpfs", str(store)], check=False, capture_output=True).returncode:
        return {"skipped": "only root can mount a small file system"}
    folder = fleet_of(work, 4)
    try:
        said = ""
        try:
            hil.run_fleet(folder / "fleet.toml", workers=2, store=store)
        except hil.UnusableInputError as problem:
            said = str(problem).replace(str(store), "STORE")
        kept = hil.query_fleet(store, "select count(distinct file) from results").rows[0][0]
        left = [path.name for path in store.rglob("*.tmp")]
        subprocess.run(["mount", "-o", "remount,size=10m", str(store)], check=True)
        again = hil.run_fleet(folder / "fleet.toml", workers=2, store=store)
        whole = hil.query_fleet(store, "select count(distinct file), count(*) filter (where quantity = 'failure') from results").rows[0]
        return {"said": said, "kept": kept, "drafts_left": len(left), "rerun": again.done, "results": whole[0], "failures": whole[1]}
    finally:
        subprocess.run(["umount", str(store)], check=False)


def spoilt(work: Path) -> dict[str, Any]:
    """Recordings cut, overwritten, emptied and without a date, among sound ones; and two runs at once."""
    folder = fleet_of(work, 4)
    of = [folder / f"recordings/machine_{number:03d}/2026-11-27" for number in range(4)]
    data = (of[0] / "scan.mf4").read_bytes()
    (of[0] / "scan.mf4").write_bytes(data[: len(data) // 2])
    (of[1] / "scan.mf4").write_bytes(random.Random(0).randbytes(len(data)))
    (of[2] / "scan.mf4").write_bytes(b"")
    (folder / "recordings/machine_003/scan.mf4").write_bytes(data)
    command = [sys.executable, "-m", "hil", "fleet", "run", str(folder / "fleet.toml"), "--workers", "1"]
    runs = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for _ in range(2)]
    statuses = [run.wait() for run in runs]
    status = hil.fleet_status(folder / "fleet.toml")
    asked = "select count(distinct file), count(distinct machine || experiment || task || recording_hashes[1]) from results"
    files, distinct = hil.query_fleet(status.store, asked).rows[0]
    said = [line.replace(str(folder), "FLEET") for line in (*status.failures, *status.wrong)]
    return {"tasks": 16, "results": files, "distinct": distinct, "exit_statuses": statuses, "named": said}


def cancelled(work: Path) -> dict[str, Any]:
    """A run that the key ends in its midst, as at a terminal: the whole group of processes has the signal."""
    folder = fleet_of(work, 4)
    store = folder / "fleet-results"
    command = [sys.executable, "-m", "hil", "fleet", "run", str(folder / "fleet.toml"), "--workers", "2"]
    run = subprocess.Popen(command, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    while len(list(store.rglob("*.parquet"))) < 4 and run.poll() is None:
        time.sleep(0.1)
    began_s = time.perf_counter()
    os.killpg(run.pid, signal.SIGINT)
    said, _ = run.communicate()
    ended_s = time.perf_counter()
    again = hil.run_fleet(folder / "fleet.toml", workers=2)
    return {
        "exit_status": run.returncode,
        "said": [line for line in said.splitlines() if not line.startswith("...")][-1],
        "seconds": ended_s - began_s,
        "tracebacks": said.count("Traceback"),
        "kept": again.present,
        "rerun": again.done,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("cost", "overhead", "diagnosis", "faults"))
    parser.add_argument("--work", type=Path, required=True, help="folder of recordings and stores")
    parser.add_argument("--json", type=Path, required=True, help="file of the results")
    options = parser.parse_args()
    found: dict[str, Any] = json.loads(options.json.read_text(encoding="utf-8")) if options.json.exists() else {}

    def keep(name: str, value: Any) -> None:
        found[name] = value
        print(name, json.dumps(value, indent=1), flush=True)
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")

    if options.what in ("cost", "overhead"):
        keep("overhead", {"own_processor": os.sched_getscheduler(0) != os.SCHED_OTHER, **overhead(options.work)})
    if options.what == "cost":
        keep("load_average", os.getloadavg()[0])
        keep("workers", two_beside_one())
        keep("night", night(options.work))
    if options.what == "diagnosis":
        keep("diagnosis", diagnosis(options.work))
    if "night" in found and "overhead" in found:
        serial_s = 1e-3 * found["overhead"]["dask_client_and_scheduler_processor_ms"]
        keep("simulated_efficiency", simulated(found["night"]["tasks"], serial_s, 0.0, 0))
        if "diagnosis" in found:
            each_s = found["diagnosis"]["diagnose"]["processor_s"]
            keep("simulated_efficiency_all_diagnosed", simulated(found["night"]["tasks"], serial_s, each_s, MACHINES))
    if options.what != "faults":
        return
    keep("workers_killed", workers_killed(options.work))
    keep("hung_and_greedy", hung_and_greedy())
    keep("scheduler_restarted", scheduler_restarted(options.work))
    keep("disk_full", disk_full(options.work))
    keep("spoilt", spoilt(options.work))
    keep("cancelled", cancelled(options.work))


if __name__ == "__main__":
    main()
