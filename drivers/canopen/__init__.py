"""CANopen: network and SDO, identity and configuration of nodes, heartbeats, and the device profiles 402 (drives) and 406 (encoders)."""
