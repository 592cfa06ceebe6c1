"""What is allowed of each sensor, from the file's [judging] tables and from what the file says of the sensors themselves."""

from __future__ import annotations

import math

from drivers.judging.chances import deviations, packets_until_frozen, share_of
from drivers.judging.settings import ENCODERS_WINDOW_S, DriveJudging, EncoderJudging, ImuJudging, JudgingSettings, TemperatureJudging
from drivers.modbus.registers import TEMPERATURE_STEP_K
from drivers.settings import AxisScaling, BusSettings
from hil.machine.build import joint_of, require_kind, require_known
from hil.machine.messages import ComplaintError
from hil.machine.schema import CurrentTable, ImuTable, MachineTable, TemperatureTable
from hil.machine.schema_judging import DriveJudgingTable, EncodersJudgingTable, JudgingTable, TemperatureJudgingTable
from virtual_bus.settings import PlantSettings

FAR_SHARE = 0.2
"""Share of the rated effort by which a drive that is off stops the motors in any case: current sensors of drives are off by a tenth."""
DRIFT_SHARE = 0.1
"""Share of the tolerance by which a growing difference is a drift: a tenth keeps what friction and play make, which does not grow."""


def build_judging(table: MachineTable, plant: PlantSettings, bus: BusSettings | None) -> JudgingSettings:
    """Build what is judged of a machine on a bus. How fast its encoders can move is the plant's to say: `hil.bench.judging`."""
    if bus is None:
        if table.judging is not None:
            raise ComplaintError(("judging",), "a machine without [bus] is not run, so nothing is judged; leave it out")
        return JudgingSettings()
    rules = table.judging or JudgingTable.model_validate({})
    for name, tables in (("encoders", rules.encoders), ("temperature", rules.temperature), ("drive", rules.drive)):
        for axis in tables:
            require_known(axis, table.drives, ("judging", name, axis), "axis")
    thermometers = () if bus.io is None else tuple(axis for axis in table.drives if axis in bus.io.temperature_registers)
    for axis in rules.temperature:
        if axis not in thermometers:
            raise ComplaintError(("judging", "temperature", axis), "has no thermometer; add it to [bus.io] temperature_registers")
    return JudgingSettings(
        imu=_imu(table, rules, bus),
        encoders=tuple(_encoders(number, axis, table, rules, plant, bus) for number, axis in enumerate(table.drives)),
        temperatures=tuple(_temperature(axis, table, rules, bus) for axis in thermometers),
        drives=tuple(_drive(number, axis, table, rules, bus) for number, axis in enumerate(table.drives)),
    )


def _imu(table: MachineTable, rules: JudgingTable, bus: BusSettings) -> ImuJudging | None:
    if bus.imu is None:
        if table.judging is not None and table.judging.has("imu"):
            raise ComplaintError(("judging", "imu"), "there is no IMU on the bus; add [bus.imu] or leave it out")
        return None
    sensor = table.sensors[bus.imu.name]
    assert isinstance(sensor, ImuTable)
    period_s = max(1.0 / bus.imu.rate_Hz, bus.sync_period_s)  # a row holds one packet at most
    chance = share_of(rules.false_alarm_probability, 6.0 / period_s)
    noise = (*sensor.accelerometer_noise_rms, *sensor.gyro_noise_rms)
    steps = (sensor.accelerometer_resolution,) * 3 + (sensor.gyro_resolution,) * 3
    at_least = rules.imu.frozen_packets
    return ImuJudging(
        sensor=bus.imu.name,
        follows=rules.imu.follows,
        period_s=bus.sync_period_s,
        rate_Hz=bus.imu.rate_Hz,
        age_s=rules.imu.age if rules.imu.age is not None else (table.timing.stale_ticks + 0.5) * period_s,
        rate_tolerance=rules.imu.rate_tolerance,
        full_scale=(sensor.accelerometer_range or math.inf,) * 3 + (sensor.gyro_range or math.inf,) * 3,
        frozen_packets=tuple(packets_until_frozen(s, q, chance, at_least) for s, q in zip(noise, steps, strict=True)),
        damaged_per_s=rules.imu.damaged_per_s,
        triggered=bus.imu.triggered_by_sync,
        force_tolerance=math.inf if rules.imu.force_tolerance is None else rules.imu.force_tolerance,
        turn_tolerance=math.inf if rules.imu.turn_tolerance is None else rules.imu.turn_tolerance,
    )


