"""From a picture of particles, springs and surfaces to an image: the only room that draws."""
