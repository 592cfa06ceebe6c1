"""Keys of every command's JSON answer, and of diagnosis.json: of a verb from its answer's fields; a test holds the others to the code."""

from __future__ import annotations

from docs.generate.answer_types import entries
from docs.generate.format_tables import Entry
from hil.verbs.calibrate import CalibrateAnswer
from hil.verbs.check import CheckAnswer
from hil.verbs.compare import CompareAnswer
from hil.verbs.expose import ExposeAnswer
from hil.verbs.identify import ResponseAnswer
from hil.verbs.observe import ObserveAnswer
from hil.verbs.plot import PlotAnswer
from hil.verbs.reconstruct import ReconstructAnswer
from hil.verbs.shape import ShapeAnswer
from hil.verbs.simulate import SimulateAnswer

_RUN = (
    Entry("machine, hash", "text", "Name and hash of the machine file."),
    Entry("bus, scheduler", "text", "The bus, and how the loop was scheduled."),
    Entry("emulated", "true or false", "Whether an emulator of this host was the machine."),
    Entry(
        "recordings",
        "list",
        "`recording` and `events` (the files), `experiment` (its metadata), `notes`, `judged` (a line for every check that a sensor "
        "failed; with any the exit status is 1), and `timing`: `ticks`, `missed`, and of `lateness`, `work_time`, its parts `answer_time`, "
        "`compute_time` and `write_time`, and `own_work_time`, the last two together, the keys `…_p50_us`, `…_p99_us`, `…_p99.9_us` and "
        "`…_max_us`.",
    ),
    Entry(
        "calibration",
        "object",
        "Only with `--data`: images by fate, `age_s` (`p50`, `p95`, `max`: from the middle of their exposures to the rows that took them "
        "in), `place_sigma_m`, `lost`, `unplaced`, `skipped` (not looked at, as a newer one was there), `source` and the file `geometry`.",
    ),
    Entry(
        "faults",
        "object",
        "Only with `--faults`: `events`, when each fault began and ended (`time_s` of the machine, `label`, `begins`), and `outcome` since "
        "the last began: `onset_s`, `watched_s`, and of each of `axes` `axis`, `ending`, `rest_s`, `travel`, `furthest`, `fastest`.",
    ),
    Entry("quirks", "list", "Only with `--quirk`: each as `DRIVE:NAME`."),
)

_FLEET_CHANGE = (
    Entry("software", "text", "The version that found it."),
    Entry("answer", "text", "Who needs a visit, in a sentence."),
    Entry(
        "changes",
        "list",
        "The most certain first: `machine`; `task`, `experiment`, `quantity` and `unit` of the parameter; `kind`, `step` or `growth`; "
        "`sigma`, evidence in standard deviations, its sign the direction; `alarm`, the night on which it passed the threshold; `since`, "
        "when it began, and `since_ci95`; `before` and `now` with the `standard_deviation` of their difference; `also`, other "
        "quantities that changed with it; `sentence`.",
    ),
    Entry("common", "list of text", "What moved on all machines at once."),
    Entry("notes", "list of text", "What limits the answer: few nights, few machines."),
    Entry("machines, parameters", "number", "How many there are, and how many of the parameters have enough results."),
    Entry("nights", "list of text", "First and last."),
    Entry("threshold_sigma", "number", "From which evidence on a machine is named."),
    Entry("false_alarms_per_machine_year_stated", "number", "The rate that the threshold keeps."),
    Entry("machine_years_watched", "number", "Over which alarms could be raised."),
)

