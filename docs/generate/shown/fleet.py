"""Results of a fleet."""

from __future__ import annotations

from docs.generate.shown.kinds import Column, Figure, Rows, Shown

FLEET = (
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
        "for step in sound found short score; do python benchmarks/fleet_change.py $step WORK; done",
        (
            Figure("machine-years in which nothing changes", ("sound", "machine_years"), asked="at least 2000"),
            Figure("false alarms in 100 of them", ("sound", "per_100_machine_years"), asked="at most 1"),
            Figure("one fleet over 60 nights: of 30 changed found", ("found", "found"), asked="at least 27"),
            Figure("machines that did not change and were named", ("found", "false_machines")),
            Figure("forty drawn fleets: changed machines found, of 1200", ("short", "found"), asked="at least 1080"),
            Figure("machines told right, changed or sound", ("short", "map_right"), "%", 1e2, asked="at least 95 %"),
            Figure("false alarms in 100 machine-years of these", ("short", "per_100_machine_years"), asked="at most 1"),
            Figure("the same at most, at 95 %", ("short", "upper_95")),
        ),
    ),
    Shown(
        "fleet_nights.json",
        "Machines recorded every night, in a fleet",
        "Four emulated turntables, one with friction that grows and one with friction that steps, through three recordings of 10 s a "
        "night, checked, fitted and diagnosed by `isocenter fleet run`; as four of a fleet of 200 over 60 nights, whose others are drawn "
        "with the covariances measured on them. The growth begins on night 20, the step on night 30: fewer recorded nights cannot show "
        "them. Scatter is about what was hidden, each machine's mean error taken off.",
        "python benchmarks/fleet_nights.py WORK",
        (
            Figure("machine-nights recorded and fitted, of 240", ("machine_nights",)),
            Figure("of 30 changed machines found", ("of_200", "found"), asked="at least 27"),
            Figure("machines that did not change and were named", ("of_200", "false_machines")),
            Figure("machines told right, changed or sound", ("of_200", "map_right"), "%", 1e2, asked="at least 95 %"),
            Figure("delay of a step, median", ("of_200", "delay_nights", "step", "median"), "nights"),
            Figure("of a growth", ("of_200", "delay_nights", "growth", "median"), "nights"),
            Figure("dry friction scatters by", ("compared", "coulomb_friction", "scatter"), "Nm"),
            Figure("which the fit states as", ("compared", "coulomb_friction", "stated_deviation"), "Nm"),
            Figure("carried to the next night", ("compared", "coulomb_friction", "carried_to_the_next_night")),
        ),
    ),
    Shown(
        "fleet_night.json",
        "A fleet's night, whole",
        "200 C-arms with three recordings of 10 s each through `isocenter fleet run` on two workers: all checked and identified, two, "
        "whose friction changed, diagnosed. Memory is what is resident in all processes together.",
        "python benchmarks/fleet_night.py WORK",
        (
            Figure("time on the wall", ("wall_s",), "s"),
            Figure("other load when it began", ("load_average",)),
            Figure("processor time, all processes", ("processor_s",), "s"),
            Figure("of that for a recording", ("processor_s_per_recording",), "s"),
            Figure("largest memory of all processes", ("resident_GB",), "GB"),
            Figure("a recording", ("bytes_per_recording",), "kB", 1e-3),
            Figure("its results", ("result_bytes_per_recording",), "kB", 1e-3),
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
)
