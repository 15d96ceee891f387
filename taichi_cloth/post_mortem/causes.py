"""Why a run failed: a function of what its trace says, each cause with the number that proves it.

Numerics are told from physics by the account of energy: what a run has of motion and springs came
from its start, from work and from what was done to it, or from nothing, which no law allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taichi_cloth.kernels import methods
from taichi_cloth.limits.auto_step import MOST, substeps_needed
from taichi_cloth.limits.bounds import any_geometry, gershgorin, step_within
from taichi_cloth.limits.modes import growth
from taichi_cloth.limits.precision import WATCHED
from taichi_cloth.post_mortem.trace import Sample, Trace
from taichi_cloth.scene.model import Particles
from taichi_cloth.simulation.strain import lengths, strains

# What a cause is called.
STEP, DAMPING, AIR, NEVER, SOLVER, RANGE = "step", "damping", "air", "method", "solver", "range"
SPEED, PUSH, ENERGY, CONTACT = "speed", "push", "energy", "contact"
TEARING, BUCKLING, NOTHING, UNKNOWN = "tearing", "buckling", "nothing", "unknown"
# Those of which a scene is the cause, or who acted on it, and no step and no method.
PHYSICS = frozenset((SPEED, PUSH, ENERGY, TEARING, BUCKLING, NOTHING))

FROM_NOTHING = 0.5  # of the energy of motion and springs: above it the numerics made the most
GREW = 4.0  # times: what has grown
DRIFTS = 0.05  # of it: a run that did not fail is suspect
SQUEEZED = 0.02  # of their length, by which springs are short that buckle


@dataclass(frozen=True)
class Cause:
    """Why a run failed, or what it did.

    kind: one of the words above. says: a sentence. proof: the numbers. spring, particle: where, -1:
    nowhere. sample: the first that shows it, -1: none does.
    """

    kind: str
    says: str
    proof: str
    spring: int = -1
    particle: int = -1
    sample: int = -1

    @property
    def numerical(self) -> bool:
        """Whether it is the numerics' doing, and another setting would not have it."""
        return self.kind not in PHYSICS and self.kind != UNKNOWN


def cause_of(trace: Trace) -> Cause:
    """The cause, or what there is to say of a run that goes on."""
    with np.errstate(all="ignore"):
        if trace.failure is None:
            return _of_running(trace)
        for look in (_range, _speed, _push, _energy, _solver, _limit, _contact, _gravity):
            found = look(trace)
            if found is not None:
                return found
    return Cause(UNKNOWN, "no cause was found", f"the run says: {trace.failure.what}")


def grown(trace: Trace) -> int:
    """The first sample whose energy came from nothing for the most part; -1: there is none.

    What a small drift gathers in a long rest does not count: it is to have grown.
    """
    least = GREW * trace.samples[0].moving
    for k, sample in enumerate(trace.samples):
        if not math.isfinite(sample.moving):
            return k
        if sample.moving > least and sample.drift > FROM_NOTHING * sample.moving:
            return k
    return -1


def beyond(trace: Trace) -> int:
    """The first sample whose step is longer than the stable one; -1: there is none."""
    return next((k for k, s in enumerate(trace.samples) if not s.used <= 1 + 1e-9), -1)


# --- one after the other: what no step changes first -----------------------------------------


def _range(trace: Trace) -> Cause | None:
    """Numbers that nothing here can compute with, or only steps of which nobody has the time."""
    network, precision = trace.before, trace.precision
    real = np.float64 if precision == "f64" else np.float32
    springs, most = network.springs, float(np.finfo(real).max)
    if not len(springs):
        return None
    inverse = _inverse_masses(trace, springs.between)
    rate = springs.stiffness * inverse.sum(axis=1)
    at = int(rate.argmax())
    if springs.stiffness[at] == 0:
        return None
    spring = _spring(trace, int(network.number[at]))
    if not rate[at] * max(1.0, float(springs.rest_length[at])) < most:
        return Cause(
            RANGE,
            f"what {spring} does to its particles is no number in {precision}",
            f"stiffness times inverse masses is {rate[at]:.3g}; the largest number of {precision} "
            f"is {most:.2g}",
            spring=int(network.number[at]),
        )
    method = methods.load(trace.settings.method)
    limit = step_within(method, gershgorin(network))
    limited = limit if 0 < limit < math.inf else 2.0 / math.sqrt(rate[at])
    if substeps_needed(trace.settings.dt, limited) <= MOST:
        return None
    h_omega = trace.settings.dt / trace.settings.substeps * math.sqrt(rate[at])
    return Cause(
        RANGE,
        f"{spring} is far too stiff for frames of {trace.settings.dt:g}, whatever the steps",
        f"h omega = {h_omega:.3g}; a frame would take "
        f"{substeps_needed(trace.settings.dt, limited):.2g} stable steps, and may have {MOST:.0e}",
        spring=int(network.number[at]),
    )


