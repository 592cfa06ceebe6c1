"""What stands in the project's files: arrays, channels and keys with shapes, units and meanings.

`tests/docs` writes a file of each kind with the project's own writer and compares its names with these tables.
"""

from __future__ import annotations

from typing import NamedTuple


class Entry(NamedTuple):
    """An array, column or key: its name, shape or unit, and meaning."""

    name: str
    shape: str
    meaning: str


class ArrayFile(NamedTuple):
    """A NumPy archive: who writes it, its arrays, and how NumPy alone reads it. `A` in a name stands for an axis."""

    title: str
    writer: str
    text: str
    arrays: tuple[Entry, ...]
    example: str = ""


CHANNELS = {
    "time": ("time", "Tick number times period, 0 in row 0; skipped ticks leave a gap. Complete and increasing."),
    "reference_.+": ("reference_A, reference_raw_A", "Reference that the controller gets, and the reference before any shaper."),
    "excitation_.+": ("excitation_A", "Excitation w, added after feedback and feedforward, before saturation."),
    "feedforward_.+": ("feedforward_A", "Feedforward."),
    "damping_(?!share$).+": ("damping_A", "What the observer's damping added to the command, before saturation."),
    "command_.+": ("command_A", "What the loop computed from this row, saturated; it acts from the next row on."),
    "velocity_offset_.+": ("velocity_offset_A", "Of a CAN log: velocity that a master added behind the position loop (60B1h)."),
    "current_.+": ("current_A", "What a drive measured that is commanded in ampere."),
    "effort_.+": ("effort_A", "What a drive measured that is commanded in V, Nm or N."),
    "position_.+": ("position_A", "Position on the motor side, at the joint."),
    "link_position_.+": ("link_position_A", "Position of the link encoder, where there is one."),
    "speed_.+": ("speed_A", "Speed sensor, where there is one."),
    r"imu_(\w+_)?[xyz]": ("imu_x, imu_y, imu_z", "Specific force in the IMU's frame; of a further IMU `imu_NAME_x` and so on."),
    r"gyro_(\w+_)?[xyz]": ("gyro_x, gyro_y, gyro_z", "Angular rate in the IMU's frame; of a further IMU `gyro_NAME_x` and so on."),
    r"imu_(\w+_)?time": ("imu_time", "The IMU's own clock; of `imu_NAME_time`, of an IMU on the bus, the time of its SYNC."),
    r"imu_(\w+_)?counter": ("imu_counter", "The IMU's sample counter, likewise `imu_NAME_counter`."),
    "temperature_.+": ("temperature_A", "Temperature of the winding."),
    "statusword_.+": ("statusword_A", "CiA 402 statusword."),
    "data_age_.+": ("data_age_A", "Age of the newest good value of the axis."),
    "sync_lateness": ("sync_lateness", "Lateness of this row's SYNC against its absolute time."),
    "work_time|answer_time": (
        "work_time, answer_time",
        "Time from SYNC until the loop was ready to wait again, and until all answers were there.",
    ),
    "sensor_marks": ("sensor_marks", "Bit field: bit k is set while sensor k of the metadata's `judged.sensors` is not to be believed."),
    "exposure_id": ("exposure_id", "X-ray exposure that this row belongs to."),
    "can_id|can_length|can_extended|can_remote|can_fd|byte_[0-9]+": (
        "can_id, can_length, can_extended, can_remote, can_fd, byte_0, byte_1, …",
        "Of a table of raw CAN frames: a row per frame; `can_fd` where one is of CAN FD.",
    ),
}
"""Pattern of a kind of channel in `hil.recording.channels` to its names and meaning; `A` is an axis."""

OTHER_CHANNELS = (
    Entry("estimate_*", "its own", "An observer's estimates and their variances: the columns of an EST file, below."),
    Entry("damping_share", "", "Share of the observer's damping in force, 0 to 1."),
    Entry(
        "deviation_source_u … _w",
        "m",
        "Live calibration: focal spot in the detector's frame, off the nominal geometry; each with `_variance`.",
    ),
    Entry("deviation_phantom_u … _w", "m", "The same of the isocentre."),
    Entry("deviation_rotation_u … _w", "rad", "The same of the detector's rotation, a rotation vector in its own frame."),
    Entry("deviation_images", "", "Images taken into account so far."),
)

