"""The pages of `isocenter calibrate`: how well the geometry is known, then every parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.calibration.data_driven.values import Calibration
from hil.calibration.marker.scan import MarkerScan
from hil.calibration.phantom.pose import PoseFit
from hil.calibration.use.lookup_table import LookUp
from hil.imaging.geometry import DEVIATIONS
from hil.imaging.markers.projection import PARAMETERS
from hil.imaging.scan_folder import ImageScan
from hil.machine import Machine
from hil.machine.load import name_to_load
from hil.pages import Bullets, Page, Section, Table, Verdict
from hil.pages.contents import Kind
from hil.recording import Recording
from hil.reports.deviations import Curve, deviation_charts, deviation_table
from hil.reports.made_from import command_line, machine_fact, was_emulated

UNITS = ("mm",) * 6 + ("mrad",) * 3
MOST_LEFT_OUT = 0.1
"""Share of a scan's exposures without an answer, from which on the verdict is not good."""


def geometry_page(
    title: str,
    machine: Machine,
    verdict: Verdict,
    along: tuple[np.ndarray, str],
    curves: Mapping[str, Curve],
    files: tuple[Path, Path],
    said: Sequence[str],
    following: tuple[str, str],
    names: Sequence[str] = DEVIATIONS,
    units: Sequence[str] = UNITS,
) -> Page:
    """Return the page of a geometry over a scan.

    Parameters
    ----------
    title : str
    machine : Machine
    verdict : Verdict
    along : (N,) array and its label
    curves : mapping of str to Curve
        The first is that which was found.
    files : two paths
        Scan or recording, and what was written.
    said : sequence of str
        What the command said.
    following : two strings
        The command that comes next, and what it brings.
    names, units : sequences of str
        Of the parameters.
    """
    source, out = files
    values, covariance = next(iter(curves.values()))
    sigma = np.full(values.shape, np.nan) if covariance is None else np.sqrt(np.einsum("nii->ni", covariance))
    over = along[1].split(" [")[0]
    return Page(
        title,
        verdict,
        [
            Section(f"Deviation from the nominal geometry over {over}", [deviation_charts(*along, curves, names, units)]),
            Section("In numbers", [deviation_table(values, sigma, names, units)], is_folded=True),
            Section("What the command said", [Bullets(said)], is_folded=True),
        ],
        *following,
        {"Machine": machine_fact(machine), "From": source.name, "Written": out.name},
    )


def _reconstruct(machine: Machine, option: str, out: Path) -> tuple[str, str]:
    """Return the command that uses a geometry, and what it brings."""
    command = command_line("reconstruct", name_to_load(machine), "SCAN", option, out, "-o", "reconstruction")
    return command, "reconstructs a scan with it."


def of_exposures(used: int, offered: int, residual: str) -> Verdict:
    """Return the sentence on top of a calibration from single exposures."""
    share = used / offered if offered else 0.0
    said = f"The geometry of {used} of {offered} exposures is known; {residual}."
    return Verdict(said, "good" if share > 1.0 - MOST_LEFT_OUT else "unsure" if used else "bad")


def phantom_page(machine: Machine, fit: PoseFit, table: LookUp, files: tuple[Path, Path], said: Sequence[str]) -> Page:
    """Return the page of a calibration from images of the phantom."""
    axis = int(np.argmax(np.ptp(table.positions, axis=0)))
    residual = f"bullets lie within {1e6 * float(np.nanmedian(fit.residual_m)):.1f} µm (median) of where it puts them on the panel"
    verdict = of_exposures(int(fit.good.sum()), len(fit.good), residual)
    is_angle = machine.units[machine.axis_index(table.axes[axis])].position == "rad"
    along = np.degrees(table.positions[:, axis]) if is_angle else table.positions[:, axis]
    over = (along, f"{table.axes[axis]} [{'°' if is_angle else 'm'}]")
    curves = {"phantom": (table.deviation, table.covariance)}
    following = _reconstruct(machine, "--lookup", files[1])
    return geometry_page(f"Geometry of {files[0].name}", machine, verdict, over, curves, files, said, following)


