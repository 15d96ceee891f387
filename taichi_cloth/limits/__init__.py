"""The largest stable step, what sets it, and what a precision can follow: pure numerics."""
