"""MATLAB files: by SciPy, Octave, hdf5storage, mat4py, asammdf and, as MATLAB lays them out, by h5py."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from foreign_logs.known import FORMULAS, ROWS, STATUS, Foreign, Known, RATE_Hz, TIME_s, as_put_in, signal

Q, I = signal("position_roll"), signal("current_roll")
PAIR = ("position_roll", "current_roll")
NAMES = {"time": TIME_s, **{name: signal(name) for name in FORMULAS}}
_OBJECT = "SimulationOutput"


def scipy(content: dict[str, Any], **options: object) -> Callable[[Path], Path]:
    """Return a maker with scipy.io.savemat."""

    def make(folder: Path) -> Path:
        from scipy.io import savemat

        savemat(folder / "log.mat", content, **options)
        return folder / "log.mat"

    return make


def cell(*values: object) -> np.ndarray:
    """Return a cell array of one column."""
    found = np.empty((len(values), 1), dtype=object)
    found[:, 0] = values
    return found


def scope() -> dict[str, Any]:
    """Structure with time, as a scope of Simulink stores it: an array of structures with labels."""
    signals = np.empty((1, 2), dtype=[("values", object), ("dimensions", object), ("label", object)])
    signals[0, 0] = (Q[:, None], 1.0, "position_roll")
    signals[0, 1] = (I[:, None], 1.0, "current_roll")
    return {"ScopeData": {"time": TIME_s[:, None], "signals": signals, "blockName": "model/Scope"}, "tout": TIME_s[:, None]}


def octave(save: str, more: str = "", file: str = "log.mat") -> Callable[[Path], Path]:
    """Return a maker with Octave; the signals are t, q, i."""

    def make(folder: Path) -> Path:
        code = f"t=(0:{ROWS - 1})'/{RATE_Hz}; q={FORMULAS['position_roll']}; i={FORMULAS['current_roll']}; {more} {save};"
        subprocess.run(["octave-cli", "--eval", code], cwd=folder, check=True, capture_output=True)
        return folder / file

    return make


def store(content: dict[str, Any], fmt: str = "7.3", **options: object) -> Callable[[Path], Path]:
    """Return a maker with hdf5storage."""

    def make(folder: Path) -> Path:
        import hdf5storage

        hdf5storage.savemat(str(folder / "log.mat"), content, fmt=fmt, store_python_metadata=False, **options)
        return folder / "log.mat"

    return make


def plain_lists(folder: Path) -> Path:
    """By mat4py, from lists."""
    import mat4py

    mat4py.savemat(str(folder / "log.mat"), {"t": TIME_s.tolist(), "q": Q.tolist(), "i": I.tolist()})
    return folder / "log.mat"


def as_matlab(fill: Callable[[Any], None]) -> Callable[[Path], Path]:
    """Return a maker with h5py that puts MATLAB's header before the HDF5 part."""

    def make(folder: Path) -> Path:
        import h5py

        path = folder / "log.mat"
        with h5py.File(path, "w", userblock_size=512) as file:
            fill(file)
        head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  5 12:00:00 2026 HDF5 schema 1.00 .".ljust(124)
        with path.open("r+b") as raw:
            raw.write(head + b"\x00\x02IM")
        return path

    return make


def _dataset(place: Any, name: str, values: np.ndarray, kind: str = "double", **options: object) -> None:
    made = place.create_dataset(name, data=values, **options)
    made.attrs["MATLAB_class"] = np.bytes_(kind)


def _vectors(file: Any) -> None:
    _dataset(file, "t", TIME_s[None, :], compression="gzip", chunks=(1, 100))
    _dataset(file, "data", np.stack([Q, I]), compression="gzip")
    _dataset(file, "name", np.array([[ord(letter)] for letter in "run 3"], dtype=np.uint16), "char")
    _dataset(file, "brakes", np.ones((1, ROWS), np.uint8), "logical")


def _structures(file: Any) -> None:
    import h5py

    run = file.create_group("run")
    run.attrs["MATLAB_class"] = np.bytes_("struct")
    _dataset(run, "time", TIME_s[None, :])
    kept = file.create_group("#refs#")
    _dataset(kept, "a", Q[None, :].astype(np.float32), "single")
    _dataset(kept, "b", I[None, :])
    both = np.array([[kept["a"].ref, kept["b"].ref]], dtype=h5py.ref_dtype)
    _dataset(run, "signals", both.T, "cell")
    _dataset(file, "obj", np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32).T, "timeseries")
    file["obj"].attrs["MATLAB_object_decode"] = np.int32(3)


def exported(version: str) -> Callable[[Path], Path]:
    """Return a maker with asammdf's export."""

    def make(folder: Path) -> Path:
        from asammdf import MDF, Signal

        with MDF() as mdf:
            mdf.append([Signal(Q, TIME_s, unit="rad", name="q"), Signal(I, TIME_s, unit="A", name="i")], common_timebase=True)
            mdf.export("mat", folder / "log.mat", format=version, single_time_base=True, raster=None)
        return next(folder.glob("*.mat"))

    return make


