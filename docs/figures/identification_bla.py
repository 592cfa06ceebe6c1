"""What the robust method tells apart, on a mode behind a weak cubic: `python docs/figures/identification_bla.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from hil.identification import periodic_records, robust_bla

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 11})

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"
RATE_Hz, SAMPLES, PERIODS, REALISATIONS = 256.0, 2560, 8, 7
MODE_Hz, DAMPING, CUBIC, NOISE_RMS = 8.0, 0.02, 1e-3, 0.05


def main() -> None:
    """Simulate, identify and draw beside this file."""
    draw = np.random.default_rng(0)
    lines = np.arange(11, 400, 2)
    s = 2j * np.pi * np.arange(SAMPLES // 2 + 1) * RATE_Hz / SAMPLES
    mode = 2.0 * np.pi * MODE_Hz
    linear = mode**2 / (s**2 + 2.0 * DAMPING * mode * s + mode**2)
    inputs = np.zeros((REALISATIONS, 1, PERIODS * SAMPLES, 1))
    outputs = np.zeros_like(inputs)
    for record in range(REALISATIONS):
        spectrum = np.zeros(SAMPLES // 2 + 1, complex)
        spectrum[lines] = np.exp(2j * np.pi * draw.random(len(lines))) * SAMPLES / 2.0 * np.sqrt(2.0 / len(lines))
        steady = np.fft.irfft(spectrum * linear, SAMPLES)
        steady = steady + CUBIC * steady**3
        inputs[record, 0, :, 0] = np.tile(np.fft.irfft(spectrum, SAMPLES), PERIODS)
        outputs[record, 0, :, 0] = np.tile(steady, PERIODS) + NOISE_RMS * draw.standard_normal(PERIODS * SAMPLES)
    response = robust_bla(periodic_records(outputs, None, inputs, period_samples=SAMPLES, sample_rate_Hz=RATE_Hz, lines=lines))
    fig, ax = plt.subplots(figsize=(5.4, 3.6), layout="constrained")
    for values, colour, style, text in (
        (np.abs(response.G), "black", "-", "|G|"),
        (response.standard_deviation("nonlinear"), ORANGE, ":", "distortion, one realisation"),
        (response.standard_deviation("total"), BLUE, "-", "total, of the mean"),
        (response.standard_deviation("noise"), GREEN, "--", "noise, of the mean"),
    ):
        ax.semilogy(response.frequencies_Hz, np.where(values > 0.0, values, np.nan)[:, 0, 0], color=colour, ls=style, lw=1.8, label=text)
    ax.set(xlabel="frequency [Hz]", ylabel="magnitude, standard deviation", xlim=(0.0, 40.0), ylim=(5e-4, 3e3))
    ax.legend(frameon=False, loc="upper right", fontsize=10)
    ax.spines[["top", "right"]].set_visible(False)
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main()
