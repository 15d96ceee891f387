"""Interaction logs, saved trajectories, files that appear whole or not at all."""
