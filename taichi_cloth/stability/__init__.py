"""`stability`: the largest stable step, computed and found by runs."""
