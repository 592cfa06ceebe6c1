"""Checks of a Linux computer, as pure functions of its /proc and /sys trees below a root folder; elsewhere nothing is known."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from hil.bench.clock import SPIN_S
from hil.doctor.finding import Finding, number_of, text_of, unknown
from hil.processes.real_time import FIFO_PRIORITY, Scheduling

NO_PROC = "this system has no such file, so nothing says"
LIMITS = f"give the user `rtprio {FIFO_PRIORITY + 1}` and `memlock unlimited` in /etc/security/limits.conf and log in again"
GOOD_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page")
"""Clock sources that are read without a system call; the loop reads one some thousand times while it spins."""
LEAST_RT_SHARE = 0.9
"""Share of a processor that real-time processes may take (sched_rt_runtime_us over sched_rt_period_us); the kernel's default is 0.95."""
STOLEN_LOOK, STOLEN_BAD = 0.001, 0.02
"""Shares of processor time taken by the hypervisor. Two percent are five ticks of a second at 256 Hz."""
MOST_USED_MEMORY = 0.9
LEAST_SHARED_BYTES = 64 << 20
"""Free shared memory: the blocks of I/O and supervisor take kilobytes, the emulated panel's images some megabytes each."""
BUSY_PROCESSORS = 2
"""Loop and supervisor; the recorder takes what is left over."""


def kernel(root: Path) -> Finding:
    """Say which kernel it is and how it preempts."""
    release, build = text_of(root / "proc/sys/kernel/osrelease"), text_of(root / "proc/sys/kernel/version")
    if release is None or build is None:
        return unknown("kernel", NO_PROC)
    mode = re.search(r"\bpreempt=(\w+)", text_of(root / "proc/cmdline") or "")
    if number_of(root / "sys/kernel/realtime") == 1 or "PREEMPT_RT" in build:
        return Finding("ok", "kernel", f"{release}, PREEMPT_RT")
    if (mode and mode[1] == "full") or re.search(r"\bPREEMPT\b", build):
        return Finding("ok", "kernel", f"{release}, preemptible (PREEMPT)")
    kind = "PREEMPT_DYNAMIC" if "PREEMPT_DYNAMIC" in build else "not preemptible"
    how = f", preempt={mode[1]}" if mode else ""
    return Finding("look", "kernel", f"{release}, {kind}{how}", "boot with preempt=full, or install a PREEMPT_RT kernel")


def scheduler(root: Path, granted: Scheduling, real_bus: bool) -> Finding:
    """Say whether SCHED_FIFO is granted, and what the limits are; on a real bus the loop should not go without."""
    limit = _limit(root, "Max realtime priority")
    said = "" if limit is None else f", limit rtprio {limit}"
    if not granted.scheduler.startswith("SCHED_FIFO"):
        if limit is None:
            return unknown("scheduler", "SCHED_FIFO is not granted, and this system does not say why")
        return Finding("bad" if real_bus else "look", "scheduler", f"SCHED_FIFO {FIFO_PRIORITY} is refused{said}", LIMITS)
    period, runtime = (number_of(root / f"proc/sys/kernel/sched_rt_{name}_us") for name in ("period", "runtime"))
    if period and runtime is not None and 0 <= runtime < LEAST_RT_SHARE * period:
        found = f"{granted.scheduler} is granted for {runtime / period:.0%} of the time alone"
        return Finding("look", "scheduler", found, "sysctl kernel.sched_rt_runtime_us=950000")
    return Finding("ok", "scheduler", f"{granted.scheduler} is granted")


def locked_memory(root: Path, granted: Scheduling) -> Finding:
    """Say whether memory can be locked."""
    limit = _limit(root, "Max locked memory")
    if granted.memory_locked:
        return Finding("ok", "locked memory", "mlockall is granted")
    if limit is None:
        return unknown("locked memory", "mlockall is not granted, and this system does not say why")
    size = limit if limit == "unlimited" else f"{int(limit) >> 20} MiB"
    return Finding("look", "locked memory", f"mlockall is refused, limit memlock {size}", LIMITS)


def processors(root: Path) -> Finding:
    """Say how many processors there are, which are isolated and which this process may use."""
    online = cpu_list(text_of(root / "sys/devices/system/cpu/online"))
    if not online:
        return unknown("processors", NO_PROC)
    isolated = cpu_list(text_of(root / "sys/devices/system/cpu/isolated"))
    status = re.search(r"^Cpus_allowed_list:\s*(\S+)", text_of(root / "proc/self/status") or "", re.MULTILINE)
    allowed = (cpu_list(status[1]) & online) if status else online
    found = f"{len(online)} online, {len(isolated) or 'none'} isolated, {len(allowed)} for this process"
    if len(allowed) < BUSY_PROCESSORS:
        advice = f"loop and supervisor need {BUSY_PROCESSORS} processors: use a computer with more, or widen the affinity (taskset)"
        return Finding("bad", "processors", found, advice)
    if isolated and not allowed & isolated:
        return Finding("look", "processors", found, "the isolated ones stay idle: start with `taskset -c` on one of them")
    if len(allowed) == BUSY_PROCESSORS:
        return Finding("look", "processors", found, "nothing is left for kernel threads and recorder; use a computer with four, or idle it")
    return Finding("ok", "processors", found)


