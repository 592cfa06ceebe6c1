"""The reference of file formats, from the code's tables of channels and keys and the declared ones of `format_tables`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator

from controllers.excitation_lines import Band
from docs.generate import format_tables as declared
from docs.generate.format_tables import ArrayFile, Entry
from docs.generate.machine_file import key_and_units, value_words
from docs.generate.markdown import block, code, number, table
from docs.generate.markdown import page as whole
from hil.experiments.file_tables import (
    BandTable,
    ExperimentTable,
    JogTable,
    MultisineTable,
    PeriodicTable,
    ScanTable,
    StaticTable,
    TourTable,
)
from hil.experiments.jog import Jog, JogOnly
from hil.experiments.multisine import Multisine
from hil.experiments.scan import Scan
from hil.experiments.static import Static
from hil.experiments.tour import Tour
from hil.machine.table import Table
from hil.recording.channels import KINDS, SI_OF

INTRODUCTION = """
This page lists what stands in every file that Isocenter reads and writes, so that other tools can read them. The
machine file and the effects file have pages of their own: [Machine file](machine-file.md), [Effects](effects.md).
`diagnosis.json` is on the page of [JSON answers](json.md). `.npz` files are NumPy archives; text in them is Unicode,
and JSON is one string.
"""

RECORDINGS_TEXT = """
A recording has one row per SYNC. It is written as MDF 4 (`.mf4`), CSV (`.csv`, with a `.toml` beside it), Parquet or
MCAP. All hold the same, and `isocenter convert A B` goes between them without loss. `A` in a channel's name is an axis of the
machine. A sample that did not arrive is missing: an empty cell, an invalidation bit, NaN once it is read. Other
channels are kept as they are, with their unit. Values are kept in the first unit given; other units are converted
when the file is read, and a unit that is not listed is refused.
"""

CSV_TEXT = """
UTF-8 text. Cells are separated by commas; the header's cells are `name [unit]`, or `name` for a plain number; a line
is a row. Numbers have as many digits as it takes to read back the same double; counters and statuswords are whole
numbers. Metadata are in the `.toml` of the same name. Without it, name the machine with `--machine`. A file with a
fault is refused with its line: a row with too few or too many cells, a cell that is no number, time that is missing
or does not increase, a channel twice, a unit that the channel cannot have.
"""

CSV_EXAMPLE = """
import numpy as np

table = np.genfromtxt("run.csv", delimiter=",", names=True, deletechars="", replace_space=" ")
time_s = table["time [s]"]
position_rad = table["position_roll [rad]"]  # NaN where the sample is missing
"""

MDF_TEXT = """
Version 4.10 with one channel group, whose master channel is `time`. Values are 64-bit floats, counters and
statuswords 64-bit integers. A missing sample has its invalidation bit set. The metadata are the attachment
`recording.toml`. Data blocks are compressed (deflate). The last 16 bytes are outside every block: `isocrc32`, the
CRC-32 of everything before as u32, and the number of bytes before as u32 modulo 2³², little endian. They are checked
where they are there; a tool that saves the file anew drops them. Of another tool's file,
signals of several rasters are put onto the raster with the machine's rate, without one onto that with most samples:
interpolated linearly, whole numbers held, and missing outside a signal's own time and where it lost samples.
"""

MDF_EXAMPLE = """
from asammdf import MDF

with MDF("run.mf4") as mdf:
    position = mdf.get("position_roll")  # .timestamps, .samples, .unit; missing samples are left out
    metadata = mdf.attachments[0].extract().decode()