COMMANDS: dict[str, tuple[Entry, ...]] = {
    "demo": (
        Entry("page", "text", "The page that was written."),
        Entry("seconds", "number", "Time of the whole."),
        Entry(
            "seed, seal",
            "number or null, text",
            "What drew, null for the demo's own; SHA-256 of what is hidden, said before the first run.",
        ),
        Entry("envelope, recordings, diagnosis", "text, list", "Files that were written."),
        Entry("hidden[].effect, at, parameters", "text, object", "What the emulated machine had."),
        Entry(
            "verdict, findings, held_out",
            "text, list, object",
            "The answer; findings by effect and place, errors as of `diagnose`.",
        ),
        Entry(
            "worth",
            "text",
            "`right`: named are the hidden effects, or laws of their families, at their places, and nothing else; `listed`: among the sets "
            "of an ambiguous answer; `in part`: some of them, and nothing else; `silent`: nothing; `wrong`.",
        ),
    ),
    "effects": (
        Entry(
            "[].name, plain, kind, equation, convention, source", "text", "One object per effect, as on the page of [effects](effects.md)."
        ),
        Entry("[].at, neighbours", "list", "Kinds of place, and effects it is mistaken for."),
        Entry("[].needs", "text", "`spring` or `neighbour`, where the place needs one."),
        Entry("[].several", "text", "Parameter in which several at one place differ."),
        Entry("[].family, parent", "text", "Laws that are hard to tell from each other, and the effect that this one refines."),
        Entry("[].everyday", "true or false", "Whether an engineer's first fit has it."),
        Entry(
            "[].parameters",
            "list",
            "`name`, `key`, `unit`, `key_prismatic`, `unit_prismatic`, `low`, `high`, `description`, `is_strength`, `neutral`.",
        ),
    ),
    "emulate": (
        Entry("ready", "text", "The machine or EDS file. The object is written in one line when everything listens."),
        Entry("bus", "text", "The bus."),
        Entry("node", "number", "Only with `--eds`."),
        Entry("imu, imu_tcp, io, io_rtu, panel", "text", "Ports of the emulated devices, those that there are."),
    ),
    "fleet run": (
        Entry("store", "text", "Folder of the results."),
        Entry(
            "planned, present, unneeded, done",
            "number",
            "Tasks that the recordings make; those that had a result; diagnoses of nights that agree with the simulation; results written.",
        ),
        Entry("by_verdict", "object", "How many of the new results say what."),
        Entry("failures", "list of text", "New results without an answer: machine, date, task, and why."),
        Entry("wrong", "list of text", "What could not be used: machine files, folders, recordings without a date."),
        Entry("cancelled", "true or false", "Whether Ctrl-C ended it early."),
    ),
    "fleet status": (
        Entry("store", "text", "Folder of the results."),
        Entry(
            "machines",
            "list",
            "`machine`; `nights` with results, and the `newest`; `results`, of which `failed` have no answer and `differing` are of "
            "recordings that differ from their simulation; `waiting`, tasks without a result.",
        ),
        Entry("failures, wrong", "list of text", "As of `fleet run`, of all results."),
    ),
    "fleet query": (
        Entry("columns", "list of text", "Names of the columns."),
        Entry("rows", "list", "An object per row; times as ISO 8601 text in UTC, numbers that are none as null."),
    ),
    "fleet change": _FLEET_CHANGE,
    "fleet page": (Entry("page", "text", "The fleet's page."), *_FLEET_CHANGE),
    "faults list": (
        Entry(
            "faults",
            "list",
            "`name`, `does`, `class`, `at`, `at_in_words`, `emulated`, and `parameters` as on the page of [faults](faults.md).",
        ),
        Entry("places, states", "object", "Kinds of place, and states that a condition may name, in words."),
    ),
    "faults quirks": (Entry("quirks", "list", "`name`, `does`, `group` and `source`, the address of a report."),),
    "faults check": (
        Entry("machine, hash, software", "text", "What was tried, and with which version."),
        Entry("axis, motion, speed, unit, rows", "text, text, number, text, number", "What moved in every run, and its greatest speed."),
        Entry("verdicts", "object", "How many faults ended how."),
        Entry("processor_s", "number", "Processor time of all runs."),
        Entry(
            "faults",
            "list",
            "`name` of the row, `kind`, `at`, `group`, `during`; `verdict` (stopped, noted, within tolerance, unnoticed, cannot be "
            "held, not at rest, never began, did not end), `exit_status`, `said`, `stopping`; `rows` kept of `planned`; `onset_s`, "
            "`rest_s`, `travel`, `ending`, `watched_s`, and `axes` as of `run`; `budget` of a stop (null: none): its class `name`, what it "
            "took (`time_s`, `travel`; null: it did not come to stand) and what is allowed (`allowed_s`, `allowed_travel`); "
            "`contradicted`, claims of `said` that the truth contradicts; `processor_s`.",
        ),
    ),
    "doctor": (
        Entry("machine, bus", "text", "Machine and bus."),
        Entry("ok, says", "true or false, text", "Nothing is bad; the answer in a sentence."),
        Entry("findings", "list", "`level` (ok, look, bad, not known), `check`, what was `found`, and `advice`, which may be empty."),
        Entry(
            "prediction",
            "object or null",
            "Of whole ticks, from due to ready to wait again; null where nothing was measured. `ticks`, `period_s`, `p50_s`, `p99_s`, "
            "`p999_s`, and for the ten minutes after it `p999_least_s` to `p999_most_s`, nine times of ten if the computer goes on as in "
            "the trial, `max_s`; `missed_in_trial`; per ten minutes `expected_missed`, extrapolated from block maxima, and `least_missed` "
            "to `most_missed`, as often.",
        ),
        Entry("wake_up_us", "object or null", "Lateness of a loop without a bus: `p50`, `p99`, `p99.9`, `max`."),
        Entry("trial", "object or null", "Timing of the run against the emulated machine, as in a recording."),
        Entry("answer_from", "text", "Where the time of the devices' answers in the prediction is from."),
    ),
    "bench": (
        Entry("address", "text", "The address to open, with its one-time token. One line, as soon as the page is served."),
        Entry("machine, bus", "text", "Machine and bus."),
        Entry("folder", "text", "Where recordings and answers go."),
    ),
    "attend": (
        Entry("machine, bus, emulated", "text, text, true or false", "Where it was."),
        Entry("position", "object", "Where each axis stood at the end [rad or m]."),
    ),
    "scan-bus": (
        Entry("bus", "text", "The bus."),
        Entry("nodes", "list", "`node_id`, `device_type`, `description`, `identity`, `nmt_state`, `name`."),
    ),
    "commission": (
        Entry("machine, hash", "text", "Name and hash of the machine file."),
        Entry("folder, page", "text, text or null", "Where everything is, and the page of it."),
        Entry("says, next", "text", "The answer in a sentence, and the command to type next."),
        Entry("ok, emulated", "true or false", "Every step passed; anything was recorded on the emulator."),
        Entry("comparison", "object or null", "Of a recording with its simulation, as of `compare`; null where it did not come so far."),
        Entry("steps", "list", "`name`, `ok`, `said` (a line each) and `files` of every step."),
    ),
    "conform": (
        Entry("eds, bus, writes", "text, text, true or false", "What was asked."),
        Entry("node", "number", "The node id."),
        Entry("passed, failed, skipped", "number", "How many checks ended how."),
        Entry("seconds", "number", "How long it took."),
        Entry("other_nodes", "list", "Other node ids on the bus; what would reach them, too, was skipped."),
        Entry("not_restored", "list of text", "What the node held before and could not be put back."),
        Entry(
            "checks",
            "list",
            "`group`, `check` in words, `clause` of the standard, `result` (pass, fail, skip), what was `expected`, `reason` of a skip, "
            "and the `frames` of a failure: `time_s`, `id`, `data` in hexadecimal, `sent` (by the tester), `remote`.",
        ),
    ),
    "stop": (
        Entry("bus", "text", "The bus."),
        Entry("ended", "text", "How it ended: `no torque`, `held` by a drive, or `bench ended`."),
        Entry("seen", "list of text", "What the supervisor saw, in order."),
    ),
    "move": (
        Entry("machine, bus", "text", "Machine and bus."),
        Entry("emulated", "true or false", "Whether an emulator of this host was the machine."),
        Entry("position", "object", "Where each axis stands [rad or m]."),
        Entry("notes", "list of text", "What an operator should know of nodes and bus."),
        Entry("judged", "list of text", "What was found of the sensors on the way."),
        Entry("checks", "list of text", "What homing checked, in order."),
    ),
    "home": (
        Entry("machine, bus", "text", "Machine and bus."),
        Entry("emulated", "true or false", "Whether an emulator of this host was the machine."),
        Entry("checks", "list of text", "What was checked, in order."),
        Entry("judged", "list of text", "What was found of the thermometers."),
    ),
    "simulate": entries(SimulateAnswer),
    "plot": entries(PlotAnswer),
    "compare": entries(CompareAnswer),
    "convert": (
        Entry("target, rows", "text, number", "The file that was written, and its rows."),
        Entry("channels", "object", "Channel to unit."),
        Entry("names", "object", "Signal of another tool's file to channel."),
        Entry("not_taken", "list", "What is in the file and not in the recording, a text each."),
        Entry("notes", "list", "How the rest was taken where that was not plain: resampled, summed, in another unit."),
        Entry("target, lines, outputs, inputs", "text, number, list, list", "Of a frequency response these four alone."),
    ),
    "foxglove": (Entry("url, place", "text", "Where it serves, and what. The object is written in one line when it listens."),),
    "identify": entries(ResponseAnswer),
    "lpv": (
        Entry(
            "emulated, direction, pose_range",
            "true or false, number, list",
            "Coordinate of the poses that varies, and its ends [rad or m]; of two, lists of both.",
        ),
        Entry("misfit", "number", "Weighted sum of squares over its degrees of freedom; 1 where noise alone is left."),
        Entry("outputs, inputs", "list", "Channels."),
        Entry(
            "poses",
            "list",
            "`pose` [rad or m]; of every mode `natural_frequency_Hz`, `damping`, and half widths `natural_frequency_ci95`, `damping_ci95`; "
            "`A`, `B`, `C`, `D` from applied effort to outputs, continuous, and whether they are `stable`.",
        ),
    ),
    "shape": entries(ShapeAnswer),
    "shape-plant": (
        Entry("poles", "list", "Of the plant: real and imaginary part [rad/s]."),
        Entry("delays_s, gains, transient_s", "list, list, number", "Taps of the filter, and after which time it has settled [s]."),
        Entry("forcing_rad_s", "list", "Frequencies that are tracked."),
        Entry(
            "error, error_unshaped, error_forcing_off",
            "list",
            "At each of them, as a share of the reference: of the filtered plant, of the plant alone, of both with the frequency 10 % off.",
        ),
        Entry("error_poles_off", "number", "The largest of these errors with all poles and zeros of the plant 10 % off."),
    ),
    "observe": entries(ObserveAnswer),
    "expose": entries(ExposeAnswer),
    "roadmap": (
        Entry("poses, registered", "number, true or false", "Benchmark poses, and whether worlds were laid on each other."),
        Entry("overlay_m", "object", "Calibration to place on the image to `max`, `max_90` (of the best 90 %) and `mean`."),
    ),
    "calibrate convergence": (
        Entry("runs, images", "number", "Runs, and images of each."),
        Entry("converged", "number", "Images until the median error stays below what one image is unsure by; null: never."),
        Entry("convergence[]", "object", "After every image: median error of poses that no image showed, and the worst run's."),
        Entry("model_based", "object", "The same of the model fitted to all images at once; null where no fit converged."),
        Entry(
            "parameters.NAME",
            "object",
            "Unit, start, `true` with `--true`, errors of filter and model, what is stated at the end.",
        ),
        Entry("curves.NAME", "object", "Of the first four after every image: mean and scatter of the error, and what is stated."),
        Entry("nees", "object", "Squared errors over what is stated, of chain, modes, and poses along the runs; 1 where it is true."),
        Entry(
            "refused, widened",
            "number",
            "Images left out; runs in which no image agreed with the drawing: its tolerances were doubled.",
        ),
        Entry("along[]", "object", "Per part of the runs: error and stated deviation of the phantom, errors of the frequencies as shares."),
        Entry("robustness.CONDITION", "object", "With `--robustness`, instead of all else: medians of the runs."),
    ),
    "calibrate chain": (
        Entry("written", "text", "The chain that was written."),
        Entry(
            "parameters, deviations, units",
            "object",
            "By parameter, as `a_NAME`, `delta_theta_NAME`, …, `theta_z`: value, standard deviation, unit.",
        ),
        Entry(
            "rank, not_seen, kept", "number, list, list", "Combinations seen; those not seen, with each parameter's share; parameters kept."
        ),
        Entry("misfit", "number", "Residual's rms over the noise that was stated."),
        Entry("poses.FILE", "object", "`nominal` and `fitted`: `position_rms_m`, `angle_rms_rad`."),
    ),
    "reconstruct": entries(ReconstructAnswer),
    "plane": (
        Entry("rays, views, bins", "text, number, number", "`parallel rays` or `a fan`, and the sinogram's shape."),
        Entry("size, spacing_m", "number", "Pixels along each edge of the image, and a pixel's edge."),
        Entry("discs", "list", "With `--disc`: `disc`, `mean_1_m` of the image in its inner half, and `true_1_m`, what was drawn there."),
    ),
    "diagnose": (Entry("", "", "The object of `diagnosis.json`, below."),),
    "machine list": (Entry("[].name, description, axes, hash", "", "One object per shipped machine."),),
    "machine show": (
        Entry("name, description, hash", "text", "The machine."),
        Entry(
            "axes",
            "list",
            "`name`, `position_unit`, `effort_unit`, `joint`, `effort_per_unit`, `effort_limit`, `target_resolution`, `range`, `speed`, "
            "`acceleration`, `jerk`, `tracking_error`, in SI and the drive's unit.",
        ),
        Entry("sample_rate_Hz, substeps", "number", "Timing."),
        Entry(
            "bodies",
            "list",
            "`name`, `parent`, `mass_kg`, and `joint` with `name`, `type`, `stiffness`, `damping`, `armature`, `brake_effort`.",
        ),
        Entry("sensors", "list", "Channels, and names of IMUs."),
        Entry("effects", "list", "Physics that the file states, as an effects file has it."),
        Entry(
            "controllers",
            "list",
            "`axis`, `position_sections`, `reference_sections`, `gravity_feedforward`: laws in effort.",
        ),
        Entry("commands", "object", "Per axis what the loop commands: `mode`, `unit`, and the `excitation_unit`."),
        Entry("nodes", "list", "`name`, `role`, `axis`, `node_id`."),
    ),
    "machine check": entries(CheckAnswer),
    "machine export": (Entry("mjcf, machine, hash", "text", "The file that was written, and what it is of."),),
    "machine convert": (
        Entry("machine_file, hash", "text", "The file that was written, and its hash."),
        Entry("changes", "list", "`key`, `old` and `new`; `old` is null where the file had left a default out."),
        Entry("ok", "true or false", "Whether the new file passes every check."),
        Entry("before, findings", "list", "Findings of the old file and of the new one, as of `machine check`."),
    ),
    "machine new": (
        Entry("machine_file", "text", "The file that was written."),
        Entry("axes", "list", "Names of the axes."),
        Entry("assumed, open", "list", "Marks in the file: `line`, `key`, `says` and, of what is assumed, `value`."),
        Entry("left", "list", "What was not taken over."),
        Entry("controllers", "object", "Second-order sections that were designed, by axis."),
    ),
    "machine schema": (Entry("schema", "text or null", "The file that was written; null where it was printed."),),
    **dict.fromkeys(("run multisine", "run scan", "run jog", "run static", "run file"), _RUN),
    "calibrate phantom": entries(CalibrateAnswer),
    "calibrate marker": (
        Entry("plate, exposures, used, free", "", "Plate, images, those that were used, parameters that were fitted."),
        Entry("values, sigma", "(N, 9)", "Parameters of every exposure, and their standard deviations."),
        Entry("points, residual_pixels, deviation_pixels, blur_pixels", "(N,) or (N, 2)", "Crossings, and quality of every image."),
        Entry("unusable, suspect_exposures", "object, list", "Exposure to the reason, and exposures of suspect quality."),
    ),
    "calibrate data": (
        Entry("images, used", "number", "Images offered and used."),
        Entry("refused, changes", "list", "Images that were refused, and those at which the mount was found moved."),
        Entry(
            "converged, place_sigma_m", "", "Image at which the geometry was known well enough, or null; how well it is known at the end."
        ),
        Entry("parameters.NAME", "object", "`value`, `unit`, `sigma`."),
        Entry("sigma", "(9,)", "Median standard deviations of the nine parameters."),
    ),
    "calibrate level": (Entry("recording, rows", "text, number", "The file that was written, and its rows."),),
    "calibrate model": (
        Entry("exposures, rank", "number", "Exposures, and combinations of parameters that they show."),
        Entry(
            "singular_values, null, frozen", "list", "What is shown how well, combinations that are not shown, parameters that were kept."
        ),
        Entry("chi2, unmodelled_m", "number", "Misfit, and what the model leaves out."),
        Entry("clock_lag_periods", "object", "`value`, `sigma`."),
        Entry("parameters.NAME", "object", "`value`, `nominal`, `sigma`, `unit`."),
        Entry("scans", "list", "How well each scan is fitted or predicted."),
    ),
    "calibrate scan": (
        Entry("experiment, seconds, stops", "text, number, list", "The file that was written, how long it takes, and its poses."),
        Entry(
            "position_sigma_m, rotation_sigma_rad, nominal_sigma_m",
            "number",
            "How well the geometry will be known, and how well it is now.",
        ),
        Entry("rank, null, frozen", "", "As of `calibrate model`."),
    ),
    "calibrate grid": (
        Entry("experiment, poses, seconds", "text, number, number", "The file that was written, its poses, and how long it takes."),
    ),
    "calibrate consistency": (
        Entry("images, pairs", "number", "That were compared."),
        Entry("changed", "true or false", "Whether the images say that the geometry has changed; only then there is a table."),
        Entry("gain", "number", "Twice the logarithm of odds that it has; 12 is sure."),
        Entry("moved_mm, stated_mm", "number", "By how much shadows moved on the panel (rms), and how sure that is."),
        Entry("contradiction_before, contradiction_after", "number", "Rms over what noise explains."),
        Entry("deviation, sigma", "list (N, 9)", "From the geometry before, in metres and radians, and standard deviations."),
    ),
    "calibrate tracker": (
        Entry("table", "text", "The look-up table that was written."),
        Entry("poses, lost", "number", "Poses within the recording, and lines without one of the targets."),
        Entry(
            "rms, noise",
            "object",
            "`source_m`, `phantom_m`, `rotation_rad`: rms difference from what the poses were laid on, and what the tracker's noise makes.",
        ),
    ),
    "calibrate spot": (
        Entry("time_s, spot_m, sigma_m", "list", "Place of the focal spot over time."),
        Entry("drift_m", "(2,)", "Drift along columns and rows."),
        Entry("frequencies_Hz, amplitudes_m", "list", "Spectrum."),
        Entry("anode_alias_Hz, anode_wobble_m", "number, (2,)", "Only with `--anode`: where it shows, and how much."),
    ),
    "geometry at": (
        Entry("pose", "object", "Axis to position."),
        Entry(
            "parameters, nominal, deviation, sigma",
            "object",
            "The nine parameters (2.2), the nominal ones, deviations and their standard deviations.",
        ),
    ),
    "geometry truth": (Entry("table, exposures, deviation", "", "The file that was written, and what is in it."),),
    "geometry standing": (Entry("table, poses", "", "The file that was written, and its poses."),),
    "geometry volume": (Entry("volume_m3, radius_m, corners_m", "", "The volume, a ball about the isocentre in it, and its corners."),),
    "geometry compensate": (
        Entry("folder", "text", "The scan's folder that was written."),
        Entry("turn_rad, shift_m, left_m", "list", "Per image: turn, shift, and what stays within 50 mm."),
    ),
    "geometry convert": (
        Entry("written, exposures, parameters, notes", "", "The file that was written, the nine parameters of each exposure, remarks."),
    ),
}

