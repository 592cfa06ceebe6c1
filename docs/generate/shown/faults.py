"""Results of faults, drive modes, devices and files of others."""

from __future__ import annotations

from docs.generate.shown.kinds import Column, Figure, Rows, Shown


def _faults(measure: str) -> tuple[Column, ...]:
    """Return the columns of a fault table's counts."""
    names = ("rows", "stopped", "noted", "within_tolerance", "cannot_be_held", "unnoticed", "over_budget", "contradicted")
    heads = {"rows": "faults", "over_budget": "over their budget", "contradicted": "told what the truth contradicts"}
    return tuple(Column(heads.get(name, name.replace("_", " ")), (measure, name)) for name in names)


FAULTS = (
    Shown(
        "killed_together.json",
        "Processes of the bench killed or stopped at speed",
        "The emulated C-arm moves roll at 0.4 rad/s over UDP, then processes of its bench are killed together; in some rows somebody else "
        "goes on sending the bench's heartbeat. In further rows processes are stopped (SIGSTOP) and go on later; the run may go on, and "
        "then has no time to rest. Time and travel count from the kill or stop, by the emulator's truth. No device has a fault: words that "
        "accuse one would be wrong.",
        "python benchmarks/killed_together.py",
        (),
        (
            Rows(
                "killed or stopped",
                ("rows",),
                (
                    Column("the run goes on", ("goes_on",)),
                    Column("at rest", ("at_rest",)),
                    Column("time to rest [s]", ("rest_s",)),
                    Column("travel [mrad]", ("travel_rad",), 1e3),
                    Column("words that accuse a device", ("accuses",)),
                ),
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
        "field_inputs.json",
        "Inputs that people bring",
        "Logs whose stamps and order disagree, data sheets with rare sections, files that are not what their name says, columns in other "
        "units, and geometry of other programs, made with known content. Right is what comes out as it went in, with a word on what was "
        "done or not taken; a refusal counts where its one line names what was seen and the way out.",
        "python benchmarks/field_inputs",
        (
            Figure("inputs", ("total", "inputs")),
            Figure("right", ("total", "right")),
            Figure("refused with the way out", ("total", "refused")),
            Figure("wrong", ("total", "wrong"), asked="0"),
        ),
        (
            Rows(
                "kind",
                ("kinds",),
                (
                    Column("inputs", ("inputs",)),
                    Column("right", ("right",)),
                    Column("refused with the way out", ("refused",)),
                    Column("wrong", ("wrong",)),
                ),
            ),
        ),
    ),
)
