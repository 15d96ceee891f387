"""The sine by its series: what compiles to SPIR-V (Vulkan, OpenGL, Metal) has none in f64."""

import math

import taichi as ti

TERMS = 11  # to double precision up to a quarter turn


def has_sine():
    """True if the backend has a sine in every precision."""
    return ti.cfg.arch in (ti.cpu, ti.cuda)


@ti.func
def sine_of_turn(real: ti.template(), turn):
    """The sine of an angle in turns, a number of the type `real`, as constants are then, too."""
    q = 0.5 - (turn - ti.floor(turn))  # sin(2 pi turn) = sin(2 pi q), and |q| <= 1/2
    if q > 0.25:
        q = 0.5 - q
    elif q < -0.25:
        q = -0.5 - q
    x = real(ti.static(2.0 * math.pi)) * q
    total = 0.0 * x
    for n in ti.static(range(TERMS - 1, -1, -1)):
        total = real(ti.static((-1.0) ** n / math.factorial(2 * n + 1))) + x * x * total
    return x * total


@ti.func
def sine_and_cosine(real: ti.template(), angle):
    """The sine and the cosine of an angle in radians, a number of the type `real`."""
    if ti.static(has_sine()):
        return ti.sin(angle), ti.cos(angle)
    else:
        turn = real(ti.static(0.5 / math.pi)) * angle
        return sine_of_turn(real, turn), sine_of_turn(real, turn + 0.25)
