"""Triangles, balls and lines as pixels, beside a twin that looks at all of them in each pixel."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from taichi_cloth.kernels.render import edges
from taichi_cloth.render import painter, rasterizer, space, style
from taichi_cloth.render.picture import Ghost, Rect
from taichi_cloth.render.pointer import Pointer
from taichi_cloth.render.rasterizer import Group, Lens, Rasterizer, Things
from taichi_cloth.render.renderer import Renderer
from taichi_cloth.render.tiles import Panel, Tile

W, H = 90, 70
FOCAL, MIDDLE = 60.0, (47.3, 33.8)
PAPER = 0x101820


@pytest.fixture(autouse=True)
def started(device):
    """Kernels need Taichi to have been started; anew, it would take the fields of other tests."""


def flat_lens():
    """An eye at the origin that looks along z, in even light: colours are as given."""
    lights = np.zeros((3, 4))
    lights[2, 3] = 1.0
    return Lens(np.zeros(3), np.eye(3), FOCAL, MIDDLE, 0.1, lights, 0.0)


def scattered(seed, triangles=14, balls=5, lines=6):
    """Things in strong colours, some of them partly beside the picture, or behind the eye."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 1 << 24, 3 * triangles + balls + 2 * lines).astype(np.int32)
    place = rng.uniform((-4, -3, 3), (4, 3, 8), (len(codes), 3))
    place[0, 2] = -1.0
    place[5] = np.nan
    corner = np.arange(3 * triangles, dtype=np.int32).reshape(-1, 3)
    side = np.repeat(codes[corner[:, 0]], 3)
    first = 3 * triangles + np.arange(balls)
    radius = rng.uniform(0.2, 1.1, balls).astype(np.float32)
    ball = np.stack([first, codes[first], radius.view(np.int32)], axis=1).astype(np.int32)
    ends = 3 * triangles + balls + np.arange(2 * lines).reshape(-1, 2)
    line = np.concatenate([ends, codes[ends[:, :1]]], axis=1).astype(np.int32)
    normal = np.tile(np.array([0, 0, -1], np.float32), (3 * triangles, 1))
    group = Group(triangles, balls, lines, width=2.6, lift=0.02)
    side = np.stack([side, side], axis=1).astype(np.int32)
    return Things(
        place.astype(np.float32), normal, side, corner, np.full_like(corner, -1), ball, line, group
    )


def drawn(things, lens, on=None):
    image = np.full(W * H, -1, np.int32)
    on = on or Rasterizer(W, H)
    on.lay(PAPER, None, lens)
    on.stand(Things(), lens)
    on.draw(image, W, (0, 0), things, lens, None, None, rasterizer.NOWHERE)
    return image.reshape(H, W)


def depth_of(things, name, u, v):
    """One over the depth of a thing at places of the picture, 0 where it is not; f64."""
    s, kind = divmod(name, 4)
    place = things.place.astype(float)
    with np.errstate(all="ignore"):
        seen = np.array(MIDDLE) + FOCAL * place[:, :2] / place[:, 2:]
    if kind == 0:
        a, b, c = things.corner[s]
        if not (place[[a, b, c], 2] > 0.1).all():
            return np.zeros_like(u)
        x, y = (
            (seen[[a, b, c]] - np.stack([u, v], -1)[..., None, :]).transpose(2, 0, 1)
            if u.ndim == 1
            else np.moveaxis(seen[[a, b, c]] - np.stack([u, v], -1)[..., None, :], -1, 0)
        )
        share = np.stack(
            [np.roll(x, -1, -1) * np.roll(y, -2, -1), -np.roll(y, -1, -1) * np.roll(x, -2, -1)]
        ).sum(0)
        total = share.sum(-1)
        inside = (share >= 0).all(-1) | (share <= 0).all(-1)
        z = (share / place[[a, b, c], 2]).sum(-1) / np.where(total != 0, total, 1)
        return np.where(inside & (total != 0), z, 0.0)
    if kind == 1:
        centre = place[things.ball[s, 0]]
        radius = float(things.ball[s, 2:].view(np.float32)[0])
        way = np.stack([(u - MIDDLE[0]) / FOCAL, (v - MIDDLE[1]) / FOCAL, np.ones_like(u)], -1)
        size2 = (way**2).sum(-1)
        nearest = way @ centre / size2
        inside = radius**2 - ((nearest[..., None] * way - centre) ** 2).sum(-1)
        z = nearest - np.sqrt(np.maximum(inside, 0) / size2)
        return np.where((inside >= 0) & (z > 0.1), 1 / z, 0.0)
    a, b = things.line[s, :2]
    if not (place[[a, b], 2] > 0.1).all():
        return np.zeros_like(u)
    way = seen[b] - seen[a]
    off = np.stack([u, v], -1) - seen[a]
    part = np.clip(off @ way / (way @ way), 0, 1)
    away = np.linalg.norm(off - part[..., None] * way, axis=-1)
    z = (1 / place[a, 2] + part * (1 / place[b, 2] - 1 / place[a, 2])) / (1 - things.firm.lift)
    return np.where(away <= things.firm.width / 2, z, 0.0)


