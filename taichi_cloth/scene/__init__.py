"""What is simulated, as plain NumPy data: no Taichi, no method."""
