"""Faults of the bench's own processes: named here, made only where loop, I/O poller and recorder are processes of their own."""

from __future__ import annotations

from virtual_bus.faults.fault import FaultKind, Parameter

_FOR = Parameter("pause", "s", 2.0, 0.0, 600.0, "how long it is stopped")
KINDS = (
    FaultKind("loop_stopped", "The sample loop's process is stopped for a while.", "process", "process", None, (_FOR,), ()),
    FaultKind("loop_killed", "The sample loop's process is killed.", "process", "process", None, (), ()),
    FaultKind("io_poller_killed", "The I/O poller's process is killed.", "process", "process", None, (), ()),
    FaultKind("loop_and_io_poller_killed", "The processes of loop and I/O poller are killed at once.", "process", "process", None, (), ()),
    FaultKind("recorder_stopped", "The recorder's process is stopped for a while.", "process", "process", None, (_FOR,), ()),
    FaultKind("recorder_killed", "The recorder's process is killed.", "process", "process", None, (), ()),
)
