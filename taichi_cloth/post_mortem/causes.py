"""Why a run failed: a function of what its trace says, each cause with the number that proves it.

Numerics are told from physics by the account of energy: what a run has of motion and springs came
from its start, from work and from what was done to it, or from nothing, which no law allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from taichi_cloth.kernels import methods
from taichi_cloth.limits.auto_step import MOST, substeps_needed
from taichi_cloth.limits.bounds import gershgorin, step_within
from taichi_cloth.limits.eigenmodes import Limit
from taichi_cloth.limits.modes import largest_step
from taichi_cloth.limits.network import Network
from taichi_cloth.limits.precision import WATCHED
from taichi_cloth.post_mortem.done import PULLING, PUSHING, THROWING
from taichi_cloth.post_mortem.onset import (
    any_geometry_holds,
    beyond,
    from_nothing,
    grown,
    growth_of,
    has_grown,
    of_failed_frame,
    part_from_nothing,
    too_long,
)
from taichi_cloth.post_mortem.sample import Sample
from taichi_cloth.post_mortem.trace import Trace, inverse_masses
from taichi_cloth.post_mortem.wording import (
    air_at,
    apart,
    by_whom,
    counted,
    since,
    spring_named,
    spring_of,
)
from taichi_cloth.simulation.strain import lengths, strains

# What a cause is called.
STEP, DAMPING, AIR, NEVER, SOLVER, RANGE = "step", "damping", "air", "method", "solver", "range"
SPEED, MOTION, PUSH, ENERGY, CONTACT = "speed", "motion", "push", "energy", "contact"
TEARING, BUCKLING, NOTHING, UNKNOWN = "tearing", "buckling", "nothing", "unknown"
DAMPINGS = frozenset((DAMPING, AIR))
# Those of which a scene is the cause, or who acted on it, and no step and no method.
PHYSICS = frozenset((SPEED, MOTION, PUSH, ENERGY, TEARING, BUCKLING, NOTHING))

DRIFTS = 0.05  # of it: a run that did not fail is suspect
FAR = 1.0  # of its length: a strain that no cloth bears
SQUEEZED = 0.02  # of their length, by which springs are short that buckle
USUAL = "symplectic_euler"  # the method beside which one without a limit of its own is judged


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
        """True if it is the numerics' doing, and another setting would not have it."""
        return self.kind not in PHYSICS and self.kind != UNKNOWN


def cause_of(trace: Trace) -> Cause:
    """The cause, or what there is to say of a run that goes on."""
    with np.errstate(all="ignore"):
        if trace.failure is None:
            return _of_running(trace)
        for look in (_range, _speed, _motion, _push, _energy, _solver, _limit, _gravity, _contact):
            found = look(trace)
            if found is not None:
                return found
    return Cause(UNKNOWN, "no cause was found", f"the run says: {trace.failure.what}")


# --- one after the other: what no step changes first -----------------------------------------


def _range(trace: Trace) -> Cause | None:
    """Numbers that nothing here can compute with, or only steps of which nobody has the time."""
    return _range_of(trace, trace.before) or _range_of(trace, trace.last)


def _range_of(trace: Trace, network: Network) -> Cause | None:
    precision = trace.precision
    real = np.float64 if precision == "f64" else np.float32
    springs, most = network.springs, float(np.finfo(real).max)
    if not len(springs):
        return None
    inverse = inverse_masses(network.particles, springs.between)
    rate = springs.stiffness * inverse.sum(axis=1)
    at = int(rate.argmax())
    if springs.stiffness[at] == 0:
        return None
    spring = spring_named(trace, int(network.number[at]))
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
    first = of_failed_frame(trace)
    for k in (begin, first):
        if k is None or trace.samples[k].speed <= limit * (1 - 1e-6):
            continue
        sample = trace.samples[k]
        if grown(trace) not in (-1, k) and k != 0:
            continue
        # What the drift before this frame gave is no speed that somebody set.
        if k != 0 and (not trace.acts or trace.acts[-1].frame != sample.frame):
            continue
        who = by_whom(trace, sample, THROWING) if k else "the scene"
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


def _motion(trace: Trace) -> Cause | None:
    """An obstacle that moves so fast that what it meets, or what it carries, is lost with it."""
    limit = min(trace.speed_limit, math.sqrt(WATCHED))
    name, particle, speed = trace.met
    if not speed > limit:
        return None
    return Cause(
        MOTION,
        f"{name} moves too fast for particle {particle}, which it meets or carries along",
        f"it goes at {speed:.4g} there; at {limit:.3g} a particle is lost",
        particle=particle,
    )