def marker_page(machine: Machine, result: MarkerScan, scan: ImageScan, files: tuple[Path, Path], said: Sequence[str]) -> Page:
    """Return the page of a calibration from images of a marker plate on the tube."""
    good, columns = result.good, [PARAMETERS.index(name) for name in result.free]
    residual = f"crossings lie within {float(np.nanmedian(result.residual_pixels)):.3f} pixels (median) of where it puts them"
    verdict = of_exposures(int(good.sum()), len(good), residual)
    changes = (result.values - result.nominal)[good][:, columns]
    curves = {"marker plate": (changes, result.covariance[good][:, columns][:, :, columns])}
    units = ["mrad" if 3 <= k < 6 else "mm" for k in columns]
    over = (np.asarray(scan.middle_s)[good], "time [s]")
    command = command_line("calibrate", "data", name_to_load(machine), "REC", "--marker", files[0], "-o", "scan.geometry.npz")
    following = (command, "makes the geometry of that scan at every sample from its recording and the same images.")
    title = f"Tube against panel in {files[0].name}"
    return geometry_page(title, machine, verdict, over, curves, files, said, following, result.free, units)


def data_page(machine: Machine, found: Calibration, recording: Recording, files: tuple[Path, Path], said: Sequence[str]) -> Page:
    """Return the page of a data-driven calibration."""
    first, last = 1e3 * found.place_sigma_m[0], 1e3 * found.place_sigma_m[-1]
    verdict = Verdict(
        f"The isocentre's place is known to {last:.3f} mm after {len(found.used)} images (before them {first:.3f} mm).",
        "good" if len(found.used) > len(found.refused) else "unsure",
    )
    curves: dict[str, Curve] = {"live": (found.live, found.covariance), "parameters of the end": (found.final, None)}
    over = (recording.time[: len(found.live)], "time [s]")
    following = _reconstruct(machine, "--geometry", files[1])
    page = geometry_page(f"Geometry of {files[0].name}", machine, verdict, over, curves, files, said, following)
    return replace(page, is_emulated=was_emulated([recording]))


def model_page(
    machine: Machine,
    judged: Mapping[str, Mapping[str, Any]],
    left: Mapping[str, Sequence[np.ndarray]],
    out: Path,
    said: Sequence[str],
) -> Page:
    """Return the page of a kinematic model.

    `judged` says of each scan whether it was `held_out`, and the rms that `nominal` and `model` leave of it; `left` has what is left of
    every exposure, an array (N, 9) [m, rad] for each scan.
    """
    rows: list[tuple[str, ...]] = []
    kinds: list[Kind] = []
    for name, row in judged.items():
        nominal, model = row["nominal"], row["model"]
        kinds.append("good" if model["position_m"] <= nominal["position_m"] else "bad")
        numbers = [f"{1e3 * each[key]:.3f}" for key in ("position_m", "rotation_rad", "source_m") for each in (nominal, model)]
        rows.append((Path(name).name + (" (held out)" if row["held_out"] else ""), *numbers))
    head = ("scan", *(f"{what}, {whose}" for what in ("place [mm]", "rotation [mrad]", "source [mm]") for whose in ("nominal", "model")))
    held = [row for row in judged.values() if row["held_out"]] or list(judged.values())
    before, after = (float(np.mean([row[key]["position_m"] for row in held])) for key in ("nominal", "model"))
    every = {name: (np.concatenate(parts), None) for name, parts in left.items()}
    exposures = np.arange(len(next(iter(every.values()))[0]), dtype=float)
    charts = deviation_charts(exposures, "exposure of all scans, one after the other", every, DEVIATIONS, UNITS)
    of = "held-out scans" if any(row["held_out"] for row in judged.values()) else "the scans that it was fitted to"
    return Page(
        f"Kinematic model of {machine.name}",
        Verdict(
            f"The model puts the isocentre of {of} right to {1e3 * after:.3f} mm rms, the drawing to {1e3 * before:.3f} mm.",
            "good" if after < before else "bad",
        ),
        [
            Section("What it leaves of each scan", [Table(head, rows, frozenset(range(1, 7)), kinds)]),
            Section("Over the exposures", [charts]),
            Section("What the command said", [Bullets(said)], is_folded=True),
        ],
        *_reconstruct(machine, "--lookup", out),
        {"Machine": machine_fact(machine), "From": ", ".join(Path(name).name for name in judged), "Written": out.name},
    )
