"""What the results page shows: for each results file the command, what was asked, and which figures."""

from __future__ import annotations

from typing import NamedTuple

Path = tuple[str, ...]


class Column(NamedTuple):
    """A figure of every row: its heading with the unit, where it is below the row, and the factor to that unit."""

    heading: str
    path: Path
    factor: float = 1.0


class Figure(NamedTuple):
    """One figure: what it is, where it is in the file, its unit, the factor to that unit, and what was asked of it."""

    name: str
    path: Path
    unit: str = ""
    factor: float = 1.0
    asked: str = ""


class Rows(NamedTuple):
    """A table: a row per key of the object at `path`, or per named key."""

    heading: str
    path: Path
    columns: tuple[Column, ...]
    keys: tuple[str, ...] = ()


class Shown(NamedTuple):
    """A results file of benchmarks/results and what of it is shown."""

    file: str
    title: str
    text: str
    command: str
    figures: tuple[Figure, ...] = ()
    rows: tuple[Rows, ...] = ()


_PLACES = (
    Column("focal spot [mm]", ("source_mm",)),
    Column("isocentre [mm]", ("phantom_mm",)),
    Column("rotation [mrad]", ("rotation_mrad",)),
)
_VARIANCES = (
    Column("isocentre, true [µm]", ("isocentre_true_um",)),
    Column("stated", ("isocentre_stated_um",)),
    Column("ratio", ("isocentre_ratio",)),
    Column("focal spot, true [µm]", ("focal_spot_true_um",)),
    Column("stated", ("focal_spot_stated_um",)),
    Column("ratio", ("focal_spot_ratio",)),
    Column("orientation, true [µrad]", ("orientation_true_urad",)),
    Column("stated", ("orientation_stated_urad",)),
    Column("ratio", ("orientation_ratio",)),
    Column("NIS per measurement", ("nis_per_measurement",)),
    Column("in the 95 % band", ("share_in_band",)),
    Column("rows in alarm", ("alarm_share",)),
    Column("false alarms in ten minutes", ("false_alarms_in_ten_minutes",)),
    Column("error passed twice the stated", ("passed_twice",)),
    Column("alarm within 1 s", ("in_time",)),
)
_POSES = (
    Column("focal spot [mm]", ("source_m",), 1e3),
    Column("isocentre [mm]", ("position_m",), 1e3),
    Column("rotation [mrad]", ("rotation_rad",), 1e3),
)
_OVERLAY = tuple(Column(f"{place}, largest of the best 90 % [mm]", (place, "max_90"), 1e3) for place in ("centre", "1/3", "2/3"))
_LIVE = (Column("focal spot [mm]", ("source",)), Column("isocentre [mm]", ("phantom",)), Column("rotation [mrad]", ("rotation",)))
_LIVE_ROWS = (
    "nominal",
    "live, row by row",
    "live, parameters of the end",
    "afterwards, as known at each row",
    "afterwards, parameters of the end",
)
_FILTERS = ("kf", "ekf", "ukf", "filterpy_ukf", "numpy_ukf")
_PARTS = (
    "observer and damping",
    "frames",
    "IMU",
    "judges of sensors",
    "loop",
    "recorder",
    "I/O",
    "feedback",
    "supervisor",
)
_CASES = {"quiet": "256 Hz", "loaded": "256 Hz beside a load of eight", "fast": "1 kHz"}

DIAGNOSIS = (
    Shown(
        "real_sets_table.json",
        "Recordings that others measured",
        "What is named in sets of recordings that are not part of the project, and its largest held-out error among the channels: over "
        "that of the nominal machine, and over that of an engineer's least-squares fit of the same split, by the engineer's metric.",
        "python benchmarks/real_sets.py",
        rows=(
            Rows(
                "set and split",
                (),
                (
                    Column("named", ("named",)),
                    Column("error over nominal", ("nominal",)),
                    Column("error over the engineer's", ("engineer",)),
                    Column("time [s]", ("seconds",)),
                ),
            ),
        ),
    ),
    Shown(
        "next_experiment.json",
        "Does the next experiment separate",
        "The emulated turntable with one hidden effect. While the verdict is `ambiguous`, the experiment that the diagnosis proposes is "
        "run, twice at most. The last column is empty where no experiment was needed.",
        "python benchmarks/next_experiment.py",
        rows=(
            Rows(
                "effect",
                ("circle",),
                (Column("verdict at first", ("first", "verdict")), Column("verdict at the end", ("rounds", "-1", "then", "verdict"))),
            ),
        ),
    ),
    Shown(
        "bad_data.json",
        "Wrong recordings",
        "Sound recordings of shipped machines and of a Stäubli TX40, each spoilt in one way and given to `diagnose`. Right is the status, "
        "the verdict and a reason that names the channel and the fault.",
        "python benchmarks/bad_data.py",
        (
            Figure("told as that", ("right",)),
            Figure("of", ("of",)),
            Figure("sound sets of recordings, of these machines and of eight sets by others", ("sound",)),
            Figure("of which accused", ("accusations",), asked="0"),
        ),
        (Rows("spoilt by", ("ways",), (Column("status", ("status",)), Column("verdict", ("verdict",)), Column("right", ("right",)))),),
    ),
    Shown(
        "diagnosis_speed.json",
        "Time and memory of a diagnosis",
        "The two-axis C-arm with four repeats and a held-out recording of 60 s each; all effects are tried.",
        "python benchmarks/diagnosis_speed.py",
        (
            Figure("first answer", ("-1", "first_answer_s"), "s", 1.0, "at most 10 s"),
            Figure("wall clock", ("-1", "wall_s"), "s", 1.0, "at most 30 s"),
            Figure("processor", ("-1", "processor_s"), "s"),
            Figure("memory", ("-1", "peak_GB"), "GB", 1.0, "at most 1 GB"),
        ),
    ),
)
"""Beside the proof, which has a table of its own."""


def _faults(measure: str) -> tuple[Column, ...]:
    """Return the columns of a fault table's counts."""
    names = ("rows", "stopped", "noted", "within_tolerance", "cannot_be_held", "unnoticed", "over_budget", "contradicted")
    heads = {"rows": "faults", "over_budget": "over their budget", "contradicted": "told what the truth contradicts"}
    return tuple(Column(heads.get(name, name.replace("_", " ")), (measure, name)) for name in names)


