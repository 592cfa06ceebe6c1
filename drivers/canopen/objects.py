"""Objects that a PDO may map, of CiA 301, 402, 406 and of a CANopen IMU (`can_imu`), by the names used in machine files."""

from __future__ import annotations

# name -> (index, subindex, bits); CiA 402 part 2 and CiA 406, mandatory and common optional objects
MAPPABLE: dict[str, tuple[int, int, int]] = {
    "error_register": (0x1001, 0x00, 8),
    "error_code": (0x603F, 0x00, 16),
    "controlword": (0x6040, 0x00, 16),
    "statusword": (0x6041, 0x00, 16),
    "modes_of_operation": (0x6060, 0x00, 8),
    "modes_of_operation_display": (0x6061, 0x00, 8),
    "position_demand_value": (0x6062, 0x00, 32),
    "position_actual_value": (0x6064, 0x00, 32),
    "velocity_actual_value": (0x606C, 0x00, 32),
    "target_torque": (0x6071, 0x00, 16),
    "torque_demand": (0x6074, 0x00, 16),
    "torque_actual_value": (0x6077, 0x00, 16),
    "current_actual_value": (0x6078, 0x00, 16),
    "target_position": (0x607A, 0x00, 32),
    "position_offset": (0x60B0, 0x00, 32),
    "velocity_offset": (0x60B1, 0x00, 32),
    "torque_offset": (0x60B2, 0x00, 16),
    "digital_inputs": (0x60FD, 0x00, 32),
    "digital_outputs": (0x60FE, 0x01, 32),
    "target_velocity": (0x60FF, 0x00, 32),
    "position_value": (0x6004, 0x00, 32),
    "speed_value": (0x6030, 0x01, 16),
    "specific_force_x": (0x2100, 0x01, 16),
    "specific_force_y": (0x2100, 0x02, 16),
    "specific_force_z": (0x2100, 0x03, 16),
    "angular_rate_x": (0x2101, 0x01, 16),
    "angular_rate_y": (0x2101, 0x02, 16),
    "angular_rate_z": (0x2101, 0x03, 16),
    "sample_counter": (0x2102, 0x00, 16),
}
