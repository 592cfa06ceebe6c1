"""Parameters as states in full (thesis Secs. 5.2.4, 5.5): Tables 5.1 and 5.2, Fig. 5.8, images withdrawn, drift, robustness.

    python benchmarks/calibration_states.py --json benchmarks/results/calibration_states.json

All from `isocenter calibrate convergence` with the chains of benchmarks/chains: from Table 2.1 to a machine of Table 5.1 over 15 runs;
machines drawn within the drawing's tolerance, images withdrawn after 20 while frequencies fall by 5 % over 40 s; and every condition of
`--robustness`. `printed`: how far poses of the thesis's two printed tables are from each other.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from controllers.models.denavit_hartenberg import DenavitHartenberg
from hil.calibration.kinematic.chain_file import read_chain
from hil.calibration.kinematic.identify_denavit_hartenberg import pose_difference
from hil.terminal.output import Answer

CHAINS = Path(__file__).parent / "chains"
PRINTED_5_2 = np.array(
    [
        [-0.2322e-3, 1.5612, -1.5713, -389.009e-3, 0.9989],
        [0.6701e-3, 1.5789, 1.5822, -0.1288e-3, 0.9933],
        [-0.1131e-3, 1.5703, -1.5689, 6.1443e-3, 0.9931],
        [2.1100e-3, 3.1912, 0.0201, 1.8764e-3, 0.9901],
    ]
)
PRINTED_FRAMES_5_2 = np.array([3.1e-4, -0.4e-4, 9.1e-4, 12.4e-4])
COLUMNS = ("a", "delta_theta", "alpha", "d", "beta")


def command(*arguments: str) -> dict[str, object]:
    """Answer of `isocenter calibrate convergence` with the drawing of Table 2.1."""
    words = [sys.executable, "-m", "hil", "calibrate", "convergence", str(CHAINS / "table_2_1.toml"), *arguments, "--json", "-"]
    answer: dict[str, object] = json.loads(subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return answer


def printed(tables: dict[str, object]) -> dict[str, object]:
    """How far Table 5.2 is from Table 5.1, in poses and by parameter, beside what the filter's runs scatter."""
    model = read_chain(CHAINS / "table_5_1.toml")
    data = DenavitHartenberg(model.joints, PRINTED_5_2, PRINTED_FRAMES_5_2)
    angles = np.random.default_rng(9000).uniform(-1.0, 1.0, (200, 4))
    apart = pose_difference(*model.poses(angles), *data.poses(angles))
    parameters = tables["parameters"]
    assert isinstance(parameters, dict)
    return {
        "phantom_m": float(np.sqrt(np.mean(np.sum(apart[:, :3] ** 2, axis=1)))),
        "rotation_rad": float(np.sqrt(np.mean(np.sum(apart[:, 3:] ** 2, axis=1)))),
        "columns": {
            column: {
                "printed_rms": float(np.sqrt(np.mean((PRINTED_5_2[:, k] - model.table[:, k]) ** 2))),
                "filter_rms": float(np.sqrt(np.mean([parameters[f"{column}_{joint}"]["error_rms"] ** 2 for joint in model.joints]))),
                "model_rms": float(np.sqrt(np.mean([parameters[f"{column}_{joint}"]["model_error_rms"] ** 2 for joint in model.joints]))),
            }
            for k, column in enumerate(COLUMNS)
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where to write the answer; - for standard output")
    parser.add_argument("--draws", type=int, default=5, help="runs of each condition of robustness")
    options = parser.parse_args()
    to = Answer(options.json)
    tables = command("--true", str(CHAINS / "table_5_1.toml"), "--draws", "15")
    withdrawn = command("--draws", "10", "--seconds", "40", "--withdraw", "20", "--drift", "5")
    robust = command("--robustness", "--draws", str(options.draws))
    tables["after"] = {str(row["images"]): row for row in tables["convergence"] if row["images"] in (0, 1, 2, 5, 10, 15, 20, 30)}  # type: ignore[index,attr-defined]
    withdrawn = {key: withdrawn[key] for key in ("runs", "along", "nees", "refused")}
    withdrawn["along"] = {f"{row['from_s']:g} to {row['to_s']:g} s": row for row in withdrawn["along"]}  # type: ignore[attr-defined]
    to.write({"tables": tables, "printed": printed(tables), "withdrawn": withdrawn, **robust})


if __name__ == "__main__":
    main()
