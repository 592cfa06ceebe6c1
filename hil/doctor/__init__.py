"""Whether this computer can run the sample loop: what it is set to, how punctual it is, and what to change."""
