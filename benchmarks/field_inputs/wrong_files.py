"""Files that are something else than their name says, or not whole: the message names what was seen."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import can
import h5py
import numpy as np
from asammdf import MDF, Signal
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from drivers.serial.imu import ImuDriver
from drivers.serial.xbus import Reading, encode_reading
from drivers.settings import ImuPort
from field_inputs.kinds import RIGHT, WRONG, Input, Outcome, refused
from hil.errors import RecordingError, UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.exchange.dicom_file import read_xa
from hil.imaging.exchange.read_vectors import read_bare_vectors
from hil.machine import load_machine
from hil.recording import read_recording
from virtual_bus.serial.pipe import pipe

CARM = load_machine("carm")
PNG = b"\x89PNG\r\n\x1a\n" + bytes(64)
ROS_1 = b"#ROSBAG V2.0\n" + bytes(64)


def text(content: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(content) and None


def raw(content: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(content) and None


def cut_mf4(path: Path) -> None:
    with MDF(version="4.10") as file:
        file.append([Signal(np.arange(500.0), np.arange(500) / 256.0, unit="rad", name="position_roll")])
        file.save(path, overwrite=True)
    path.write_bytes(path.read_bytes()[:700])


def cut_blf(path: Path) -> None:
    with can.BLFWriter(path) as writer:
        for k in range(50):
            writer(can.Message(timestamp=1.0 + k, arbitration_id=0x80, is_extended_id=False))
    path.write_bytes(path.read_bytes()[:-40])


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["q"] = np.arange(9.0)


def angiography(path: Path, sop_class: str, **attributes: object) -> None:
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.SOPClassUID, data.SOPInstanceUID = sop_class, generate_uid()
    for name, value in attributes.items():
        setattr(data, name, value)
    data.save_as(path, enforce_file_format=True)


CT, XA, ENHANCED = "1.2.840.10008.5.1.4.1.1.2", "1.2.840.10008.5.1.4.1.1.12.1", "1.2.840.10008.5.1.4.1.1.12.1.1"
LOGS: list[tuple[str, str, Callable[[Path], None], tuple[str, ...]]] = [
    ("picture as MDF", "a.mf4", raw(PNG), ("no MDF file",)),
    ("empty MDF", "a.mf4", raw(b""), ("no MDF file",)),
    ("cut MDF", "a.mf4", cut_mf4, ("damaged",)),
    ("text as BLF", "a.blf", text("hello\n"), ("no BLF",)),
    ("cut BLF", "a.blf", cut_blf, ("cut off",)),
    ("ROS 1 bag as MCAP", "a.mcap", raw(ROS_1), ("no MCAP file",)),
    ("JSON as MCAP", "a.mcap", text("{}"), ("no MCAP file",)),
    ("text as SQLite bag", "a.db3", text("hello\n" * 40), ("no bag of ROS 2",)),
    ("HDF5 of another tool as MATLAB", "a.mat", hdf5, ("HDF5", "save -v7")),
    ("picture as MATLAB", "a.mat", raw(PNG), ("a.mat",)),
    ("BUSMASTER's own log", "a.log", text("***BUSMASTER Ver 3.2.2***\n"), ("BUSMASTER", "Format Converters")),
    ("any text as candump", "a.log", text("hello world\n"), ("line 1", "candump")),
    ("TRC of a version that is not known", "a.trc", text(";$FILEVERSION=9.9\n"), ("version 9.9", "2.1")),
    ("CSV without time", "a.csv", text("a,b\n1,2\n3,4\n"), ("time",)),
    ("CSV with a word for a number", "a.csv", text("time [s],position_roll [rad]\n0,1\n0.1,two\n"), ("line 3", "two")),
    ("CSV with a hole in time", "a.csv", text("time [s],position_roll [rad]\n0,1\n,2\n"), ("line 3", "time is missing")),
    ("suffix that is none", "a.xyz", text("hello"), (".mf4",)),
]
GEOMETRY: list[tuple[str, str, Callable[[Path], None], tuple[str, ...]]] = [
    ("CT as angiography", "a.dcm", partial(angiography, sop_class=CT), ("PositionerPrimaryAngle", "CT Image Storage")),
    (
        "angiography without angles",
        "a.dcm",
        partial(angiography, sop_class=XA, DistanceSourceToDetector="1195"),
        ("PositionerPrimaryAngle",),
    ),
    (
        "Enhanced XA without groups",
        "a.dcm",
        partial(angiography, sop_class=ENHANCED, NumberOfFrames="2"),
        ("frame 1 of 2", "PositionerPositionSequence"),
    ),
    ("fan-beam vectors of ASTRA", "a.npy", lambda path: np.save(path, np.zeros((3, 6))), ("fanflat_vec", "(N, 12)")),
    ("text as vectors", "a.npy", text("1 2 3"), (".npy",)),
]


def log(folder: Path, name: str, make: Callable[[Path], None], words: tuple[str, ...]) -> Outcome:
    make(folder / name)
    try:
        read_recording(folder / name, CARM)
    except (RecordingError, UnusableInputError) as refusal:
        return refused(str(refusal), *words)
    return Outcome(WRONG, "was read")


def geometry(folder: Path, name: str, make: Callable[[Path], None], words: tuple[str, ...]) -> Outcome:
    make(folder / name)
    try:
        read_xa(folder / name) if name.endswith(".dcm") else read_bare_vectors(folder / name, Detector(620, 480, 6e-4))
    except UnusableInputError as refusal:
        return refused(str(refusal), *words)
    return Outcome(WRONG, "was read")


def tracker(folder: Path, reading: Reading, words: str) -> Outcome:
    """An Xsens that leaves a field out."""
    near, far = pipe()
    driver = ImuDriver(ImuPort(name="imu", device="", baud=921600, triggered_by_sync=True, rate_Hz=256.0), near)
    far.write(encode_reading(reading))
    driver.before_sync()
    return Outcome(RIGHT, driver.first_malformed) if words in driver.first_malformed else Outcome(WRONG, driver.first_malformed)


FORCE, TURN = (0.0, 0.0, 9.81), (0.0, 0.0, 0.0)
INPUTS = [Input(name, "what was seen", "other tools", partial(log, name=file, make=make, words=words)) for name, file, make, words in LOGS]
INPUTS += [
    Input(name, "what was seen", "other tools", partial(geometry, name=file, make=make, words=words))
    for name, file, make, words in GEOMETRY
]
INPUTS += [
    Input(
        "tracker without sample time",
        "what was seen",
        "bytes",
        partial(tracker, reading=Reading(1, None, FORCE, TURN, None), words="1060h"),
    ),
    Input(
        "tracker without counter", "what was seen", "bytes", partial(tracker, reading=Reading(None, 1, FORCE, TURN, None), words="1020h")
    ),
]
