"""The page of `isocenter reconstruct`: how sharp thin wires are, then the volume."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hil.figures.reconstruction import volume_figure, wires_figure
from hil.machine import Machine
from hil.machine.load import name_to_load
from hil.pages import Page, Section, Table, Verdict
from hil.pages.contents import Block
from hil.pages.picture import drawn
from hil.reconstruction.fdk import Volume
from hil.reconstruction.wire_profiles import WireQuality
from hil.reports.made_from import command_line, machine_fact

SHARP = 0.8
"""Share of a wire's attenuation that its peak must reach, below which its scan was not where it was thought to be."""

HEAD = ("wire", "peak [1/m]", "of what it has", "widths [mm]", "from its place [mm]", "artefacts [%]")


def reconstructed_page(
    machine: Machine, volume: Volume, wires: Mapping[str, WireQuality], files: tuple[Path, Path], facts: Mapping[str, str]
) -> Page:
    """Return the page of a volume; `files` are scan and folder, `wires` is empty for a scan of something else."""
    scan, out = files
    title = f"{scan.name}, {facts['Geometry']}"
    sections = [Section("The volume", [drawn(volume_figure(volume, title), "Three slices through the middle over three projections")])]
    if wires:
        rows = [_row(name, quality) for name, quality in wires.items()]
        blocks: list[Block] = [
            Table(HEAD, rows, frozenset((1, 2, 4, 5))),
            drawn(wires_figure(wires, title), "Cross section and profiles of each wire"),
        ]
        sections.insert(0, Section("The wires", blocks))
    return Page(
        f"Reconstruction of {scan.name}",
        verdict(volume, wires),
        sections,
        command_line("calibrate", "phantom", name_to_load(machine), "PHANTOM_SCAN", "-o", "scan.lookup.npz"),
        "gives a geometry to reconstruct with: --lookup scan.lookup.npz",
        {"Machine": machine_fact(machine), "Scan": scan.name, "Written": str(out), **facts},
    )


def verdict(volume: Volume, wires: Mapping[str, WireQuality]) -> Verdict:
    """Return how sharp the wires are; of anything else, that there is a volume."""
    if not wires:
        return Verdict(f"A volume of {volume.values.shape[0]} voxels along each edge of {1e3 * volume.spacing_m:g} mm each.")
    worst = min(wires, key=lambda name: wires[name].peak_ratio)
    ratio, width = wires[worst].peak_ratio, 1e3 * max(float(np.max(each.widths_m)) for each in wires.values())
    said = f"The wires reach {ratio:.2f} of what they have or more, and are {width:.2f} mm wide at most."
    return Verdict(said, "good" if ratio >= SHARP else "unsure")


def _row(name: str, quality: WireQuality) -> tuple[str, ...]:
    widths = " and ".join(f"{1e3 * width:.2f}" for width in quality.widths_m)
    offset = 1e3 * float(np.linalg.norm(quality.offset_m))
    return (name, f"{quality.peak_1_m:.1f}", f"{quality.peak_ratio:.2f}", widths, f"{offset:.2f}", f"{100.0 * quality.artefact:.1f}")