"""

JOURNAL_TEXT = """
`run.mf4.part` (or `run.csv.part`) is the journal that becomes `run.mf4` when the recording is closed. It holds every
row that was handed to the disk, whatever is killed. Every command that reads `run.mf4` reads the journal where the
file is missing, and says so; `isocenter convert run.mf4 kept.mf4` makes a recording of it. A name whose journal holds
rows is refused for a new recording.
"""

JOURNAL_LAYOUT = """
ISOJRNL1, header length u32, CRC-32 of header u32, header
blocks of: ROWS, number of rows u32, CRC-32 u32, rows x channels float64
"""

JOURNAL_MORE = """
All is little endian. The header is the metadata with one more key, `journal_channels = [[name, unit], …]`, in the
order of columns. A block's CRC-32 covers its number of rows (as u32) and its values. Reading ends at the first block
that is incomplete or does not fit.
"""

OTHERS = (
    (
        "Parquet `.parquet`",
        "A column per channel, whose metadata have the `unit`; missing samples are null. The table's metadata `isocenter` are the "
        "recording's as TOML text. Tables of other tools need `--machine`; times of day count from the first row.",
    ),
    (
        "MCAP `.mcap`",
        "A JSON message per row on the topic `/isocenter/recording`, null for a missing sample; its JSON schema has a `unit` for each "
        "channel. The metadata are the attachment `recording.toml`.",
    ),
    (
        "Bag of ROS 2: `.mcap`, `.db3`, or the folder",
        "With `--machine`. Of sensor_msgs/JointState, joints with the axes' names become `position_A`, `speed_A`, and `current_A` or "
        "`effort_A` in the drive's unit. Others are named by `--map '/joint_states.position[joint]=position_A'`. Times are the headers' "
        "stamps, without them those of logging. MCAP files with JSON messages are read likewise, `/topic.field`. Files or messages may be "
        "compressed by zstd.",
    ),
    (
        "MATLAB `.mat`",
        "With `--machine` for axes and units. Variables bear the names of channels, or `--map` says which is which: `q`, `log.time`, "
        "`log.signals(2).values`, `runs{3}`, `data(:,2)`, `data(2,:)`. Simulink's structures with time whose labels are channels, and the "
        "variables of the EMPS benchmark, are known. Scalars are kept in the metadata under `source.constants`. Versions 4 to 7.3, and "
        "the text that Octave saves. Of a Modelica tool's result the trajectories by their names, in the units of their descriptions.",
    ),
    (
        "CAN log: candump (`.log`), Vector `.blf` and `.asc`, PEAK `.trc`, python-can's `.csv` and `.db`, MDF 4 with nothing but frames",
        "With `--machine` the PDOs are decoded by the machine file's maps: SYNC k opens row k, TPDOs up to the next SYNC are its samples, "
        "RPDOs its commands. `time` counts periods. Without a machine every frame is a row of raw CAN frames. What candump prints is "
        "read with any time stamp or none. In an MDF 4 with signals beside them, frames are not taken.",
    ),
    (
        "CSV of other tools, without a `.toml` beside it",
        "Separated by commas, semicolons, tabs or bars; decimal commas or points, with marks between thousands; UTF-8, UTF-16 or Windows' "
        "code page 1252. Comments above the header begin with `#` or `%`. A row of units below the header, names of rows, times of day "
        "(ISO 8601) and words for missing numbers (`NA`, `NULL`) are known. Whether the mark of `1,234` is of decimals, other numbers tell "
        "(`0,5`; `1,000.0`); where none does, points are of decimals in a table that commas separate, and all else is refused.",
    ),
    (
        "MDF 3 and 4 of other tools, `.mf4`, `.mdf`, `.dat`",
        "With `--machine`. Signals of several rates go onto the rows of the machine's rate; the notes say how.",
    ),
    (
        "File of names, `--map FILE`",
        'TOML, a table `[channels]`: name in the file to `"CHANNEL [unit]"`, or to a table of `channel`, `unit`, `scale` and `offset`: '
        "channel = scale × signal + offset, in that unit. Without a unit it is the file's, else that in the name (`position_deg`, "
        "`Speed (rpm)`, `Iq_mA`), else the machine's; times without one have that in which they have "
        "the machine's rate. Units may be spelled as "
        "other tools do (`°`, `RPM`, `N·m`); `counts` have the size of the machine file's encoder, `%` and `permille` are of the rated "
        "effort.",
    ),
    (
        "Order and time stamps of any log of another tool",
        "Both are kept. Samples that stand elsewhere than their stamps say are put in their order where that makes an even raster; long "
        "stretches behind stamps that go back are a clock that was set, and go on one step later, or by the other clock of a bag. Copies "
        "are taken once, stamps coarser than the samples spread, a SYNC that was lost put in, gaps told. Two senders of a signal (told by "
        "channel, frame, joints, rate, or a column that says whose a line is) are refused with the option that takes one: of a bag "
        "`--map 'SIGNAL@1=CHANNEL'`, of other files `--map @1=part`, `--map can0=part`, `--map joint@roll=part`.",
    ),
)

EVENTS_TEXT = """
`run.events.jsonl` stands beside `run.mf4`: a JSON object per line, in the order in which things happened. Every one
has `time_s` since the session began, `who` (`operator`, `bench`, `loop`, `drivers` or a device) and `what`; other keys
depend on it: `reason` of `stop asked`, `sensor`, `check`, `says` and `row_time_s` of `sensor judged`, `finding` of
`commissioned`, `error` of `session failed`. On the wall clock `session started` has the time of day, `utc`. At most
1024 events are kept, the first 256 and the newest; `events dropped` then says how many are missing.
"""

TRUTH_TEXT = """
`run --bus lockstep: --truth FILE` writes what only the emulator knows: a CSV file with header cells `name [unit]` and
a row per recorded row. `emulate --truth FILE` writes every SYNC since power-on. `time` is the emulated machine's own.
`run --frame-log FILE` writes the frames as lines of `candump -l`: `(0.003906) vcan0 181#3902…`, with seconds in six
decimals and identifiers of three (11 bits) or eight (29 bits) hexadecimal digits.
"""

EXPERIMENT_TEXT = """
`isocenter run file FILE` takes an experiment from a TOML file; `diagnose`, `calibrate scan` and `calibrate grid`
write one. Keys end in their unit as in the machine file; `[pose]` and the other tables by axis have a key per axis,
`roll_deg`. A key that is left out has its default.
"""

EXPERIMENT_EXAMPLE = """
format = 1
kind = "multisine"
period_s = 20.0
periods = 4
amplitude_A = 0.8