METADATA = (
    Entry("recording_format", "number", "1; marks the text as the metadata of a recording."),
    Entry("software", "text", "Name and version of what recorded."),
    Entry("emulated", "true", "Only where an emulator was the machine."),
    Entry("started", "text", "Time of day of row 0, ISO 8601 with zone. Absent in virtual time."),
    Entry("rows", "number", "CSV only: number of rows; fewer in the file mean that it was cut off."),
    Entry("machine", "table", "`name`, `hash` (SHA-256 of the text), `axes` in order, and the machine file's whole `text`."),
    Entry(
        "experiment",
        "table",
        "`kind`, `period_samples`, `settle_periods`, `periods`, `realisation`, `realisations`, `experiment` (column of the excitation "
        "matrix), `experiments`, `excited_lines`, `seed`, `amplitude`, `start_pose` and others of the experiment.",
    ),
    Entry(
        "experiment.settle_rows", "number", "The first rows only settle: `diagnose` simulates them and does not judge them. 0 where absent."
    ),
    Entry(
        "initial",
        "table",
        "States at row 0: `controller_states`, `brakes`, the emulator's `seed`, `speeds` of a recording that begins in motion, and "
        "`standing.deviation` and `standing.speed` of the axes about the start pose.",
    ),
    Entry("observer", "table", "Of a run with an observer: `design`, `filter`, `adapted_modes`, `damping`, `calibration`."),
    Entry("judged.sensors", "list", "What was judged, in the order of the bits of `sensor_marks`."),
    Entry(
        "judged.findings",
        "list",
        "Of every check that a sensor failed: `sensor`, `check`, `says` in words, `follows`, `since_s` from which the readings are in "
        "doubt, `first_s` and `last_s` of the marked rows, and how many `rows` are marked.",
    ),
    Entry("events", "list", "The audit trail, as in the EVENTS file."),
    Entry("ended.error", "text", "Only of a run that did not end as planned: why."),
    Entry("rows_lost", "number", "Only if rows found the recorder's buffer full: how many."),
    Entry("recovered", "table", "Only if read from the journal of a recording that was cut short: `rows`, `unread_bytes`."),
    Entry("kind", "text", '`"can_frames"` for a table of raw CAN frames.'),
)

