"""The emulated machine: plant and physics, sensors, CANopen nodes, serial and Modbus devices."""
