"""What moved, which effort was missing, and how surely: the recordings beside the equations, without simulating them."""
