"""Sweeps: many runs of which each counts, kept as they finish, so that no kill loses one."""