[band]
low_Hz = 0.5
high_Hz = 30.0

[pose]
roll_deg = 30.0
"""

VOLUME_TEXT = """
`volume.mha` of `isocenter reconstruct` is a MetaImage: attenuation [1/m] in single precision, voxels in millimetres.
The voxels run along a frame of its own whose y is the scan's axis; `TransformMatrix` and `Offset` put it into the
phantom's frame, as 3D Slicer and ITK-SNAP read it.

A sinogram of `isocenter plane` is an `.npz` of `projections` (views, bins), line integrals without a unit,
`angles_rad` (views,), and `spacing_m` of parallel bins, which count along (cos, sin) from the origin at bin bins // 2;
or, of a fan, the source's `angles_rad`, its distance `source_m` from the origin, and `psi_rad` (bins,), each ray's angle
from the central one, counterclockwise. Its `image.npz` has `image_1_m`, rows along y, and `spacing_m`.
"""

MATRICES_TEXT = """
`isocenter geometry convert` reads and writes 3 × 4 projection matrices from the phantom's coordinates [mm] to columns
and rows times the depth from the focal spot [mm]; other scales and signs are read. A `.csv` has the header
`exposure_id,m00,m01,...,m23` and a row per exposure. A `.json` has `format` 1, `unit` "mm", `detector` (as in
`scan.toml`, optional) and `matrices` (N, 3, 4). `.xml` is RTK's geometry, `.dcm` has the attributes of X-ray
angiography, or of Enhanced XA frame by frame. `.npz` may have the arrays of ASTRA's cone_vec (a `.npy` its vectors
alone), LEAP's modular beam or TIGRE's geometry by their names, lengths in mm; `--for` writes them.
"""

PANEL_TEXT = """
A panel at `tcp:HOST:PORT` has one host at a time. It greets the host with a header that is all zero behind its mark,
and is told lines of text: `expose RATE BINNING` (exposures a second; N × N pixels read as one) and `stop`. It sends
frames, little endian: the mark `IXF1`, number (u32), rows and columns (u16 each), count of the SYNC at which the
exposure's pulse was seen, since the last NMT start (u64), start and width by its own clock [s] (f64 each), then rows
× columns pixels (u16), row 0 first. After `stop` and the last frame comes a header without rows and columns, whose
number is that of the exposures there were.
"""

# kind of experiment, its table, the class whose defaults it has, and the keys that the machine's axes make
_EXPERIMENTS: tuple[tuple[str, type[Table], type | None, tuple[str, ...]], ...] = (
    ('kind = "multisine"', MultisineTable, Multisine, ("pose", "amplitudes")),
    ('kind = "jog"', PeriodicTable, JogOnly, ("pose",)),
    ('kind = "scan"', ScanTable, Scan, ("pose",)),
    ('kind = "static"', StaticTable, Static, ("pose",)),
    ('kind = "move"', ExperimentTable, None, ("start", "goal")),
    ('kind = "tour"', TourTable, Tour, ("stops",)),
    ("[band]", BandTable, Band, ()),
    ("[jog]", JogTable, Jog, ()),
)


def page() -> str:
    """Write the page."""
    parts = [INTRODUCTION, "## Recordings", RECORDINGS_TEXT, table(("channel", "units", "meaning"), [*_channels(), *_others()])]
    parts += ["### Metadata", "TOML, the same in both formats.", _entries(declared.METADATA, ("key", "type", "meaning"))]
    parts += ["### CSV", CSV_TEXT, "NumPy alone reads it:", block(CSV_EXAMPLE, "python")]
    parts += ["### MDF 4", MDF_TEXT, block(MDF_EXAMPLE, "python")]
    parts += ["### Journal of a recording that is being made", JOURNAL_TEXT, block(JOURNAL_LAYOUT), JOURNAL_MORE]
    parts += [
        "### Other files that are read as recordings",
        table(("file", "how it is read"), OTHERS),
        "### EVENTS: the audit trail of a run",
        EVENTS_TEXT,
        "### Truth and frame logs",
        TRUTH_TEXT,
    ]
    parts += ["## Experiment files", EXPERIMENT_TEXT, block(EXPERIMENT_EXAMPLE, "toml")]
    for title, kind, made, by_axis in _EXPERIMENTS:
        parts += [f"### {title}", table(("key", "unit", "value", "default", "meaning"), _experiment(title, kind, made, by_axis))]
    for file in declared.ARRAY_FILES:
        parts += _archive(file)
        if file is declared.EST:
            parts.append(_entries(declared.ESTIMATES, ("column", "unit", "meaning")))
    parts += ["## SCAN: a folder of images", _entries(declared.SCAN, ("file", "format", "content"))]
    parts += ["## Panels on the network", PANEL_TEXT, "## Projection matrices", MATRICES_TEXT, "## Reconstructed volumes", VOLUME_TEXT]
    return whole("File formats", *parts)


def _channels() -> Iterator[tuple[str, str, str]]:
    for kind in KINDS:
        names, meaning = declared.CHANNELS[kind.pattern]
        units = sorted((unit for unit in kind.units if unit), key=lambda unit: unit in SI_OF)
        yield ", ".join(code(name) for name in names.split(", ")), ", ".join(units) or ("whole number" if kind.whole else ""), meaning


def _others() -> Iterator[tuple[str, str, str]]:
    for entry in declared.OTHER_CHANNELS:
        yield code(entry.name), entry.shape, entry.meaning


def _archive(file: ArrayFile) -> Iterator[str]:
    yield f"## {file.title}"
    writers = ", ".join(code(each) for each in file.writer.split(", ") if each)
    yield f"A NumPy archive (`.npz`) of {writers}. {file.text}" if writers else file.text
    yield _entries(file.arrays, ("array", "shape", "meaning"))
    if file.example:
        yield "NumPy alone reads it:"
        yield block(file.example, "python")


def _entries(entries: Iterable[Entry], header: tuple[str, str, str]) -> str:
    return table(header, ((", ".join(code(name) for name in each.name.split(", ")), each.shape, each.meaning) for each in entries))


def _experiment(title: str, kind: type[Table], made: type | None, by_axis: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    defaults = {} if made is None else {field.name: field for field in dataclasses.fields(made)}
    for name, info in kind.model_fields.items():
        key, units = key_and_units(name, info)
        field = defaults.get(_field_name(name, defaults))
        default = "required" if info.is_required() else _default(field)
        meaning = declared.EXPERIMENT_KEYS.get(f"{title} {name}", declared.EXPERIMENT_KEYS[name])
        yield key, units, value_words(info), default, meaning
    for name in by_axis:
        words = "tables by axis" if name == "stops" else "table by axis"
        yield code(f"[[{name}]]" if name == "stops" else f"[{name}]"), "", words, "none", declared.EXPERIMENT_KEYS[name]


def _field_name(key: str, fields: Iterable[str]) -> str:
    """Return the field of an experiment that a key is for: `period` for `period_s`."""
    if key == "duration":
        return "seconds"
    return next((name for name in fields if name == key or name.rpartition("_")[0] == key), key)


def _default(field: dataclasses.Field[object] | None) -> str:
    value = None if field is None else field.default
    if isinstance(value, bool):
        return code(str(value).lower())
    if isinstance(value, str):
        return code(f'"{value}"')
    if isinstance(value, int | float):
        in_degrees = {"amplitude_rad": "deg", "speed": "deg/s"}
        unit = in_degrees.get(field.name, "") if field is not None else ""
        return code(f"{number(round(math.degrees(value), 6))} {unit}" if unit else number(value))
    return "none"
