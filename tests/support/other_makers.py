"""The C-arm with drives of other makers: their own data sheets, unchanged, on the emulated plant."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import canopen
from bench_machines import CARM, LOOPS, edited

from drivers.canopen.eds import load_object_dictionary

FILES = {
    "maxon EPOS4": "maxon_EPOS4_compact_50-8_node1.eds",
    "Elmo Gold": "elmo_gold.dcf",
    "Faulhaber MCBL 300": "faulhaber_mcbl300.eds",
    "Schunk": "schunk_0_63.dcf",
    "Pilz": "pilz_prbt_0_1.dcf",
}
NEEDS = {
    "torque": (9, (0x6071,), '"target_torque"'),
    "velocity": (8, (0x60FF, 0x60B2), '"target_velocity", "torque_offset"'),
    "position": (7, (0x607A, 0x60B2), '"target_position", "torque_offset"'),
    "profile_velocity": (2, (0x60FF, 0x6083), '"target_velocity"'),
    "profile_position": (0, (0x607A, 0x6081, 0x6083), '"target_position"'),
}
"""Mode: its bit of 6502h, the objects that it takes, and what the RPDO carries beside the controlword."""
HOMING_BIT = 5
QUICK_STOP = 3_500_000  # counts/s^2, of the shipped file
FAST_RAMP = 50_000_000  # counts/s^2: the loop's own velocities are not ramped any more


UNITS = {"faulhaber_mcbl300.eds": ("rpm", "rev/s^2")}
"""Units of velocity and acceleration of drives whose objects say none, by their makers' manuals."""


def dictionary_of(file: Path) -> canopen.ObjectDictionary:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of repairs, which tests/virtual_bus/canopen/test_eds_files.py looks at
        return load_object_dictionary(file, 1)


def modes_of(file: Path) -> list[str]:
    """Return the modes that a data sheet supports (6502h, where it says any) and has the objects for."""
    dictionary = dictionary_of(file)
    supported = dictionary[0x6502].default or 0
    return [
        mode
        for mode, (bit, objects, _) in NEEDS.items()
        if (not supported or supported >> bit & 1) and all(index in dictionary for index in objects)
    ]


def carm_text_with(file: Path, mode: str) -> str:
    """Return the C-arm's file with drives of this data sheet, commanded in this mode."""
    dictionary = dictionary_of(file)
    effort = next(
        (f', "{name}"' for name, index in (("current_actual_value", 0x6078), ("torque_actual_value", 0x6077)) if index in dictionary), ""
    )
    supported = dictionary[0x6502].default or 0
    text = edited(r'^eds = "isocenter_drive.eds"\nvendor_id = .*\nproduct_code = .*\nrevision_number = .*\n', f'eds = "{file}"\n')
    text = edited(r'^map = \["statusword", .*\]$', f'map = ["statusword", "position_actual_value"{effort}]', text)
    text = edited(r'^map = \["controlword", .*\]$', f'map = ["controlword", {NEEDS[mode][2]}]', text)
    if any(index not in dictionary for index in (0x1016, 0x6007, 0x605E)):
        text = edited(r"^(\[bus\.nodes\.\w+_drive\])$", r'\g<1>\nstopped_by = "safe torque off, by the output watchdog"', text)
    if 0x6085 not in dictionary:
        text = edited(r"^\[\[bus\.nodes\.\w+_drive\.write\]\]\nindex = 0x6085.*\nvalue = .*\n", "", text)
        for axis in CARM.axes:
            text = edited(rf"^(\[limits\.{axis}\])$", r"\g<1>\nquick_stop_deg_s2 = 600.0", text)
    elif (most := dictionary[0x6085].max) is not None and most < QUICK_STOP:
        text = edited(rf"^value = {QUICK_STOP}$", f"value = {most}", text)
    if supported and not supported >> HOMING_BIT & 1:
        text = edited(r"^method = 37$", "method = 0", text)
    elif (last := dictionary[0x6098].max) is not None and last < 37:
        text = edited(r"^method = 37$", "method = 35", text)
    if mode == "profile_velocity":
        ramps = {index: min(FAST_RAMP, dictionary[index].max or FAST_RAMP) for index in (0x6083, 0x6084)}
        writes = "".join(f"[[bus.nodes.\\1_drive.write]]\nindex = {index}\nvalue = {ramp}\n" for index, ramp in ramps.items())
        text = edited(r"^\[\[bus\.nodes\.(\w+)_drive\.tpdo\]\]$", f"{writes}\\g<0>", text)
    if units := UNITS.get(file.name):
        said = f'velocity_unit = "{units[0]}"\nacceleration_unit = "{units[1]}"'
        counts = dictionary[0x608F][1].default
        text = edited(r"^encoder_counts_per_motor_turn = .*$", f"encoder_counts_per_motor_turn = {counts}\n{said}", text)
    if mode == "torque":
        return text
    for axis, gains in LOOPS.items():
        position_gain = gains["position_gain"]
        loops = ", ".join(f"{name} = {value}" for name, value in gains.items())
        text = edited(rf"^(\[drives\.{axis}\])$", rf'\g<1>\nmode = "{mode}"\nloops = {{ {loops} }}', text)
        per_s = position_gain if mode.endswith("velocity") else 0.0
        ahead = CARM.sample_rate_Hz / (1.0 if mode.endswith("velocity") else position_gain)
        law = f"position_sections = [[{per_s}, 0.0, 0.0, 1.0, 0.0, 0.0]]\n"
        law += f"reference_sections = [[{per_s + ahead}, {-ahead}, 0.0, 1.0, 0.0, 0.0]]\n"
        text = re.sub(rf"(\[controller.{axis}\]\n)position_sections = \[(?:.|\n)*?\n\]\n", rf"\g<1>{law}", text)
    return text
