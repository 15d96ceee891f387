"""Solvers that implicit methods share: Newton's method, sweeps by colour, and steps in phases."""