SHOWN = (
    *DIAGNOSIS,
    Shown(
        "killed_together.json",
        "Processes of the bench killed at speed",
        "The emulated C-arm sweeps roll at 0.4 rad/s over UDP, then processes of its bench are killed together; in some rows somebody else "
        "goes on sending the bench's heartbeat. Time and travel count from the kill to rest, by the emulator's truth.",
        "python benchmarks/killed_together.py",
        (),
        (
            Rows(
                "killed",
                ("rows",),
                (Column("at rest", ("at_rest",)), Column("time to rest [s]", ("rest_s",)), Column("travel [mrad]", ("travel_rad",), 1e3)),
            ),
        ),
    ),
    Shown(
        "drive_modes.json",
        "Drive modes and experiments",
        "The C-arm with its drives in cyclic synchronous torque, velocity and position mode, over the bus in lockstep. Multisines with jog "
        "in four poses: share of the lines of the frequency responses, from effort to encoders and IMU, within their 95 % bounds of the "
        "equations' linearisation. A shaped scan with the observer, beside its simulation. The fault table of each mode, while roll scans."
        "\n\nThe fault table while roll is moved to a pose: in profile velocity mode the loop leads it, at half the limits; in profile "
        "position mode its drive goes at the limits; neither takes an effort. And while the drive searches a limit switch. Failing rows "
        "stand below."
        "\n\nWhat stays, and why. At the speed limit a drive that stops by itself over an open brake creeps to rest by its own integrator, "
        "half a second of time constant with these loops, which the budgets' closed forms leave out (`brake_stays_open`, `brake_weak`, "
        "`io_ignores_writes`). A second sender of a heartbeat is certain after three of its periods (`foreign_heartbeat`); of lost frames "
        "those that matter come some time after the first (`bus_loses_frames`): both count from their beginning. A drive whose RPDO "
        "carries no effort does not tell what its loops ask for, so a power stage that is late by less than they bear is not seen "
        "(`torque_late`).",
        "python benchmarks/drive_modes.py",
        (),
        (
            Rows(
                "mode",
                (),
                (
                    Column("lines inside [%], asked 93 to 97", ("multisine", "inside"), 1e2),
                    Column("lines", ("multisine", "lines")),
                    Column("scan: tracking error, largest [mrad]", ("scan", "tracking_rad"), 1e3),
                    Column("off its simulation, largest [mrad]", ("scan", "simulation_rad"), 1e3),
                    Column("observer: NIS per measurement", ("scan", "mean_nis")),
                    Column("homing: encoders differ by [mrad]", ("homing", "encoders_differ_rad"), 1e3),
                    *_faults("faults"),
                ),
            ),
            Rows("moved to a pose", (), _faults("faults_moved")),
            Rows("homing", (), _faults("faults_homing")),
            *(
                Rows(f"{mode.replace('_', ' ')}: failing", (mode, "faults_moved", "failing"), (Column("what", ("what",)),))
                for mode in ("profile_velocity", "profile_position")
            ),
        ),
    ),
    Shown(
        "makers.json",
        "Drives of other makers",
        "Makers' own data sheets, unchanged, on emulated drives: did the arm go to a pose, in every mode that the sheet supports.",
        "python benchmarks/makers.py FOLDER",
        (),
        (
            Rows(
                "maker",
                (),
                tuple(
                    Column(mode.replace("_", " "), (mode, "moved"))
                    for mode in ("torque", "velocity", "position", "profile_velocity", "profile_position")
                ),
            ),
        ),
    ),
    Shown(
        "fleet_engine.json",
        "A fleet on Dask",
        "What the engine adds to a task, for jobs that do nothing, answers written; the share of two workers' time that is spent in jobs; "
        "a night of 200 C-arms with three recordings of 10 s each, checked and identified, on two cores, extrapolated from the processor "
        "time of six machines; efficiency with more workers, simulated from these times. Then 30 % of the jobs end their worker, the disk "
        "is full, the scheduler is restarted, and two runs are started at once. On a computer with ten times its work; what is added to a "
        "task is measured by `chrt --rr 1 python benchmarks/fleet_engine.py overhead`, which waits for no processor.",
        "python benchmarks/fleet_engine.py cost --work WORK --json OUT",
        (
            Figure("added to a task, on the wall", ("overhead", "dask_wall_ms"), "ms", asked="at most 20 ms"),
            Figure("without Dask", ("overhead", "without_dask_wall_ms"), "ms"),
            Figure("added to a task, processor time of client and scheduler", ("overhead", "dask_client_and_scheduler_processor_ms"), "ms"),
            Figure("two workers' time in jobs", ("workers", "efficiency_2"), "%", 1e2),
            Figure("night of 200 machines on two cores", ("night", "night_of_200_on_two_cores_s"), "s"),
            Figure("largest memory of a job", ("night", "tasks", "identify", "peak_GB"), "GB"),
            Figure("efficiency of 16 workers", ("simulated_efficiency", "16"), "%", 1e2),
            Figure("of 64", ("simulated_efficiency", "64"), "%", 1e2),
            Figure("jobs of 24 that are right, 7 of their workers killed", ("workers_killed", "right")),
            Figure("jobs of 40 that are done, scheduler restarted", ("scheduler_restarted", "done")),
            Figure("results of 16 after the disk was full", ("disk_full", "results")),
            Figure("results of 16 after two runs at once", ("spoilt", "distinct")),
            Figure("time until a run is ended by Ctrl-C", ("cancelled", "seconds"), "s"),
        ),
    ),
    Shown(
        "fleet_change.json",
        "What changed in a fleet",
        "Tracks of results of 200 C-arms, drawn with measured covariances, seasons, software updates and bad nights: years in which "
        "nothing changes; and fleets over 60 nights, in each of which 20 machines hide a growth and 10 a step.",
        "python benchmarks/fleet_change.py short WORK && python benchmarks/fleet_change.py score WORK",
        (
            Figure("machine-years in which nothing changes", ("sound", "machine_years"), asked="at least 2000"),
            Figure("false alarms in 100 of them", ("sound", "per_100_machine_years"), asked="at most 1"),
            Figure("one fleet over 60 nights, four of its machines recorded: of 30 changed found", ("found", "found"), asked="at least 27"),
            Figure("machines that did not change and were named", ("found", "false_machines")),
            Figure("forty drawn fleets: changed machines found, of 1200", ("short", "found"), asked="at least 1080"),
            Figure("machines told right, changed or sound", ("short", "map_right"), "%", 1e2, asked="at least 95 %"),
            Figure("false alarms in 100 machine-years of these", ("short", "per_100_machine_years"), asked="at most 1"),
            Figure("the same at most, at 95 %", ("short", "upper_95")),
        ),
    ),
    Shown(
        "fleet_ruptures.json",
        "What changed, beside the library ruptures",
        "On white tracks of 60 nights with a step in the middle, where least squares with a penalty is right: share of 50 stepping "
        "machines that are found, by the step's size in standard deviations, both at the same stated rate. Then a fleet with "
        "seasons, carried scatter and bad nights, of which the library knows nothing.",
        "python benchmarks/fleet_ruptures.py",
        (
            Figure("a fleet with 30 changes: false machines", ("found", "fleet", "false_machines")),
            Figure("the same by the library", ("found", "library", "false_machines")),
            Figure("sound years: false machines in 100 machine-years", ("sound", "fleet", "per_100_machine_years"), asked="at most 1"),
            Figure("the same by the library", ("sound", "library", "per_100_machine_years")),
        ),
        (
            Rows(
                "step [standard deviations]",
                ("white",),
                (
                    Column("found", ("fleet", "found_share")),
                    Column("by the library", ("library", "found_share")),
                    Column("false", ("fleet", "false")),
                    Column("false by the library", ("library", "false")),
                    Column("machines told alike", ("machines_told_alike",)),
                ),
                ("1", "1.5", "2", "3"),
            ),
        ),
    ),
    Shown(
        "supervisor_cost.json",
        "What the supervisor costs the sample loop",
        "The emulated C-arm stands under control at 256 Hz over UDP, on a computer of two processors that has other work, too: short runs "
        "in pairs, with the supervisor's process and without, their order turned from pair to pair. A whole tick lasts from the SYNC until "
        "the loop is ready to wait again. Ratios are those of a pair.",
        "python benchmarks/supervisor_cost.py",
        (
            Figure("whole tick, 99.9 %, with over without, median of the pairs", ("ratio", "p99.9", "median")),
            Figure("smallest", ("ratio", "p99.9", "smallest")),
            Figure("largest", ("ratio", "p99.9", "largest")),
            Figure("added to a whole tick, 50 %, median of the pairs", ("added_us", "p50", "median"), "µs"),
            Figure("of a processor, that the supervisor takes", ("processor_share", "median"), "%", 1e2),
        ),
        (
            Rows(
                "supervisor",
                ("together",),
                (
                    Column("ticks", ("ticks",)),
                    Column("missed", ("missed",)),
                    *(Column(f"whole tick, {share} % [µs]", (f"p{share}_us",)) for share in ("50", "99", "99.9")),
                ),
            ),
        ),
    ),
    Shown(
        "mutation.json",
        "Do the tests notice what is made wrong",
        "mutmut makes one small change of the code at a time, and runs the tests that reach it. A change that no test notices has "
        "survived; some do the same as the code, each with its reason in `benchmarks/mutation_equivalents.toml`. A test that does not end "
        "in its time has noticed, too. The survivors stand in `benchmarks/results/mutation.json`.",
        "python benchmarks/mutation.py",
        rows=(
            Rows(
                "code",
                (),
                (
                    Column("mutants", ("mutants",)),
                    Column("tried", ("tried",)),
                    Column("killed", ("killed",)),
                    Column("out of time", ("timed_out",)),
                    Column("survived", ("survived",)),
                    Column("not reached", ("not_covered",)),
                    Column("do the same", ("equivalent",)),
                    Column("died [%]", ("dead_share",), 1e2),
                    Column("died of those that do something else [%]", ("dead_share_without_equivalent",), 1e2),
                    Column("asked [%]", ("asked_share",), 1e2),
                ),
            ),
        ),
    ),
    Shown(
        "faults_carm.json",
        "Faults injected into the emulated C-arm",
        "Each fault in a short run of its own, in lockstep. The line per fault is on its own [page](fault-table.md).",
        "isocenter faults check carm -o faults; python benchmarks/fault_table.py faults",
        (
            Figure("faults", ("faults",)),
            Figure("stopped, at rest", ("verdicts", "stopped")),
            Figure("gone on and said", ("verdicts", "noted")),
            Figure("brake and drive both lost, which was said at once", ("verdicts", "cannot be held")),
            Figure("not at rest", ("verdicts", "not at rest"), asked="0"),
            Figure("not noticed, and within the tolerance of the machine file", ("verdicts", "within tolerance")),
            Figure("ended as if nothing had been", ("verdicts", "unnoticed"), asked="0"),
            Figure("stops over their budget", ("over_budget",), asked="0"),
            Figure("said what the truth contradicts", ("contradicted",), asked="0"),
        ),
    ),
    Shown(
        "foreign_logs.json",
        "Logs and recordings of other tools",
        "Files that other tools write, made with known signals, converted by `isocenter convert`, and compared with what was put in: "
        "times, values, missing samples, and whether all that could not be taken is listed. A file that cannot be read is right where one "
        "line says so and what would be.",
        "python benchmarks/foreign_logs",
        (
            Figure("files", ("total", "made")),
            Figure("of them right", ("total", "right"), asked="all"),
            Figure("of these refused, with what would be right", ("total", "refused")),
        ),
        (
            Rows(
                "kind",
                ("kinds",),
                (Column("files", ("files",)), Column("right", ("right",)), Column("made by", ("tools",))),
            ),
        ),
    ),
    Shown(
        "conform_mutants.json",
        "Defects of CANopen nodes, and what `conform` finds",
        "Defects that implementers make, put into an emulated device that has every service, one at a time, all but one written before the "
        "checks. That one drops PDOs that are too long, whose first bytes are to be used; to report them is not asked for. Below, "
        "devices without a defect: the shipped data sheets, and bare devices of makers' data sheets.",
        "python benchmarks/conform_mutants.py --json benchmarks/results/conform_mutants.json",
        (
            Figure("defects drawn by a fixed seed", ("drawn", "tried")),
            Figure("of them found", ("drawn", "found"), asked="all"),
            Figure("all defects", ("all", "tried")),
            Figure("of them found", ("all", "found")),
            Figure("of them found without `--writes`", ("all_without_writes", "found")),
        ),
        (
            Rows(
                "device without a defect",
                ("sound",),
                (Column("passed", ("pass",)), Column("failed", ("fail",)), Column("skipped", ("skip",))),
            ),
        ),
    ),
    Shown(
        "wall_clock_udp.json",
        "Timing on the wall clock, beside a bare python-can loop",
        "Loop and emulated machine in two processes on a UDP bus, with shaper, observer and damping, two virtual processors with real-time "
        "scheduling. *Bare* is a loop that exchanges the same frames with the same emulator and computes nothing, before and after the "
        "bench in one run. A whole tick lasts from when it is due until the loop is ready to wait again.",
        "python benchmarks/wall_clock.py",
        tuple(
            figure
            for case, name in _CASES.items()
            for figure in (
                Figure(f"{name}: 99.9 % of the bench over that of the bare loop", (case, "ratio_p99.9"), asked="at most 1.5"),
                Figure(f"{name}: 99.9 % as `doctor` predicts it", (case, "predicted", "p999_s"), "µs", 1e6),
                Figure(f"{name}: 99.9 % as it was", (case, "bench", "p99.9_us"), "µs", 1.0),
            )
        ),
        tuple(
            Rows(
                name,
                (case,),
                (
                    Column("ticks", ("ticks",)),
                    Column("missed", ("missed",)),
                    *(Column(f"{share} [µs]", (f"p{share}_us",)) for share in ("50", "99", "99.9")),
                    Column("longest [µs]", ("max_us",)),
                ),
                ("bench", "bare"),
            )
            for case, name in _CASES.items()
        ),
    ),
    Shown(
        "tick_shares.json",
        "What a tick spends its time on",
        "The same scan at 256 Hz. The process is interrupted as its processor time goes by, and the part at work counts. "
        "`frames` are the drives' CANopen frames, sent and taken.",
        "python benchmarks/tick_shares.py",
        (Figure("median work of a tick", ("median_work_us",), "µs", 1.0),),
        (Rows("part", ("us_a_tick",), (Column("a tick [µs]", ()),), _PARTS),),
    ),
    Shown(
        "lockstep.json",
        "Speed in lockstep",
        "The whole CANopen stack of the C-arm in one process, with IMU, I/O, supervisor and journal. python-can's `virtual` bus alone, by "
        "turns with it, carries SYNC, three frames up and two down a tick.",
        "python benchmarks/lockstep.py --json benchmarks/results/lockstep.json",
        (
            Figure("times real time", ("times_real_time_processor", "median")),
            Figure("of the rate of bare frames", ("share_of_bare", "median"), asked="at least 0.75"),
        ),
    ),
    Shown(
        "plot_opens.json",
        "Time until a page of recordings is open",
        "A minute at 256 Hz with 30 channels of `isocenter plot`, from disk in headless Chromium, until the last chart is drawn.",
        "python benchmarks/plot_opens.py",
        (
            Figure("opens, median", ("opens_s", "median"), "s", asked="at most 1"),
            Figure("zooms all charts, median", ("zooms_s", "median"), "s"),
            Figure("size of the page", ("page_MB",), "MB"),
        ),
    ),
    Shown(
        "observer_steps.json",
        "Time of an observer's step",
        "24 states and 10 measurements; `filterpy_ukf` and `numpy_ukf` are the same filter in a public package and in plain NumPy.",
        "python benchmarks/observer.py --json benchmarks/results/observer_steps.json",
        rows=(Rows("filter", (), (Column("median [µs]", ("p50_us",)), Column("99 % [µs]", ("p99_us",))), _FILTERS),),
    ),
    Shown(
        "observer_tick.json",
        "Time of a tick with shaper, observer and damping",
        "Loop and emulated machine in two processes on a UDP bus.",
        "python benchmarks/observer.py --design carm.observer.npz --json benchmarks/results/observer_tick.json",
        tuple(
            Figure(f"whole tick, {share} %", ("tick_in_two_processes", "timing", f"work_time_p{share}_us"), "µs", 1.0, asked)
            for share, asked in (("50", ""), ("99", ""), ("99.9", "below 1000 µs"))
        ),
    ),
    Shown(
        "observer_scan.json",
        "Observer during shaken scans",
        "Root mean square error of the detector's displacement. The oracle is a filter that knows the emulator's true model.",
        "python benchmarks/observer_scan.py --save-design carm.observer.npz --json benchmarks/results/observer_scan.json",
        rows=tuple(
            Rows(scan, ("scans", scan), (Column("shift [µm]", ("shift_um",)), Column("turn [µrad]", ("turn_urad",))), keys)
            for keys in (("motor encoders", "link encoders", "model only", "kf", "ekf", "ukf", "oracle"),)
            for scan in ("roll 30 deg/s", "roll 55 deg/s", "propeller 30 deg/s")
        ),
    ),
    Shown(
        "observer_variances.json",
        "What the observer states, against the truth",
        "True error and stated deviation of the nine geometric parameters on both C-arms; the ratio of stated to true is asked to lie "
        "between 0.7 and 1.5. The observer's model has the machine file's own numbers, so that nothing is false but the effects of "
        "`carm-real`, of which each seed draws the machine: every effect lies somewhere in the range that the file states, and the design "
        "knows its root mean square. The propeller at 37 deg is between the design's poses. Encoders state nothing. An error of a sound "
        "machine passes twice what is stated where one that no sensor shows, above all the turn of a warm detector, lies far out in its "
        "range: no alarm can tell that."
        "\n\nNot met, with the propeller at 37 deg: on `carm` what is stated is 0.57 to 0.59 of what is wrong, and on `carm-real` the "
        "alarm is false 17 times in ten minutes. The model errs by some 30 urad there, more the farther the propeller is from 0 deg, at "
        "the design's own poses, too, and with a denser grid; this is not counted. Without sensors, quiet scans are stated as if shaken.",
        "python benchmarks/observer_variances.py --own-model --json benchmarks/results/observer_variances.json",
        (
            Figure("machines per scan", ("seeds",), asked="at least 20"),
            Figure("model of the observer", ("model",)),
        ),
        (Rows("machine, scan: method", ("rows",), _VARIANCES),),
    ),
    Shown(
        "observer_alarms.json",
        "What the observer's alarm tells",
        "Faults on the same design and machines, in roll scans at 30 deg/s; those of sensors begin after 3 s. Asked: at most one false "
        "alarm in ten minutes, and 90 % of alarms within 1 s where the true error passes twice what is stated."
        "\n\nNot met on `carm-real`: a detector half as heavy again bends from the beginning as a warm one may, and the alarm comes "
        "later, as the pose changes; after a motor encoder's slip, which the link side puts right, the error passes later and by little. "
        "And on sound machines, where an error is far out in its range by chance: no sensor shows that.",
        "python benchmarks/observer_alarms.py --seeds 12 --json benchmarks/results/observer_alarms.json",
        (Figure("machines per fault", ("seeds",)),),
        (
            Rows(
                "machine: fault",
                ("rows",),
                (
                    Column("scans", ("scans",)),
                    Column("error passed twice the stated", ("passed_twice",)),
                    Column("alarm within 1 s", ("in_time",)),
                    Column("share", ("in_time_share",)),
                    Column("false alarms in ten minutes", ("false_alarms_in_ten_minutes",)),
                    Column("rows in alarm", ("alarm_share",)),
                ),
            ),
        ),
    ),
    Shown(
        "observer_tracking.json",
        "A mode that has changed",
        "A natural frequency that the observer adapts (`--adapt`), after 20 s of a shaken scan.",
        "python benchmarks/observer_tracking.py --design carm.observer.npz --json benchmarks/results/observer_tracking.json",
        rows=(
            Rows(
                "shaken scan",
                ("shaken",),
                (
                    Column("error after 20 s [%]", ("error_after_20_s_percent",)),
                    Column("standard deviation believed [%]", ("deviation_believed_percent",)),
                    Column("least possible [%]", ("deviation_possible_percent",)),
                ),
            ),
        ),
    ),
    Shown(
        "shapers_tables.json",
        "The thesis's Chapter 7 with the printed and with the corrected plant",
        "The plant that Sec. 7.4 prints does not give the gains of Table 7.2; frequencies of √2, 2.5 and 3 rad/s with a tenth of the "
        "dampings give the normal filter's, and no plant is known that gives the robust filter's. Errors are the largest of the response "
        "to (7.40), once the transient is over; the second natural and the third forcing frequency change by up to 10 %.\n\n"
        "With both changes the robust filter lowers the error to a fifth with the printed plant, at a smaller error during the transient. "
        "With the corrected one it lowers it by less than a fifth, at a larger error during the transient: within 10 % this plant's second "
        "natural frequency comes to lie on the third forcing frequency. What the thesis says of Fig. 7.13, a far smaller error at the cost "
        "of a larger one during the transient, holds for the corrected plant and the forcing frequency alone.\n\n"
        "Example 7.3: the waves' tracking error, rms after the transient. The gains of Table 7.1 raise it.",
        "python benchmarks/shapers_tables.py --json benchmarks/results/shapers_tables.json",
        rows=(
            Rows(
                "gain (Table 7.2)",
                ("table_7_2",),
                tuple(
                    Column(name, (key,)) for name, key in (("thesis", "thesis"), ("corrected", "corrected"), ("printed plant", "printed"))
                ),
            ),
            Rows(
                "error (Fig. 7.13)",
                ("fig_7_13",),
                (
                    Column("transient [s]", ("transient_s",)),
                    Column("during it", ("during_transient",)),
                    Column("nominal", ("nominal",)),
                    Column("natural frequency ±10 %", ("natural_frequency",)),
                    Column("forcing frequency ±10 %", ("forcing_frequency",)),
                    Column("both ±10 %", ("both",)),
                    Column("conditions missed by", ("largest_residual",)),
                ),
            ),
            Rows(
                "error (Example 7.3)",
                ("example_7_3",),
                (
                    Column("transient [s]", ("transient_s",)),
                    Column("triangle", ("triangle",)),
                    Column("over that without filter", ("triangle_over_none",)),
                    Column("block", ("block",)),
                    Column("over that without filter", ("block_over_none",)),
                ),
            ),
        ),
    ),
    Shown(
        "observer_damping.json",
        "Damping by the observer",
        "Damping ratio of the lowest mode, measured in ring-downs and computed from the linearised loop.",
        "python benchmarks/damping.py --design carm.observer.npz --json benchmarks/results/observer_damping.json",
        rows=(
            Rows(
                "damping ratio asked of `--damping`",
                (),
                (
                    Column("ring-down", ("ring_down_ratio",)),
                    Column("linear loop", ("linear_ratio",)),
                    Column("acceleration, rms [m/s²]", ("shaken", "acceleration_rms_m_s2")),
                ),
                ("asked for 0", "asked for 0.05", "asked for 0.1"),
            ),
        ),
    ),
    Shown(
        "identification_speed.json",
        "Time of the estimators",
        "Processor time for two axes. BLA is the best linear approximation by averaging, LPM and LRM are the local polynomial and rational "
        "methods; [Identification](../explanation/identification.md) explains them.",
        "python benchmarks/identification_speed.py --out benchmarks/results/identification_speed.json",
        (
            Figure("robust BLA", ("robust_bla_s",), "s"),
            Figure("robust LRM", ("robust_lrm_s",), "s"),
            Figure("robust LRM, 13 poses", ("robust_lrm_13_poses_s",), "s"),
            Figure("fast LPM, two experiments", ("fast_lpm_two_experiments_s",), "s"),
            Figure("fast LRM, two experiments", ("fast_lrm_two_experiments_s",), "s"),
            Figure("memory of a long measurement", ("long_measurement_peak_GB",), "GB"),
        ),
    ),
    Shown(
        "identification_coverage.json",
        "Are the covariances true",
        "Data are drawn many times and estimated each time. A ratio of variances of 1 and a share of 0.95 are right. P is the number of "
        "periods; 2D methods use neighbouring poses.",
        "python benchmarks/identification_coverage.py --out benchmarks/results/identification_coverage.json",
        rows=(
            Rows(
                "method and case",
                (),
                (
                    Column("estimated over sample variance, noise", ("noise: estimated over sample variance",)),
                    Column("within the 95 % circle, noise", ("noise: within 95 % circle",)),
                    Column("estimated over sample variance, total", ("total: estimated over sample variance",)),
                    Column("within the 95 % circle, total", ("total: within 95 % circle",)),
                ),
            ),
        ),
    ),
    Shown(
        "identification_public.json",
        "Beside a public package",
        "The same data, estimated by Isocenter and by the package `best-linear-approximation`.",
        "python benchmarks/identification_public.py --out benchmarks/results/identification_public.json",
        (
            Figure("closed loop: largest relative difference of G", ("closed loop", "G")),
            Figure("closed loop: noise variance, package over Isocenter", ("closed loop", "noise variance, theirs over ours")),
            Figure("closed loop: total variance, package over Isocenter", ("closed loop", "total variance, theirs over ours")),
            Figure("closed loop: time of Isocenter", ("closed loop", "ours_s"), "s"),
            Figure("closed loop: time of the package", ("closed loop", "theirs_s"), "s"),
            Figure("Silverbox: largest relative difference of G", ("silverbox", "G")),
            Figure("Silverbox: total variance, package over Isocenter", ("silverbox", "total variance, theirs over ours")),
        ),
    ),
    Shown(
        "identification_modal.json",
        "Modal model at held-out poses",
        "A modal model over roll positions from frequency responses, compared halfway between them.",
        "python benchmarks/identification_modal.py --out benchmarks/results/identification_modal.json",
        rows=(
            Rows(
                "poses",
                (),
                (
                    Column("largest error of a natural frequency [%]", ("largest error of a natural frequency [%]",)),
                    Column("largest error of a damping ratio [%]", ("largest error of a damping ratio [%]",)),
                    Column("within the noise bound", ("within the noise bound",)),
                ),
                ("13 poses, 15 degrees apart", "25 poses, 7.5 degrees apart"),
            ),
        ),
    ),
    Shown(
        "identification_sec35.json",
        "Robust and fast methods (thesis Sec. 3.5)",
        "Fast methods on one recording, robust ones on 14. Standard deviation of the response, over that of the robust BLA.",
        "python benchmarks/identification_sec35.py --out benchmarks/results/identification_sec35.json",
        rows=(
            Rows(
                "method",
                (),
                (
                    Column("deviation over robust BLA's", ("deviation_over_robust_BLA",)),
                    Column("predicted by the covariances", ("predicted_by_the_covariances",)),
                ),
                ("robust BLA", "robust LPM", "robust LRM", "fast LPM", "fast LRM"),
            ),
        ),
    ),
    Shown(
        "identification_sec47.json",
        "Bias and variance over poses (thesis Sec. 4.7)",
        "The emulated C-arm at 25 roll positions. The error is that of the thesis's (4.55), relative to the response.",
        "python benchmarks/identification_sec47.py --out benchmarks/results/identification_sec47.json",
        (
            Figure("variance gained by 2D-LPM over LPM, inner poses", ("gain of 2D-LPM over LPM [dB]", "measured_inner_poses"), "dB"),
            Figure("the same, predicted", ("gain of 2D-LPM over LPM [dB]", "predicted_inner_poses_from_SHS"), "dB"),
            Figure("variance gained by 2D-LRM over LRM, inner poses", ("gain of 2D-LRM over LRM [dB]", "measured_inner_poses"), "dB"),
            Figure("the same, predicted", ("gain of 2D-LRM over LRM [dB]", "predicted_inner_poses_from_SHS"), "dB"),
        ),
        (
            Rows(
                "method",
                (),
                (
                    Column("error", ("error_4_55_relative",)),
                    Column("reported over sample variance, total", ("reported_over_sample_total_variance",)),
                ),
                ("LPM", "2D-LPM", "LRM", "2D-LRM"),
            ),
        ),
    ),
    Shown(
        "identification_sec48.json",
        "Gain over poses with friction (thesis Sec. 4.8)",
        "The emulated C-arm with a Coulomb friction of 8 Nm in both joints. Figures say by how much neighbouring poses lower the variance.",
        "python benchmarks/identification_sec48.py --out benchmarks/results/identification_sec48.json",
        tuple(
            Figure(f"{method}, {name}", (key, "inner_poses", field), "dB")
            for method, key in (("2D-LPM", "2D-LPM over LPM [dB]"), ("2D-LRM", "2D-LRM over LRM [dB]"))
            for name, field in (
                ("of the noise, predicted", "predicted"),
                ("over draws of phases", "over_draws"),
                ("reported", "reported_total"),
            )
        ),
    ),
    Shown(
        "imaging_markers.json",
        "Accuracy of marker crossings",
        "Twelve emulated images a row; *predicted* is the error that photon noise alone causes.",
        "python benchmarks/imaging_markers.py --out benchmarks/results/imaging_markers.json",
        rows=(
            Rows(
                "plate, blur, photons a pixel",
                ("crossings",),
                (
                    Column("rms error [pixels]", ("rms_pixels",)),
                    Column("predicted [pixels]", ("predicted_pixels",)),
                    Column("by edges, as in the thesis [pixels]", ("edges_rms_pixels",)),
                    Column("time of an image [ms]", ("median_s",), 1e3),
                ),
            ),
        ),
    ),
    Shown(
        "imaging_patients.json",
        "Marker plates with a patient in the beam",
        "Forty emulated images a plate, each with a patient, a pose, a geometry and a dose of its own, 620 × 480 pixels. A crossing is "
        "*uncovered* where the shade about it is a plane to 5 %. Stated over true is 1 where the deviation is true. The last table "
        "has no patient and six images a row: the plate's distance from a focal spot of a size (thesis Sec. 6.6).",
        "python benchmarks/imaging_patients.py --draws 40 --distance-draws 6",
        rows=(
            *(
                Rows(
                    f"{plate} plate",
                    ("patients", plate),
                    (
                        Column("images", ("images",)),
                        Column("found", ("found",)),
                        Column("rms error [pixels]", ("true_pixels",)),
                        Column("stated [pixels]", ("stated_pixels",)),
                        Column("stated over true", ("stated_over_true",)),
                        Column("largest error [pixels]", ("largest_pixels",)),
                    ),
                    keys,
                )
                for plate, keys in (("experimental", ("all",)), ("clinical", ("80% uncovered or more", "fewer uncovered", "all")))
            ),
            Rows(
                "spot, distance",
                ("distance",),
                (
                    Column("blur on the panel [mm]", ("blur_mm",)),
                    Column("crossings", ("crossings",)),
                    Column("rms error [pixels]", ("true_pixels",)),
                    Column("stated [pixels]", ("stated_pixels",)),
                    Column("focal length [µm]", ("focal_length_um",)),
                    Column("focal spot along u, angles fitted [µm]", ("focal_u_um",)),
                ),
            ),
        ),
    ),
    Shown(
        "imaging_speed.json",
        "Time of an image",
        "Plate or phantom found and fitted, in processor time of one process; 1 is a frame's time at 30 a second.",
        "python benchmarks/imaging_speed.py",
        rows=(
            Rows(
                "what, pixels",
                (),
                (Column("processor time [ms]", ("processor_s",), 1e3), Column("share of a frame", ("share_of_frame",))),
            ),
        ),
    ),
    Shown(
        "imaging_reconstruction.json",
        "Reconstruction",
        "150 projections of 256 × 256 pixels into 128³ voxels, one thread.",
        "python benchmarks/imaging_reconstruction.py --json benchmarks/results/imaging_reconstruction.json",
        (Figure("cone-beam volume, wall clock", ("cone_beam", "wall_s"), "s", 1.0, "at most 3 s"),),
    ),
    Shown(
        "calibration_phantom_speed.json",
        "Time of a phantom calibration",
        "1200 images of 620 × 480 pixels, two processes.",
        "python benchmarks/calibration_phantom_speed.py SCAN --out benchmarks/results/calibration_phantom_speed.json",
        (Figure("wall clock", ("wall_s",), "s", 1.0, "at most 60 s"), Figure("processor", ("processor_s",), "s")),
    ),
    Shown(
        "calibration_model.json",
        "Kinematic parameters from poses",
        "Four joints of the thesis's Table 2.2, from 1200 measured poses.",
        "python benchmarks/calibration_model.py --out benchmarks/results/calibration_model.json",
        (
            Figure("held-out position error", ("held_out", "position_m"), "µm", 1e6),
            Figure("held-out angle error", ("held_out", "angle_rad"), "µrad", 1e6),
            Figure("parameters within three standard deviations", ("parameters", "within_3_sigma"), "", 1.0, "all"),
            Figure("parameters", ("parameters", "of")),
            Figure("processor time", ("processor_s",), "s"),
        ),
    ),
    *(
        Shown(
            f"calibration_carm_{machine}.json",
            f"Model and look-up tables: {title}",
            "Root mean square error of the geometry in a scan, and overlay errors over benchmark poses. *nominal* is the drawing, "
            "*phantom* a look-up table of the same scan, *model* the kinematic model, *grid* a table of standing poses and *grid_six* "
            "the same with the focal spot held. *Registered* errors leave out what is alike in all poses.",
            f"python benchmarks/calibration_carm.py --machine {machine} --out benchmarks/results/calibration_carm_{machine}.json",
            (),
            (
                Rows("scan of roll", ("pose", "roll"), _POSES),
                Rows("scan of propeller", ("pose", "propeller"), _POSES),
                Rows("roadmap, not registered", ("overlay as-it-is",), _OVERLAY),
                Rows("roadmap, registered", ("overlay registered",), _OVERLAY),
            ),
        )
        for machine, title in (("off", "a C-arm built off its drawing"), ("bending", "the same, with an arc that bends at the tube"))
    ),
    Shown(
        "calibration_consistency.json",
        "A scan recalibrated from its own images",
        "Emulated C-arm built askew, 129 exposures. Error is of shadows on the panel (rms), the scan's place and size fitted. Where the "
        "images do not say that something has changed, no table is written and the start stays. The stated deviation is of slow changes; "
        "vibration, 5 µm here, is not in it. An earlier form with a prior of 2 mm, all pixels, and pairs taken as independent left "
        "wires 0.90 mm wrong from the drawing and up to 1.4 mm from the phantom's table: refuted.",
        "python benchmarks/calibration_consistency.py --work FOLDER --json benchmarks/results/calibration_consistency.json",
        (),
        (
            Rows(
                "object, start",
                ("scans",),
                (
                    Column("error before [mm]", ("before_mm",)),
                    Column("error after [mm]", ("after_mm",)),
                    Column("stated [mm]", ("stated_mm",)),
                    Column("table written", ("changed",)),
                    Column("processor time [s]", ("cpu_s",)),
                ),
            ),
        ),
    ),
    Shown(
        "calibration_consistency_drawn.json",
        "A scan recalibrated: drawn machines",
        "Machines that have changed by a draw: 0.3 mm and 0.3 mrad in each of the nine parameters, less in faster courses.",
        "python benchmarks/calibration_consistency.py --work FOLDER --drawn benchmarks/results/calibration_consistency_drawn.json",
        (),
        (
            Rows(
                "object",
                ("drawn",),
                (
                    Column("draws", ("draws",)),
                    Column("tables written", ("changed",)),
                    Column("worse than before", ("worse",)),
                    Column("error before [mm]", ("before_mm",)),
                    Column("error after [mm]", ("found_mm",)),
                    Column("stated over true", ("ratio",)),
                ),
            ),
        ),
    ),
    Shown(
        "calibration_states.json",
        "Parameters as states of one filter with images",
        "Thesis Tables 5.1, 5.2 and Fig. 5.8 on drawn runs. Errors are of poses that no image showed; squared errors are over what the "
        "filter states, 1 where it is true. The thesis's recordings are not public. Its two tables differ by more in angles and ratios "
        "than runs with this noise do, which is not explained. Where joints stand still, parameters wander along what nothing shows; poses "
        "do not. Without an inertial sensor, two images a second do not tell frequencies.",
        "python benchmarks/calibration_states.py --json benchmarks/results/calibration_states.json",
        (
            Figure("images until the error stays below a single image's", ("tables", "converged"), asked="about 20 (thesis)"),
            Figure("phantom, after 20 images", ("tables", "after", "20", "held_out_m"), "mm", 1e3, asked="0.04"),
            Figure("phantom, model-based from all 40 images at once", ("tables", "model_based", "held_out_m"), "mm", 1e3),
            Figure("phantom, between the printed tables", ("printed", "phantom_m"), "mm", 1e3),
            Figure("squared error, chain's parameters", ("tables", "nees", "chain"), asked="1"),
            Figure("squared error, modes' parameters", ("tables", "nees", "dynamic"), asked="1"),
            Figure("squared error, poses along the runs", ("tables", "nees", "poses"), asked="1"),
        ),
        (
            Rows(
                "images",
                ("tables", "after"),
                (
                    Column("phantom, median [mm]", ("held_out_m",), 1e3),
                    Column("rotation [mrad]", ("held_out_rad",), 1e3),
                    Column("phantom, worst [mm]", ("worst_m",), 1e3),
                ),
            ),
            Rows(
                "rms by column [SI]",
                ("printed", "columns"),
                (
                    Column("Table 5.2 less 5.1", ("printed_rms",)),
                    Column("filter's error", ("filter_rms",)),
                    Column("model's error", ("model_rms",)),
                ),
            ),
            Rows(
                "images withdrawn after 20, frequencies fall by 5 %",
                ("withdrawn", "along"),
                (
                    Column("phantom [mm]", ("phantom_m",), 1e3),
                    Column("stated", ("stated_m",), 1e3),
                    Column("frequencies [%]", ("frequency_share",), 1e2),
                    Column("at the start's values", ("frequency_start_share",), 1e2),
                ),
            ),
            Rows(
                "robustness",
                ("robustness",),
                (
                    Column("phantom [mm]", ("held_out_m",), 1e3),
                    Column("worst", ("worst_m",), 1e3),
                    Column("in all poses", ("everywhere_m",), 1e3),
                    Column("images", ("converged",)),
                    Column("squared error: chain", ("nees_chain",)),
                    Column("modes", ("nees_dynamic",)),
                    Column("poses", ("nees_poses",)),
                    Column("frequency [%]", ("frequency_share",), 1e2),
                    Column("refused", ("refused",)),
                ),
            ),
        ),
    ),
    Shown(
        "calibration_side_by_side.json",
        "All calibrations on one scan",
        "Root mean square error of the geometry, for a machine that repeats itself and for one that does not. *Data-driven* is the filter "
        "of [Calibration](../explanation/calibration.md), *marker-augmented* the same with a plate in every exposure. *Live* is what was "
        "known at each sample; other rows use the parameters of the end.",
        "python benchmarks/calibration_side_by_side.py --work WORK --json benchmarks/results/calibration_side_by_side.json",
        (
            Figure("recording time of the look-up tables", ("workload", "phantom_s"), "s"),
            Figure("recording time of the model's tour", ("workload", "tour_s"), "s"),
        ),
        (
            Rows("repeatable", ("repeatable", "rows"), _PLACES),
            Rows("not repeatable", ("not_repeatable", "rows"), _PLACES),
        ),
    ),
    Shown(
        "calibration_other_runs.json",
        "Data-driven calibration on further scans",
        "Median error over scans. *Images of the tour* are those that the calibration before the scan was made from.",
        "python benchmarks/calibration_other_runs.py --work WORK --json benchmarks/results/calibration_other_runs.json",
        rows=(
            Rows(
                "calibration",
                ("summary",),
                (
                    Column("focal spot [mm]", ("median", "source_mm")),
                    Column("isocentre [mm]", ("median", "phantom_mm")),
                    Column("rotation [mrad]", ("median", "rotation_mrad")),
                ),
            ),
        ),
    ),
    Shown(
        "calibration_live.json",
        "Calibration during a run",
        "Root mean square error of the geometry of a run in lockstep with images.",
        "python benchmarks/calibration_live.py --work WORK --json benchmarks/results/calibration_live.json",
        (
            Figure("images used", ("images",)),
            Figure("time of a row", ("step", "row_median_us"), "µs"),
            Figure("time of an image", ("step", "image_median_us"), "µs"),
        ),
        (Rows("geometry", (), _LIVE, _LIVE_ROWS),),
    ),
    Shown(
        "calibration_live_wall.json",
        "Calibration during a run, wall clock",
        "The same in two processes on a UDP bus.",
        "python benchmarks/calibration_live.py --work WORK --bus udp: --json benchmarks/results/calibration_live_wall.json",
        (Figure("ticks missed", ("wall clock", "timing", "missed")), Figure("images used", ("wall clock", "images", "used"))),
        (Rows("geometry", (), _LIVE, _LIVE_ROWS),),
    ),
)

PROOF = "concealed/scores_sealed.json"
PROOF_COMMAND = "python benchmarks/concealed all --results DIR --work WORK"
PROOF_TEXT = """
Machines with concealed physics, simulated by code that shares nothing with the diagnosis. [The proof](../explanation/proof.md) says
how they are drawn and judged.

A *null* hides nothing. The *oracle* is a fit that knows what is hidden; it *separates* an effect whose name may be asked for.
*Confident* is the verdict `explained`. A law off the catalogue is *spanned* where an effect of the catalogue imitates it, in the
strength that was drawn. The column *of* holds what was counted, and how many there were.
"""