def _speed(trace: Trace) -> Cause | None:
    """A particle that was too fast before any force had acted on it."""
    limit = min(trace.speed_limit, math.sqrt(WATCHED))
    begin = 0 if trace.whole else None
    first = _of_failed_frame(trace)
    for k in (begin, first):
        if k is None or trace.samples[k].speed <= limit * (1 - 1e-6):
            continue
        sample = trace.samples[k]
        if grown(trace) not in (-1, k) and k != 0:
            continue
        # What the drift before this frame gave is no speed that somebody set.
        if k != 0 and (not trace.acts or trace.acts[-1].frame != sample.frame):
            continue
        who = _by_whom(trace, sample) if k else "the scene"
        most = f"the {trace.speed_limit:.3g} at which it would cross the world 100 times in a frame"
        if limit < trace.speed_limit:
            most = f"{limit:.2g}, above which no square of a speed is a number that is watched"
        return Cause(
            SPEED,
            f"{who} gives particle {sample.fastest} a speed at which it is lost at once",
            f"its speed is {sample.speed:.4g} before any step: more than {most}",
            particle=sample.fastest,
            sample=k,
        )
    # Fast by one step that nobody had a chance to limit: within a part in ten of the limit.
    return None


def _push(trace: Trace) -> Cause | None:
    """A force from outside that is enough for such a speed within a frame."""
    free = ~trace.last.particles.fixed
    dt = trace.settings.dt
    limit = min(trace.speed_limit, math.sqrt(WATCHED))
    if trace.push is not None and free.any():
        gained = np.linalg.norm(trace.push, axis=1) / trace.last.particles.mass * dt
        at = int(np.where(free, gained, 0.0).argmax())
        if not gained[at] < limit:
            sample = trace.samples[_of_failed_frame(trace) or -1]
            return Cause(
                PUSH,
                f"the force by which {_by_whom(trace, sample)} pushes particle {at} is too large",
                f"it gives the particle a speed of {gained[at]:.3g} within a frame; at "
                f"{limit:.3g} it is lost",
                particle=at,
            )
    return None


def _gravity(trace: Trace) -> Cause | None:
    """Gravity that is enough for such a speed within a frame, where nothing holds against it."""
    gravity = float(np.linalg.norm(trace.last.world.gravity)) * trace.settings.dt
    limit = min(trace.speed_limit, math.sqrt(WATCHED))
    if trace.last.particles.fixed.all() or gravity < limit:
        return None
    return Cause(
        PUSH,
        "gravity alone makes particles too fast within a frame",
        f"it gives a speed of {gravity:.3g} within a frame; at {limit:.3g} particles are lost",
    )


def _energy(trace: Trace) -> Cause | None:
    """Energy that is there from the start, or was given by hand, and is enough for the speed."""
    first = _of_failed_frame(trace)
    samples = trace.samples
    sample = samples[first if first is not None else -1]
    onset = grown(trace)
    if 0 <= onset < (first or 0):
        return None
    mass = trace.last.particles.mass[~trace.last.particles.fixed]
    if not len(mass) or not math.isfinite(sample.moving):
        return None
    springs = trace.last.springs
    if not len(springs):
        return None
    # The energy that the springs of one particle can give it alone.
    length = lengths(trace.last.position, springs.between)
    stored = 0.5 * springs.stiffness * (length - springs.rest_length) ** 2
    ends = springs.between
    own = np.bincount(ends.ravel(), np.repeat(stored, 2), len(trace.last.particles))
    speed = np.sqrt(2.0 * own / trace.last.particles.mass)
    speed[trace.last.particles.fixed] = 0.0
    at, limit = int(speed.argmax()), min(trace.speed_limit, math.sqrt(WATCHED))
    if not speed[at] > limit:
        return None
    mine = np.flatnonzero((ends == at).any(axis=1))
    worst = mine[int(stored[mine].argmax())]
    by = "the scene"
    if sample.by_hand > 0.5 * sample.moving or not trace.whole or sample.frame > 0:
        by = _by_whom(trace, sample)
    strain = strains(length, springs)[worst]
    number = int(trace.last.number[worst])
    return Cause(
        ENERGY,
        f"{by} stretches {_spring(trace, number)} so far that letting go makes particle {at} too "
        "fast, however small the steps",
        f"it is {100 * strain:.3g} % longer than at rest; its energy of {stored[worst]:.3g} gives "
        f"a speed of {speed[at]:.3g}, and at {limit:.3g} a particle is lost",
        spring=number,
        particle=at,
    )


