"""Checks of one CANopen node against CiA 301 and its data sheet, safe on a real device."""
