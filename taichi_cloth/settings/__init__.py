"""Settings that a person can change: declared once, read from flags."""