def governor(root: Path) -> Finding:
    """Say how the processors' frequency is governed."""
    files = (root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    found = {text for path in files if (text := text_of(path))}
    if not found:
        return unknown("frequency governor", "this kernel governs no frequency; firmware or a hypervisor may")
    said = ", ".join(sorted(found))
    if found == {"performance"}:
        return Finding("ok", "frequency governor", said)
    return Finding("look", "frequency governor", said, "`cpupower frequency-set -g performance`")


def clock_source(root: Path) -> Finding:
    """Say which clock the kernel reads."""
    folder = root / "sys/devices/system/clocksource/clocksource0"
    source = text_of(folder / "current_clocksource")
    if not source:
        return unknown("clock source", NO_PROC)
    if source in GOOD_CLOCKS:
        return Finding("ok", "clock source", source)
    others = [name for name in (text_of(folder / "available_clocksource") or "").split() if name in GOOD_CLOCKS]
    advice = f"boot with clocksource={others[0]}" if others else "reading it takes a microsecond or more; firmware may offer tsc"
    return Finding("look", "clock source", source, advice)


def timer_slack(root: Path) -> Finding:
    """Say by how much the kernel may put off this process's wake-ups without a real-time scheduler."""
    slack_ns = number_of(root / "proc/self/timerslack_ns")
    if slack_ns is None:
        return unknown("timer slack", NO_PROC)
    found = f"{slack_ns / 1e3:g} us"
    if slack_ns > 0.5 * SPIN_S * 1e9:
        return Finding("look", "timer slack", found, f"at most {0.5e6 * SPIN_S:g} us: the loop wakes {1e6 * SPIN_S:g} us before a tick")
    return Finding("ok", "timer slack", found)


def load(root: Path) -> Finding:
    """Say what else the computer does."""
    online, words = cpu_list(text_of(root / "sys/devices/system/cpu/online")), (text_of(root / "proc/loadavg") or "").split()
    if not online or not words:
        return unknown("load", NO_PROC)
    average = float(words[0])
    found = f"{average:.2f} of {len(online)} processors in the last minute"
    if average > len(online) - 0.5:
        return Finding("look", "load", found, "end other work: the loop, its supervisor and its recorder need processors of their own")
    return Finding("ok", "load", found)


def processor_times(root: Path) -> tuple[int, int] | None:
    """Return processor time [jiffies] taken by the hypervisor, and all there was, since the start; None where nothing says."""
    cells = (text_of(root / "proc/stat") or "").split("\n")[0].split()[1:9]
    return (int(cells[7]), sum(map(int, cells))) if len(cells) == 8 else None


def stolen(before: tuple[int, int] | None, after: tuple[int, int] | None) -> Finding:
    """Say how much processor time the hypervisor took between two looks at `processor_times`."""
    if before is None or after is None:
        return unknown("stolen time", NO_PROC)
    share = (after[0] - before[0]) / max(after[1] - before[1], 1)
    found = f"{share:.2%} of the processors' time went to other virtual machines"
    if share >= STOLEN_LOOK:
        advice = "run on a computer of its own, or give this virtual machine processors of its own"
        return Finding("bad" if share >= STOLEN_BAD else "look", "stolen time", found, advice)
    return Finding("ok", "stolen time", found)


def swap(root: Path, granted: Scheduling) -> Finding:
    """Say whether there is swap, and whether the loop could be swapped out."""
    table, memory = text_of(root / "proc/swaps"), text_of(root / "proc/meminfo")
    if table is None or memory is None:
        return unknown("swap", NO_PROC)
    values = {name: int(value) for name, value in re.findall(r"^(\w+):\s*(\d+) kB", memory, re.MULTILINE)}
    used = 1.0 - values.get("MemAvailable", 0) / max(values.get("MemTotal", 0), 1)
    areas = len(table.splitlines()) - 1
    found = f"{areas or 'no'} swap area{'s' if areas > 1 else ''}, {used:.0%} of memory in use"
    if areas > 0 and not granted.memory_locked:
        return Finding("look", "swap", found, "`swapoff -a`, or let memory be locked: see there")
    if used > MOST_USED_MEMORY:
        return Finding("look", "swap", found, "end other programs, or the kernel will end one")
    return Finding("ok", "swap", found)


def shared_memory(folder: Path, free_bytes: Callable[[Path], int | None]) -> Finding:
    """Say whether I/O, supervisor and panel find memory to share with the loop; `free_bytes` says how much a folder's disk has."""
    free = free_bytes(folder)
    if free is None:
        return unknown("shared memory", f"{folder} is not there")
    found = f"{free >> 20} MiB free in {folder}"
    if free < LEAST_SHARED_BYTES:
        return Finding("bad", "shared memory", found, f"free {LEAST_SHARED_BYTES >> 20} MiB (docker: --shm-size)")
    return Finding("ok", "shared memory", found)


def cpu_list(text: str | None) -> frozenset[int]:
    """Return the processors of the kernel's notation, such as `0-2,5`."""
    found: set[int] = set()
    for first, last in re.findall(r"(\d+)(?:-(\d+))?", text or ""):
        found.update(range(int(first), int(last or first) + 1))
    return frozenset(found)


def _limit(root: Path, name: str) -> str | None:
    """Return the soft limit of this process."""
    found = re.search(rf"^{name}\s+(\S+)", text_of(root / "proc/self/limits") or "", re.MULTILINE)
    return found[1] if found else None