DIAGNOSIS = (
    Entry(
        "verdict",
        "text",
        "`inconclusive`, `misconfigured`, `unknown_physics`, `ambiguous`, `explained`, `retuned` or `consistent`; the first that applies.",
    ),
    Entry("reason", "text", "The verdict in a sentence."),
    Entry(
        "findings",
        "list",
        "What is taken to be there: effects of the answer, play between encoders, numbers out of tolerance.",
    ),
    Entry("findings[].kind", "text", "`effect` or `number`."),
    Entry("findings[].effect", "text", "Name of the effect."),
    Entry(
        "findings[].number",
        "text",
        "Of a number, in the effect's place: `OWNER.QUANTITY` of the machine file, or of the controller's side (`AXIS.controller_gain`, "
        "`AXIS.command_early`, `AXIS.speed_limit`, `AXIS.effort_zero`, `AXIS.effort_lag`, `CHANNEL.zero`, `lateness`).",
    ),
    Entry("findings[].at", "text", "Where it acts."),
    Entry("findings[].confidence", "0 to 1", "Share of the evidence, times the share of answers with this verdict that were right."),
    Entry(
        "findings[].parameters.NAME",
        "object",
        "`value`, `unit` and `ci95`, a span of 95 %; by the parameter's name without unit, `Fc`.",
    ),
    Entry("findings[].parameters.value", "object", "Of a number: the same, and `nominal`, what the file says."),
    Entry("findings[].ambiguous_with", "list", "Effects of other plausible sets that the likeliest set has not."),
    Entry("findings[].ambiguous_sets", "list of lists", "Other plausible sets, with another effect in the place of this one."),
    Entry("findings[].separating_experiment", "text or null", "`next_experiment.toml`, where it was written."),
    Entry("findings[].evidence_for", "list of text", "What speaks for the effect."),
    Entry("findings[].evidence_against", "list of text", "What speaks against it."),
    Entry("findings[].family", "text", "Laws that recordings often do not tell apart."),
    Entry("findings[].variants", "list", "Laws of the family at this place that may be it: `effect`, `at`, `confidence`."),
    Entry("hypotheses", "list", "All sets that were weighed, the likeliest first."),
    Entry("hypotheses[].effects", "list", "Effects of the set; empty: no effect is missing."),
    Entry("hypotheses[].confidence", "0 to 1", "Likewise; all sum to at most 1."),
    Entry("hypotheses[].gained", "number", "Fall of the sum of squares in units of noise, over no effect, in training."),
    Entry(
        "hypotheses[].gained_held_out",
        "number or null",
        "Of the answer, held out; null where noise is assumed.",
    ),
    Entry("hypotheses[].parameters", "number", "Parameters that were fitted for it."),
    Entry("hypotheses[].is_confirmed", "true or false", "Whether it is the answer."),
    Entry(
        "retuned.OWNER.QUANTITY",
        "object",
        "`nominal`, `value`, `unit`, `ci95`: numbers of the machine file that the recordings show. One key, with its dot.",
    ),
    Entry("frozen.OWNER.QUANTITY", "text", "Numbers that the recordings do not show or do not decide, and what became of them."),
    Entry("noise", "text", "What the noise was taken from: `repeats`, `periods` of one recording, or `assumed`."),
    Entry("location.channels", "object", "Channel to its share of the mismatch's power in units of noise; shares sum to 1."),
    Entry("location.frequency_hz", "spans [Hz]", "Frequencies. A dimension in which the mismatch is not localised is left out."),
    Entry("location.time_s", "object", "Recording to spans [s] of its time."),
    Entry("location.position", "object", "Axis to spans [rad or m]."),
    Entry("location.speed", "object", "Axis to spans [rad/s or m/s]."),
    Entry("location.effort", "object", "Axis to spans [drive's unit]."),
    Entry("location.direction", "object", "Axis to `positive`, `negative` or `both`."),
    Entry("location.shares", "object", "Dimension to axis (or `all`) to the share of the power that its spans hold."),
    Entry(
        "fit.channels.CHANNEL",
        "stages",
        "NRMSE of free runs: rms of recorded less simulated, over the rms of the recorded channel about its mean. Of `rows` the "
        "rms error in units of noise: 1 is noise alone.",
    ),
    Entry("fit.train", "stages", "E: root mean square over channels of these errors in units of that channel's noise, in training."),
    Entry("fit.held_out", "stages or null", "The same held out."),
    Entry("fit.removed_share", "number or null", "(E_retuned² - E_extended²) / (E_retuned² - 1), held out where there is one."),
    Entry("fit.removed_share_from_nominal", "number or null", "The same from E_nominal."),
    Entry(
        "fit.horizon_s",
        "s or null",
        "What `fit` was measured by: the length of free runs, null for whole recordings; of `rows` their period.",
    ),
    Entry(
        "fit.errors_of",
        "text",
        "`rows` that are predicted from those before them, or free runs: of the `closed_loop`, or driven by the recorded `efforts`.",
    ),
    Entry("predicted_separations", "list", "What the next experiment should show, of the likeliest set against each rival."),
    Entry("predicted_separations[].rival", "list", "Effects of the rival."),
    Entry(
        "predicted_separations[].if_likeliest", "number", "Standard deviations of one recording's noise, where the likeliest set is right."
    ),
    Entry("predicted_separations[].if_rival", "number", "The same where the rival is right."),
    Entry(
        "disturbance.joints",
        "object",
        "Driven joint to its share of the power of the effort that is missing by the machine file, each in units of the effort on it; "
        "shares sum to 1.",
    ),
    Entry("disturbance.sensors", "object", "Empty."),
    Entry("suspicions", "list of text", "Empty: wrong units, signs and shifts are `misconfigured`, and the reason names them."),
    Entry(
        "audit.axes.AXIS",
        "object",
        "Controller: `gain`, `delay_s`, `saturation`, `offset`, `rate_Hz`, `sign` (each `value`, `ci95`, `file`), `replayed_rms`,"
        " `resolution`, `status`: `as_filed`, `differs` or `unknown`.",
    ),
    Entry(
        "audit.recordings",
        "list",
        "What is wrong with recordings: `recording`, `channel`, `said`; where there is something, nothing else was audited.",
    ),
    Entry("audit.sensors", "list", "Two encoders of an axis: `first`, `second`, `gain`, `delay_s`, `gap` (play), `offset`, `status`."),
    Entry("detection_limits", "list", "The least that would have shown: `effect`, `at`, `parameter`, `strength` (or null), `unit`."),
    Entry("baseline", "list", "The engineer's fit: friction and load of every driven joint, each with `parameters`."),
    Entry("known", "list", "Effects given with `--known`: `effect`, `at` and `parameters`, each `value` and `unit`."),
    Entry("provisional", "true or false", "Whether this is a first answer, which the last word replaces."),
    Entry("unexplained_share", "0 to 1", "Of what re-tuning leaves above noise in training, what the extended simulation leaves."),
    Entry("seconds", "s", "Time of the diagnosis, without writing files."),
)
