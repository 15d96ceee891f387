"""The colours that particles have where a scene gives none: red, green, blue, 0..255."""

PARTICLE_COLOR = (220, 60, 60)
CLOTH_COLOR = (0, 255, 0)  # of a cloth's particles, as in the first program
FABRIC_COLOR = (88, 136, 196)  # of cloths in space, which are drawn as surfaces
FIXED_COLOR = (128, 128, 128)
COLOR_CYCLE = (  # colours of spawned particles, in turn
    (232, 66, 66),  # red
    (224, 84, 214),  # magenta
    (82, 122, 250),  # blue
    (64, 204, 220),  # cyan
    (84, 200, 104),  # green
    (242, 206, 74),  # yellow
)
