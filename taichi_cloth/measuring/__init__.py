"""Processes of their own, timing, and what machine this is."""
