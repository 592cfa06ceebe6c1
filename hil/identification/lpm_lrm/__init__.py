"""Local polynomial and rational methods, LPM and LRM (thesis Secs. 3.4 and 4.5, Chapter 4), and the choice of their orders."""
