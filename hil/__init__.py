"""The bench: machine file, clock, sample loop, experiments, recordings, identification, diagnosis, reports, command line."""