def _push(trace: Trace) -> Cause | None:
    """A force from outside that is enough for such a speed within a frame."""
    free = ~trace.last.particles.fixed
    dt = trace.settings.dt
    limit = min(trace.speed_limit, math.sqrt(WATCHED))
    if trace.push is not None and free.any():
        gained = np.linalg.norm(trace.push, axis=1) / trace.last.particles.mass * dt
        at = int(np.where(free, gained, 0.0).argmax())
        if not gained[at] < limit:
            sample = trace.samples[of_failed_frame(trace) or -1]
            who = by_whom(trace, sample, PUSHING)
            return Cause(
                PUSH,
                f"the force by which {who} pushes particle {at} is too large",
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
    done = [act for act in trace.acts if "gravity" in act.given]
    since = f", since {done[-1].words} at frame {done[-1].frame}" if done else ""
    return Cause(
        PUSH,
        "gravity alone makes particles too fast within a frame",
        f"it gives a speed of {gravity:.3g} within a frame{since}; at {limit:.3g} particles are "
        "lost",
    )


def _energy(trace: Trace) -> Cause | None:
    """Energy that is there from the start, or was given by hand, and is enough for the speed."""
    first = of_failed_frame(trace)
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
        by = by_whom(trace, sample, PULLING)
    strain = strains(length, springs)[worst]
    number = int(trace.last.number[worst])
    does, than = ("stretches", "longer") if strain > 0 else ("squeezes", "shorter")
    return Cause(
        ENERGY,
        f"{by} {does} {spring_named(trace, number)} so far that letting go makes particle {at} "
        "too fast, however small the steps",
        f"it is {100 * abs(strain):.3g} % {than} than at rest; its energy of {stored[worst]:.3g} "
        f"gives a speed of {speed[at]:.3g}, and at {limit:.3g} a particle is lost",
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
            f"{counted(int(sweeps), 'sweep', 'sweeps')} of {trace.settings.method} a step is too "
            "little for so long a step: what is left of its equations adds up",
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
            f"{reach}, and {part_from_nothing(trace)}",
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
    when = f"from frame {sample.frame + (sample.part > 0)} on"
    if k == 0:
        when = "from the start" if trace.whole else f"at frame {sample.frame} already"
    return _too_long(trace, sample, when + (since(trace, sample) if k > 0 else ""), k)


def _too_long(trace: Trace, sample: Sample, when: str, k: int) -> Cause:
    """The excess of a step beyond its limit. k: number of the sample, or -1."""
    limit, shares, h = sample.limit, sample.shares, sample.h
    damped = shares is not None and 2 * h * shares.d > h**2 * shares.omega2
    # What explicit Euler makes grow at every step grows slowly beside a damping beyond its limit.
    if limit.dt == 0 and not (damped and shares and h * shares.d > 2):
        return Cause(
            NEVER,
            f"{sample.method} is unstable on undamped springs at every step",
            f"h omega = {sample.reach:.3g} {when}, and no step is stable: each multiplies a "
            f"vibration by {growth_of(sample):.9g}",
            spring=limit.spring,
            particle=limit.particle,
            sample=k,
        )
    own = methods.load(sample.method).claims.stability_limit
    if own == 0 and not damped and h <= _usual(limit):
        return Cause(
            NEVER,
            f"{sample.method} makes springs vibrate more in each step, but for what damping takes",
            f"h omega = {sample.reach:.4g}, which {USUAL} bears, {when}; {sample.method} bears a "
            f"step of {limit.dt:.3g} by damping alone, and it is {h:.3g}",
            spring=limit.spring,
            particle=limit.particle,
            sample=k,
        )
    longest, own_step = apart(limit.dt, h)
    stable = f"the longest stable step is {longest}, and it is {own_step}"
    if damped and shares is not None:
        kind, what = _damper(sample)
        beside = f" beside h omega = {sample.reach:.3g}" if shares.omega2 > 0 else ""
        proof = (
            f"h d = {h * shares.d:.4g}{beside} {when}: {sample.method} then is stable up to a step "
            f"of {longest}, and it is {own_step}"
        )
        return Cause(
            kind, f"the step is too long for {what}", proof, limit.spring, limit.particle, k
        )
    reach, at_most = apart(sample.reach, own)
    beyond_it = f" > {at_most}" if own > 0 else f", which {sample.method} bears with damping alone"
    return Cause(
        STEP,
        f"the step is too long for {spring_of(sample)}",
        f"h omega = {reach}{beyond_it} {when}; {stable}",
        limit.spring,
        limit.particle,
        k,
    )


def _usual(limit: Limit) -> float:
    """The longest step that the usual method has for what sets a limit."""
    return largest_step(methods.load(USUAL), limit.omega2, limit.damping)


def _damper(sample: Sample) -> tuple[str, str]:
    """The strongest damping of the mode beyond its limit: the kind of cause, and in words."""
    shares, limit = sample.shares, sample.limit
    assert shares is not None
    along = float(shares.damping.sum())
    if shares.air >= max(along, shares.drag):
        return AIR, air_at(limit.particle)
    if shares.drag > along:
        return DAMPING, f"the drag on particle {limit.particle}"
    return DAMPING, f"the dashpot of {spring_of(sample)}"


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
            f"at frame {sample.frame} {part_from_nothing(trace)}, with steps within the springs' "
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
    """The findings on a run that has not failed: numerics that are about to, or physics."""
    unsolved = _solver(trace) if 2 * trace.unconverged > trace.steps else None
    if unsolved is not None:
        return unsolved
    k, last = beyond(trace), trace.samples[-1]
    if k >= 0 and (from_nothing(trace, last) > DRIFTS or has_grown(trace)):
        found = _limit(trace)
        if found is not None:
            return found
    sound = (
        f"steps are within the limit (h omega = {last.reach:.3g}, {100 * last.used:.3g} % of the "
        f"stable step)"
    )
    if last.limit.dt == math.inf:
        sound = f"no step of {last.method} is too long here (h omega = {last.reach:.3g})"
    if k >= 0:
        most = max(trace.samples, key=lambda s: s.used)
        sound = (
            f"steps were too long at frame {most.frame} (h omega = {most.reach:.4g}), "
            "and no energy came from nothing"
        )
    if trace.torn.count:
        return _torn(trace, sound)
    # What grows from rounding needs many steps to be seen; that it will be is known before.
    found = _limit(trace) if k >= 0 and too_long(last) else None
    if found is not None and found.kind == NEVER:
        return found
    if found is not None:
        by = f"; each step multiplies it by {growth_of(last):.6g}, which has not become energy yet"
        return replace(found, proof=found.proof + by)
    springs = trace.last.springs
    strained = strains(lengths(trace.last.position, springs.between), springs)
    squeezed = int((strained < -SQUEEZED).sum())
    if squeezed:
        at = int(strained.argmin())
        return Cause(
            BUCKLING,
            f"{counted(squeezed, 'spring is', 'springs are')} squeezed and give way sideways: that "
            "they buckle is the scene's doing, not the step's",
            f"{spring_named(trace, int(trace.last.number[at]))} is {-100 * strained[at]:.3g} % "
            f"shorter than at rest; {sound}",
            spring=int(trace.last.number[at]),
        )
    most = max(trace.samples, key=lambda s: abs(s.strain))
    says = "nothing went wrong"
    if most.strain > FAR:
        says = (
            f"no step went wrong; spring {most.spring} became {1 + most.strain:.3g} times as long"
        )
    largest = f"the largest strain was {100 * most.strain:.3g} %, of spring {most.spring}"
    return Cause(NOTHING, says, sound + (f"; {largest}" if most.spring >= 0 else ""))


def _torn(trace: Trace, sound: str) -> Cause:
    """Springs broke: most of them since a step was too long, or by the load of the scene."""
    torn = trace.torn
    broke = counted(torn.count, "spring broke", "springs broke")
    first = ""
    if torn.first is not None:
        frame, spring = torn.first
        first = f"spring {spring} broke{' first,' if torn.count > 1 else ''} in frame {frame}; "
    if torn.sample is None or 2 * torn.before > torn.count:
        if torn.sample is not None:
            sound = (
                f"{torn.before} before any step was too long, which it was {torn.since}; {sound}"
            )
        says = f"{broke}: that is the scene's load, not the step"
        return Cause(TEARING, says, first + sound, spring=torn.first[1] if torn.first else -1)
    found = _too_long(trace, torn.sample, torn.since, -1)
    before = f", {torn.before} of them before" if torn.before else ""
    return replace(found, proof=f"{found.proof}; {first}{broke}{before}")
