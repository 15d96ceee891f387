"""Device code of drawing: surfaces, balls and lines with depth, flat shapes, shadows."""
