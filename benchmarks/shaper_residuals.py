"""Do stated intervals of residual vibration hold: further moves, both C-arms, both axes, frequencies -10 to +10 per cent.

Only the draws differ: further moves are simulated and measured by the same code as those from which the interval is stated. So this
measures whether as many moves are enough, not whether the simulation is right.

python benchmarks/shaper_residuals.py [--json FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from hil.machine import load_machine
from hil.shaping.choice import choose_shaper
from hil.shaping.predicted import Prediction

SEED = 1
"""Other moves than those that the statement is made from, whose seed is 0."""


def main() -> None:
    """Print a line per arm and axis, and the share of moves inside."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    found, held, drawn = [], 0, 0
    arguments = parser.parse_args()
    for name in ("carm", "carm-real"):
        machine = load_machine(name)
        for axis in machine.axes:
            choice = choose_shaper(machine, axis)
            stated = choice.chosen.verdict.residual
            assert stated is not None
            pose = np.zeros(len(machine.axes))
            left, _ = Prediction(machine, axis, pose, SEED).left(choice.shaper)
            inside = int(np.count_nonzero((left >= stated.low) & (left <= stated.high)))
            held += inside
            drawn += len(left)
            found.append(
                {
                    "machine": name,
                    "axis": axis,
                    "design": choice.chosen.name,
                    "linear_at_10": choice.chosen.verdict.vibration_at_10,
                    "stated": [stated.low, stated.likely, stated.high],
                    "left": left.tolist(),
                    "inside": inside,
                }
            )
            print(
                f"{name:10s} {axis:10s} {choice.chosen.name:14s} linear {found[-1]['linear_at_10']:.2%}, stated {stated.low:.1%} to "
                f"{stated.high:.1%}, left {left.min():.1%} to {left.max():.1%}, inside {inside} of {len(left)}",
                flush=True,
            )
    print(f"inside: {held} of {drawn}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
