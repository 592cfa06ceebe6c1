"""An identified response and a scan without and with a shaper: `python docs/figures/commission-arm.py FOLDER`.

FOLDER is where the commands of the tutorial "Commission an arm" were run. Writes commission-frf.svg and commission-scan.svg.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from scipy.signal import butter, sosfiltfilt

from hil.identification import read_frf
from hil.recording import read_recording

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 12})
BLUE, ORANGE = "#0072B2", "#D55E00"
BAND_Hz = (4.0, 20.0)
"""Where the arm's lightly damped modes are."""
HERE = Path(__file__).parent


def draw_frf(folder: Path) -> None:
    """Acceleration across the detector by the propeller's current, with its standard deviation from noise."""
    response = read_frf(folder / "carm.frf.npz")
    row, column = response.output_names.index("imu_y"), response.input_names.index("command_propeller")
    deviation = response.standard_deviation("noise")[:, row, column]
    fig, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
    ax.loglog(response.frequencies_Hz, np.abs(response.G[:, row, column]), color=BLUE, label="response")
    ax.loglog(response.frequencies_Hz, deviation, ".", ms=3, color=ORANGE, label="standard deviation, noise")
    ax.set(xlabel="Frequency [Hz]", ylabel="imu_y / command_propeller\n[m/s² per A]")
    ax.grid(alpha=0.25)
    ax.legend(frameon=False, loc="lower center", ncols=2, bbox_to_anchor=(0.5, 1.0))
    fig.savefig(HERE / "commission-frf.svg", metadata={"Date": None})


def draw_scan(folder: Path) -> None:
    """Acceleration of the detector within the band, over both scans."""
    sections = butter(4, BAND_Hz, "bandpass", fs=256.0, output="sos")
    fig, axes = plt.subplots(2, 1, figsize=(6.4, 4.2), layout="constrained", sharex=True, sharey=True)
    for ax, name, colour, title in zip(axes, ("plain", "shaped"), (ORANGE, BLUE), ("without a shaper", "with the shaper"), strict=True):
        recording = read_recording(folder / f"{name}.mf4")
        ax.plot(recording.time, 1e3 * sosfiltfilt(sections, recording["imu_y"]), color=colour, lw=0.8)
        ax.set(ylabel="imu_y [mm/s²]", title=title)
        ax.grid(alpha=0.25)
    axes[1].set_xlabel("Time [s]")
    fig.savefig(HERE / "commission-scan.svg", metadata={"Date": None})


if __name__ == "__main__":
    draw_frf(Path(sys.argv[1]))
    draw_scan(Path(sys.argv[1]))
