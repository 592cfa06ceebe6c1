"""Results of images."""

from __future__ import annotations

from docs.generate.shown.kinds import Column, Figure, Rows, Shown

IMAGING = (
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
)
