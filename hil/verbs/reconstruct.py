"""A volume from a scan's images and the geometry of each exposure, and how sharp known things are in it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import RequestError, UnusableInputError
from hil.verbs.verb import KEPT, NOBODY, SCAN, Listener, argument, option

if TYPE_CHECKING:
    from hil.imaging.geometry import ConeBeam
    from hil.imaging.scan_folder import ImageScan
    from hil.machine import Machine
    from hil.reconstruction.fdk import Volume
    from hil.reconstruction.wire_profiles import WireQuality

LARGE_BYTES = 2e9
"""Memory from which on a reconstruction reports how much it takes."""

Point = tuple[float, float, float]
"""[m] of the phantom's frame."""


@dataclass(frozen=True)
class ReconstructRequest:
    """A scan, and with which geometry and how finely it is reconstructed."""

    machine: Machine
    scan: Path = argument(SCAN, "SCAN")
    out: Path = option("Folder for volume.mha and figures.", "DIR", "-o", "--out", is_needed=True)
    lookup: Path | None = option("Look-up table or model; nominal without.", "LOOKUP", "--lookup")
    geometry: Path | None = option("Geometry of this very run: isocenter calibrate data.", "FILE", "--geometry")
    size: int = option("Voxels along each edge.", None, "--size", default=128, least=16, most=1024)
    spacing_m: float = option("Edge of a voxel.", "MM", "--spacing", default=0.5e-3)
    hann: float = option("Hann window's cut-off, relative to Nyquist; 0: none.", None, "--hann", default=0.0, least=0.0, most=1.0)
    neck: Point | None = option("Of an aneurysm to measure: a point of its neck's plane [mm], with --dome.", "X,Y,Z", "--neck")
    dome: Point | None = option("A point inside its dome [mm]; the plane is square to the line between both.", "X,Y,Z", "--dome")


@dataclass(frozen=True)
class NumberAnswer:
    """A number of an aneurysm's shape."""

    value: float
    """In its unit."""
    deviation: float
    """Standard deviation."""
    unit: str
    """Empty of a ratio."""


@dataclass(frozen=True)
class ReconstructAnswer:
    """A volume that was written."""

    geometry: str
    """The geometry that was used."""
    projections: int
    """Number of images."""
    wires: Mapping[str, WireQuality]
    """Of a scan of thin wires: each, as `wire x`."""
    aneurysm: Mapping[str, NumberAnswer]
    """With `--neck` and `--dome`: `volume`, `wall_area`, `neck_width`, `dome_height`, `dome_width`, `aspect_ratio` (height over neck),
    `bottleneck_factor` (dome over neck width), `sphericity`."""
    volume: Volume = field(metadata=KEPT, repr=False)


def answer(request: ReconstructRequest, listener: Listener = NOBODY) -> ReconstructAnswer:
    """Reconstruct, write volume and pictures, and judge wires and an aneurysm in it; the listener hears it in words.

    Raises
    ------
    RequestError
        Parts of the request do not go together, or the volume does not fit into this computer's memory.
    UnusableInputError
        A file cannot be read or written, or shows no aneurysm where it is said to be.
    """
    import numpy as np

    from hil.figures.reconstruction import volume_figure
    from hil.files.writable import folder_can_be_written
    from hil.imaging.scan_folder import read_scan
    from hil.reconstruction.fdk import line_integrals, reconstruct, write_volume

    if not 0.0 < request.spacing_m < math.inf:
        raise RequestError("{spacing_m} {}: must be a positive number", f"{1e3 * request.spacing_m:g}")
    if (request.neck is None) != (request.dome is None):
        raise RequestError("{neck} and {dome}: give both, or none")
    if request.lookup is not None and request.geometry is not None:
        raise RequestError("{lookup} and {geometry}: give the one or the other")
    folder_can_be_written(request.out)
    scan = read_scan(request.scan)
    beam, source = _beam(request, scan, listener)
    shape = len(scan), scan.detector.rows, scan.detector.columns
    _require_memory(request.size, shape, listener)
    images = np.empty(shape, dtype=np.float32)
    with listener.working("reading", len(scan)) as work:
        for k in range(len(scan)):
            images[k] = line_integrals(scan.frame(k))
            work.done(k + 1)
        work.then("reconstructing")
        volume = reconstruct(images, scan.detector, beam, request.size, request.spacing_m, request.hann)
    title = f"{request.scan.name}, {source}"
    try:
        request.out.mkdir(parents=True, exist_ok=True)
        write_volume(volume, request.out / "volume.mha")
        volume_figure(volume, title).savefig(request.out / "volume.png", dpi=130)
    except OSError as error:
        raise UnusableInputError(f"{request.out}: cannot be written: {error.strerror or error}") from None
    voxels = f"{request.size}^3 voxels of {1e3 * request.spacing_m:g} mm"
    listener.say(f"{request.out}: volume.mha of {voxels}, volume.png; {len(scan)} projections, {source}")
    wires = _wires(volume, str(scan.notes.get("scene", "")), request.out / "wires.png", title, listener)
    return ReconstructAnswer(source, len(scan), wires, _aneurysm(volume, request, listener), volume)


