"""Words of ``taichi-cloth run``: its first and last line, and notes on standard error."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy

from taichi_cloth import runtime
from taichi_cloth.errors import InputError, RunFailure, counted, milliseconds, printable
from taichi_cloth.files.recordings import Recordings
from taichi_cloth.scene.model import Scene
from taichi_cloth.scene.source import SceneSource
from taichi_cloth.scene.spheres import nearness
from taichi_cloth.scene.triangles import parted
from taichi_cloth.settings.options import PROGRAM, SOLVER_SETTINGS, RunOptions

if TYPE_CHECKING:
    from taichi_cloth.runtime import Device
    from taichi_cloth.simulation.simulation import Simulation
    from taichi_cloth.ui.interaction import Log
    from taichi_cloth.ui.summary import Refused, Summary
    from taichi_cloth.ui.view import View

# What of a log's header is compared with a run that replays it.
LOGGED = (
    *("scene", "dt", "substeps", "method", *SOLVER_SETTINGS),
    *("topology", "precision", "beside"),
)
MOST_NOTES = 4  # sentences on spheres wider than the thickness, before a run


def say(text: str) -> None:
    """Say something on standard error, in a line; where nothing can be said, the run goes on."""
    with contextlib.suppress(OSError):
        print(f"{PROGRAM}: {text}", file=sys.stderr, flush=True)


def compiling(scene: Scene, options: RunOptions) -> Callable[[], None] | None:
    """A teller, on standard error, why nothing happens for a while: once, whichever of two runs
    beside each other compiles first; None: a quiet run says nothing.
    """
    if options.quiet:
        return None
    touches = scene.obstacles or scene.features().resting
    takes = "up to half a minute" if touches else "some seconds"
    later = "later runs find them" if runtime.keeps_kernels() else "there is no cache to keep them"
    lines = [f"compiling kernels for this run: {takes}, once; {later}"]

    def tell() -> None:
        while lines:
            say(lines.pop())

    return tell


def announce(sim: Simulation, device: Device, view: View) -> None:
    """Say what runs, and on standard error if its steps are too long to be stable, or if there is
    something that the precision cannot resolve.
    """
    from taichi_cloth.limits.auto_step import above_limit, above_limit_in_air
    from taichi_cloth.limits.precision import too_stiff, unresolved
    from taichi_cloth.simulation.diagnostics import acceleration_at_start

    print(_first_line(sim, device, view), flush=True)
    warnings = [
        above_limit(sim.method, sim.scene, sim.dt, sim.substeps),
        unresolved(
            sim.scene, acceleration_at_start(sim.scene), sim.dt, sim.substeps, device.precision
        ),
        too_stiff(sim.scene, sim.method, device.precision),
    ]
    for warning in filter(None, warnings):
        say(f"warning: {warning}")
    in_air = above_limit_in_air(sim.method, sim.scene, sim.dt, sim.substeps)
    if in_air:
        say(f"note: {in_air}")
    if sim.scene.features().thick:
        widened = sim.scene.spheres.widened
        for sentence in widened[:MOST_NOTES]:
            say(f"note: {sentence}")
        if len(widened) > MOST_NOTES:
            say(f"note: and {len(widened) - MOST_NOTES} more such")
        near = nearness(sim.scene.particles.position, sim.scene.spheres)
        if near:
            say(f"warning: {near}")


def tell_assumed(scene: Scene) -> None:
    """Say what a scene's file leaves open, and what is taken for it."""
    for key, words in scene.assumed.items():
        print(f"  {key} = {words}")


def note_passing(source: SceneSource, scene: Scene) -> None:
    """Say on standard error that a mesh file passes through itself, where nobody asked for that."""
    asked = any(entry.keys[-1] == "thickness" for entry in source.assignments)
    if source.is_mesh and not asked and not scene.features().thick:
        say(
            "note: the mesh passes through itself: it is so large or so uneven that its steps "
            "would take far longer; --set meshes[0].thickness=0.01 keeps it from that"
        )


def note_files(scene: Scene) -> None:
    """Say on standard error what was passed over, or joined, as a scene's files were read."""
    for note in scene.notes:
        say(f"note: {note}")