FRF = ArrayFile(
    "FRF: frequency responses",
    "isocenter identify",
    "L excited lines, n_y outputs, n_u inputs; in closed loop n_z = n_y + n_u, in open loop n_z = n_y. vec(G) stacks columns: element "
    "(i, j) of G has index j n_y + i. Covariances are of the estimate with all averaging counted, E[e eᴴ], so a diagonal element is the "
    "variance of a complex number. What the data could not tell is absent: without a second period there is no noise covariance. "
    "`isocenter convert` writes the same arrays as `.mat`, for `frd(permute(G, [2 3 1]), frequencies_Hz, 1 / sample_rate_Hz, "
    "'FrequencyUnit', 'Hz')`, and G as `.uff` or `.unv` (Universal File Format, data set 58, text: response node i is output i, "
    "reference node j input j; six digits of the frequency where lines are uneven).",
    (
        Entry("format", "", "1."),
        Entry("lines", "(L,)", "Excited harmonics of `sample_rate_Hz` / `period_samples`."),
        Entry("frequencies_Hz", "(L,)", "Their frequencies."),
        Entry(
            "G",
            "(L, n_y, n_u) complex",
            "Response from `input_names` to `output_names`, in `output_units` per `input_units`. It starts at "
            "the command of row k and ends at the sample of row k, so the tick that the command waits is in it.",
        ),
        Entry("G_wz", "(L, n_z, n_u) complex", "Closed-loop response from the excitation to outputs, then inputs."),
        Entry("noise_covariance", "(L, n_y n_u, n_y n_u) complex", "Covariance of vec(G) by noise. Optional."),
        Entry("total_covariance", "(L, n_y n_u, n_y n_u) complex", "Covariance of vec(G) by noise and nonlinear distortion. Optional."),
        Entry(
            "nonlinear_covariance",
            "(L, n_y n_u, n_y n_u) complex",
            "By stochastic nonlinear distortion: of one realisation (BLA, robust methods), of the estimate (fast local methods). Optional.",
        ),
        Entry(
            "noise_covariance_z",
            "(L, n_z, n_z) complex",
            "Of one column of the averaged outputs and inputs, as Fourier coefficients (half an amplitude). Optional.",
        ),
        Entry("total_covariance_z", "(L, n_z, n_z) complex", "The same with nonlinear distortion. Optional."),
        Entry("noise_dof", "(L,)", "Complex degrees of freedom of the noise covariance; 0 where there is none."),
        Entry("total_dof", "(L,)", "The same of the total covariance."),
        Entry("distortion_lines", "(K,)", "Lines of the band that were not excited. Optional, with the four that follow."),
        Entry("distortion_frequencies_Hz", "(K,)", "Their frequencies."),
        Entry(
            "distortion_level",
            "(K, n_y)",
            "Mean square of the Fourier coefficient there, less noise. Even lines hold even distortion when only odd lines are excited.",
        ),
        Entry("distortion_noise", "(K, n_y)", "The noise's share of the mean square."),
        Entry("distortion_dof", "", "Records averaged."),
        Entry("output_names", "(n_y,)", "Channels of the outputs."),
        Entry("input_names", "(n_u,)", "Channels of the inputs."),
        Entry("output_units", "(n_y,)", "Units of the outputs."),
        Entry("input_units", "(n_u,)", "Units of the inputs."),
        Entry("sample_rate_Hz", "", "Sample rate."),
        Entry("period_samples", "", "Samples of a period."),
        Entry("pose", "(axes,)", "Pose in rad or m; empty where it is not known."),
        Entry("method", "", "Name of the method."),
        Entry("settings", "JSON", "Settings of the method."),
        Entry("notes", "(any,)", "What a user should know."),
    ),
    """
import numpy as np

frf = np.load("carm.frf.npz")
n_y = frf["G"].shape[1]
i, j = list(frf["output_names"]).index("position_roll"), list(frf["input_names"]).index("command_roll")
magnitude = np.abs(frf["G"][:, i, j])
deviation = np.sqrt(frf["noise_covariance"][:, j * n_y + i, j * n_y + i].real)
""",
)

SHAPER = ArrayFile(
    "SHAPER: reference shapers",
    "isocenter shape",
    "`run scan --shaper` reads it. n taps, p scheduling positions, k tail sections; `A` is a shaped axis.",
    (
        Entry("format", "", "1."),
        Entry("axes", "(shaped axes,)", "Their names."),
        Entry("sample_rate_Hz", "", "What delays are counted in."),
        Entry("notes", "JSON", "Machine, its hash, what it was designed for, verdict."),
        Entry("name_A", "", "Name of the design."),
        Entry("delays_A", "(n,) integer", "Delays in samples, rising."),
        Entry("gains_A", "(p, n)", "A row per scheduling position, interpolated linearly between them, held beyond the ends."),
        Entry("positions_A", "(p,)", "Scheduling positions [rad or m]; one number where nothing is scheduled."),
        Entry("schedule_axis_A", "", "Axis whose raw reference chooses the row; empty: one row."),
        Entry("tail_A", "(k, 6)", "Sections b0, b1, b2, 1, a1, a2 on the last tap, gain 1 at standstill; (0, 6) for none."),
        Entry("static_gain_A", "", "Gain at standstill, 1."),
    ),
    """
import numpy as np

shaper = np.load("roll.shaper.npz")  # without a tail
delays, gains = shaper["delays_roll"], shaper["gains_roll"][0]
raw = np.concatenate([np.full(delays[-1], r[0]), r])  # r: the raw reference, from standstill at r[0]
shaped = sum(gain * raw[delays[-1] - delay : len(raw) - delay] for delay, gain in zip(delays, gains))
""",
)