def _beam(request: ReconstructRequest, scan: ImageScan, listener: Listener) -> tuple[ConeBeam, str]:
    """Return the geometry of every exposure, and where it is from."""
    from hil.calibration.data_driven.data_file import read_data_file
    from hil.calibration.kinematic.geometric_model import read_calibration
    from hil.calibration.use.lookup_table import LookUp, sweep_speed
    from hil.imaging.nominal import nominal_beam

    machine, positions = request.machine, scan.positions_of(request.machine)
    if request.geometry is not None:
        return read_data_file(request.geometry).beam(machine, scan.middle_s), f"geometry from {request.geometry.name}"
    beam = nominal_beam(machine, positions)
    if request.lookup is None:
        return beam, "nominal geometry"
    name, table = request.lookup.name, read_calibration(request.lookup, machine)
    if table.notes.get("hash", machine.hash) != machine.hash:
        listener.say(f"{name} was made with another version of {machine.name}'s file; its deviations are used as they are")
    if other := table.other_speed(sweep_speed(scan.middle_s, positions)) if isinstance(table, LookUp) else "":
        listener.say(f"{name}: {other}")
    return beam.moved(table.at(positions)), f"geometry from {name}"


def _wires(volume: Volume, scene_name: str, picture: Path, title: str, listener: Listener) -> dict[str, WireQuality]:
    """Judge and draw the wires of a scan of some."""
    import numpy as np

    from hil.emulated.scenes import scene
    from hil.figures.reconstruction import wires_figure
    from hil.reconstruction.wire_profiles import wire_quality
    from virtual_bus.xray.objects import Rod

    if not scene_name.startswith("wires"):
        return {}
    wires: dict[str, WireQuality] = {}
    for axis, rod in zip("xyz", (item for item in scene(scene_name) if isinstance(item, Rod)), strict=True):
        try:
            wires[f"wire {axis}"] = wire_quality(volume, rod.start_m, rod.end_m, rod.attenuation_1_m)
        except UnusableInputError as error:
            listener.say(f"  wire {axis}: {error}")
    if wires:
        wires_figure(wires, title).savefig(picture, dpi=130)
    for wire, quality in wires.items():
        listener.say(
            f"  {wire}: peak {quality.peak_1_m:.1f} 1/m, {quality.peak_ratio:.2f} of what it has, widths"
            f" {1e3 * quality.widths_m[0]:.2f} and {1e3 * quality.widths_m[1]:.2f} mm,"
            f" {1e3 * np.linalg.norm(quality.offset_m):.2f} mm from its place, artefacts {quality.artefact:.1%} of the peak"
        )
    return wires


def _aneurysm(volume: Volume, request: ReconstructRequest, listener: Listener) -> dict[str, NumberAnswer]:
    """Measure an aneurysm where one is asked for, and say its numbers in millimetres."""
    import numpy as np

    from hil.reconstruction.aneurysm import UNITS, aneurysm_shape

    if request.neck is None or request.dome is None:
        return {}
    found = aneurysm_shape(volume, np.array(request.neck), np.array(request.dome))
    for name, unit in UNITS.items():
        power = {"m": 1, "m^2": 2, "m^3": 3}.get(unit, 0)
        value, deviation = (1e3**power * each[name] for each in (found.values, found.deviations))
        listener.say(f"  {name.replace('_', ' '):18s} {value:8.4g} ± {deviation:.2g} {unit.replace('m', 'mm', 1)}".rstrip())
    return {name: NumberAnswer(found.values[name], found.deviations[name], unit) for name, unit in UNITS.items()}


def _require_memory(size: int, projections: tuple[int, int, int], listener: Listener) -> None:
    """Refuse a volume that this computer cannot hold; say how much memory a large one takes."""
    from hil.reconstruction.fdk import bytes_needed

    needed, there_is = bytes_needed(size, projections), math.inf
    if hasattr(os, "sysconf"):  # Windows does not say
        there_is = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if needed > there_is:
        raise RequestError(
            "{size} {}: takes {} GB of memory; this computer has {} GB", size, f"{needed / 1e9:.1f}", f"{there_is / 1e9:.1f}"
        )
    if needed > LARGE_BYTES:
        listener.say(f"a volume of {size} voxels a side takes {needed / 1e9:.1f} GB of memory")
