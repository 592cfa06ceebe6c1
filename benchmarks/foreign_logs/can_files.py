"""Logs of CAN buses, by python-can's writers, by the converters of can-utils, and by candump on a real vcan."""

from __future__ import annotations

import functools
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import can
from can.io.trc import TRCFileVersion

from foreign_logs.known import ROWS, Foreign, frames, of_the_bus

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

PDOS = "the PDOs' 6040, which no channel has"
TICK_s = 1e-9
"""With a machine the rows are its ticks."""

CANDUMP = {
    "a": ["-t", "a"], "d": ["-t", "d"], "z": ["-t", "z"], "A": ["-t", "A"], "none": [], "x": ["-x", "-t", "z"],
    "letters": ["-a", "-t", "a"],
    "colours": ["-c", "-c", "-t", "z"], "L": ["-L"], "errors": ["-e", "-t", "A", "any,0:0,#FFFFFFFF"],
    "swapped": ["-S", "-t", "z"], "binary": ["-i", "-t", "z"],
}  # fmt: skip
"""Name -> options of candump; an interface without filters of its own comes behind them."""


def messages(others: bool = False) -> list[can.Message]:
    """Return the frames as python-can's; `others` adds what no machine can use, 0.05 ms behind SYNCs."""
    found = [
        can.Message(timestamp=one.time_s, arbitration_id=one.can_id, data=one.data, is_extended_id=False, channel=0) for one in frames()
    ]
    if others:
        kinds = [
            {"arbitration_id": 0x123, "is_fd": True, "bitrate_switch": True, "data": bytes(range(48)), "is_extended_id": False},
            {"arbitration_id": 0x18FF1234, "is_extended_id": True, "data": b"\1\2\3"},
            {"arbitration_id": 0x701, "is_remote_frame": True, "dlc": 1, "is_extended_id": False},
            {"is_error_frame": True, "is_extended_id": False},
        ]
        start_s = frames()[0].time_s
        found += [can.Message(timestamp=start_s + (10 * k + 5) / 256 + 5e-5, channel=0, **kind) for k, kind in enumerate(kinds)]
        found.sort(key=lambda message: message.timestamp)
    return found


def logged(suffix: str, others: bool = False, **options: object) -> Callable[[Path], Path]:
    """Return a maker that lets the logger of python-can for a suffix write."""

    def make(folder: Path) -> Path:
        path = folder / f"bus{suffix}"
        with can.Logger(path, **options) as logger:
            for message in messages(others):
                logger(message)
            while getattr(logger, "num_frames", len(frames())) < len(frames()):  # the one of SQLite drops what waits when it is closed
                time.sleep(0.05)
        return path

    return make


def trc_1_0(folder: Path) -> Path:
    """Write TRC 1.0, which has no line of its version."""
    path = folder / "bus.trc"
    with can.TRCWriter(path) as writer:
        writer.file_version = TRCFileVersion.V1_0
        for message in messages():
            writer(message)
    return path


def piped(command: Sequence[str], suffix: str, source: str = ".log") -> Callable[[Path], Path]:
    """Return a maker that pipes a log of python-can through a program of can-utils."""

    def make(folder: Path) -> Path:
        raw, path = logged(source)(folder), folder / f"piped{suffix}"
        channel = ["can0"] if command[0] == "log2asc" else []
        done = subprocess.run([*command, *channel], input=raw.read_bytes(), capture_output=True, check=True)
        path.write_bytes(done.stdout)
        return path

    return make