def note_parted(scene: Scene) -> None:
    """Say on standard error where cloth lies on cloth without being joined to it, as at seams that
    a program parted for its textures: it would come apart there.
    """
    pairs = parted(scene.particles.position, scene.triangles, scene.springs.between)
    if len(pairs):
        first, other = pairs[0]
        lie = "lies" if len(pairs) == 1 else "lie"
        such = "" if len(pairs) == 1 else "the first is "
        say(
            f"note: {counted(len(pairs), 'particle')} of surfaces {lie} exactly where another one "
            f"does, and nothing joins the two: {such}{other}, on {first}; where that is no seam "
            "that is to open, say weld = 1e-6 in [[meshes]], or merge vertices by distance"
        )


def note_reset(recordings: Recordings, view: View) -> None:
    """Say what going back to the start does to what is saved, where a user may do so."""
    if recordings and view.visible:
        words = " and ".join(recordings.by_flag())
        begin = "begin" if len(recordings.by_flag()) > 1 else "begins"
        print(f"r goes back to the start, and {words} {begin} anew there", flush=True)


def _first_line(sim: Simulation, device: Device, view: View) -> str:
    """Scene, method, dt, substeps, device, execution path and view."""
    particles, springs = (
        counted(sim.particle_count, "particle"),
        counted(sim.spring_count, "spring"),
    )
    width, height = view.size
    window = f"window {view.name} {width}x{height}" if view.visible else "headless"
    return (
        f"{printable(sim.scene.name)}: {particles}, {springs}; "
        f"{sim.method}, dt {sim.dt:g}, {counted(sim.substeps, 'substep')}; "
        f"{device.describe()}, {sim.way}; {window}"
    )


def last_line(sim: Simulation, way: str, summary: Summary, seconds: float, waited: float) -> str:
    """Frames, time a frame, steps a second, and the execution path, with that of the start.

    way: that of the start. waited: seconds of the frames in which it waited for the error meter,
    or for a run beside it.
    """
    frames = summary.frames
    if not frames:
        return f"0 frames in {seconds:.2f} s"
    done = f"{frames} frame{'s' * (frames > 1)} in {seconds:.2f} s"
    if frames == 1:
        return done
    a_frame = (summary.simulate - waited) / (frames - 1)
    return (
        f"{done}: {milliseconds(a_frame)} ms a frame to simulate after the first, "
        f"{sim.substeps / a_frame:.4g} steps/s, "
        f"{sim.way if way == sim.way else f'{way} first, then {sim.way}'}"
    )


def _too_wide(scene: Scene) -> str:
    """A note on a particle that no place in the world has room for; "": there is none."""
    side, radius = min(scene.world.size), scene.particles.radius
    wide = numpy.flatnonzero(2.0 * radius > side)
    if not len(wide):
        return ""
    return (
        f"particle {wide[0]} has a radius of {radius[wide[0]]:g}, in a world of {side:g}; a scene "
        "file says it by radius in [particle], which is 5 where it does not"
    )


def note_wide(scene: Scene) -> None:
    """Say on standard error that particles are wider than the world, which nobody would want."""
    words = _too_wide(scene)
    if words:
        say(f"note: {words}")


def note_rounded(sim: Simulation, options: RunOptions) -> None:
    """Say on standard error where obstacles that are meshes end in tips or edges that are rounded
    off.
    """
    for solid in sim.storage.solids if not options.quiet else ():
        placed, (centre, turn) = solid.placed, solid.pose(0.0)

        def where(local: numpy.ndarray, centre: Any = centre, turn: Any = turn) -> str:
            return ", ".join(f"{number:.4g}" for number in centre + turn @ local)

        if placed.rounded:
            local, off = placed.rounded
            say(
                f"note: {solid.name} tapers off, and is rounded there, most at ({where(local)}), "
                f"by {off:.2g}; a smaller cell keeps more"
            )


def note_inside(sim: Simulation, options: RunOptions) -> None:
    """Say on standard error which particles begin inside an obstacle, from which they are pushed.

    Raises InputError where one has no place outside.
    """
    inside = sim.inside_at_start()
    if len(inside.stuck):
        first = int(inside.stuck[0])
        name = inside.solid[int(numpy.searchsorted(inside.particles, first))]
        words = _too_wide(sim.scene)
        if words:
            raise InputError(f"particle {first} begins inside {name}: {words}")
        raise InputError(
            f"particle {first} begins inside {name}, and what is around leaves it no room; "
            "move it, or make it fixed"
        )
    if len(inside.particles) and not options.quiet:
        count = len(inside.particles)
        say(
            f"note: {counted(count, 'particle')} begin{'s' * (count == 1)} inside an obstacle and "
            f"{'is' if count == 1 else 'are'} pushed out in the first step; the first is particle "
            f"{inside.particles[0]}, in {inside.solid[0]}"
        )
    through = sim.through_at_start()
    if through and not options.quiet:
        say(
            f"note: {counted(through, 'face')} or edge{'s' * (through > 1)} of a cloth "
            f"{'begins' if through == 1 else 'begin'} through an obstacle, which keeps out "
            "their particles alone; let the cloth begin outside of it"
        )


