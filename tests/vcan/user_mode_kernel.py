"""A second Linux kernel as an ordinary process, for machines whose own kernel has no CAN: the bus tests run in it over a real vcan0.

Debian's `user-mode-linux` ships the kernel with the modules can, can-raw, vcan and slcan. The host's file system is its root, so the same
Python environment serves. It has one processor, and a system call takes ten microseconds and more: its clock is slowed while it works
(slow_clock.c). Behaviour is proven there, timing is not.
"""

from __future__ import annotations

import fcntl
import os
import shlex
import shutil
import signal
import socket
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

INTERFACE = "vcan0"
KERNEL = "linux.uml"
PACKAGES = "user-mode-linux can-utils kmod iproute2 gcc libc6-dev"

MEMORY = "4G"
"""An emulator, a loop with its observer and a recorder, each a process with compiled code, and the recordings' file system. With 2 GB a
loop that had to compile its plant in there was killed."""

BOOT_ALLOWANCE_S = 60.0
"""Booting takes four to eight seconds on a shared machine; the rest is for a loaded one."""

PRIORITY = 60
"""Of SCHED_FIFO, above the benches of other tests: the kernel inside has the clock outside, and the machine's time-outs mean it."""

NICENESS = -15
"""Where real-time scheduling is refused."""

LOCK = Path("/var/tmp/isocenter-vcan.lock")

_INIT = """#!/bin/sh
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mkdir -p /dev/pts /dev/shm
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
mount -t tmpfs tmpfs /run
modules=/usr/lib/uml/modules/$(uname -r)/kernel
for module in net/can/can net/can/can-raw net/can/can-bcm drivers/net/can/dev/can-dev drivers/net/can/vcan drivers/net/can/slcan/slcan; do
    insmod $modules/$module.ko
done
ip link set lo up
ip link add dev {interface} type vcan
ip link set {interface} up
mkdir -p /run/tmp
export XDG_RUNTIME_DIR=/run TMPDIR=/run/tmp {environment}
cd {folder}
{command} > {result}/output 2>&1 < /dev/null
echo $? > {result}/status.tmp
mv {result}/status.tmp {result}/status
sync
halt -f
"""


@dataclass(frozen=True)
class Outcome:
    """What a command left behind: its exit status (None when the kernel never came that far) and what it printed."""

    status: int | None
    output: str
    console: str


def vcan_here() -> str:
    """'' when this kernel's vcan0 can be used (it is brought up if we may), else why not."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (AttributeError, OSError) as error:
        return f"this kernel has no CAN ({error})"
    if not Path(f"/sys/class/net/{INTERFACE}").exists():
        subprocess.run(["ip", "link", "add", "dev", INTERFACE, "type", "vcan"], capture_output=True, check=False)
        subprocess.run(["ip", "link", "set", INTERFACE, "up"], capture_output=True, check=False)
    state = Path(f"/sys/class/net/{INTERFACE}/flags")
    if not state.exists() or not int(state.read_text(), 16) & 1:
        return f"{INTERFACE} is not up and we may not bring it up"
    return ""


def kernel_missing() -> str:
    """'' when a user-mode kernel can be booted here, else what is missing."""
    missing = [tool for tool in (KERNEL, "ip", "insmod", "candump", "cc") if shutil.which(tool) is None]
    if missing:
        return f"{', '.join(missing)} not found (as root: apt-get install {PACKAGES})"
    if os.geteuid() != 0:
        return "booting a user-mode kernel on the host's file system needs root"
    return ""


def _more_registers_than_it_knows() -> bool:
    return "amx_tile" in Path("/proc/cpuinfo").read_text(encoding="utf-8")


def _environment(folder: Path) -> dict[str, str]:
    """Environment of the kernel's process: a clock that it can follow, and whole registers where the processor has more than it knows."""
    sources = ["slow_clock.c", *(["whole_registers.c"] if _more_registers_than_it_knows() else [])]
    libraries = [folder / f"{name}.so" for name in sources]
    for name, library in zip(sources, libraries, strict=True):
        subprocess.run(
            ["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(Path(__file__).with_name(name)), "-ldl"],
            check=True,
        )
    return os.environ | {"LD_PRELOAD": ":".join(map(str, libraries))}


def _take_one_processor() -> None:
    """Give this process a processor and a priority; its children inherit both.

    Every system call inside is a switch between two processes here, which takes four times as long between two processors that others use.
    """
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)


def run_in_user_mode_kernel(command: Sequence[str], environment: Mapping[str, str], timeout_s: float) -> Outcome:
    """Boot, run `command` in the current folder, halt.

    Parameters
    ----------
    command : sequence of str
        Program and arguments; paths as on the host.
    environment : mapping
        Variables set for it, beside XDG_RUNTIME_DIR=/run.
    timeout_s : float
        For the command; booting has an allowance of its own.

    Returns
    -------
    Outcome
    """
    with LOCK.open("w") as lock, tempfile.TemporaryDirectory(prefix="isocenter-vcan-", dir="/var/tmp") as folder:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two kernels would share the one processor
        script = Path(folder) / "init"
        script.write_text(
            _INIT.format(
                interface=INTERFACE,
                environment=" ".join(f"{name}={shlex.quote(value)}" for name, value in environment.items()),
                folder=shlex.quote(os.getcwd()),
                command=shlex.join(command),
                result=folder,
            ),
            encoding="utf-8",
        )
        script.chmod(0o755)
        boot = [
            KERNEL,
            f"mem={MEMORY}",
            "rootfstype=hostfs",
            "rootflags=/",
            "rw",
            f"init={script}",
            "con=null",
            "con0=fd:0,fd:1",
        ]
        with subprocess.Popen(
            boot,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=_environment(Path(folder)),
            start_new_session=True,
            preexec_fn=_take_one_processor,
        ) as kernel:
            try:
                console = kernel.communicate(timeout=timeout_s + BOOT_ALLOWANCE_S)[0].decode(errors="replace")
            except subprocess.TimeoutExpired:
                os.killpg(kernel.pid, signal.SIGKILL)  # the kernel's own processes are processes here, and would go on
                console = kernel.communicate()[0].decode(errors="replace") + f"\nstill running after {timeout_s:.0f} s"
        status, output = Path(folder) / "status", Path(folder) / "output"
        return Outcome(
            int(status.read_text()) if status.exists() else None,
            output.read_text(errors="replace") if output.exists() else "",
            console,
        )
