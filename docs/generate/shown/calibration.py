"""Results of calibrations."""

from __future__ import annotations

from docs.generate.shown.kinds import Column, Figure, Rows, Shown

_PLACES = (
    Column("focal spot [mm]", ("source_mm",)),
    Column("isocentre [mm]", ("phantom_mm",)),
    Column("rotation [mrad]", ("rotation_mrad",)),
)
_POSES = (
    Column("focal spot [mm]", ("source_m",), 1e3),
    Column("isocentre [mm]", ("position_m",), 1e3),
    Column("rotation [mrad]", ("rotation_rad",), 1e3),
)
_OVERLAY = tuple(Column(f"{place}, largest of the best 90 % [mm]", (place, "max_90"), 1e3) for place in ("centre", "1/3", "2/3"))
_SHARES = {"p50": "half", "p95": "95 %", "max": "oldest"}
_LIVE = (Column("focal spot [mm]", ("source",)), Column("isocentre [mm]", ("phantom",)), Column("rotation [mrad]", ("rotation",)))
_LIVE_ROWS = (
    "nominal",
    "live, row by row",
    "live, parameters of the end",
    "afterwards, as known at each row",
    "afterwards, parameters of the end",
)

CALIBRATION = (
    Shown(
        "calibration_phantom_speed.json",
        "Time of a phantom calibration",
        "1200 images of 620 × 480 pixels, two processes.",
        "python benchmarks/calibration_phantom_speed.py SCAN --out benchmarks/results/calibration_phantom_speed.json",
        (Figure("wall clock", ("wall_s",), "s", 1.0, "at most 60 s"), Figure("processor", ("processor_s",), "s")),
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
        "live_images.json",
        "Images beside the loop",
        "Phantom (`dodecahedron`) or plate at 30 frames a second, found by a process beside the loop at 256 Hz on a UDP bus, two virtual "
        "processors. Emulated machine and panel share them; the machine jogs, and frames are made beforehand. Binning 2 is 1240 x 960 "
        "pixels. An image is *in time* where it is taken in before the middle of the next exposure; its age counts from the middle of its "
        "own. *No images* is the same loop and observer alone; *loaded*: two processes of lowest priority compute all the time. A tick "
        "lasts from when it is due until the loop waits again.",
        "python benchmarks/live_images.py --work WORK",
        rows=(
            Rows(
                "in the beam",
                (),
                (
                    Column("in time", ("images", "in_time")),
                    Column("images", ("images", "exposures")),
                    Column("taken in", ("images", "used")),
                    Column("skipped", ("images", "skipped")),
                    *(Column(f"age, {name} [ms]", ("images", "age_ms", key)) for key, name in _SHARES.items()),
                    Column("ticks", ("tick", "ticks")),
                    Column("missed", ("tick", "missed")),
                    Column("tick, 99 % [µs]", ("tick", "p99_us")),
                    Column("99.9 % [µs]", ("tick", "p99.9_us")),
                ),
            ),
        ),
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