EST = ArrayFile(
    "EST: estimates of an observer",
    "isocenter observe",
    "N rows of the recording, C columns, n_z measured channels, n_x states. With `-o FILE.mf4` or `.csv` the columns join the recording as "
    "channels instead. The detector's pose is R(p) d + c(p) with d the estimated displacement, p the estimated motor-side positions, and c "
    "and R the detector centre and rotation of the rigid machine there.",
    (
        Entry("estimate_format", "", "1."),
        Entry("time_s", "(N,)", "The recording's time."),
        Entry("names", "(C,)", "Columns of `values`."),
        Entry("units", "(C,)", "Their units."),
        Entry(
            "values",
            "(N, C)",
            "Estimates, then their variances, then the consistency of the filter. With `--data` the channels `deviation_*` follow.",
        ),
        Entry("measured_names", "(n_z,)", "Channels that the observer looks at."),
        Entry("innovation", "(N, n_z)", "What they read less what was predicted; NaN where nothing was measured."),
        Entry("state_names", "(n_x,)", "States of the filter."),
        Entry("states", "(N, n_x)", "Their values, in the model's units."),
        Entry("filter", "", "`kf`, `ekf` or `ukf`."),
        Entry("machine_hash", "", "Of the machine that the design was made for."),
        Entry("notes", "(any,)", "What a user should know."),
    ),
    """
import numpy as np

est = np.load("run.est.npz")
names = list(est["names"])
rocking_rad = est["values"][:, names.index("estimate_detector_ry")]
deviation_rad = np.sqrt(est["values"][:, names.index("estimate_detector_ry_variance")])
""",
)

ESTIMATES = (
    Entry("estimate_position_A, estimate_link_position_A", "rad or m", "Motor side and link side of axis A."),
    Entry(
        "estimate_detector_x, _y, _z, _rx, _ry, _rz",
        "m, rad",
        "Displacement of the detector from where the rigid machine would have it, in the detector's frame; turns as a rotation vector.",
    ),
    Entry("estimate_detector_vx … _wz", "m/s, rad/s", "Rate of that displacement."),
    Entry("estimate_source_x … _z", "m", "Focal spot from the detector's centre, in the detector's frame (2.2)."),
    Entry("estimate_isocenter_x … _z", "m", "Isocentre from the detector's centre, in the detector's frame (2.2)."),
    Entry("estimate_orientation_x … _z", "rad", "Orientation of the detector in the world, extrinsic x, y, z angles."),
    Entry("…_variance", "squared", "Error variance of each of these, as the filter believes."),
    Entry("estimate_nis, estimate_measured", "", "Normalised innovation squared of the row, and of how many measurements it is."),
    Entry(
        "estimate_nis_window",
        "",
        "Mean of it per measurement over 64 rows; 1 for a consistent filter, more where something acts unknown to it.",
    ),
    Entry("estimate_alarm", "", "1 where sensors surprise more than a sound machine's, or moved the geometry more than is stated."),
)

