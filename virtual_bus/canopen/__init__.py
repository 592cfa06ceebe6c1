"""CANopen devices as pure state machines: frames and time in, frames out. No thread, no clock, no bus of their own."""
