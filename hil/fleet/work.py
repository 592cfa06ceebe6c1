"""What a job does: fetch its recordings, do its task as the command line does it, and return rows."""

from __future__ import annotations

import functools
import hashlib
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import RecordingError, in_one_line
from hil.extras import extra_package
from hil.fleet.answers import Number, failure, of_comparison, of_diagnosis, of_friction, of_parameters, of_resonances
from hil.machine.load import machine_from_text
from hil.machine.machine import Machine
from hil.recording import Recording, read_recording
from hil.version import software_version

WELL_DAMPED = 0.5
"""Damping ratio from which a pair of poles of the machine file is no resonance."""

LOCAL = "file://"

IMAGES = ("first", "middle", "last")
"""Of a scan: where its geometry is said."""


def work(argument: dict[str, Any]) -> dict[str, Any]:
    """Do a task; whatever keeps the recordings from an answer is named in a row of its own."""
    with tempfile.TemporaryDirectory(prefix="isocenter-fleet-") as folder, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            machine = _machine(argument["machine_file"]["text"], argument["machine_file"]["path"])
            rows = _TASKS[argument["task"]](machine, argument, Path(folder))
        except MemoryError:
            raise
        except Exception as error:
            rows = failure(in_one_line(error)[0].replace(f"{folder}/", ""))
    notes = [str(each.message).replace(f"{folder}/", "") for each in told if each.category.__name__ == "RecordingWarning"]
    return {"software": software_version(), "notes": notes, "rows": [asdict(row) for row in rows]}


@functools.lru_cache(maxsize=8)
def _machine(text: str, path: str | None) -> Machine:
    return machine_from_text(text, None if path is None else Path(path))


def _recordings(argument: dict[str, Any], which: str, machine: Machine, folder: Path) -> dict[str, Recording]:
    """Read recordings by their path under the machine's."""
    return {one["files"][0]["name"]: read_recording(_fetch(one, folder), machine) for one in argument[which]}


def _fetch(recording: dict[str, Any], folder: Path) -> Path:
    """Copy the files of a recording and return where its first one is.

    Raises
    ------
    RecordingError
        A file is not what was listed.
    """
    for file in recording["files"]:
        target = folder / file["name"]
        target.parent.mkdir(parents=True, exist_ok=True)
        digest = hashlib.sha256()
        with _open(file["url"]) as source, target.open("wb") as copy:
            while block := source.read(1 << 20):
                digest.update(block)
                copy.write(block)
        if digest.hexdigest() != file["sha256"]:
            raise RecordingError(f"{file['name']}: is not the file that was listed: it was written to meanwhile; run again")
    return folder / str(recording["files"][0]["name"])


def _open(url: str) -> Any:  # noqa: ANN401, fsspec has no types
    if url.startswith(LOCAL):
        return Path(url.removeprefix(LOCAL)).open("rb")
    return extra_package("fsspec", "recordings of a fleet").open(url, "rb").open()


def _check(machine: Machine, argument: dict[str, Any], folder: Path) -> list[Number]:
    from hil.verbs.compare import compare
    from hil.verbs.simulate import simulate

    [recording] = _recordings(argument, "recordings", machine, folder).values()
    return of_comparison(compare(recording, simulate(machine, recording)))


def _identify(machine: Machine, argument: dict[str, Any], folder: Path) -> list[Number]:
    from hil.identification import resonances
    from hil.verbs.identify import identify

    recordings = _recordings(argument, "recordings", machine, folder)
    sets = _repeats(recordings)
    rows = []
    for place, each in enumerate(sets):
        response = identify(each, machine=machine)
        expected_Hz = _modes_Hz(machine.text, argument["machine_file"]["path"], response.pose)
        repeat = f", repeat {place + 1}" if len(sets) > 1 else ""
        rows += of_resonances(resonances(response), expected_Hz, "; ".join(response.notes), repeat)
    return rows


def _repeats(recordings: Mapping[str, Recording]) -> list[list[Recording]]:
    """Return sets of recordings with one of each realisation and experiment, in the order of their names.

    Raises
    ------
    RecordingError
        There are more of one than of another, so that a set has a hole.
    """
    of: dict[tuple[object, object], list[Recording]] = {}
    for recording in recordings.values():
        of.setdefault((recording.experiment.get("realisation"), recording.experiment.get("experiment")), []).append(recording)
    counts = {len(found) for found in of.values()}
    if len(counts) > 1:
        raise RecordingError(f"{', '.join(recordings)}: not as many repeats of each realisation and experiment; one is missing")
    return [list(each) for each in zip(*of.values(), strict=True)]


@functools.lru_cache(maxsize=32)
def _modes_Hz(text: str, path: str | None, pose: tuple[float, ...]) -> tuple[float, ...]:
    """Return the lightly damped modes of a machine file, rising [Hz]."""
    from hil.verbs.machine import linear_plant

    machine = _machine(text, path)
    at = dict(zip(machine.axes, pose, strict=True)) if pose else {}
    poles = np.linalg.eigvals(linear_plant(machine, at).A)
    light = poles[(poles.imag > 0.0) & (-poles.real < WELL_DAMPED * np.abs(poles))]
    return tuple(float(one) for one in np.sort(np.abs(light)) / (2.0 * np.pi))


def _friction(machine: Machine, argument: dict[str, Any], folder: Path) -> list[Number]:
    from hil.verbs.diagnose import fit_friction
    from hil.verbs.recordings import Recordings

    return of_friction(fit_friction(machine, Recordings(_recordings(argument, "recordings", machine, folder))))


def _diagnose(machine: Machine, argument: dict[str, Any], folder: Path) -> list[Number]:
    from hil.verbs.diagnose import diagnose
    from hil.verbs.recordings import Recordings

    train = Recordings(_recordings(argument, "recordings", machine, folder))
    held = Recordings(_recordings(argument, "held_out", machine, folder))
    return of_diagnosis(diagnose(machine, train, held, jobs=argument["threads"]))


def _calibrate(machine: Machine, argument: dict[str, Any], folder: Path) -> list[Number]:
    """Return the geometry where a scan's first, middle and last image were exposed: unlike the parameters, images determine it."""
    from hil.imaging.geometry import DEVIATIONS
    from hil.imaging.scan_folder import read_scan
    from hil.verbs.calibrate_data import calibrate_data

    [(_, recording)] = _recordings(argument, "recordings", machine, folder).items()
    scan = read_scan(folder / argument["recordings"][0]["scan"])
    made = calibrate_data(machine, recording, scan)
    positions, _, load = made.observed.at(scan.middle_s[[0, len(scan) // 2, -1]])
    rows = made.model.rows(positions, load).reshape(len(IMAGES) * len(DEVIATIONS), -1)
    found = made.found.parameters
    names = [f"{name}, {image} image" for image in IMAGES for name in DEVIATIONS]
    units = ["rad" if name.startswith("rotation") else "m" for name in names]
    said = f"{len(made.found.used)} of {made.offered} images used"
    return of_parameters("geometry", "calibrated", said, names, units, rows @ found.values, rows @ found.covariance @ rows.T)


_TASKS: dict[str, Callable[[Machine, dict[str, Any], Path], list[Number]]] = {
    "check": _check,
    "identify": _identify,
    "friction": _friction,
    "diagnose": _diagnose,
    "calibrate": _calibrate,
}
