"""What a Dask worker of a local cluster does when it starts: Ctrl-C is the command's own to answer."""

from __future__ import annotations

import signal


def dask_setup(worker: object) -> None:
    """Ignore the key that cancels the run: the command ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
