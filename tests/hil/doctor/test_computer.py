"""What the checks of a computer say of trees of /proc and /sys that are made up."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hil.doctor import computer, storage
from hil.doctor.finding import Finding
from hil.processes.real_time import Scheduling

FIFO = Scheduling("SCHED_FIFO 50", True)
DEFAULT = Scheduling("default scheduler", False)
Tree = Callable[..., Path]


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    """A function that writes files below a root and returns it."""

    def write(files: dict[str, str]) -> Path:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n")
        return tmp_path

    return write


OSRELEASE, VERSION = "proc/sys/kernel/osrelease", "proc/sys/kernel/version"


@pytest.mark.parametrize(
    ("files", "level", "word"),
    [
        ({VERSION: "#1 SMP PREEMPT_RT Mon"}, "ok", "PREEMPT_RT"),
        ({VERSION: "#1 SMP", "sys/kernel/realtime": "1"}, "ok", "PREEMPT_RT"),
        ({VERSION: "#1 SMP PREEMPT_DYNAMIC"}, "look", "preempt=full"),
        ({VERSION: "#1 SMP PREEMPT_DYNAMIC", "proc/cmdline": "quiet preempt=full"}, "ok", "preemptible"),
        ({VERSION: "#1 SMP PREEMPT_DYNAMIC", "proc/cmdline": "preempt=none"}, "look", "preempt=none"),
        ({VERSION: "#1 SMP"}, "look", "not preemptible"),
    ],
)
def test_a_kernel_is_judged_by_how_it_preempts(tree: Tree, files: dict[str, str], level: str, word: str) -> None:
    found = computer.kernel(tree({OSRELEASE: "6.1.0", **files}))
    assert found.level == level
    assert word in str(found)


LIMITS = "Limit Soft Hard Units\nMax locked memory         8388608     8388608    bytes\nMax realtime priority     0     0"


def test_a_refused_scheduler_is_bad_on_a_real_bus_alone_and_says_what_to_grant(tree: Tree) -> None:
    root = tree({"proc/self/limits": LIMITS})
    found = computer.scheduler(root, DEFAULT, real_bus=True)
    assert found.level == "bad"
    assert "limit rtprio 0" in found.found
    assert "rtprio 51" in found.advice
    assert computer.scheduler(root, DEFAULT, real_bus=False).level == "look"
    assert computer.scheduler(root, FIFO, real_bus=True).level == "ok"
    memory = computer.locked_memory(root, DEFAULT)
    assert memory.level == "look"
    assert "8 MiB" in memory.found


@pytest.mark.parametrize(("runtime", "level"), [("950000", "ok"), ("-1", "ok"), ("500000", "look")])
def test_real_time_processes_that_are_throttled_are_found(tree: Tree, runtime: str, level: str) -> None:
    root = tree({"proc/sys/kernel/sched_rt_period_us": "1000000", "proc/sys/kernel/sched_rt_runtime_us": runtime})
    assert computer.scheduler(root, FIFO, real_bus=True).level == level


CPU = "sys/devices/system/cpu"


@pytest.mark.parametrize(
    ("online", "isolated", "allowed", "level", "word"),
    [
        ("0-7", "", "0-7", "ok", "8 online, none isolated, 8 for"),
        ("0-7", "6-7", "0-5", "look", "isolated ones stay idle"),
        ("0-7", "6-7", "5-7", "ok", "2 isolated, 3 for"),
        ("0-1", "", "0-1", "look", "2 online"),
        ("0-7", "", "3", "bad", "1 for this process"),
        ("0", "", "0-127", "bad", "1 online"),
    ],
)
def test_processors_are_counted_as_this_process_may_use_them(
    tree: Tree, online: str, isolated: str, allowed: str, level: str, word: str
) -> None:
    root = tree({f"{CPU}/online": online, f"{CPU}/isolated": isolated, "proc/self/status": f"Name:\tx\nCpus_allowed_list:\t{allowed}"})
    found = computer.processors(root)
    assert found.level == level
    assert word in str(found)


def test_one_processor_that_saves_power_is_found(tree: Tree) -> None:
    root = tree({f"{CPU}/cpu0/cpufreq/scaling_governor": "performance"})
    assert computer.governor(root).level == "ok"
    found = computer.governor(tree({f"{CPU}/cpu11/cpufreq/scaling_governor": "powersave"}))
    assert found.level == "look"
    assert found.found == "performance, powersave"


CLOCK = "sys/devices/system/clocksource/clocksource0"


def test_a_slow_clock_is_found_and_a_better_one_named(tree: Tree) -> None:
    assert computer.clock_source(tree({f"{CLOCK}/current_clocksource": "tsc"})).level == "ok"
    root = tree({f"{CLOCK}/current_clocksource": "hpet", f"{CLOCK}/available_clocksource": "hpet acpi_pm tsc"})
    found = computer.clock_source(root)
    assert (found.level, found.advice) == ("look", "boot with clocksource=tsc")


@pytest.mark.parametrize(("nanoseconds", "level"), [("50000", "ok"), ("1000000", "look")])
def test_timer_slack_may_not_reach_the_spin_before_a_tick(tree: Tree, nanoseconds: str, level: str) -> None:
    assert computer.timer_slack(tree({"proc/self/timerslack_ns": nanoseconds})).level == level


@pytest.mark.parametrize(("average", "level"), [("0.40", "ok"), ("3.80", "look")])
def test_a_busy_computer_is_found(tree: Tree, average: str, level: str) -> None:
    assert computer.load(tree({f"{CPU}/online": "0-3", "proc/loadavg": f"{average} 1 1 1/2 3"})).level == level


@pytest.mark.parametrize(("taken", "level"), [(0, "ok"), (10, "look"), (300, "bad")])
def test_time_that_the_hypervisor_takes_between_two_looks_counts(tree: Tree, taken: int, level: str) -> None:
    before = computer.processor_times(tree({"proc/stat": "cpu  1000 0 0 90000 0 0 0 777 0 0\ncpu0 1 1"}))
    after = computer.processor_times(tree({"proc/stat": f"cpu  1000 0 0 {95000 - taken} 0 0 0 {777 + taken} 0 0\ncpu0 1 1"}))
    assert computer.stolen(before, after).level == level


@pytest.mark.parametrize(
    ("areas", "available", "granted", "level"),
    [(0, 60, DEFAULT, "ok"), (1, 60, DEFAULT, "look"), (1, 60, FIFO, "ok"), (0, 5, FIFO, "look")],
)
def test_swap_matters_unless_memory_is_locked(tree: Tree, areas: int, available: int, granted: Scheduling, level: str) -> None:
    table = "\n".join(["Filename Type Size Used Priority", *["/dev/sda2 partition 9 0 -2"] * areas])
    root = tree({"proc/swaps": table, "proc/meminfo": f"MemTotal:  100 kB\nMemFree: 1 kB\nMemAvailable: {available} kB"})
    assert computer.swap(root, granted).level == level


def test_shared_memory_as_small_as_a_containers_is_found(tmp_path: Path) -> None:
    assert computer.shared_memory(tmp_path, lambda folder: 1 << 30).level == "ok"
    assert computer.shared_memory(tmp_path, lambda folder: 32 << 20).level == "bad"
    assert computer.shared_memory(tmp_path / "none", storage.free_bytes).level == "not known"


@pytest.mark.parametrize(
    ("speed", "free", "level"),
    [(100e6, 1e12, "ok"), (0.5e6, 1e12, "look"), (100e6, 0.1e6 * 1800, "look"), (0.05e6, 1e12, "bad"), (100e6, 0.1e6 * 60, "bad")],
)
def test_a_disk_is_judged_by_what_the_rows_take(tmp_path: Path, speed: float, free: float, level: str) -> None:
    assert storage.disk(tmp_path, 0.1e6, speed, int(free)).level == level


def test_a_measured_disk_keeps_nothing(tmp_path: Path) -> None:
    assert storage.written_bytes_s(tmp_path) > 0.0
    assert list(tmp_path.iterdir()) == []
    assert storage.disk(tmp_path, 1e5, None, None).level == "bad"


CHECKS: list[Callable[[Path], Finding]] = [
    computer.kernel,
    lambda root: computer.scheduler(root, DEFAULT, real_bus=True),
    lambda root: computer.locked_memory(root, DEFAULT),
    computer.processors,
    computer.governor,
    computer.clock_source,
    computer.timer_slack,
    computer.load,
    lambda root: computer.stolen(computer.processor_times(root), computer.processor_times(root)),
    lambda root: computer.swap(root, DEFAULT),
]


@pytest.mark.parametrize("check", CHECKS)
def test_where_the_system_says_nothing_nothing_is_claimed(tmp_path: Path, check: Callable[[Path], Finding]) -> None:
    assert check(tmp_path).level == "not known"