def _solver(trace: Trace) -> Cause | None:
    """A method that solves equations, and did not get to the solution, or to one that holds."""
    claims = methods.load(trace.settings.method).claims
    if not math.isinf(claims.stability_limit):
        return None
    first = trace.samples[0]
    h_omega = trace.h * math.sqrt(max(gershgorin(trace.before).omega2, 0.0))
    reach = f"a step has h omega = {max(h_omega, first.reach):.3g}"
    sweeps = trace.settings.solver.get("iterations")
    if sweeps is not None and h_omega > 1:
        return Cause(
            SOLVER,
            f"the {sweeps:g} sweeps of {trace.settings.method} are too few for so long a step: "
            "what they leave of each step's equations adds up",
            f"{reach}: a pull would have to go about {h_omega:.3g} springs far within it",
        )
    if trace.unconverged:
        return Cause(
            SOLVER,
            f"the equations of {trace.settings.method}'s steps were not solved",
            f"{trace.unconverged} of {trace.steps} steps missed their tolerance (the last one: "
            f"{trace.outcome}); {reach}",
        )
    if h_omega > 1 and grown(trace) >= 0:
        return Cause(
            SOLVER,
            f"steps of {trace.settings.method} are solved, but far too long for springs that turn",
            f"{reach}, and {_part_from_nothing(trace)}",
        )
    return None


def _limit(trace: Trace) -> Cause | None:
    """A step beyond what is stable, by what most of the limit is made of."""
    k = beyond(trace)
    if k < 0:
        return None
    onset = grown(trace)
    if 0 <= onset < k and any_geometry_holds(trace):
        return None  # it is how the springs flew apart that made the limit shorter
    sample = trace.samples[k]
    method, limit = methods.load(trace.settings.method), sample.limit
    when = "from the start" if k == 0 and trace.whole else f"from frame {sample.frame} on"
    since = ""
    if k > 0 and any(
        act.frame == sample.frame or act.frame + 1 == sample.frame for act in trace.acts
    ):
        since = f", since {_by_whom(trace, sample)}"
    shares = sample.shares
    damped = shares is not None and 2 * trace.h * shares.d > trace.h**2 * shares.omega2
    # What explicit Euler makes grow at every step grows slowly beside a damping beyond its limit.
    if limit.dt == 0 and not (damped and shares and trace.h * shares.d > 2):
        return Cause(
            NEVER,
            f"{trace.settings.method} is unstable on undamped springs at every step",
            f"h omega = {sample.reach:.3g}, and no step is stable: each multiplies a vibration by "
            f"{_growth(trace, sample):.6g}",
            spring=limit.spring,
            particle=limit.particle,
            sample=k,
        )
    what = limit.describe()
    kind, says = STEP, f"the step is too long for {_spring(trace, limit.spring)}"
    proof = (
        f"h omega = {sample.reach:.4g} > {method.claims.stability_limit:.3g} "
        f"{when}{since}; the longest stable step is {limit.dt:.3g}, and it is {trace.h:.3g}"
    )
    if limit.spring < 0:
        says = f"the step is too long for {what}"
    if damped and shares is not None:
        along = float(shares.damping.sum())
        kind = AIR if shares.air >= max(along, shares.drag) else DAMPING
        damps = {
            AIR: f"the air at the triangles around particle {limit.particle}",
            DAMPING: f"the dashpot of {_spring(trace, limit.spring)}",
        }[kind]
        if kind == DAMPING and shares.drag > along:
            damps = f"the drag on particle {limit.particle}"
        says = f"the step is too long for {damps}"
        proof = (
            f"h d = {trace.h * shares.d:.4g} beside h omega = {sample.reach:.3g} {when}{since}: "
            f"{trace.settings.method} then is stable up to a step of {limit.dt:.3g}, and it is "
            f"{trace.h:.3g}"
        )
    return Cause(kind, says, proof, limit.spring, limit.particle, k)


def _contact(trace: Trace) -> Cause | None:
    """Energy from nothing, or a particle that got past a wall, where things can touch."""
    world = trace.last.world
    touches = trace.depth is not None or bool(world.walls) or world.collisions
    if not touches:
        return None
    onset = grown(trace)
    what = trace.failure.what if trace.failure else ""
    deep = f"; the deepest penetration is {trace.depth:.3g}" if trace.depth else ""
    if onset >= 0:
        sample = trace.samples[onset]
        return Cause(
            CONTACT,
            "contacts gave energy from nothing: what overlaps is pushed apart too far in a step",
            f"at frame {sample.frame} {_part_from_nothing(trace)}, with steps within the springs' "
            f"limit (h omega = {sample.reach:.3g}){deep}",
            particle=sample.fastest,
            sample=onset,
        )
    return Cause(
        CONTACT,
        "a particle went past what should hold it within one step",
        f"the run says: {what}{deep}",
        particle=trace.failure.particle if trace.failure else -1,
    )


