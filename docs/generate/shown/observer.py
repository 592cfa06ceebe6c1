"""Results of the observer."""

from __future__ import annotations

from controllers.observers.publish import QUANTITIES
from docs.generate.shown.kinds import Column, Figure, Rows, Shown

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
_FILTERS = ("kf", "ekf", "ukf", "filterpy_ukf", "numpy_ukf")

OBSERVER = (
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
        "observer_published.json",
        "What one command's observer states, against the truth",
        "Stated deviation over true error of all that is published, for the design that `hil.design_observer(MACHINE)` makes, on machines "
        "drawn within the ranges of the file, others than those to which it was held; 0.7 to 1.5 is asked. NIS stays below 1: the noise "
        "model leaves room for shaking, which these scans have not, while what is published is wrong by slow errors that no innovation "
        "shows: tilt against bias, heat, encoders' eccentricity.",
        "python benchmarks/observer_published.py --json benchmarks/results/observer_published.json",
        (
            Figure("machines per scan", ("seeds",), asked="at least 20"),
            Figure("cells", ("cells",)),
            Figure("cells outside 0.7 to 1.5", ("outside",), asked="0"),
        ),
        (
            Rows(
                "machine, scan: method",
                ("rows",),
                (*(Column(name, (name,)) for name in QUANTITIES), Column("NIS per measurement", ("nis",))),
            ),
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
        "alarm is false 17 times in ten minutes. These numbers are of a model in which a bend before an axis did not turn in the "
        "detector's frame as that axis does, which was 30 urad there; they have not been measured anew. Without sensors, quiet scans are "
        "stated as if shaken.",
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
        "And on sound machines, where an error is far out in its range by chance: no sensor shows that."
        "\n\nThen effects drawn over a range, on machines that are drawn, too, with the design that `hil.design_observer(MACHINE)` makes, "
        "whose alarm knows sound machines; beside it the alarm by corrections, in the same replay. An error that the same machine without "
        "the effect has as well does not count. What bends the arm does so from the beginning, and at rest looks like an IMU that sits "
        "askew: the alarm comes as gravity turns in the arm's frame. False alarms of a drawn effect are true of the machine: something is "
        "wrong with it, but the error stays below twice what is stated. Not met on `carm-real`: loads and soft mounts are seldom told "
        "within 1 s (1 of 4 and 7 of 20; on `carm` 3 of 3 and 10 of 15), as its design says. No sensor is lost in "
        "these scans. Another 72 sound machines of `carm-real` raised one false alarm in 10.1 minutes.",
        "python benchmarks/observer_alarms.py --seeds 12 --json benchmarks/results/observer_alarms.json",
        (Figure("machines per fault", ("seeds",)),),
        (
            Rows(
                "machine: drawn effect",
                ("drawn",),
                (
                    Column("scans", ("scans",)),
                    Column("largest error over stated, median", ("median_ratio",)),
                    Column("error passed twice the stated", ("passed_twice",)),
                    Column("alarm within 1 s", ("in_time",)),
                    Column("by corrections", ("in_time_before",)),
                    Column("scans in which it passed", ("scans_that_passed",)),
                    Column("with an alarm", ("alarmed_that_passed",)),
                    Column("by corrections", ("alarmed_that_passed_before",)),
                    Column("false alarms in ten minutes", ("false_alarms_in_ten_minutes",)),
                    Column("by corrections", ("false_alarms_in_ten_minutes_before",)),
                ),
            ),
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
)
