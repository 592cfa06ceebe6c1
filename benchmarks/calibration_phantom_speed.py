"""How long the poses of a phantom scan take: `isocenter calibrate phantom` on as many images as asked, repeated from those of one scan.

    python benchmarks/calibration_phantom_speed.py SCAN [--images 1200] [--jobs 2] [--out benchmarks/results/calibration_phantom_speed.json]

SCAN is a folder of phantom images of the shipped C-arm (isocenter expose). Processor seconds are those of all processes, reading the
images included; wall seconds mean something on a computer with nothing else to do.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import tifffile

from hil.cli import main
from hil.imaging.scan_folder import FRAMES, read_scan, write_description, write_exposures

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scan", type=Path)
    parser.add_argument("--images", type=int, default=1200)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "calibration_phantom_speed.json")
    given = parser.parse_args()
    scan = read_scan(given.scan)
    which = np.arange(given.images) % len(scan)
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(kept) / "scan"
        folder.mkdir()
        with tifffile.TiffWriter(folder / FRAMES) as frames:
            for k in which:
                frames.write(scan.frame(int(k)), contiguous=True)
        write_description(folder, scan.detector, scan.axes, scan.notes)
        starts = scan.start_s[0] + np.arange(given.images) / 7.0
        units = dict(zip(scan.axes, scan.units, strict=True))
        write_exposures(folder, np.arange(given.images), starts, scan.width_s[which], units, scan.positions[which])
        began = time.perf_counter()
        try:
            main(["calibrate", "phantom", "carm", str(folder), "--jobs", str(given.jobs), "-o", str(Path(kept) / "table.npz")])
        except SystemExit as ended:
            if ended.code:
                raise
        wall = time.perf_counter() - began
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    answer = {
        "images": given.images,
        "pixels": [scan.detector.columns, scan.detector.rows],
        "jobs": given.jobs,
        "wall_s": wall,
        "processor_s": sum(each.ru_utime + each.ru_stime for each in used),
        "load_average": os.getloadavg()[0],
        "host_processors": os.cpu_count(),
    }
    given.out.write_text(json.dumps(answer, indent=2) + "\n")
    print(json.dumps(answer, indent=2))