DESIGN = ArrayFile(
    "Observer designs",
    "isocenter observe --save-design",
    "The parameters of the modal model are trigonometric polynomials of the pose; the basis is stated by `controllers.models.modal`. "
    "Format 2 is read as well; it lacks `coupling`, `effort_step`, `places` and `noise_low_pass`.",
    (
        Entry("observer_format", "", "3."),
        Entry("chain_axes", "(axes, 3)", "Directions of the driven axes at position zero."),
        Entry("chain_points", "(axes, 3)", "Points on them [m]."),
        Entry("chain_revolute", "(axes,)", "Whether an axis turns."),
        Entry("chain_gravity_m_s2", "(3,)", "Gravity."),
        Entry(
            "sensor_body_end_m, sensor_sensor_end_m",
            "(sensors, 3)",
            "Where each inertial sensor's body and the sensor stand, from the end of the chain.",
        ),
        Entry("sensor_rotation", "(sensors, 3, 3)", "Rotation of each sensor."),
        Entry("sensor_lag_s", "(sensors,)", "Time constant of its low pass."),
        Entry("sensor_channels", "(sensors, 6)", "Its channels."),
        Entry("axes", "(axes,)", "Names of the axes."),
        Entry("position_unit", "(axes,)", "rad or m."),
        Entry("source_end_m", "(3,)", "Focal spot from the end of the chain."),
        Entry("harmonics", "(axes,)", "Highest harmonic of the pose in each axis."),
        Entry(
            "coefficients", "(rows, basis)", "Parameters of the model, rows in the order that `controllers.models.modal.ModalModel` states."
        ),
        Entry("sample_rate_Hz", "", "Sample rate."),
        Entry("effort_limit", "(axes,)", "Limit of each drive."),
        Entry("effort_step", "(axes,)", "Step to which a drive rounds its command; empty: none."),
        Entry("directions", "(coordinates, disturbances, basis)", "What each disturbance gives axes and modes. Optional."),
        Entry("turning", "(coordinates, products of speeds, basis)", "What turning axes push. Optional."),
        Entry("coupling", "(axes, axes, modes, basis)", "Acceleration of one axis by another's speed times a mode's. Optional."),
        Entry("places", "(disturbances,)", "Where each disturbance acts; empty: not known."),
        Entry(
            "noise_*",
            "",
            "Fields of `controllers.observers.settings.ObserverNoise`: standard deviations, times and frequencies of the "
            "disturbances, biases expected at the start.",
        ),
        Entry("isocenter_m", "(3,)", "Isocentre in the world."),
        Entry("machine, machine_hash", "", "The machine that it was made for."),
        Entry("poses", "(poses, axes)", "At which it was measured [rad or m]; empty: not known. Optional."),
        Entry("notes", "(any,)", "What a user should know."),
        Entry("unseen_*", "(any,)", "Fields of `hil.observing.unseen.Unseen`: what the alarm does not see. Optional."),
    ),
)

LOOKUP = ArrayFile(
    "LOOKUP: geometry tables",
    "isocenter calibrate phantom, isocenter geometry truth, isocenter geometry convert",
    "N exposures. A deviation has nine numbers: focal spot (3) and phantom origin (3) in the detector's frame [m], and the rotation vector "
    "(3) in the detector's frame [rad] that multiplies the detector's rotation from the right. Wherever a command takes a LOOKUP for the "
    "geometry of a scan, it takes a MODEL.",
    (
        Entry("format", "", "1."),
        Entry("axes", "(axes,)", "Names of the axes."),
        Entry("positions", "(N, axes)", "Where each exposure was taken [rad or m]."),
        Entry("deviation", "(N, 9)", "Deviation from the nominal geometry there."),
        Entry("covariance", "(N, 9, 9)", "Its covariance; zero in tables of `geometry convert`."),
        Entry(
            "notes",
            "JSON",
            "`machine`, `hash`, `six` (the source was held) and `speed` of each axis: signed [rad/s or m/s], 0 where it stood, "
            "null where no one number says it.",
        ),
    ),
    """
import numpy as np

table = np.load("roll.lookup.npz")
source_mm = 1e3 * table["deviation"][:, :3]
deviation_mm = 1e3 * np.sqrt(table["covariance"][:, range(3), range(3)])
""",
)

MODEL = ArrayFile(
    "MODEL: kinematic models",
    "isocenter calibrate model",
    "p parameters: Denavit-Hartenberg a, delta_theta, alpha, d and beta of each row from the panel to the phantom, four frame angles, "
    "the focal spot, and compliances. Masses, the places of elastic joints and the nominal geometry are those of the machine file.",
    (
        Entry("format", "", "1."),
        Entry("kind", "", '"model".'),
        Entry("axes", "(axes,)", "Names of the axes."),
        Entry("names", "(p,)", "Names of the parameters."),
        Entry("units", "(p,)", "Their units."),
        Entry("values", "(p,)", "Their values."),
        Entry("covariance", "(p, p)", "Their covariance."),
        Entry(
            "notes",
            "JSON",
            "`machine`, `hash`, `scans`, `six` (the source was held), `rank`, `null` (combinations that the data do not show) "
            "and `frozen`.",
        ),
    ),
    """
import numpy as np

model = np.load("carm.model.npz")
for name, value, deviation, unit in zip(model["names"], model["values"], np.sqrt(np.diag(model["covariance"])), model["units"]):
    print(name, value, deviation, unit)
""",
)