def color_of(things, name):
    s, kind = divmod(name, 4)
    if name < 0:
        return PAPER
    if kind == 0:
        return int(things.side[things.corner[s, 0], 0])
    return int(things.ball[s, 1] if kind == 1 else things.line[s, 2])


def channels(codes):
    return np.stack([(np.asarray(codes) >> place) & 255 for place in (16, 8, 0)], -1).astype(int)


def twin(things):
    """The picture by the rules of `kernels/render/edges.py`, each pixel by itself."""
    names = [4 * s for s in range(len(things.corner))]
    names += [4 * s + 1 for s in range(len(things.ball))]
    names += [4 * s + 2 for s in range(len(things.line))]
    v, u = np.mgrid[:H, :W] + 0.5
    depth = np.stack([depth_of(things, name, u, v) for name in names])
    best = np.where(depth.max(0) > 0, np.array(names)[depth.argmax(0)], -1)
    colors = channels(np.vectorize(lambda name: color_of(things, name))(best))
    around = np.pad(best, 1, constant_values=-2)
    found = colors.copy()
    for j in range(H):
        for i in range(W):
            steps = [
                (a, b)
                for a, b in ((-1, 0), (1, 0), (0, -1), (0, 1))
                if around[j + 1 + b, i + 1 + a] not in (-2, best[j, i])
            ]
            if not any(
                np.abs(colors[j, i] - colors[j + b, i + a]).max() > edges.SEEN for a, b in steps
            ):
                continue
            total = np.zeros(3, int)
            for q in range(4):
                at = np.array([i + 0.25 + 0.5 * (q & 1)]), np.array([j + 0.25 + 0.5 * (q >> 1)])
                nearest, shown = -1.0, colors[j, i]
                for a, b in [(0, 0), *steps]:
                    name = best[j + b, i + a]
                    z = 0.0 if name < 0 else depth_of(things, name, *at)[0]
                    if z > nearest and (z > 0 or name < 0):
                        nearest, shown = z, colors[j + b, i + a]
                total += shown
            found[j, i] = (total + 2) >> 2
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_pixels_show_what_is_nearest_and_edges_the_mean_of_four_samples(seed):
    things = scattered(seed)
    seen, expected = channels(drawn(things, flat_lens())), twin(things)
    differ = np.abs(seen - expected).max(axis=2)
    # Lit colours have ten bits; what f32 rounds decides a few samples, and pixels' middles.
    assert (differ > 1).mean() < 0.004
    assert len(np.unique(expected.reshape(-1, 3), axis=0)) > 50


@pytest.mark.parametrize("tile", [(3, W), (70, W), (8, 8), (5, 13)])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_a_picture_has_the_same_bits_for_all_tiles_and_threads(tile, threads, monkeypatch):
    things, lens = scattered(3), flat_lens()
    first = drawn(things, lens)
    monkeypatch.setattr(rasterizer, "tile_of", lambda width: tile)
    device = SimpleNamespace(arch="cpu", threads=threads)
    monkeypatch.setattr(rasterizer, "runtime", SimpleNamespace(current_device=lambda: device))
    np.testing.assert_array_equal(drawn(things, lens), first)


def test_veils_are_half_there_before_what_is_firm_and_hidden_behind_it():
    """A square of a veil before one half of a firm one, behind the other half, and beside both."""

    def square(x0, x1, z):
        return [[x0, -1, z], [x1, -1, z], [x1, 1, z], [x0, -1, z], [x1, 1, z], [x0, 1, z]]

    place = np.array(square(-1, 1, 4.0) + square(-2, 0, 3.0) + square(0.2, 0.9, 5.0), np.float32)
    codes = np.repeat(np.array([0x804020, 0x2080C0, 0x2080C0], np.int32), 6)
    side = np.stack([codes, codes], axis=1)
    normal = np.tile(np.array([0, 0, -1], np.float32), (18, 1))
    corner = np.arange(18, dtype=np.int32).reshape(-1, 3)
    beside = np.full_like(corner, -1)
    things = Things(place, normal, side, corner, beside, firm=Group(2), veil=Group(4))
    seen = channels(drawn(things, flat_lens()))
    row = seen[int(MIDDLE[1])]

    def at(x, z):
        return row[int(MIDDLE[0] + FOCAL * x / z)]

    firm, veil, paper = (channels(code) for code in (0x804020, 0x2080C0, PAPER))
    np.testing.assert_allclose(at(-0.5, 4.0), (firm + veil) / 2, atol=1)
    np.testing.assert_allclose(at(0.5, 5.0), firm, atol=1)
    np.testing.assert_allclose(at(-1.9, 3.0), (paper + veil) / 2, atol=1)


