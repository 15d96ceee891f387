"""The reference of runs, and how far it can be trusted.

Where a scene has a closed form, that; else the solution of the differential equation, by SciPy's
DOP853 on forces of its own (`ode`) and, independently, by our method of the highest order in
f64 at a fine step: what they differ by is what they are worth. A contact or a break within the
horizon is an event, past which there is no smooth solution: then it is our method at a fine step,
and what it differs by from one four times as long. The time of its first touch is that of its step.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.errors import InputError, counted
from taichi_cloth.limits.bounds import any_geometry
from taichi_cloth.limits.network import Network
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.trade import errors, ode
from taichi_cloth.trade.errors import Distance, Samples, displacement, distance, rms_by_frame
from taichi_cloth.trade.seconds import SECOND

DISTURBANCE = 1e-10  # of the largest displacement: what the starts of two runs differ by
# The horizon ends where it has grown to this: what is smaller by then is chance.
GROWN = 1e-7
FINER = 4  # from one fine run to the next
RESOLUTION = 16  # steps in 1 / omega of the coarsest of the fine runs
MOST_STEPS = 2**28  # of that a frame: those of the next one, too, are counted in 32 bits
ENOUGH = 1e-13  # of the scale: finer runs differ by round-off alone
SAMPLES = 8_000_000  # numbers that the positions of a run may have: they are all kept
LEAST, MOST = 5, 20  # seconds of a horizon that is left open
TRUST = 10  # times what two references differ by: the least error that they can measure


@dataclass(frozen=True)
class Horizon:
    """The horizon of a comparison of runs.

    asked, frames: frames wanted, and those that are compared; scale: `extent` within them, in world
    units, and what that is; grown: what a disturbance of `DISTURBANCE` grows to within them, in
    parts of the scale.
    """

    asked: int
    frames: int
    scale: float
    what: str
    grown: float

    def describe(self) -> str:
        disturbed = f"a disturbance of {DISTURBANCE:g} grows to {self.grown:.1e}"
        frames = counted(self.frames, "frame")
        if self.frames == self.asked:
            return f"horizon: {frames}, in which {disturbed}"
        return (
            f"horizon: {frames} of the {self.asked} asked for: in these {disturbed}, "
            f"soon after to more than {GROWN:g}, and errors beyond are chance"
        )


@dataclass(frozen=True)
class Reference:
    """States that runs are compared to. what: where they come from; against: what they were
    checked with; apart: by how much they differ from that; event: what ends smoothness; note: why
    the differential equation was not solved, where nothing ends it.
    """

    samples: Samples
    what: str
    against: str
    apart: Distance
    event: str | None = None
    note: str = ""

    def floor(self, horizon: Horizon) -> float:
        """The least trajectory error that it can measure, in world units."""
        return max(TRUST * self.apart.trajectory, horizon.grown * horizon.scale)

    def describe(self, horizon: Horizon) -> list[str]:
        """Sentences on where it comes from and what it is worth."""
        apart, floor = self.apart.trajectory / horizon.scale, self.floor(horizon) / horizon.scale
        said = [
            f"reference: {self.what}; it differs from {self.against} by {apart:.1e}",
            f"errors below {floor:.1e} are beyond what it can tell, and marked",
        ]
        if self.event:
            said.insert(1, f"not smooth: {self.event}; no high order is to be expected past that")
        return said + [self.note] * bool(self.note)


def default_frames(scene: Scene) -> int:
    """Frames of the scene's own length: whole seconds in which the slowest vibration swings once or
    so, 5 to 20 of them, or as many as can be kept of a large scene.

    A wave passes sqrt(k/m) springs per time; the farthest particle from a fixed one is reached and
    left four times in a period of the lowest mode.
    """
    most = most_frames(scene)
    longest = max(most // SECOND, 1) * SECOND
    seconds = math.ceil(min(max(_slowest(scene) / scene.world.dt / SECOND, LEAST), MOST))
    return min(seconds * SECOND, longest, most)


def _slowest(scene: Scene) -> float:
    """The period of the slowest vibration, about; 0 where there is none."""
    springs, particles = scene.springs, scene.particles
    n = len(particles)
    stiff = springs.stiffness > 0
    if not stiff.any():
        return 0.0
    from scipy.sparse import csgraph, csr_matrix

    between = springs.between[stiff]
    graph = csr_matrix((np.ones(len(between)), between.T), shape=(n, n))
    start = np.flatnonzero(particles.fixed) if particles.fixed.any() else between[:1, 0]
    far = csgraph.dijkstra(graph, directed=False, unweighted=True, indices=start, min_only=True)
    depth = max(float(far[np.isfinite(far)].max()), 1.0)
    mass = particles.mass[between].mean()
    return 4.0 * depth * float(np.sqrt(mass / springs.stiffness[stiff].mean()))


def most_frames(scene: Scene) -> int:
    """Frames of which the states can be kept; raises InputError where there are none."""
    numbers = len(scene.particles) * scene.world.dim
    frames = SAMPLES // max(numbers, 1) - 1
    if frames < 1:
        raise InputError(
            f"scene '{scene.name}' has {len(scene.particles)} particles: too many, as the states "
            f"of all runs are kept (at most {SAMPLES // (2 * scene.world.dim)})"
        )
    return frames


def check_frames(scene: Scene, frames: int) -> int:
    """Return `frames` if their states can be kept, else raise InputError."""
    most = most_frames(scene)
    if frames > most:
        raise InputError(
            f"--frames {frames}: too many for {len(scene.particles)} particles, as the states of "
            f"all runs are kept; use at most {most}"
        )
    return frames


def disturbed(scene: Scene, size: float, seed: int = 0) -> Scene:
    """The scene with its free particles moved at random by `size` (root of the mean square)."""
    rng = np.random.default_rng(seed)
    particles = scene.particles
    shift = rng.normal(size=particles.position.shape)
    shift[particles.fixed] = 0.0
    rms = np.sqrt((shift[~particles.fixed] ** 2).sum(axis=1).mean())
    moved = particles.position + shift * (size / rms)
    moved = np.clip(moved, scene.world.low, scene.world.high)
    return replace(scene, particles=replace(particles, position=moved))


def coarsest(scene: Scene, dt: float, resolution: float = RESOLUTION) -> int:
    """Substeps of the coarsest of the fine runs; resolution: steps in 1 / omega.

    Raises InputError where these are too many, or the frame is too short to divide by.
    """
    if dt * sys.float_info.max <= 1.0:
        raise InputError(f"--dt {dt:g}: is too short a frame to divide by; use a longer one")
    with np.errstate(all="ignore"):  # what overflows is refused
        bounds = any_geometry(Network.from_scene(scene))
        rate = float(np.max([np.sqrt(bounds.omega2), bounds.damping, 1.0 / dt]))
    needed = resolution * dt * rate
    if not needed <= MOST_STEPS:
        shown = f"{needed:.3g}" if math.isfinite(needed) else "countless"
        raise InputError(
            f"the reference would need {shown} steps in a frame of {dt:g}, and the most is "
            f"{MOST_STEPS}; use a smaller --dt or softer springs"
        )
    return 1 << max(0, int(np.ceil(np.log2(needed))))


def limit_horizon(scene: Scene, run: Samples, other: Samples) -> Horizon:
    """The horizon of comparison, from two runs whose starts differ by `DISTURBANCE` of the largest
    displacement of the first.
    """
    free, asked = ~scene.particles.fixed, len(run) - 1
    apart = np.maximum.accumulate(rms_by_frame(run, other, free))
    moved = np.linalg.norm(run.x[:, free] - run.x[:1, free], axis=2).max(axis=1)
    largest = np.maximum.accumulate(moved)
    fine = apart <= GROWN * np.where(largest > 0, largest, extent(scene, run)[0])
    frames = max(int(np.flatnonzero(fine).max(initial=0)), 1)
    scale, what = extent(scene, run.first(frames))
    return Horizon(asked, frames, scale, what, float(apart[frames] / scale))


def extent(scene: Scene, run: Samples) -> tuple[float, str]:
    """The scale of a scene's errors, and its name (`errors.extent`)."""
    diagonal = float(np.linalg.norm(scene.world.size))
    return errors.extent(run, ~scene.particles.fixed, diagonal)


