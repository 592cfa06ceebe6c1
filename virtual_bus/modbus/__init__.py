"""The emulated Modbus input/output device, and its servers for TCP and RTU."""
