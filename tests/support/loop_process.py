"""A loop to be killed: records rows in a process of its own and says over standard output how far it is.

    python loop_process.py PATH ROWS

Row k is (k / 256 s, k). Every 64 rows it prints the recorder's process id and how many rows are in the journal, and it never runs more than
1024 rows ahead of the journal. After ROWS rows it closes the recording and prints how many rows that has.
"""

from __future__ import annotations

import os
import sys

import numpy as np

from hil.recording import RecorderProcess

CHANNELS = [("time", "s"), ("estimate_row", "")]
METADATA = {"machine": {"name": "carm", "hash": "ab", "axes": [], "text": ""}}
AHEAD_ROWS = 1024


def main(path: str, rows: int) -> None:
    row = np.zeros(2)
    recorder = RecorderProcess(path, CHANNELS, METADATA)
    for k in range(rows):
        while k - recorder.rows_kept > AHEAD_ROWS:
            os.sched_yield()
        if k % 64 == 0:
            print(recorder.pid, recorder.rows_kept, flush=True)
        row[:] = k / 256.0, k
        recorder.put(row)
    print("closed", recorder.close({"initial": {"seed": 1}}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