@functools.cache
def dumped() -> dict[str, bytes] | str:
    """Return what candump printed with each of its options while canplayer sent the frames over vcan; or why not."""
    from vcan.user_mode_kernel import kernel_missing, run_in_user_mode_kernel, vcan_here  # of the tests

    if missing := vcan_here() and kernel_missing():
        return missing
    import tempfile

    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        folder = Path(name)
        text = logged(".log")(folder).read_text()
        lines = [line.replace(" can0 ", " vcan0 ", 1) for line in text.splitlines()]
        (folder / "sent.log").write_text("\n".join(lines) + "\n")
        script = ["cd " + name]
        for form, options in {**CANDUMP, "l": ["-l"]}.items():
            words = " ".join(f"'{word}'" for word in [*options, *([] if form == "errors" else ["vcan0"])])
            script.append(
                f"candump -r 8000000 -n {4 * ROWS} -T 3000 {words} > {form}.log & sleep 1; canplayer -t -g 1 -I sent.log vcan0=vcan0; wait"
            )
        (folder / "script").write_text("\n".join(script) + "\n")
        command = ["bash", str(folder / "script")]
        if vcan_here():
            run_in_user_mode_kernel(command, {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin"}, 240.0)
        else:
            subprocess.run(command, check=False, timeout=240.0)
        found = {form: (folder / f"{form}.log").read_bytes() for form in CANDUMP}
        filed = next(iter(folder.glob("candump-*.log")), None)
        return found | {"l": filed.read_bytes() if filed else b""}


def candump(form: str) -> Callable[[Path], Path]:
    """Return a maker of what candump prints or, with `l`, files."""

    def make(folder: Path) -> Path:
        printed = dumped()
        if isinstance(printed, str):
            raise ModuleNotFoundError(printed)
        path = folder / "bus.log"
        path.write_bytes(printed[form])
        if len(printed[form].splitlines()) != 4 * ROWS:
            raise ValueError(f"candump printed {len(printed[form].splitlines())} lines of {4 * ROWS} frames")
        return path

    return make


def _of_bus(name: str, kind: str, tool: str, make: Callable[[Path], Path], **more: object) -> Foreign:
    return Foreign(name, kind, tool, make, of_the_bus(), **{"left": (PDOS,), "time_within_s": TICK_s} | more)


OTHERS = (PDOS, "1 error frame", "1 CAN FD frame", "1 remote frame", "1 frame with 29-bit identifiers")
FILES = [
    _of_bus("asc", "ASC", "python-can", logged(".asc")),
    _of_bus("asc-others", "ASC", "python-can", logged(".asc", others=True), left=OTHERS),
    _of_bus("trc-2.1", "TRC", "python-can", logged(".trc")),
    _of_bus("trc-1.0", "TRC", "python-can", trc_1_0),
    _of_bus("blf", "BLF", "python-can", logged(".blf")),
    _of_bus("blf-uncompressed", "BLF", "python-can", logged(".blf", compression_level=0)),
    _of_bus("blf-others", "BLF", "python-can", logged(".blf", others=True), left=OTHERS),
    _of_bus("candump-python-can", "candump", "python-can", logged(".log")),
    _of_bus("candump-others", "candump", "python-can", logged(".log", others=True), left=OTHERS),
    _of_bus("frames-csv", "CAN frames in CSV", "python-can", logged(".csv")),
    _of_bus("frames-csv-others", "CAN frames in CSV", "python-can", logged(".csv", others=True), left=OTHERS),
    _of_bus("frames-sqlite", "CAN frames in SQLite", "python-can", logged(".db")),
    _of_bus("frames-mf4", "CAN frames in MF4", "python-can", logged(".mf4")),
    _of_bus("frames-mf4-others", "CAN frames in MF4", "python-can", logged(".mf4", others=True), left=OTHERS),
    _of_bus("asc-log2asc", "ASC", "can-utils", piped(["log2asc"], ".asc")),
    _of_bus("asc-log2asc-4", "ASC", "can-utils", piped(["log2asc", "-4", "-n"], ".asc")),
    _of_bus("asc-log2asc-fd", "ASC", "can-utils", piped(["log2asc", "-f"], ".asc")),
    _of_bus("candump-asc2log", "candump", "can-utils", piped(["asc2log"], ".log", ".asc")),
    _of_bus("candump-log2long", "candump", "can-utils", piped(["log2long"], ".log")),
    *(
        _of_bus(f"candump-{form}", "candump", "can-utils", candump(form), noted=("differences",) if form == "d" else ())
        for form in (*CANDUMP, "l")
    ),
]  # fmt: skip
