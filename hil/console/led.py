"""A command of `isocenter` on a lead: it is stopped, motors first, when whoever holds the lead lets go of it, or is gone.

`python -m hil.console.led LEAD ARGUMENTS...`, where LEAD is the descriptor of a pipe to which nobody writes. Its end is a Ctrl-C: the loop
stops the motors at the next tick. The thread that waits for it sleeps in the kernel and takes no time from the loop.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading


def stop_when_let_go(lead: int) -> None:
    """Wait for the end of the lead, then interrupt this process."""
    while os.read(lead, 1):
        pass
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    threading.Thread(target=stop_when_let_go, args=(int(sys.argv.pop(1)),), daemon=True).start()
    runpy.run_module("hil", run_name="__main__", alter_sys=True)
