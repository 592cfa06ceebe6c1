"""sensor_msgs/JointState, the message in which ROS 2 says where joints are, how fast and with what effort."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hil.errors import RecordingError
from hil.extras import extra_package
from hil.recording.bag_topic import Topic
from hil.recording.mcap_stream import WHAT, mcap_package

JOINT_STATE_TYPES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")

QUANTITIES = {"position": "position", "velocity": "speed", "effort": ""}
"""Field of the message -> recorded quantity; that of efforts depends on the drive's unit."""

DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
"""The message in all of ROS 2, by ros2/common_interfaces."""


def joint_states(topic: str, messages: Sequence[tuple[int, int, bytes]], path: Path) -> Topic:
    """Return the samples of each quantity of each joint, such as `/joint_states.position[roll]`.

    Parameters
    ----------
    topic : str
    messages : sequence
        Time of logging [ns], which is used where the header has no stamp, the file's channel, and the message in CDR.
    path : Path
        For the messages.

    Raises
    ------
    RecordingError
        A message is damaged, or has another number of values than of names.
    UnusableInputError
        mcap-ros2-support is not installed.
    """
    schema = mcap_package("mcap.records").Schema(id=1, name=JOINT_STATE_TYPES[0], encoding="ros2msg", data=DEFINITION.encode())
    decode = extra_package("mcap_ros2.decoder", WHAT).DecoderFactory().decoder_for("cdr", schema)
    found = Topic(topic)
    for number, (logged_ns, channel, data) in enumerate(messages):
        try:
            message = decode(data)
            stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            fields = {quantity: list(getattr(message, quantity)) for quantity in QUANTITIES}
            names = list(message.name)
        except Exception as problem:  # the decoder raises any error of its parser
            reason = str(problem).partition("\n")[0] or type(problem).__name__
            raise RecordingError(f"{path}: {topic}: message {number} is damaged: {reason}") from None
        found.add(stamp_ns, logged_ns, (channel, message.header.frame_id, *sorted(names)))
        for quantity, values in fields.items():
            if values and len(values) != len(names):
                raise RecordingError(f"{path}: {topic}: message {number} has {len(names)} names and {len(values)} values of {quantity}")
            for name, value in zip(names, values, strict=False):
                found.samples[f"{topic}.{quantity}[{name}]"].append((number, value))
    return found
