"""The emulated machine of a machine file: its devices, its X-ray panel, what only it knows, and where it says that it runs."""
