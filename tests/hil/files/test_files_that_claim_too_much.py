"""Devices in place of files, and files that claim more than they hold: one line within a second, and no memory is taken for them."""

from __future__ import annotations

import io
import os
import resource
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import asammdf  # noqa: F401  the readers import both when first asked: not what is timed here
import numpy as np
import pydicom  # noqa: F401
import pytest

from drivers.canopen.eds import load_object_dictionary
from drivers.errors import ProtocolError
from drivers.imaging.spool import FrameSpool, SpoolError
from hil.emulated.images import xray_side
from hil.errors import RecordingError, UnusableInputError
from hil.experiments.file import read_experiment
from hil.files.arrays import read_arrays
from hil.imaging.detector import Detector
from hil.imaging.exchange.dicom_file import read_xa
from hil.imaging.exchange.rtk_xml import read_rtk
from hil.imaging.scan_folder import EXPOSURES, FRAMES, read_scan, write_description
from hil.machine import load_machine
from hil.recording import read_recording
from hil.recording.formats import READABLE, write_recording
from hil.recording.recording import Channel, Recording
from virtual_bus.xray.motion import FocalSpot

NO_SPOT = FocalSpot(np.zeros(3), 1.0, np.zeros(3), 0.0)
PANEL = Detector(columns=8, rows=6, pitch_m=1e-3)
SOON_S = 1.0  # of processor time
MORE_MEMORY_kB = 64_000


def refused(error: type[Exception], words: str, read: Callable[[], object]) -> None:
    """One line, soon, and without the memory that was claimed."""
    before_kB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin_s = time.process_time()
    with pytest.raises(error, match=words) as caught:
        read()
    assert time.process_time() - begin_s < SOON_S
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kB < MORE_MEMORY_kB
    assert "\n" not in str(caught.value)


@pytest.fixture
def mf4(tmp_path: Path) -> bytes:
    time_s = np.arange(100) / 256.0
    path = tmp_path / "good.mf4"
    write_recording(Recording({"time": Channel("s", time_s), "x": Channel("", np.sin(time_s))}, {"machine": {}}), path)
    return path.read_bytes()[:-16]  # without the seal, as another tool writes it


@pytest.mark.parametrize("suffix", [*READABLE, ".mf4.part"])
def test_a_device_or_pipe_is_no_recording(tmp_path: Path, suffix: str) -> None:
    zero, pipe = tmp_path / f"zero{suffix}", tmp_path / f"pipe{suffix}"
    zero.symlink_to("/dev/zero")
    os.mkfifo(pipe)
    for path in (zero, pipe):
        refused(RecordingError, "is a device, pipe or socket and no regular file", lambda path=path: read_recording(path))


def test_a_device_is_no_other_file_either(tmp_path: Path) -> None:
    for name in ("machine.toml", "device.eds", "frf.npz", "geometry.xml", "image.dcm", "truth.csv", EXPOSURES, FRAMES):
        (tmp_path / name).symlink_to("/dev/zero")
    refused(UnusableInputError, "no regular file", lambda: load_machine(tmp_path / "machine.toml"))
    refused(UnusableInputError, "no regular file", lambda: read_experiment(tmp_path / "machine.toml", load_machine("carm")))
    refused(UnusableInputError, "no regular file", lambda: read_arrays(tmp_path / "frf.npz", "a frequency response"))
    refused(ProtocolError, "an EDS or DCF is a regular file", lambda: load_object_dictionary(tmp_path / "device.eds", 1))
    refused(UnusableInputError, "no regular file", lambda: read_rtk(tmp_path / "geometry.xml"))
    refused(UnusableInputError, "no regular file", lambda: xray_side(load_machine("carm"), tmp_path / "truth.csv", NO_SPOT, 0.0))
    refused(UnusableInputError, "no regular file", lambda: read_xa(tmp_path / "image.dcm"))
    write_description(tmp_path, PANEL, (), {})
    refused(UnusableInputError, "exposures.csv: is a device", lambda: read_scan(tmp_path))
    (tmp_path / EXPOSURES).unlink()
    (tmp_path / EXPOSURES).write_text("exposure_id,start [s],width [s]\n0,0.0,0.008\n")
    refused(UnusableInputError, "no regular file", lambda: read_scan(tmp_path).frame(0))


