"""Results of identification."""

from __future__ import annotations

from docs.generate.shown.kinds import Column, Figure, Rows, Shown

IDENTIFICATION = (
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
)
