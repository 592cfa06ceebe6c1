"""Inputs of five kinds that people bring, made here with known content: time disorder, data sheets, wrong files, units, other geometry."""