def test_an_image_that_claims_terabytes(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    write_description(tmp_path, PANEL, (), {})
    (tmp_path / EXPOSURES).write_text("exposure_id,start [s],width [s]\n0,0.0,0.008\n")
    tifffile.imwrite(tmp_path / FRAMES, np.zeros((PANEL.rows, PANEL.columns), np.uint16))
    assert read_scan(tmp_path).frame(0).shape == (PANEL.rows, PANEL.columns)
    with tifffile.TiffFile(tmp_path / FRAMES, mode="r+b") as file:
        for name in ("ImageWidth", "ImageLength"):
            file.pages[0].tags[name].overwrite(2**20)
    refused(UnusableInputError, "image 0 is 1048576 x 1048576; scan.toml says 8 x 6", lambda: read_scan(tmp_path).frame(0))


@pytest.mark.parametrize("suffix", [*READABLE, ".mf4.part"])
def test_a_sparse_file_of_8_terabytes_is_not_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"sparse{suffix}"
    path.touch()
    os.truncate(path, 8 * 2**40)
    refused(RecordingError, "8796093022208 bytes; at most 2147483648 are read into memory", lambda: read_recording(path))


@pytest.mark.parametrize(("offset", "width"), [(8, "<Q"), (24, "<I")], ids=["cycles", "bytes per cycle"])
def test_an_mf4_whose_headers_claim_terabytes(tmp_path: Path, mf4: bytes, offset: int, width: str) -> None:
    content = bytearray(mf4)
    group = content.find(b"##CG")
    links = struct.unpack_from("<Q", content, group + 16)[0]
    struct.pack_into(width, content, group + 24 + 8 * links + offset, 2**40 if width == "<Q" else 2**32 - 1)
    path = tmp_path / "claims.mf4"
    path.write_bytes(content)
    refused(RecordingError, r"its headers claim \d{12,} bytes of samples; a file of \d+ bytes has at most", lambda: read_recording(path))


def header(shape: tuple[int, ...]) -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return content.getvalue()


def test_an_npz_that_unpacks_to_two_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "frame_0.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header((2**28,)) + bytes(2**20))
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, content.find(b"PK\x01\x02") + 24, 2**31 + 128)  # the directory's size of its one file
    path.write_bytes(content)
    refused(UnusableInputError, "claim 2147483776 bytes unpacked", lambda: read_arrays(path, "a frequency response"))
    refused(SpoolError, "claims 2147483776 bytes unpacked", FrameSpool(tmp_path).poll)


def test_an_array_whose_header_claims_8_terabytes(tmp_path: Path) -> None:
    path = tmp_path / "frame_1.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", header((2**40,)) + bytes(80))
    refused(UnusableInputError, "no whole archive of NumPy arrays", lambda: read_arrays(path, "a frequency response"))
    (tmp_path / "a.npy").write_bytes(header((2**40,)))
    refused(UnusableInputError, "no whole archive of NumPy arrays", lambda: read_arrays(tmp_path / "a.npy", "a frequency response"))


def mat(name: bytes, body: bytes) -> bytes:
    inner = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 1, 2**30) + struct.pack("<II", 1, 4) + name.ljust(8, b"\0")
    inner += struct.pack("<II", 9, len(body) & 0xFFFFFFFF)
    return struct.pack("<II", 14, len(inner) + len(body) & 0xFFFFFFFF) + inner + body


def test_a_mat_that_claims_terabytes_or_unpacks_to_more_than_fits(tmp_path: Path) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    carm = load_machine("carm")
    claims = tmp_path / "claims.mat"
    claims.write_bytes(head + mat(b"time", bytes(16)))
    refused(RecordingError, "damaged", lambda: read_recording(claims, carm))
    packer = zlib.compressobj(1)
    packed = b"".join(packer.compress(bytes(2**20)) for _ in range(300)) + packer.flush()
    bombed = tmp_path / "bomb.mat"
    bombed.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(RecordingError, match="a variable of more than 268435456 bytes"):
        read_recording(bombed, carm)


def nested(levels: int) -> bytes:
    """Structures in structures, each with the one field `a`."""
    inner = b""
    for _ in range(levels):
        parts = struct.pack("<IIII", 6, 8, 2, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 0)
        parts += struct.pack("<III", 5 | 4 << 16, 2, 1) + struct.pack("<I", 2) + b"a".ljust(8, b"\0")
        inner = struct.pack("<II", 14, len(parts) + len(inner)) + parts + inner
    return inner