# --- of a run that goes on -------------------------------------------------------------------


def _of_running(trace: Trace) -> Cause:
    """What a run did that has not failed: numerics that are about to, or physics."""
    unsolved = _solver(trace) if 2 * trace.unconverged > trace.steps else None
    if unsolved is not None:
        return unsolved
    k, last = beyond(trace), trace.samples[-1]
    if k >= 0 and _from_nothing(trace, last) > DRIFTS:
        found = _limit(trace)
        if found is not None:
            return found
    broke = last.broken - trace.samples[0].broken
    sound = (
        f"steps are within the limit (h omega = {last.reach:.3g}, {100 * last.used:.3g} % of the "
        f"stable step)"
    )
    if k >= 0:
        sound = f"h omega is {last.reach:.3g}, and no energy came from nothing"
    if broke > 0:
        return Cause(
            TEARING, f"{broke} springs broke: that is the scene's load, not the step", sound
        )
    springs = trace.last.springs
    strained = strains(lengths(trace.last.position, springs.between), springs)
    squeezed = int((strained < -SQUEEZED).sum())
    if squeezed:
        at = int(strained.argmin())
        return Cause(
            BUCKLING,
            f"{squeezed} springs are squeezed and give way sideways: that they buckle is the "
            "scene's doing, not the step's",
            f"{_spring(trace, int(trace.last.number[at]))} is {-100 * strained[at]:.3g} % shorter "
            f"than at rest; {sound}",
            spring=int(trace.last.number[at]),
        )
    return Cause(NOTHING, "nothing went wrong", sound)


# --- words -----------------------------------------------------------------------------------


def _of_failed_frame(trace: Trace) -> int | None:
    """The sample at the beginning of the frame that failed, with what was done before it."""
    return next((k for k, s in enumerate(trace.samples) if s.part > 0), None)


def _part_from_nothing(trace: Trace, sample: Sample | None = None) -> str:
    sample = sample or trace.samples[max(grown(trace), 0)]
    if not math.isfinite(sample.moving):
        return "its energy is no number any more"
    return f"{100 * _from_nothing(trace, sample):.2g} % of the energy that moved came from nothing"


def _from_nothing(trace: Trace, sample: Sample) -> float:
    """What of the energy that moved until a sample came from nothing, as a part."""
    until = trace.samples[: trace.samples.index(sample) + 1]
    moved = max(s.moving for s in until) + abs(sample.work) + abs(sample.by_hand)
    return max(sample.drift, 0.0) / moved if moved > 0 else 0.0


def _growth(trace: Trace, sample: Sample) -> float:
    method = methods.load(trace.settings.method)
    return growth(method, trace.h, sample.limit.omega2, sample.limit.damping)


def any_geometry_holds(trace: Trace) -> bool:
    """Whether the step is stable however the springs turn, by where the trace begins."""
    method = methods.load(trace.settings.method)
    return trace.h <= step_within(method, any_geometry(trace.before))


NAMES: dict[str, str] = {"push": "a blow", "hold": "a held force", "set": "`set`"}


def _by_whom(trace: Trace, sample: Sample) -> str:
    """Who did something last, until a sample."""
    done = [act for act in trace.acts if act.frame <= sample.frame]
    if not done:
        return "the scene"
    name = done[-1].name
    return f"{NAMES.get(name, f'`{name}`')} at frame {done[-1].frame}"


def _inverse_masses(trace: Trace, ends: np.ndarray) -> np.ndarray:
    return _inverse_masses_of(trace.before.particles, ends)


def _spring(trace: Trace, number: int) -> str:
    """A spring with the numbers that make it fast: "spring 17 (stiffness 1e6, ...)"."""
    for network in (trace.last, trace.before):
        at = np.flatnonzero(network.number == number)
        if number >= 0 and len(at):
            springs = network.springs
            inverse = _inverse_masses_of(network.particles, springs.between[at[0]])
            of = " and ".join(f"{w:.3g}" for w in dict.fromkeys(inverse))
            stiffness = f"stiffness {springs.stiffness[at[0]]:.3g}"
            return f"spring {number} ({stiffness}, inverse mass {of})"
    return "what is bent or dragged"


def _inverse_masses_of(particles: Particles, ends: np.ndarray) -> np.ndarray:
    fixed, mass = particles.fixed[ends], particles.mass[ends]
    inverse: np.ndarray = np.where(fixed, 0.0, 1.0 / mass)
    return inverse
