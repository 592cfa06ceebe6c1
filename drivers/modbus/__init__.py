"""Brakes, hold-to-run, door contact and temperatures over Modbus TCP and RTU."""
