"""What the processes of the loop, of the I/O and of the supervisor tell each other without locks, in shared memory."""