def check_converged(sim: Simulation, options: RunOptions) -> None:
    """Say on standard error how many steps' solutions missed their tolerance.

    Raises RunFailure where most of them did, unless the user accepts that.
    """
    if options.unconverged == "fail":
        try:
            sim.check_converged()
        except RunFailure as failure:
            raise RunFailure(f"{failure}, or accept it: --unconverged accept") from None
    if sim.work().unconverged and not options.quiet:
        say(f"note: {sim.describe_convergence()}")


def note_held_up(sim: Simulation) -> None:
    """Say on standard error that several threads were asked for, and only waited."""
    if sim.held_up:
        alone, together = (milliseconds(seconds) for seconds in sim.held_up)
        say(
            f"note: another program wants the cores: a frame took {together} ms on all "
            f"threads, where one would take about {alone} ms; --execution parallel keeps "
            "them, without it the run gives way"
        )


def note_refused(refused: Refused) -> None:
    """Say on standard error what of a log could not be done. That is no error: a window's log has
    what was refused there, too.
    """
    if refused.count:
        were = "was" if refused.count == 1 else "were"
        first = "" if refused.count == 1 else "the first, "
        say(
            f"note: {counted(refused.count, 'event')} of the log {were} refused: "
            f"{first}{refused.first}"
        )


def note_unreplayed(log: Log, frames: int) -> None:
    """Say on standard error that a replay that was not told its frames ended before its log."""
    if log.last_frame >= frames:
        say(
            f"note: the log goes on beyond these {counted(frames, 'frame')}; "
            f"--frames {log.last_frame + 1} makes all that it has"
        )


def note_empty(recordings: Recordings, every: int) -> None:
    """Say on standard error that what is saved has no frame, as the run ended before the first."""
    if recordings and recordings.frames == 0:
        kept = f"the first that --every {every} keeps; give a smaller one, or more --frames"
        say(
            "note: nothing is saved of this run's frames: it ended before "
            f"{kept if every > 1 else 'the first'}"
        )


def note_left_out(recordings: Recordings) -> None:
    """Say on standard error that an export lacks particles, which came after its first frame."""
    left_out = recordings.export.left_out if recordings.export else 0
    if left_out:
        say(
            "note: the export has the particles of its first frame; left out: "
            f"{counted(left_out, 'particle')} that came later"
        )


def note_unsettled(sim: Simulation) -> None:
    """Say on standard error in how many steps faces were left in obstacles and resting pairs
    overlapping, and whether triangles might intersect at the end.
    """
    thick = sim.scene.features().thick
    part, near = "a tenth" if thick else "a hundredth", sim.uncertified()
    if sim.unsettled_faces():
        say(
            f"note: {sim.unsettled_faces()} of {sim.steps} steps ended with faces or edges of a "
            "cloth inside an obstacle; use more --substeps"
        )
    if sim.unsettled():
        say(
            f"note: {sim.unsettled()} of {sim.steps} steps ended with pairs that overlap by more "
            f"than {part} of their reach; use more --substeps"
        )
    if near:
        say(
            f"note: {counted(near, 'pair')} of particles ended so near that triangles of cloth "
            f"might intersect: {'they began so near, ' if sim.unguarded() else ''}they are "
            "stretched, or the steps are too long"
        )


def note_differences(recorded: Mapping[str, Any], present: Mapping[str, Any]) -> None:
    """Say on standard error where a replay's settings are not those of the recording."""
    notes = [
        f"{key} {present[key]} (recorded: {recorded[key]})"
        for key in LOGGED
        if key in recorded and key in present and recorded[key] != present[key]
    ]
    words = [shlex.join(header.get("arguments", ())) for header in (present, recorded)]
    if words[0] != words[1] and present.get("scene") == recorded.get("scene"):
        notes.append(f"{words[0] or 'no parameters'} (recorded: {words[1] or 'none'})")
    if notes:
        say(f"note: replaying with {', '.join(notes)}")
