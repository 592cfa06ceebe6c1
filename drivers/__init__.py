"""Real devices behind one interface: CANopen drives and encoders, a serial IMU, Modbus I/O. No physics, no control."""