MARKER = ArrayFile(
    "Marker parameters",
    "isocenter calibrate marker",
    "N exposures. Rows of images that could not be used are NaN.",
    (
        Entry("format", "", "1."),
        Entry("parameters", "(9,)", "Names of the parameters of the thesis's (6.8)."),
        Entry("free", "(any,)", "Those that were fitted."),
        Entry(
            "exposure_id, time_s, axes, positions",
            "as in the scan",
            "Exposure, its middle in the loop's time [s], and axis positions [rad or m].",
        ),
        Entry("values", "(N, 9)", "The parameters [m, rad]."),
        Entry("nominal", "(N, 9)", "Those of the nominal geometry."),
        Entry("covariance", "(N, 9, 9)", "Covariance of `values`."),
        Entry("points", "(N,)", "Crossings used."),
        Entry("deviation_pixels", "(N,)", "Image quality: deviation of the edges [pixels]."),
        Entry("blur_pixels", "(N, 2)", "Image quality: blur [pixels]."),
        Entry("notes", "JSON", "Machine, scan, plate."),
    ),
)

DATA = ArrayFile(
    "Data-driven calibrations",
    "isocenter calibrate data, isocenter run --data",
    "N rows of a recording, p parameters. `run` calls it `geometry.npz`. A deviation has nine numbers as in a LOOKUP.",
    (
        Entry("data_calibration_format", "", "1."),
        Entry("machine, axes", "", "The machine and its axes."),
        Entry("names", "(p,)", "Names of the parameters."),
        Entry("units", "(p,)", "Their units."),
        Entry("time_s", "(N,)", "Times of the rows."),
        Entry("positions", "(N, axes)", "Positions of the link sides."),
        Entry("live", "(N, 9)", "Deviations as known at each row."),
        Entry("final", "(N, 9)", "Deviations with the parameters of the end."),
        Entry("sigma", "(N, 9)", "Standard deviations of `live`."),
        Entry("correlation", "(N, 36) single precision", "Correlation between the columns of `live`, by rows above the diagonal."),
        Entry("values", "(p,)", "Parameters at the end."),
        Entry("covariance", "(p, p)", "Their covariance."),
        Entry(
            "static",
            "(4, 9)",
            "The observer's slow part as it follows the pose: a constant, and gravity's three components in the detector's "
            "frame over gravity. Zero without an observer.",
        ),
    ),
)

SIGHTINGS = ArrayFile(
    "Sightings of a live calibration",
    "isocenter run --data",
    "`run` calls it `sightings.npz`. S images that were seen, in the order in which they came; a run can be replayed from them.",
    (
        Entry("sightings_format", "", "1."),
        Entry("until_m, poses", "(); (poses, axes)", "How well, and where, the geometry had to be known."),
        Entry("row", "(S,)", "Row in which the image's result came."),
        Entry("fate", "(S,)", "`used`, `change` (the mount was found moved), `refused`, `late` or `withdrawn`."),
        Entry("exposure_id", "(S,)", "Exposure."),
        Entry("time_s", "(S,)", "Its middle, in the loop's time."),
        Entry("kind", "(S,)", "`phantom` or `marker`."),
        Entry("positions", "(S, axes)", "Axis positions then."),
        Entry("values", "(S, 9)", "What the image shows; NaN beyond the six numbers of a plate."),
        Entry("covariance", "(S, 9, 9)", "Its covariance."),
    ),
)

SPOOL = ArrayFile(
    "Spool: frames of a panel",
    "",
    "The software of an X-ray panel writes a NumPy archive `frame_NNNNNN.npz` per exposure into the folder that `isocenter run --images "
    "--spool DIR` watches. It is written under another name and renamed when whole.",
    (
        Entry("format", "", "1."),
        Entry("exposure_id", "", "Counts up."),
        Entry(
            "times_s",
            "(3,)",
            "Start and width by the panel's clock, and the tick of the loop, in the loop's time, at which the exposure's pulse "
            "was first seen.",
        ),
        Entry("image", "(rows, columns) uint16", "The image, row 0 first."),
    ),
)

