"""Advice from a study: its settings judged second by second, by the error meter."""
