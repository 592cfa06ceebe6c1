"""A wire reconstructed with the nominal and with the calibrated geometry: `python docs/figures/images-wires.py FOLDER`.

FOLDER is where the commands of the tutorial "Calibrate from images" were run.
"""

from __future__ import annotations

import sys
from pathlib import Path

import itk
import matplotlib as mpl
from matplotlib import pyplot as plt

mpl.rcParams.update({"svg.hashsalt": "isocenter", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 12})
SPACING_mm = 0.5
"""Edge of a voxel, the default of `isocenter reconstruct`."""
WIRE_mm, SHOWN_mm = 12.0, 6.0
"""Where the wire is along x, and how much is shown to each side."""


def main(folder: Path) -> None:
    """Draw the slice across the wire that runs along the scan's axis, beside this file."""
    fig, axes = plt.subplots(1, 2, figsize=(7.0, 3.4), layout="constrained", sharey=True)
    for ax, name, title in zip(axes, ("nominal", "calibrated"), ("nominal geometry", "calibrated geometry"), strict=True):
        volume = itk.GetArrayFromImage(itk.imread(str(folder / name / "volume.mha")))
        middle = volume.shape[1] // 2
        edge = SPACING_mm * volume.shape[0] / 2.0
        image = ax.imshow(volume[:, middle, :], cmap="gray", vmin=0.0, vmax=500.0, extent=(-edge, edge, -edge, edge), origin="lower")
        ax.set(title=title, xlabel="x [mm]", xlim=(WIRE_mm - SHOWN_mm, WIRE_mm + SHOWN_mm), ylim=(-SHOWN_mm, SHOWN_mm))
    axes[0].set_ylabel("z [mm]")
    fig.colorbar(image, ax=axes, label="Attenuation [1/m]")
    fig.savefig(Path(__file__).with_suffix(".svg"), metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
