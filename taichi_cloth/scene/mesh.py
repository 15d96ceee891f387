"""Cloths of triangles, quads and polygons out of mesh files: particles and springs of a surface.

One builder for ``[[meshes]]`` in scene files, for ``run shirt.obj`` and for Python.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.files import meshes
from taichi_cloth.files.meshes.seams import Welded, welded
from taichi_cloth.files.meshes.surface import LARGEST_COORDINATE, Surface
from taichi_cloth.scene.material import Material
from taichi_cloth.scene.model import ParticleDefaults, Particles, SpringDefaults, Springs
from taichi_cloth.scene.palette import FABRIC_COLOR, FIXED_COLOR
from taichi_cloth.scene.properties import SPRING_PROPERTIES
from taichi_cloth.scene.triangles import areas, masses
from taichi_cloth.settings import accepted

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# The numbers of springs that a mesh gives itself: from its edges, and from `stretch`.
OF_THE_MESH = ("stiffness", "rest_length")
SMALLEST_MESH = 1e-100  # length of a mesh whose squares are numbers
# A quad's springs are no softer than this part of what its triangles would make them.
SOFTEST = 0.1
# Corners of a quad at the ends of its springs: edges, then diagonals.
QUAD_SPRINGS = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3))


def mesh(
    file: str | Path,
    *,
    scale: float = 1.0,
    turn: ArrayLike = (0.0, 0.0, 0.0),
    move: ArrayLike = (0.0, 0.0, 0.0),
    pinned: Iterable[int] | Mapping[str, float] = (),
    parts: int | None = None,
    weld: float = 0.0,
    material: Material | None = None,
    up: int = 1,
    particle_defaults: ParticleDefaults | None = None,
    spring_defaults: SpringDefaults | None = None,
    **numbers: Any,
) -> tuple[Particles, Springs, np.ndarray]:
    """Particles, springs and triangles (m, 3) of the surface in an OBJ, PLY, STL or GLB file.

    Particles are the vertices that faces have, in the file's order, unless `weld` joins some. Each
    edge is a spring that rests at its length; quads have a spring along each of their diagonals,
    and larger polygons along the edges of the triangles that they are cut into.

    scale: by what positions are multiplied; turn: degrees about x, then y, then z, all through the
        origin; move: what is added then [length].
    pinned: numbers of the vertices that never move, or {"above": h}: those that are then at height
        h or above it.
    parts: how many parts that nothing joins the mesh must have; None: any number.
    weld: within what length vertices on borders are joined to each other and to the edges of
        others, after scaling; 0: none are. Particles are then numbered by the first vertex of each.
    material: what the cloth is made of, in the place of masses, radii and stiffness (it has no
        shear of its own: triangles resist it); None: each particle and spring has its own.
    up: +1 where y points up, -1 where it points down.
    numbers: damping, break_force and others of `SpringProperties`, one for all springs.

    Raises InputError for a file that holds no sound surface (`files.meshes.read`), and for values
    that make no sense.
    """
    for name in numbers:
        if name not in SPRING_PROPERTIES or name in OF_THE_MESH:
            raise TypeError(f"mesh() got an unexpected keyword argument '{name}'")
    if parts is not None:
        parts = accepted.whole_number("mesh: parts", parts, 1)
    if accepted.whole_number("mesh: up", up, None) not in (1, -1):
        raise InputError(f"mesh: up must be 1 or -1, is {up}")
    path = accepted.path("mesh: file", file)
    return of_surface(
        sewn(path, scale, weld),
        path,
        scale=scale,
        turn=turn,
        move=move,
        pinned=pinned,
        parts=parts,
        material=material,
        up=up,
        particle_defaults=particle_defaults,
        spring_defaults=spring_defaults,
        **numbers,
    )


def sewn(path: Path, scale: float, weld: float) -> Welded:
    """The surface in a file, seams joined within `weld`, a length after scaling; 0: none are."""
    surface = meshes.read(path)
    scale, weld = _positive("scale", scale), accepted.number("mesh: weld", weld)
    if not 0 <= weld < np.inf:
        raise InputError(f"weld must be finite and not negative, is {weld:g}")
    if weld == 0:
        same = np.arange(len(surface.vertices))
        return Welded(surface, same, surface.number, surface.triangles)
    return welded(path, surface, weld, scale)


def of_surface(
    of_file: Welded,
    path: Path,
    *,
    scale: float,
    turn: ArrayLike,
    move: ArrayLike,
    pinned: Iterable[int] | Mapping[str, float],
    parts: int | None,
    material: Material | None,
    up: int,
    particle_defaults: ParticleDefaults | None,
    spring_defaults: SpringDefaults | None,
    **numbers: Any,
) -> tuple[Particles, Springs, np.ndarray]:
    """`mesh` of a surface whose seams are joined already; path: its file's."""
    surface = of_file.surface
    if parts is not None and surface.parts() != parts:
        has = counted(surface.parts(), "part")
        raise InputError(f"parts: {path} has {has}, not {parts}, that nothing joins")
    of = Material.given("mesh", material, ("structural",), _given(numbers))
    position = placed(surface.vertices, scale, turn, move)
    fixed = _pinned(pinned, position, of_file, up, path)
    mass = None if of.density is None else masses(position, surface.triangles, of.density)
    particles = Particles.build(
        position,
        defaults=particle_defaults,
        fixed=fixed,
        mass=mass,
        radius=None if of.thickness is None else of.thickness / 2,
        thickness=of.thickness,
        color=np.where(fixed[:, None], FIXED_COLOR, FABRIC_COLOR),
    )
    between, shape = stiffness_by_shape(surface, position)
    rest = np.linalg.norm(position[between[:, 0]] - position[between[:, 1]], axis=1)
    springs = Springs.build(
        between,
        position,
        defaults=spring_defaults,
        rest_length=rest,
        **numbers | of.of_links("structural", shape, rest),
    )
    return particles, springs, surface.triangles


