"""isocenter plane: an image of a plane from its sinogram, and sinograms of discs (thesis Appendix B)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import can_be_written, folder_can_be_written
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption, save_figure

WINDOWS = ("ramp", "shepp-logan", "cosine", "hamming", "hann", "none")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        "plane",
        short_help="An image of a plane from its sinogram.",
        help="An image of a plane from its sinogram by filtered backprojection, of parallel rays or of a fan over a whole turn (thesis"
        " Appendix B). SINOGRAM is an archive of NumPy arrays: projections (views, bins), angles_rad, and spacing_m of parallel bins or"
        " psi_rad (bins) and source_m of a fan. With --disc it is made first: a fan's exact line integrals of discs."
        "\n\nExample:  isocenter plane discs.npz --disc 0,0,50,20 --disc 18,6,12,10 -o plane"
        "\n\nFewer views leave streaks:  isocenter plane few.npz --disc 0,0,50,20 --views 30 -o few",
    )(plane)


def plane(
    sinogram_file: Annotated[Path, typer.Argument(metavar="SINOGRAM", help="Archive of arrays (.npz); written with --disc.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for image.npz and image.png.")],
    disc: Annotated[
        list[str] | None, typer.Option("--disc", metavar="X,Y,R,MU", help="A disc: place and radius [mm], attenuation [1/m]; repeat it.")
    ] = None,
    source: Annotated[float, typer.Option("--source", metavar="MM", help="With --disc: the source's distance from the origin.")] = 810.0,
    views: Annotated[int, typer.Option("--views", min=3, max=4096, help="With --disc: over a whole turn.")] = 360,
    rays: Annotated[int, typer.Option("--rays", min=3, max=4096, help="With --disc: of each view.")] = 301,
    window: Annotated[str, typer.Option("--window", help=f"Of the ramp filter of parallel rays: {', '.join(WINDOWS)} (B.6).")] = "ramp",
    size: Annotated[
        int | None, typer.Option("--size", metavar="N", min=3, max=4096, help="Pixels along each edge, of a fan; else as its rays.")
    ] = None,
    spacing: Annotated[float | None, typer.Option("--spacing", metavar="MM", help="Edge of a pixel, of a fan; else as its rays.")] = None,
    json_to: JsonOption = None,
) -> None:
    """Read or make the sinogram, reconstruct, draw."""
    import numpy as np

    from hil.figures.reconstruction import plane_figure
    from hil.files.arrays import write_arrays
    from hil.reconstruction.sinogram import drawn, fan_of, image_of, means_in, read_sinogram, write_sinogram

    if window not in WINDOWS:
        raise UnusableInputError(f"--window {window}: must be one of {', '.join(WINDOWS)}")
    for option, value in (("--source", source), ("--spacing", spacing)):
        if value is not None and not 0.0 < value < np.inf:
            raise UnusableInputError(f"{option} {value:g}: must be a positive number")
    discs = np.array([_disc(text) for text in disc or ()]).reshape(-1, 4)
    answer = Answer(json_to)
    folder_can_be_written(out)
    if len(discs):
        can_be_written(sinogram_file)
        sinogram = fan_of(discs, 1e-3 * source, views, rays)
        write_sinogram(sinogram, sinogram_file)
    else:
        sinogram = read_sinogram(sinogram_file)
    image, spacing_m = image_of(sinogram, None if window == "none" else window, size, None if spacing is None else 1e-3 * spacing)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableInputError(f"{out}: cannot be written: {error.strerror or error}") from None
    write_arrays(out / "image.npz", {"image_1_m": image, "spacing_m": spacing_m})
    save_figure(plane_figure(sinogram, image, spacing_m), out / "image.png")
    kind = "parallel rays" if sinogram.psi is None else "a fan"
    count, bins = sinogram.projections.shape
    answer.say(
        f"{out}: image.npz, image.png; {len(image)} x {len(image)} pixels of {1e3 * spacing_m:.4g} mm; {kind}, {count} views, {bins} bins"
    )
    rows = []
    if len(discs):
        found, asked = means_in(image, discs, spacing_m), means_in(drawn(discs, len(image), spacing_m), discs, spacing_m)
        for text, mean, true in zip(disc or (), found.tolist(), asked.tolist(), strict=True):
            rows.append({"disc": text, "mean_1_m": mean, "true_1_m": true})
            answer.say(f"  disc {text}: {mean:.2f} 1/m in its inner half, {true:.2f} drawn")
    answer.write({"rays": kind, "views": count, "bins": bins, "size": len(image), "spacing_m": spacing_m, "discs": rows})


def _disc(text: str) -> list[float]:
    """Read a disc: x, y, radius [m], attenuation [1/m]."""
    import numpy as np

    try:
        x, y, radius, attenuation = (float(part) for part in text.split(","))
    except ValueError:
        x = y = radius = attenuation = float("nan")
    if not np.isfinite([x, y, radius, attenuation]).all() or radius <= 0.0:
        raise UnusableInputError(f"--disc {text}: must be four numbers, x, y and a positive radius in mm and 1/m, such as 0,0,50,20")
    return [1e-3 * x, 1e-3 * y, 1e-3 * radius, attenuation]
