"""isocenter calibrate chain: the parameters of any kinematic chain from measured poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import can_be_written, not_an_input
from hil.errors import UnusableInputError
from hil.terminal.output import Answer, JsonOption
from hil.terminal.progress import working


def register(calibrate: typer.Typer) -> None:
    """Add the command to the group."""
    calibrate.command(
        short_help="Any chain's parameters from measured poses.",
        help="The Denavit-Hartenberg parameters of any chain of turning joints from measured poses (thesis Sec. 2.3.4), gear ratios"
        " among them; what the poses cannot see stays as it was and is named."
        "\n\nCHAIN has a table [[joint]] per joint: name, a_m, delta_theta_rad, alpha_rad, d_m, beta; POSES a column NAME [rad] or [deg]"
        " per joint, and x, y, z [m], rx, ry, rz [rad], the far end seen from the first frame."
        "\n\nExample:  isocenter calibrate chain arm.toml poses.csv --held-out others.csv -o arm.fitted.toml",
    )(chain)


def chain(
    start: Annotated[Path, typer.Argument(metavar="CHAIN", help="Nominal parameters (.toml).")],
    poses: Annotated[Path, typer.Argument(metavar="POSES", help="Measured poses (.csv).")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FITTED", help="Chain to write (.toml).")],
    held_out: Annotated[Path | None, typer.Option("--held-out", metavar="POSES", help="Further poses, to judge by.")] = None,
    position_noise: Annotated[float, typer.Option("--position-noise", metavar="MM", help="Standard deviation of a position.")] = 0.05,
    angle_noise: Annotated[float, typer.Option("--angle-noise", metavar="MRAD", help="Standard deviation of an angle.")] = 0.2,
    freeze: Annotated[str, typer.Option("--freeze", metavar="NAME,...", help="Parameters to keep, such as d_j1,theta_z.")] = "",
    json_to: JsonOption = None,
) -> None:
    """Fit, say the parameters with their deviations, and how far poses are off."""
    import numpy as np

    from hil.calibration.kinematic.chain_file import read_chain, read_poses, write_chain
    from hil.calibration.kinematic.identify_denavit_hartenberg import PoseNoise, identify_kinematics, pose_difference

    if not (0.0 < position_noise < np.inf and 0.0 < angle_noise < np.inf):
        raise UnusableInputError("--position-noise, --angle-noise: must be positive numbers")
    answer = Answer(json_to)
    can_be_written(out)
    not_an_input(out, start, poses, *([held_out] if held_out else []))
    nominal = read_chain(start)
    tables = {path.name: read_poses(path, nominal.joints) for path in (poses, *([held_out] if held_out else []))}
    measured = tables[poses.name]
    noise = PoseNoise(1e-3 * position_noise, 1e-3 * angle_noise)
    frozen = [name.strip() for name in freeze.split(",") if name.strip()]
    with working("fitting"):
        found = identify_kinematics(nominal, measured.angles, measured.position, measured.rotation, noise, frozen)
    write_chain(found.model, out)
    deviations = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    misfit = float(np.sqrt(np.mean((found.residual / np.repeat([noise.position_m, noise.angle_rad], 3)) ** 2)))
    answer.say(f"{out}: {found.rank} of {len(nominal.names)} combinations are seen; residual {misfit:.3g} of the noise that was stated")
    for name, unit, value, before, deviation in zip(
        nominal.names, nominal.units, found.model.values, nominal.values, deviations, strict=True
    ):
        known = "kept" if name in found.frozen else f"± {deviation:.2g}"
        answer.say(f"  {name:18s} {value:+11.6g} {unit:3s} {known}, {value - before:+.3g} from the start")
    for combination in found.null:
        answer.say(f"  not seen, left at the start: {combination}")
    judged: dict[str, dict[str, dict[str, float]]] = {}
    for name, table in tables.items():
        for label, model in (("nominal", nominal), ("fitted", found.model)):
            off = pose_difference(table.position, table.rotation, *model.poses(table.angles))
            rms = [float(np.sqrt(np.mean(np.sum(off[:, part] ** 2, axis=1)))) for part in (slice(0, 3), slice(3, 6))]
            judged.setdefault(name, {})[label] = {"position_rms_m": rms[0], "angle_rms_rad": rms[1]}
        nominal_off, fitted_off = judged[name]["nominal"], judged[name]["fitted"]
        answer.say(
            f"  {name}: {len(table.angles)} poses off by {1e3 * nominal_off['position_rms_m']:.3g} mm and"
            f" {1e3 * nominal_off['angle_rms_rad']:.3g} mrad before, {1e3 * fitted_off['position_rms_m']:.3g} mm and"
            f" {1e3 * fitted_off['angle_rms_rad']:.3g} mrad after (rms)"
        )
    answer.write(
        {
            "written": out,
            "parameters": dict(zip(nominal.names, found.model.values, strict=True)),
            "deviations": dict(zip(nominal.names, deviations, strict=True)),
            "units": dict(zip(nominal.names, nominal.units, strict=True)),
            "rank": found.rank,
            "not_seen": [dict(each.shares) for each in found.null],
            "kept": found.frozen,
            "misfit": misfit,
            "poses": judged,
        }
    )
