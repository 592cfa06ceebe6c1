"""The emulated machine of a machine file: its devices, its X-ray panel, its truth file, and the ports that it announces."""