def test_structures_of_a_mat_in_great_number_or_depth(tmp_path: Path) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    carm = load_machine("carm")
    deep = tmp_path / "deep.mat"
    deep.write_bytes(head + nested(2000))
    refused(RecordingError, "deep", lambda: read_recording(deep, carm))
    cells = struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 2**20) + struct.pack("<IIQ", 1, 1, 0x63)
    many = tmp_path / "many.mat"
    many.write_bytes(head + struct.pack("<II", 14, len(cells) + 8 * 2**20) + cells + struct.pack("<II", 14, 0) * 2**20)
    refused(RecordingError, "more than 100000 arrays", lambda: read_recording(many, carm))


def test_a_matlab_7_3_file_that_claims_terabytes_or_goes_round_in_circles(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    carm = load_machine("carm")
    for name, shape in (("claims", (1, 2**40)), ("round", (1, 4))):
        with h5py.File(tmp_path / f"{name}.mat", "w", userblock_size=512) as file:
            file.create_dataset("time", shape=shape, dtype="f8", chunks=(1, 4))
            if name == "round":
                group = file.create_group("again")
                group["again"] = group
        content = bytearray((tmp_path / f"{name}.mat").read_bytes())
        content[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
        (tmp_path / f"{name}.mat").write_bytes(content)
    refused(RecordingError, r"variable time claims 8796093022208 bytes", lambda: read_recording(tmp_path / "claims.mat", carm))
    refused(RecordingError, "structures more than 32 deep", lambda: read_recording(tmp_path / "round.mat", carm))


def test_a_parquet_of_hundreds_of_millions_of_holes(tmp_path: Path) -> None:
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "holes.parquet"
    block = arrow.table({f"c{k}": arrow.nulls(2**20) for k in range(300)})
    parquet.write_table(block, path)
    assert path.stat().st_size < 1_000_000
    refused(RecordingError, "claims 1048576 rows of 300 columns", lambda: read_recording(path, load_machine("carm")))


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4"])
def test_an_mcap_whose_chunk_unpacks_to_gigabytes(tmp_path: Path, compression: str) -> None:
    writing = pytest.importorskip("mcap.writer")
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as file:
        writer = writing.Writer(file, chunk_size=2**30, compression=writing.CompressionType[compression])
        writer.start()
        channel = writer.register_channel("/x", "json", 0)
        writer.add_message(channel, 0, bytes(2**28 + 1), 0)
        writer.finish()
    refused(
        RecordingError, "a chunk of .* claims 268435.*; a chunk has at most 268435456", lambda: read_recording(path, load_machine("carm"))
    )
    content = bytearray(path.read_bytes())
    place = content.find(b"\x06", 20) + 9 + 16
    struct.pack_into("<Q", content, place, 100)  # the chunk's own size; the packed data say theirs
    path.write_bytes(content)
    refused(RecordingError, "damaged|claims 268435", lambda: read_recording(path, load_machine("carm")))


def plain(count: int) -> str:
    entries = (f"[{0x2000 + k:04X}]\nParameterName=O {k}\nDataType=7\nAccessType=rw\nDefaultValue=0\nPDOMapping=0\n" for k in range(count))
    return "[DeviceInfo]\nVendorName=x\n" + "".join(entries)


@pytest.mark.parametrize("megabytes", [0.1, 2.3])
def test_an_eds_of_compact_arrays_does_not_stand_for_millions_of_objects(tmp_path: Path, megabytes: float) -> None:
    path = tmp_path / "compact.eds"
    array = "[{:04X}]\nParameterName=O\nObjectType=8\nDataType=7\nCompactSubObj=254\n"
    text = "[DeviceInfo]\nVendorName=x\n" + "".join(array.format(0x2000 + k) for k in range(min(40_000, int(megabytes * 1e6 / 63))))
    path.write_text(text.ljust(int(megabytes * 1e6), ";"))
    refused(ProtocolError, r"\d+ objects and subindices, compact arrays written out: a data sheet has at most 16384", lambda: load(path))


def load(path: Path) -> object:
    return load_object_dictionary(path, 1)


def test_an_eds_of_two_megabytes_of_objects_is_refused_and_one_of_a_thousand_is_read(tmp_path: Path) -> None:
    path = tmp_path / "large.eds"
    path.write_text(plain(31_000))
    assert path.stat().st_size > 2_300_000
    refused(ProtocolError, "31000 objects and subindices", lambda: load(path))
    path.write_text(plain(1000))
    assert len(load_object_dictionary(path, 1)) == 1000
