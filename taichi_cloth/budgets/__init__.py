"""Budgets: settings of a run that are kept to a frame's time, or to an error, while it goes on."""
