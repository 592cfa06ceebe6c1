"""What a machine is predicted to do: every row from those before it, or free runs, of the closed loop or by recorded efforts."""
