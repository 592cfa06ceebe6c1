"""The loop's side of the supervisor: it is started, asked, and heard."""
