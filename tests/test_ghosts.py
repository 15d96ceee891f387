"""Ghosts as they are drawn: where the reference is, seen through, and nothing else changed."""

from dataclasses import replace

import numpy as np
from test_drawing import BLUE, RED, WORLD, camera, picture_of, sheet

from taichi_cloth.render import style
from taichi_cloth.render.picture import Picture
from taichi_cloth.scene.model import World
from taichi_cloth.ui.ghosts import Ghosts
from taichi_cloth.ui.view import View

PLANE = World((200.0, 200.0), (0.0, 0.0))
SIZE = (320, 320)
NO_SIDES = np.zeros((0, 2), np.int64)
SHARE = 1 - style.GHOST_SHARE  # of what is behind a ghost, that is seen through it


def inside(mask, by=2):
    """The pixels of a mask that are not at its border."""
    for _ in range(by):
        mask = mask & np.roll(mask, 1, 0) & np.roll(mask, -1, 0)
        mask = mask & np.roll(mask, 1, 1) & np.roll(mask, -1, 1)
    return mask


def around(mask, by=3):
    return ~inside(~mask, by)


def haunted(picture, away):
    """The picture with the ghost of its first particles, so far away."""
    return replace(picture, ghost=Ghosts().of(picture, away, NO_SIDES))


def moved(picture, away):
    return replace(picture, position=picture.position + away)


def differ(one, other, by=3):
    return np.abs(one - other).max(axis=2) > by


def check(view, picture, away, behind=None):
    """That a view draws a ghost where a picture would be that is so far away, and only there.

    behind: a second picture, which joined to the first shows what is behind; None: as in planes,
    where things have no behind.
    """

    def pixels(of):
        view.draw(of)
        return view.grab().astype(float)

    nothing = pixels(replace(picture, position=picture.position + 1e6))
    plain, ghostly = pixels(picture), pixels(haunted(picture, away))
    own, there = differ(plain, nothing), differ(pixels(moved(picture, away)), nothing)
    ghost = inside(there & ~around(own))
    changed = differ(plain, ghostly)
    assert own.sum() > 3000 and ghost.sum() > 1000
    assert changed[ghost].mean() > 0.98, changed[ghost].mean()
    assert not changed[~around(there)].any()
    assert not changed[inside(own)].any()
    color = ghostly[ghost].mean(axis=0)
    paper, pale = np.array(style.WORLD), np.array(style.GHOST)
    assert (color > paper + 15).all() and (color < pale).all(), color
    if behind is None:
        return
    far, seen_through = pixels(behind), pixels(haunted(behind, away))
    both = ghost & inside(differ(far, plain, 30))
    assert both.sum() > 300
    share = (seen_through - ghostly)[both].sum() / (far - plain)[both].sum()
    assert abs(share - SHARE) < 0.1, share


def net(n=9, pitch=10.0, at=(40.0, 50.0)):
    """A plane's net, with thick knots."""
    y, x = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    place = pitch * np.stack([x, y], axis=-1).reshape(-1, 2) + at
    number = np.arange(n * n).reshape(n, n)
    across = np.stack([number[:, :-1], number[:, 1:]], axis=-1).reshape(-1, 2)
    return Picture(
        place.astype(np.float32), np.full(n * n, 4.5, np.float32),
        np.tile(np.array(RED, np.uint8), (n * n, 1)), across,
    )  # fmt: skip


def check_all(view):
    """In a plane; in space beside the cloth, and before it."""
    view.turn_to(PLANE, None)
    picture = net()
    check(view, picture, np.full((81, 2), (47.0, 21.0), np.float32))
    view.turn_to(WORLD, camera())
    for turn in (0, 25):
        view.camera = camera(rot_x=turn / 2, rot_y=turn)
        red, blue = sheet(n=12, size=0.7), sheet(-0.4, n=12, size=1.6, color=BLUE)
        beside = np.full((144, 3), (0.35, 0.2, 0.0), np.float32)
        check(view, picture_of(red), beside, picture_of(red, blue))
    # One that is before the cloth dims it, by as much.
    view.camera = camera()
    picture, before = picture_of(red), np.full((144, 3), (0.0, 0.0, 0.2), np.float32)
    view.draw(picture)
    plain = view.grab().astype(float)
    view.draw(haunted(picture, before))
    seen = view.grab().astype(float)
    middle = inside(differ(plain, plain[0, 0] + np.zeros_like(plain), 30), 5)
    assert middle.sum() > 3000 and differ(plain, seen, 20)[middle].mean() > 0.98
    mixed = SHARE * plain + (1 - SHARE) * np.array(style.GHOST)
    assert (seen[middle] <= mixed[middle] + 20).all() and seen[middle][:, 0].min() > 60
    # Of two layers of a ghost one is seen, whichever comes first.
    picture = picture_of(sheet(-0.1, n=12, size=0.7), red)
    layers = []
    for count in (144, 288):
        view.draw(haunted(picture, np.full((count, 3), (0.0, 0.0, 0.3), np.float32)))
        layers.append(view.grab().astype(float))
    assert not differ(*layers, 6)[middle].any()


def test_ghosts_are_drawn_where_they_are(device):
    view = View("gui", PLANE, SIZE)
    try:
        check_all(view)
    finally:
        view.close()
