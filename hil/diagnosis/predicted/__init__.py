"""What a machine is predicted to do: free runs of its simulation from recorded states, driven by recorded efforts."""