def _mat(name: str, tool: str, make: Callable[[Path], Path], maps: tuple[str, ...] = (), **more: object) -> Foreign:
    return Foreign(f"mat-{name}", "MATLAB", tool, make, **{"known": as_put_in(names=PAIR) if maps else as_put_in(), "maps": maps} | more)


def tiq(time: str, position: str, current: str) -> tuple[str, ...]:
    """Return the maps of three names."""
    return f"{time}=time", f"{position}=position_roll", f"{current}=current_roll"


TIQ = tiq("t", "q", "i")
_SINGLE = {"position_roll": Known(Q, 1e-7), "current_roll": Known(I)}
FILES = [
    _mat("v5", "SciPy", scipy(NAMES)),
    _mat("v5-compressed", "SciPy", scipy(NAMES | {"note": "third run", "Ts": 1 / 256}, do_compression=True, oned_as="column")),
    _mat("v4", "SciPy", scipy({"t": TIME_s, "q": Q, "i": I, "note": "third run"}, format="4"), TIQ),
    _mat("v4-matrix", "SciPy", scipy({"data": np.column_stack([TIME_s, Q, I])}, format="4"),
         tiq("data(:,1)", "data(:,2)", "data(:,3)")),
    _mat("matrix-of-rows", "SciPy", scipy({"log": np.stack([TIME_s, Q, I, 0 * I])}), tiq("log(1,:)", "log(2,:)", "log(3,:)"),
         left=("log(4,:)",)),
    _mat("structure", "SciPy", scipy({"run": {"t": TIME_s, "drive": {"q": Q, "i": I}, "operator": "me"}}),
         tiq("run.t", "run.drive.q", "run.drive.i")),
    _mat("scope", "SciPy", scipy(scope()), tiq("ScopeData.time", "ScopeData.signals(1).values", "ScopeData.signals(2).values"),
         left=("tout",)),
    _mat("scope-by-labels", "SciPy", scipy(scope()), known=as_put_in(names=PAIR)),
    _mat("cells", "SciPy", scipy({"runs": cell(TIME_s, Q, I)}), tiq("runs{1}", "runs{2}", "runs{3}")),
    _mat("whole-numbers", "SciPy", scipy(NAMES | {"statusword_roll": STATUS.astype(np.uint16), "sparse": _OBJECT}),
         known=as_put_in() | {"statusword_roll": Known(STATUS.astype(float))}),
    _mat("complex-left", "SciPy", scipy(NAMES | {"frf": NAMES["time"] * 1j}), left=("frf",)),
    _mat("octave-v7", "Octave", octave("save -v7 log.mat t q i"), TIQ),
    _mat("octave-v6", "Octave", octave("save -v6 log.mat t q i"), TIQ),
    _mat("octave-v4", "Octave", octave("save -v4 log.mat t q i"), TIQ),
    _mat("octave-structures", "Octave", octave("save -v7 log.mat s", "s.t=t; s.d(1).v=single(q); s.d(2).v=i; s.ok=true(size(t));"),
         tiq("s.t", "s.d(1).v", "s.d(2).v"), known=_SINGLE, left=("s.ok",)),
    _mat("octave-cells", "Octave", octave("save -v6 log.mat c", "c={t,[q i]};"), tiq("c{1}", "c{2}(:,1)", "c{2}(:,2)")),
    _mat("octave-range-int", "Octave", octave("save -v7 log.mat n q i", "n=int32(0:383);"), tiq("n", "q", "i"),
         time_s=1.0 * np.arange(ROWS)),
    _mat("octave-text", "Octave", octave("save -text log.mat t q i"), TIQ),
    _mat("octave-text-structure", "Octave",
         octave("save log.mat s", "s.t=t; s.d.q=q; s.m=[q i]; s.note='third run'; s.e(1).v=int16([1 2]); s.e(2).v={t,z=3i};"),
         tiq("s.t", "s.d.q", "s.m(:,2)"), left=("s.m(:,1)",)),
    _mat("octave-hdf5", "Octave", octave("save -hdf5 log.mat t q i"), refused="save -v7"),
    _mat("7.3", "hdf5storage",
         store({"t": TIME_s[:, None], "run": {"q": Q[:, None], "i": I[None, :]}}), tiq("t", "run.q", "run.i")),
    _mat("7.3-cells", "hdf5storage", store({"c": cell(TIME_s[:, None], np.column_stack([Q, I]), "third run")}),
         tiq("c{1}", "c{2}(:,1)", "c{2}(:,2)")),
    _mat("7.3-vectors", "h5py", as_matlab(_vectors), tiq("t", "data(:,1)", "data(:,2)"), left=("brakes",)),
    _mat("7.3-structure", "h5py", as_matlab(_structures), tiq("run.time", "run.signals{1}", "run.signals{2}"),
         known=_SINGLE, left=("obj",)),
    _mat("lists", "mat4py", plain_lists, TIQ),
    _mat("export-4", "asammdf", exported("4"), ("timestamps=time", *TIQ[1:])),
    _mat("export-5", "asammdf", exported("5"), ("timestamps=time", *TIQ[1:])),
    _mat("export-7.3", "asammdf", exported("7.3"), ("timestamps=time", *TIQ[1:])),
]  # fmt: skip
