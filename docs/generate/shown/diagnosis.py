"""Results of the diagnosis, beside its proof."""

from __future__ import annotations

from docs.generate.shown.kinds import Column, Figure, Rows, Shown

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
        "demo_seeds.json",
        "The demo's answers",
        "The emulated C-arm with one effect or two that a seed draws, at two to five detection limits; its numbers are those of the file, "
        "which states them to 1 %. Right names their families and places, and nothing else. Whole processes on two "
        "cores that other work shared, from a warm start.",
        "python benchmarks/demo_seeds.py score",
        (
            Figure("seeds", ("score", "seeds")),
            Figure("right", ("score", "right"), asked="45"),
            Figure("ambiguous with the truth listed", ("score", "listed")),
            Figure("nothing named", ("score", "silent")),
            Figure("one of two named", ("score", "in part"), asked="0"),
            Figure("wrong", ("score", "wrong"), asked="0"),
            Figure("that the bench did not record", ("score", "failed"), asked="0"),
            Figure("of wrong and half answers, `explained`", ("score", "wrong or in part, and explained"), asked="0"),
            Figure("of those with one effect", ("score", "one hidden")),
            Figure("of these right", ("score", "right of these")),
            Figure("time, median", ("score", "median_s"), "s", asked="60"),
            Figure("time, longest", ("score", "longest_s"), "s", asked="60"),
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