def _encoders(number: int, axis: str, table: MachineTable, rules: JudgingTable, plant: PlantSettings, bus: BusSettings) -> EncoderJudging:
    rule = rules.encoders.get(axis, EncodersJudgingTable.model_validate({}))
    kind = joint_of(axis, table, plant.tree).kind
    for field in ("tolerance", "drift"):
        require_kind(rule, field, kind, ("judging", "encoders", axis))
    scaling, drive = bus.scalings[number], plant.drives[number]
    tolerance = rule.tolerance if rule.tolerance is not None else bus.homings[number].agreement_tolerance
    drift = rule.drift if rule.drift is not None else DRIFT_SHARE * tolerance
    if drift > tolerance:
        raise ComplaintError(("judging", "encoders", axis, rule.key("drift")), f"must not exceed the tolerance of {tolerance:.4g}")
    compliance = _compliance(axis, plant)
    scale = drive.constant * drive.ratio
    return EncoderJudging(
        sensor=f"encoders_{axis}",
        axis=number,
        unit=scaling.position_unit,
        follows=rule.follows,
        period_s=bus.sync_period_s,
        motor_resolution=scaling.position_resolution,
        motor_acceleration=math.inf,
        link_resolution=scaling.link_resolution if any(n.role == "encoder" and n.axis == axis for n in bus.nodes) else 0.0,
        stale_ticks=table.timing.stale_ticks,
        tolerance=tolerance,
        drift=drift,
        growth=_growth(axis, table, rules, scaling, compliance * scale, bus.sync_period_s),
        compliance=compliance,
        damping=joint_of(axis, table, plant.tree).damping,
        effort_scale=scale,
    )


def _compliance(axis: str, plant: PlantSettings) -> float:
    """Return the sum of the springs' compliances between motor side and link encoder; 0 where there is none."""
    joints = {encoder.channel: set(encoder.joints) for encoder in plant.encoders}
    between = joints.get(f"link_position_{axis}", set()) - joints.get(f"position_{axis}", set())
    stiffness = [joint.stiffness for joint in plant.tree.joints if joint.name in between]
    return sum((1.0 / k for k in stiffness if k > 0.0), 0.0)


def _growth(axis: str, table: MachineTable, rules: JudgingTable, scaling: AxisScaling, per_effort: float, period_s: float) -> float:
    """Return by how much two windows' mean differences of a sound axis differ at most: the effort's noise, and a count of each encoder."""
    current = _current(axis, table)
    noise = 0.0 if current is None else current.noise_rms
    mean = per_effort * noise * math.sqrt(2.0 * period_s / ENCODERS_WINDOW_S)
    away = deviations(share_of(rules.false_alarm_probability, 1.0 / ENCODERS_WINDOW_S))
    return away * mean + scaling.position_resolution + scaling.link_resolution


def _drive(number: int, axis: str, table: MachineTable, rules: JudgingTable, bus: BusSettings) -> DriveJudging:
    rule = rules.drive.get(axis, DriveJudgingTable.model_validate({}))
    current = _current(axis, table)
    noise, step = (0.0, 0.0) if current is None else (current.noise_rms, current.resolution)
    rated = bus.scalings[number].rated
    away = deviations(share_of(rules.false_alarm_probability, 1.0 / bus.sync_period_s))
    tolerance = rule.effort_tolerance * rated + away * noise + step + rated / 1000.0
    return DriveJudging(
        sensor=f"drive_{axis}",
        axis=number,
        unit=table.drives[axis].effort_unit,
        follows=rule.follows,
        tolerance=tolerance,
        settling_ticks=math.ceil(rule.settling / bus.sync_period_s),
        bridged_ticks=table.timing.stale_ticks,
        load_tolerance=math.inf if rule.load_tolerance is None else rule.load_tolerance * rated,
        stop_tolerance=max(tolerance, FAR_SHARE * rated),
    )


def _current(axis: str, table: MachineTable) -> CurrentTable | None:
    return next((sensor for sensor in table.sensors.values() if isinstance(sensor, CurrentTable) and sensor.axis == axis), None)


def _temperature(axis: str, table: MachineTable, rules: JudgingTable, bus: BusSettings) -> TemperatureJudging:
    rule = rules.temperature.get(axis, TemperatureJudgingTable.model_validate({}))
    sensor = table.sensors[f"temperature_{axis}"]
    assert isinstance(sensor, TemperatureTable)
    assert bus.io is not None
    fastest = sensor.rise * table.drives[axis].limit ** 2 / sensor.time_constant
    return TemperatureJudging(
        sensor=f"temperature_{axis}",
        axis=list(table.drives).index(axis),
        follows=rule.follows,
        period_s=bus.sync_period_s,
        limit_degC=math.inf if rule.limit is None else rule.limit,
        rate_K_s=fastest if rule.rate is None else rule.rate,
        step_K=max(sensor.resolution, TEMPERATURE_STEP_K),
        io_stale_s=bus.io.stale_after_s,
    )
