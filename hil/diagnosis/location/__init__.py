"""Where a mismatch is: by channel, time, frequency, pose, speed and effort, and which equation is short."""
