"""Sweeps: many runs by one command, each of which may fail alone, and none is done twice."""
