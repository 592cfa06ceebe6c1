"""Results of how long things take on the bench."""

from __future__ import annotations

from docs.generate.shown.kinds import Column, Figure, Rows, Shown

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

_SAMPLED = {
    "link_position_turn": "link encoder",
    "position_turn": "motor encoder",
    "current_turn": "current",
    "velocity_actual_value": "drive's speed",
    "imu_y": "acceleration along the motion",
    "imu_x": "across it",
    "gyro_z": "rate of turn",
}

TIMING = (
    Shown(
        "sampling.json",
        "What the emulated bus samples",
        "A turntable with an IMU on the emulator, and the same drive, axis and sensors at steps of 20 µs, by code that shares nothing with "
        "it, under the same targets. Largest difference at any SYNC, beyond rounding, in counts of each channel; for the speed, encoder "
        "counts in a row. An accelerometer's count is a fiftieth of its noise; plant steps of 1 ms make its differences.",
        "python benchmarks/sampling.py",
        (),
        (Rows("drive", ("conventions",), tuple(Column(name, (key, "counts")) for key, name in _SAMPLED.items())),),
    ),
    Shown(
        "supervisor_cost.json",
        "What the supervisor costs the sample loop",
        "The emulated C-arm stands under control at 256 Hz over UDP, on an idle computer of two processors: short runs "
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
        "bench_clients.json",
        "What watching costs the sample loop",
        "The same with the bench's page: short runs in pairs, one that nobody watches and one with a browser on the scope and nine readers "
        "at full rate.",
        "python benchmarks/bench_clients.py",
        (
            Figure("added to a whole tick, 50 %, median of the pairs", ("added_us", "p50", "median"), "µs"),
            Figure("added to a whole tick, 99.9 %, median of the pairs", ("added_us", "p99.9", "median"), "µs"),
            Figure("smallest", ("added_us", "p99.9", "smallest"), "µs"),
            Figure("largest", ("added_us", "p99.9", "largest"), "µs"),
        ),
        (
            Rows(
                "watched by",
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
        "wall_clock_udp.json",
        "Timing on the wall clock, beside a bare python-can loop",
        "Loop and emulated machine in two processes on a UDP bus, with shaper, observer and damping, two virtual processors with real-time "
        "scheduling. *Bare* is a loop that exchanges the same frames with the same emulator and computes nothing, before and after the "
        "bench in one run. A whole tick lasts from when it is due until the loop is ready to wait again. Of a case's repeats, of about "
        "a minute each, the one with the middle ratio is shown.",
        "python benchmarks/wall_clock.py --seconds 60 --repeats 3",
        tuple(
            figure
            for case, name in _CASES.items()
            for figure in (
                Figure(f"{name}: 99.9 % of the bench over that of the bare loop", (case, "ratio_p99.9"), asked="at most 1.5"),
                Figure(f"{name}: smallest of the repeats", (case, "smallest_ratio")),
                Figure(f"{name}: largest", (case, "largest_ratio")),
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
        "doctor.json",
        "What `doctor` foretells, and the ten minutes after it",
        "`doctor` with a trial of a minute, then ten minutes of `run static` over UDP, by turns, on an idle virtual machine of two "
        "processors whose host serves others, too. Stalls that the minute has not seen come later. The halves of one run show how near a "
        "prediction could come.",
        "python benchmarks/doctor.py",
        (
            Figure("predictions", ("runs",)),
            Figure("99.9 % of a tick, within its interval", ("p99.9_within_its_interval",), asked="nine of ten"),
            Figure("missed ticks, within theirs", ("missed_within_its_interval",), asked="nine of ten"),
            Figure("99.9 % of a tick, within a factor of 1.5", ("how_many_within",)),
            Figure("halves of a run within a factor of 1.5 of each other", ("halves_within",)),
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
        "cold_and_warm.json",
        "First use",
        "Processor time with no compiled code kept, over that with it.",
        "python benchmarks/cold_and_warm.py",
        (
            Figure("`demo`", ("demo", "cold_over_warm"), asked="at most 1.5"),
            Figure("`run jog`", ("run jog", "cold_over_warm"), asked="at most 1.5"),
            Figure("`machine show carm`, the next use", ("machine show carm", "warm_processor_s"), "s"),
            Figure("`--help`", ("--help", "warm_processor_s"), "s"),
            Figure("`stop`", ("stop", "warm_processor_s"), "s"),
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
)