def test_slivers_at_a_silhouette_are_seen_by_what_is_beside_them():
    """A thin pole of many sides, beside the mean of four samples of all of its triangles."""
    turn = np.linspace(0, 2 * np.pi, 61)[:-1]
    ring = np.stack([0.3 * np.cos(turn), 0 * turn, 5 + 0.3 * np.sin(turn)], axis=1)
    place = np.concatenate([ring + [0.11, -2.0, 0], ring + [0.42, 2.0, 0]]).astype(np.float32)
    a, b = np.arange(60), np.roll(np.arange(60), -1)
    corner = np.concatenate([np.stack([a, b, b + 60], 1), np.stack([a, b + 60, a + 60], 1)])
    corner, beside = space._corners(corner)
    assert (beside >= 0).sum() == 3 * 120 - 120  # both ends are open
    side = np.full((120, 2), 0xE0E0E0, np.int32)
    normal = np.tile(np.array([0, 0, -1], np.float32), (120, 1))
    things = Things(place, normal, side, corner, beside, firm=Group(120))
    v, u = np.mgrid[: 2 * H, : 2 * W] / 2 + 0.25
    covered = np.max([depth_of(things, 4 * s, u, v) for s in range(120)], axis=0) > 0
    share = covered.reshape(H, 2, W, 2).mean(axis=(1, 3))[..., None]
    expected = share * channels(0xE0E0E0) + (1 - share) * channels(PAPER)

    def wrong(things):
        differ = np.abs(channels(drawn(things, flat_lens())) - expected).max(axis=2)
        return (differ > 8).sum()

    edges = ((share > 0) & (share < 1)).sum()
    alone = replace(things, beside=np.full_like(beside, -1))
    assert edges > 50 and wrong(things) < 0.05 * edges < wrong(alone)


def random_picture(rng, count=60):
    """A wavy sheet and balls, with a pointer, panels and at times a ghost."""
    from test_drawing import picture_of, sheet

    x, faces, color = sheet(rng.uniform(-0.3, 0.3), n=7, size=rng.uniform(0.3, 1.6))
    x[:, 2] += 0.1 * np.sin(5 * x[:, 0] + rng.uniform(0, 6))
    balls = [
        (rng.uniform(0.4, 1.6, 3) - [0, 0, 1], rng.uniform(0.02, 0.2), (20, 220, 20))
        for _ in range(rng.integers(0, 4))
    ]
    made = picture_of((x, faces, color), balls=balls, ground=0.4)
    overlay = tuple(
        Panel(int(rng.integers(0, 60)), int(rng.integers(0, 60)), TILES[k])
        for k in range(len(TILES))
        if rng.random() < 0.5
    )
    ghost = None
    if rng.random() < 0.4:
        n = len(made.position)
        ghost = Ghost(
            made.position + 0.2, made.radius, made.segments, made.triangles, made.as_spheres, None
        )
        assert n == len(ghost.position)
    place = rng.uniform(0, 100, 2)
    pointer = Pointer(place, rng.uniform(3, 30), True) if rng.random() < 0.6 else None
    return replace(made, overlay=overlay, pointer=pointer, ghost=ghost)


TILES = [Tile(np.full((9 + 7 * k, 40 - 9 * k, 3), 60 * k, np.uint8)) for k in range(4)]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("tile", [None, (8, 8)])
def test_what_was_left_alone_is_as_in_a_picture_drawn_afresh(dim, tile, monkeypatch):
    """Whatever moved, lay over the world, and was pointed at in the frames before."""
    if tile:  # as on a graphics card
        monkeypatch.setattr(rasterizer, "tile_of", lambda width: tile)
        monkeypatch.setattr(painter, "tile_of", lambda width: tile)
    from test_drawing import WORLD, camera

    rng, size, room = np.random.default_rng(7), (120, 100), Rect(4, 6, 110, 90)
    world = WORLD if dim == 3 else replace(WORLD, size=(2.0, 2.0), gravity=(0.0, 0.0))
    used = Renderer(size)
    for frame in range(40):
        made = random_picture(rng)
        if dim == 2:
            flat = made.position[:, :2]
            made = replace(made, position=flat, normals=None, ground=None, ghost=None)
        looks = camera(rot_x=20, rot_y=5 * (frame // 10)) if dim == 3 else None
        used.draw(made, world, looks, room, None)
        fresh = Renderer(size)
        fresh.draw(made, world, looks, room, None)
        np.testing.assert_array_equal(used.pixels(), fresh.pixels(), err_msg=f"frame {frame}")
    assert (used.pixels()[:4] == style.packed_one(style.PAPER)).mean() > 0.5