def _given(numbers: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Numbers of springs as `Material.checked` takes them: by kind of link, here of one kind."""
    return {name: {"structural": value} for name, value in numbers.items() if value is not None}


def _positive(name: str, value: float) -> float:
    number = accepted.number(f"mesh: {name}", value)
    if not 0 < number < np.inf:
        raise InputError(f"{name} must be positive and finite, is {number:g}")
    return number


def placed(vertices: np.ndarray, scale: float, turn: ArrayLike, move: ArrayLike) -> np.ndarray:
    """Vertices (n, 3) scaled, turned by degrees about x, then y, then z, and moved."""
    scale = _positive("scale", scale)
    shift = accepted.array("mesh: move", move, (3,))
    a, b, c = np.radians(accepted.array("mesh: turn", turn, (3,)))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    turned: np.ndarray = scale * vertices @ (about_z @ about_y @ about_x).T + shift
    farthest = float(np.abs(turned).max())
    if not farthest <= LARGEST_COORDINATE:
        most = f"beyond {LARGEST_COORDINATE:g}"
        raise InputError(f"scale, turn and move take the mesh to {farthest:g}, {most}")
    if not np.ptp(turned, axis=0).max() > SMALLEST_MESH:
        raise InputError(f"scale: the mesh is smaller than {SMALLEST_MESH:g}; use other units")
    return turned


def _pinned(
    pinned: Iterable[int] | Mapping[str, float],
    position: np.ndarray,
    of_file: Welded,
    up: int,
    path: Path,
) -> np.ndarray:
    """The particles that never move, (n,) bool."""
    if isinstance(pinned, Mapping):
        if set(pinned) != {"above"}:
            raise InputError(f"pinned must be a list, or {{ above = h }}, is {pinned}")
        height = accepted.number("mesh: pinned: above", pinned["above"])
        up_there: np.ndarray = up * position[:, 1] >= up * height
        if not up_there.any():
            highest = up * (up * position[:, 1]).max()
            raise InputError(
                f"pinned: no vertex of {path} is above {height:g}; its highest is at {highest:.6g}"
            )
        if up_there.all():
            raise InputError(f"pinned: every vertex of {path} is above {height:g}")
        return up_there
    listed = accepted.listed("mesh: pinned", pinned, "a list of vertices, or {'above': h}")
    numbers = accepted.numbers("mesh: pinned", listed)
    fixed = np.zeros(len(position), bool)
    number = of_file.number
    for value in numbers.ravel().tolist():
        if value != int(value) or not 0 <= value <= number[-1]:
            raise InputError(f"pinned: there is no vertex {value:g}; {path} has 0 to {number[-1]}")
        at = np.searchsorted(number, value)
        if number[at] != value:
            raise InputError(f"pinned: vertex {value:g} of {path} is a corner of no face")
        fixed[of_file.joined[at]] = True
    return fixed


def stiffness_by_shape(surface: Surface, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The springs of a surface, pairs (s, 2), and what each has of the stretch stiffness, (s,).

    An edge of triangles of areas A has sum(A) / length^2: a width sum(A) / length of cloth, of
    that length (van Gelder, "Approximate simulation of elastic membranes by triangulated spring
    meshes", 1998). Sheets of equilateral triangles are then isotropic, with a Poisson ratio of 1/3;
    so are the springs of quads made (`_quad_shares`).
    """
    alone = np.ones(len(surface.triangles), bool)
    alone[surface.quad_triangles] = False
    triangles = surface.triangles[alone]
    pairs = [triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]
    area = areas(position, triangles)
    shares = [area / _squares(position, ends) for ends in pairs]
    of_quads = _quad_shares(surface.quads, position)
    for n, ends in enumerate(QUAD_SPRINGS):
        pairs.append(surface.quads[:, ends])
        shares.append(of_quads[:, n])
    all_pairs, all_shares = np.sort(np.concatenate(pairs), axis=1), np.concatenate(shares)
    key = all_pairs[:, 0] * len(position) + all_pairs[:, 1]
    found, where = np.unique(key, return_inverse=True)
    between = np.stack(np.divmod(found, len(position)), axis=1)
    return between, np.bincount(where.ravel(), all_shares, minlength=len(found))


def _squares(position: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Squared distances of the ends (s, 2)."""
    squares: np.ndarray = ((position[ends[:, 0]] - position[ends[:, 1]]) ** 2).sum(axis=1)
    return squares


def _quad_shares(quads: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Shares of a quad's edges and diagonals in the stretch stiffness, (q, 6), by `QUAD_SPRINGS`.

    Springs along unit vectors n, of length l, make a sheet of area A with the elasticity
    sum(k l^2 n n n n) / A, which has 5 components in a plane. The 6 springs take those of an
    isotropic sheet of stiffness 1 and Poisson ratio 1/3 (what springs can be), nearest to what van
    Gelder's rule makes of the quad's triangles cut both ways. A square's edges get 3/8 each, and
    so do its diagonals. Where that would leave a spring with less than `SOFTEST` of what it has by
    the rule, as in oblongs of more than 1 : 1.6, a quad goes only as far from the rule as it can.
    """
    x = position[quads]
    across, along = x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]
    normal = np.cross(across, along)
    area = np.linalg.norm(normal, axis=1) / 2
    e1 = across / np.linalg.norm(across, axis=1, keepdims=True)
    e2 = np.cross(normal, e1) / (2 * area[:, None])
    edges = np.stack([x[:, b] - x[:, a] for a, b in QUAD_SPRINGS], axis=1)
    squares = (edges**2).sum(axis=2)
    p, q = (np.einsum("fsd,fd->fs", edges, e) for e in (e1, e2))
    # l^2 n n n n / A of each spring: the components 1111, 1112, 1122, 1222, 2222.
    made = (
        np.stack([p ** (4 - n) * q**n for n in range(5)], axis=1)
        / (squares * area[:, None])[:, None, :]
    )
    wanted = np.array([9 / 8, 0.0, 3 / 8, 0.0, 9 / 8])
    cut = np.zeros_like(squares)
    for a, b, c in ((0, 1, 2), (2, 3, 0), (1, 2, 3), (3, 0, 1)):
        half = np.linalg.norm(np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]), axis=1) / 4
        for ends in ((a, b), (b, c), (c, a)):
            n = next(n for n, s in enumerate(QUAD_SPRINGS) if set(s) == set(ends))
            cut[:, n] += half / squares[:, n]
    off = wanted - np.einsum("fms,fs->fm", made, cut)
    # Shapes whose springs hardly differ in direction are left as they are.
    change = np.einsum("fsm,fm->fs", np.linalg.pinv(made, rcond=0.05), off)
    with np.errstate(divide="ignore"):
        room = np.where(change < 0, (SOFTEST - 1) * cut / change, np.inf).min(axis=1)
    shares: np.ndarray = cut + np.minimum(room, 1.0)[:, None] * change
    return shares
