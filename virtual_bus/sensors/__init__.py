"""What the emulated machine's sensors read of the plant."""
