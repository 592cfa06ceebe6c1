"""The smallest machine that can fall: one arm on a horizontal axis, with drive, link encoder, brake and I/O, at 100 Hz."""

from __future__ import annotations

import re

from controllers import loop_shaping
from hil.machine import Machine, load_machine, machine_from_text

RATE_Hz = 100.0
INERTIA_kg_m2, EFFORT_Nm_A = 7.6, 9.5  # of rotor and arm about the axis; of a drive's ampere there
CROSSOVER_Hz = 2.5

IO = """
[bus.io]
url = ""
unit_id = 1
poll_period_s = 0.05
stale_after_s = 0.5
brake_coils = { turn = 0 }
brake_feedback_inputs = { turn = 0 }
hold_to_run_input = 8
door_input = 9
watchdog = { holding_register = 0, timeout_s = 0.5 }
"""


def falling_arm() -> Machine:
    """The turntable with its axis laid down and its mass off it: level, it is held with 3 of the drive's 8 amperes."""
    stiffness = INERTIA_kg_m2 * (2.0 * 3.141592653589793 * CROSSOVER_Hz) ** 2 / EFFORT_Nm_A
    sections = loop_shaping.cascade(
        loop_shaping.gain(stiffness),
        loop_shaping.lag(0.0, 0.12, RATE_Hz),
        loop_shaping.lead(CROSSOVER_Hz, 65.0, RATE_Hz),
    )
    text = load_machine("turntable").text
    for old, new in {
        r'name = "turntable"': 'name = "arm"',
        r"sample_rate_Hz = 200.0": f"sample_rate_Hz = {RATE_Hz}",
        r"answer_timeout_s = 0.0025": "answer_timeout_s = 0.005",
        r"mass_kg = 30.0": "mass_kg = 30.0\ncenter_of_mass_m = [0.1, 0.0, 0.0]",
        r"inertia_kg_m2 = \[3.6, 3.6, 7.0, ": "inertia_kg_m2 = [3.6, 6.7, 3.6, ",
        r"axis = \[0.0, 0.0, 1.0\]": "axis = [0.0, 1.0, 0.0]",
        r"(?s)position_sections = .*?\n\]": f"position_sections = {sections.tolist()}",
        r"direction_check_effort_A = 1.0": "direction_check_effort_A = 0.3",
        r"direction_check_travel_deg = 0.4": "direction_check_travel_deg = 0.05",
        r"(?ms)^# time and travel.*": IO,
    }.items():
        text, found = re.subn(old, new, text)
        assert found == 1, old
    return machine_from_text(text)
