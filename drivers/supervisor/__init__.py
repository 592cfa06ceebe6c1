"""The supervisor: watches the bus beside the loop, and alone can keep the I/O's outputs on."""
