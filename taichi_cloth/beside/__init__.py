"""Two runs of one scene beside each other, under one mouse, in settings that differ."""
