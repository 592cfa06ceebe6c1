"""The rows of the table of faults that every change must pass: those that left an arm moving before stops were proven."""

from __future__ import annotations

MOST_DANGEROUS = (
    "brake_stays_open/roll/stop",
    "brake_feedback_stuck_open/roll/stop",
    "io_refuses_writes/io/stop",
    "io_answers_exceptions/io/sweep",
    "io_vanishes/io/sweep",
    "io_hangs/io/sweep",
    "torque_lost/roll_drive/sweep",
    "torque_inverted/roll_drive/sweep",
    "drive_deaf/roll_drive/sweep",
    "foreign_master/bus/sweep",
    "foreign_sync/bus/sweep",
    "heartbeat_lost/roll_drive/sweep",
    "motor_encoder_frozen/roll_drive/sweep",
)
