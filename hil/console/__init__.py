"""`isocenter bench`: a page on which a machine is watched, commissioned, run and stopped.

Two processes beside those of a run. The *starter*, the one that the command starts, runs commands of `isocenter`, one at a time, and lets
go of what it runs when the *server* ends or falls silent. The server has low priority; it reads rows from the journal that the recorder
writes, frames from the bus and the I/O's published state, and asks the supervisor for a stop. Neither is known to the sample loop.
"""