def closed_form(source: SceneSource, scene: Scene, times: np.ndarray) -> Samples | None:
    """The scene's own closed form at `times`; None where it has none."""
    solution = source.solution()
    if solution is None:
        return None
    x, v = solution(scene, times)
    return Samples(x, v, np.ones((len(times), 0), bool))


def decide(
    scene: Scene,
    frames: int,
    closed: Samples | None,
    smooth: ode.SmoothTrajectory | None,
    solved_to: float,
    fine: list[tuple[str, Samples]],
) -> Reference | None:
    """The reference, from what there is; None where there is too little.

    closed: by the scene's closed form, if it has one. smooth: of the differential equation, as far
    as it was solved. solved_to: time of the horizon's end. fine: runs at ever finer steps, with
    what they are.
    """
    free = ~scene.particles.fixed
    runs = [(what, samples.first(frames)) for what, samples in fine]
    if smooth is not None and smooth.until >= solved_to - 1e-9 * abs(solved_to):
        alive = runs[-1][1].alive if runs else np.ones((frames + 1, 0), bool)
        everywhere = np.ones_like(alive)
        solved = Samples(smooth.x[: frames + 1], smooth.v[: frames + 1], everywhere)
        what = "DOP853 at a tolerance of 1e-13 (SciPy, forces of its own)"
        if closed is not None:
            exact = replace(closed.first(frames), alive=everywhere)
            apart = distance(exact, solved, free)
            return Reference(exact, "the closed form", what, apart)
        if runs:
            return Reference(solved, what, runs[-1][0], distance(solved, runs[-1][1], free))
        return None
    if len(runs) < 2:
        return None
    (coarser, before), (what, finest) = runs[-2:]
    event, note = None, ""
    if smooth is not None and smooth.event:
        event = f"{smooth.event} after time {smooth.until:.4g}"
    elif not finest.alive.all():
        frame, spring = np.argwhere(~finest.alive)[0]
        event = f"spring {spring} breaks in frame {frame}"
    else:
        until = smooth.until if smooth is not None else 0.0
        note = f"DOP853 took too long, and was given up at time {until:.4g} of {solved_to:.4g}"
    return Reference(finest, what, coarser, distance(finest, before, free), event, note)


def refine(
    run: Callable[[int], Samples], scene: Scene, substeps: int, enough: Callable[[float], bool]
) -> list[tuple[int, Samples]]:
    """Runs at ever finer steps, at least two, until they differ by round-off or it is enough.

    run: runs so many substeps. enough: whether a run that takes so many times longer than the last
    one is too much.
    """
    free = ~scene.particles.fixed
    runs = [(substeps, run(substeps))]
    last = np.inf
    while len(runs) < 2 or not enough(FINER):
        substeps *= FINER
        runs.append((substeps, run(substeps)))
        apart = distance(runs[-1][1], runs[-2][1], free).trajectory
        scale = displacement(runs[-1][1], free) or 1.0
        if apart <= ENOUGH * scale or (apart < 1e-9 * scale and apart > last / 2):
            break
        last = apart
    return runs


def fine_method() -> str:
    """The method of the fine runs: of the explicit ones that with the highest order."""
    from taichi_cloth.kernels import methods

    claims = {name: methods.load(name).claims for name in methods.METHODS}
    explicit = [name for name, claim in claims.items() if not claim.implicit]
    return max(explicit, key=lambda name: claims[name].order)
