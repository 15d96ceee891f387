"""Scenes, as plain NumPy data: no Taichi, no method."""
