"""What a machine is predicted to do: every row from those before it, or free runs from recorded states by recorded efforts."""