ARRAY_FILES = (FRF, SHAPER, EST, DESIGN, LOOKUP, MODEL, MARKER, DATA, SIGHTINGS, SPOOL)

SCAN = (
    Entry(
        "scan.toml",
        "TOML",
        "`format = 1`, `axes`, `[detector]` with `columns`, `rows`, `pitch_mm` (of columns), `aspect` (row pitch over column "
        "pitch) and `skew` (columns of shift to the right per row), and notes: `machine`, `machine_hash`, `scene`, `recording`. With a "
        "marker plate also `marker` and `marker_distance_mm`.",
    ),
    Entry(
        "exposures.csv",
        "CSV",
        "A row per image: `exposure_id`, `start [s]` and `width [s]` in the loop's time, and `position_A [rad]` or `[m]` of "
        "each axis in the middle of the exposure, empty where it is not known.",
    ),
    Entry(
        "frames.tif",
        "TIFF",
        "A page per image, 16-bit photon counts, row 0 first. Pixel (0, 0) is the first value; columns grow with the panel's u, "
        "rows with its v.",
    ),
    Entry(
        "markers.csv",
        "CSV",
        "Of a scan that was received during a run: a row per exposure that was looked at, with `exposure_id`, the six parameters of the "
        "plate [m, rad], empty where it was not seen, and `points`, the number of crossings. The header alone where no plate is looked "
        "for.",
    ),
)

EXPERIMENT_KEYS = {
    "format": "Format of the file.",
    "kind": "Kind of the experiment.",
    "axes": "Axes that are excited or move; empty: all.",
    "period": "Base period; lines are its inverse apart.",
    "periods": "Periods kept.",
    "settle_periods": "Periods before them, in which transients die out.",
    "jog": "Slow sine on the reference. Without the table there is none.",
    "pose": "Start pose, by axis; axes left out stand at zero.",
    "experiments": "As many experiments as axes: all axes at once, mixed orthogonally, or one axis at a time.",
    "lines": "Excited harmonics of the base period. Give `lines` or `[band]`.",
    "band": "A choice of lines by frequency.",
    "weights": "Relative amplitude of each line; flat when left out.",
    "amplitude": "Rms of the excitation of every axis while it is excited. Give `amplitude` or `[amplitudes]`.",
    "amplitudes": "The same, by axis.",
    "realisations": "Draws of the phases.",
    "phases": "Random phases, or phases optimised for a low crest factor.",
    "seed": "Seed of the phases.",
    "axis": "Axis that sweeps.",
    "start": "Where it begins.",
    "stop": "Where it ends.",
    "speed": "Speed of the constant part.",
    "acceleration": "Acceleration of the ramps; the axis's limit when left out.",
    "dwell": "Standstill before and after each way.",
    "sweeps": "1: there; 2: there and back; and so on.",
    "duration": "How long the pose is held.",
    "pace": "Share of the machine's limits on speed, acceleration and jerk that each way takes.",
    "stops": "Poses, by axis, in order; an axis left out stays where it was.",
    "goal": "Pose at the end, by axis.",
    "low": "Lowest frequency.",
    "high": "Highest frequency.",
    "per_decade": "Lines per decade; 0: all.",
    "dense": "Bands in which every line is excited.",
    "odd": "Odd lines only.",
    "one_free_in": "Of so many lines one is left free to show distortion; 0: none.",
    "line": "Line of the base period.",
    "frequency": "Frequency instead of a line.",
    'kind = "jog" jog': "The sine; without the table it has the defaults below.",
    "[jog] amplitude": "Amplitude of the sine.",
    "turn_share": "Share of each way that the turn takes, with constant speed between turns; 1 is a sine.",
    "[jog] axes": "Axes that jog; empty: all axes of the experiment.",
}
"""Meaning of every key of an experiment file."""
