"""The text of a new machine file: what is known, what is assumed with its reason, and a mark where something is to be filled in."""

from __future__ import annotations

from collections.abc import Mapping

from hil.machine.editors import SCHEMA_LINE
from hil.machine.new.draft import Draft, DraftAxis, Value

COMMENT_COLUMN = 56


class _File:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def comment(self, text: str) -> None:
        self.lines.append(f"# {text}")

    def rule(self, title: str) -> None:
        self.lines += ["", f"# ---- {title} ".ljust(100, "-")]

    def table(self, head: str) -> None:
        self.lines += ["", head]

    def keys(self, values: Mapping[str, Value]) -> None:
        for key, value in values.items():
            self.key(key, value)

    def key(self, key: str, value: Value) -> None:
        if value.value is None:
            self.lines.append(f"# {key} = ?".ljust(COMMENT_COLUMN) + f"# {value.why}")
        else:
            line = f"{key} = {shown(value.value)}"
            words = value.why if value.is_known else f"assumed: {value.why}"
            self.lines.append(line.ljust(COMMENT_COLUMN) + f"# {words}" if value.why else line)

    def plain(self, **values: object) -> None:
        self.keys({key: Value(value) for key, value in values.items()})


def shown(value: object) -> str:
    """Write a value as TOML."""
    if isinstance(value, list | tuple):
        return "[" + ", ".join(shown(each) for each in value) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    return repr(value)


def machine_text(draft: Draft) -> str:
    """Write the file of a draft."""
    file = _File()
    file.lines.append(SCHEMA_LINE)
    file.comment(f"{draft.name}, written by `isocenter machine new` from {draft.source}. Every key: `isocenter machine schema`.")
    file.comment("`assumed:` marks what nobody said; `= ?` marks what is to be filled in. `isocenter machine check` lists both.")
    for left in draft.left:
        file.comment(f"Not taken over: {left}.")
    file.plain(format=1, name=draft.name, description=draft.description or f"{draft.name}, from {draft.source}")
    file.key("gravity_m_s2", draft.gravity)
    file.table("[timing]")
    file.key("sample_rate_Hz", draft.rate)
    file.key("substeps", Value(4, "steps of the plant in a sample"))
    file.rule("bodies, parents first")
    brakes = {axis.joint: axis.brake for axis in draft.axes}
    for body in draft.bodies:
        file.table("[[body]]")
        file.plain(name=body.name, parent=body.parent)
        file.keys(body.values)
        if body.joint is not None:
            file.lines.append("[body.joint]")
            file.keys(body.joint | brakes.get(str(body.joint["name"].value), {}))
    file.rule("drives, in the order of the axes")
    for axis in draft.axes:
        file.table(f"[drives.{axis.name}]")
        file.keys(axis.drive)
    file.rule("sensors: keys are channel names")
    for axis in draft.axes:
        _sensors(file, axis)
    if draft.sections:
        _controllers(file, draft)
    if any(axis.limits for axis in draft.axes):
        file.rule("limits")
    for axis in draft.axes:
        if axis.limits:
            file.table(f"[limits.{axis.name}]")
            file.keys(axis.limits)
    if any(axis.node for axis in draft.axes):
        _bus(file, draft)
    return "\n".join(file.lines) + "\n"


def _sensors(file: _File, axis: DraftAxis) -> None:
    file.table(f"[sensors.position_{axis.name}]")
    file.plain(type="encoder", joints=[axis.joint], kind="incremental")
    if "encoder_counts_per_motor_turn" not in axis.drive:
        file.key("resolution_rad" if axis.kind == "revolute" else "resolution_m", Value(0.0, "an encoder without steps"))
    if axis.link:
        key = "counts_per_turn" if axis.kind == "revolute" else "resolution_m"
        file.table(f"[sensors.link_position_{axis.name}]")
        file.plain(type="encoder", joints=[axis.joint], kind="absolute")
        file.key(key, axis.link[key])
    effort = axis.drive["effort_unit"].value
    file.table(f"[sensors.{'current' if effort == 'A' else 'effort'}_{axis.name}]")
    file.plain(type="current", axis=axis.name)
    file.key(f"noise_rms_{effort}", Value(0.0, "no noise"))


def _controllers(file: _File, draft: Draft) -> None:
    file.rule("feedback: second-order sections at the sample rate")
    file.comment(f"assumed: {draft.designed}")
    for axis, rows in draft.sections.items():
        file.table(f"[controller.{axis}]")
        file.lines.append("position_sections = [")
        for row, words in zip(rows, ("integrator and gain", "lead"), strict=True):
            file.lines.append(f"    {shown(row)},  # {words}")
        file.lines.append("]")


def _bus(file: _File, draft: Draft) -> None:
    if not draft.sections:
        file.rule("feedback: `isocenter machine new` designs it once everything above is answered")
        for axis in draft.axes:
            file.table(f"[controller.{axis.name}]")
            file.key("position_sections", Value(None, "rows b0, b1, b2, 1, a1, a2 from position error to command"))
    file.rule("bus")
    file.table("[bus]")
    file.key("bitrate_bit_s", Value(1000000, "1 Mbit/s"))
    file.key("master_node_id", Value(127, "the highest number is the bench's own"))
    file.key("master_heartbeat_s", Value(0.1, "time-outs are 2.5 periods"))
    rate = draft.rate.value
    assert isinstance(rate, float)
    file.key("answer_timeout_s", Value(float(f"{min(0.0025, 0.6 / rate):.3g}"), "the rest of the period is for work"))
    for axis in draft.axes:
        _node(file, axis, "drive", axis.node)
        if axis.link:
            _node(file, axis, "encoder", axis.link)
    for axis in draft.axes:
        file.table(f"[bus.homing.{axis.name}]")
        file.keys(axis.homing)


NODE_KEYS = ("node_id", "eds", "vendor_id", "product_code", "revision_number", "zero_counts")


def _node(file: _File, axis: DraftAxis, role: str, node: Mapping[str, Value]) -> None:
    name = f"{axis.name}_{role}"
    file.table(f"[bus.nodes.{name}]")
    file.plain(role=role, axis=axis.name)
    file.keys({key: node[key] for key in NODE_KEYS if key in node})
    file.key("heartbeat_s", Value(0.1, "ten a second"))
    file.key("boot_timeout_s", Value(2.0, "two seconds to appear"))
    number = node["node_id"].value
    assert isinstance(number, int)
    sent = ["statusword", "position_actual_value", node["measured"].value] if role == "drive" else ["position_value"]
    pdos = [("tpdo", 0x180, sent)] + [("rpdo", 0x200, ["controlword", "target_torque"])] * (role == "drive")
    for kind, cob_id, objects in pdos:
        file.lines.append(f"[[bus.nodes.{name}.{kind}]]")
        file.plain(number=1)
        file.lines.append(f"cob_id = 0x{cob_id + number:03X}")
        file.key("transmission_type", Value(1, "with every SYNC"))
        file.key("map", Value(objects, "what the loop needs"))
