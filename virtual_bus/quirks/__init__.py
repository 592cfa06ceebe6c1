"""Drives that bend CiA 301 and CiA 402 on the wire: what real ones have been seen to do, each put on an emulated drive by name."""
