"""Readers of the files that people log robots in, one file a format; they are found by themselves."""
