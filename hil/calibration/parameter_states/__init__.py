"""Parameters as states (thesis Secs. 5.2.4, 5.5): kinematics, compliance, frequencies, dampings and masses in one filter."""
