"""The largest stable step of a state, what sets it, and the smallest step that f32 can follow.

Around a state, particles obey M x'' = -K x - C v: K is the Hessian of the springs' energy, C holds
drag and dashpots. A method is stable while no disturbance of that system grows. What a method makes
of one mode, x'' = -omega^2 x - d v, is its own to say, beside its claims:

- a Runge-Kutta method by its `stability_function(z)`: a mode grows by |R(dt mu)| a step, where mu
  are the eigenvalues of the system itself, mu^2 + d mu + omega^2 = 0 (Hairer, Wanner, Solving
  Ordinary Differential Equations II, IV.2);
- a method that treats position and velocity differently by `amplification(h, omega2, d)`, its
  step as a matrix. Its modes are those of K and C together, which in general have none in
  common. But the matrix is linear in omega^2 and d, so every mode of the whole has a real
  omega^2 = u*Ku / u*Mu and d = u*Cu / u*Mu, and the limit is the least over all u. For symplectic
  Euler that is h^2 omega^2 + 2 h d < 4, for velocity Verlet, which takes drag at a predicted
  velocity, h^2 omega^2 + 4 h d < 4.

Three answers, each costlier and closer than the one before: `gershgorin` (NumPy alone, holds in
every geometry), `any_geometry` (the largest eigenvalue of the springs' Laplacian; holds in every
geometry, as springs turn during a run), and `stable_step` (the state's own geometry).
Eigenvalues are found by Lanczos' method (ARPACK), which takes the same products with K as power
iteration and needs some tens of them where that needs thousands: the largest eigenvalues of a cloth
lie close together.
"""

from __future__ import annotations

import contextlib
import functools
import math
from dataclasses import dataclass

import numpy as np

from taichi_cloth.scene.model import Particles, Scene, Springs

SAFETY = 0.9  # of the limit: what `--dt auto` takes, and remedies propose
# A mode that grows by less than this a step does not: round-off of the computed growth.
ROUND_OFF = 1e-11
DENSE = 400  # degrees of freedom up to which all eigenvalues are computed
MANY = 20_000  # degrees of freedom from which an eigenvalue to a thousandth is enough


@dataclass(frozen=True)
class Network:
    """Particles and the springs that hold, at one moment.

    position: (n, dim); particles: their masses, drag, and which are fixed; springs: those that
    hold; number: (s,) int, what each of these is called.
    """

    position: np.ndarray
    particles: Particles
    springs: Springs
    number: np.ndarray

    @classmethod
    def of(cls, particles: Particles, springs: Springs, position=None, holds=None) -> Network:
        """position: absent, that of `particles`; holds: (s,) bool, absent: all springs."""
        position = particles.position if position is None else position
        number = np.arange(len(springs)) if holds is None else np.flatnonzero(holds)
        return cls(position, particles, springs.select(number), number)

    @classmethod
    def of_scene(cls, scene: Scene) -> Network:
        return cls.of(scene.particles, scene.springs)

    @functools.cached_property
    def geometry(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors along the springs (s, dim), and their transverse shares (s,).

        The Hessian of a spring's energy is k [n n^T + t (I - n n^T)] with t = 1 - rest/length. It
        is taken as 0 where a spring is compressed: that it then buckles is physics, no
        instability of a method. A spring of length 0 counts as stiff in every direction.
        """
        a, b = self.springs.between.T
        d = self.position[b] - self.position[a]
        length = np.linalg.norm(d, axis=1)
        apart = length > 0
        along = d / np.where(apart, length, 1.0)[:, None]
        rest = self.springs.rest_length / np.where(apart, length, 1.0)
        return along, np.where(apart, np.maximum(0.0, 1.0 - rest), 1.0)


@dataclass(frozen=True)
class Bounds:
    """Of all modes: omega2, the largest omega^2, and the particle that sets it; damping and
    least_damping: the largest and least d, and the particle that sets the largest (-1: none).
    """

    omega2: float
    particle: int
    damping: float
    damped: int
    least_damping: float


@dataclass(frozen=True)
class Limit:
    """The largest stable step, and the mode that is the first to grow beyond it.

    dt: inf where every step is stable, 0 where none is. omega2, damping: of that mode. mode,
    velocity: (n, dim), its displacement and velocity at one moment. spring: the number of the
    spring with the largest share of the mode's energy, and that share; -1 where drag alone sets
    the limit. ends: its particles. particle: the one that moves most (-1: none does).
    """

    dt: float
    omega2: float = 0.0
    damping: float = 0.0
    mode: np.ndarray | None = None
    velocity: np.ndarray | None = None
    spring: int = -1
    ends: tuple[int, int] = (-1, -1)
    share: float = 0.0
    particle: int = -1

    def describe(self) -> str:
        """What is responsible, in words."""
        if self.spring >= 0:
            a, b = self.ends
            return f"spring {self.spring}, between particles {a} and {b}"
        return f"the drag on particle {self.particle}" if self.particle >= 0 else "nothing"


# --- one mode --------------------------------------------------------------------------------


def growth(method, h: float, omega2: float, damping: float) -> float:
    """By how much the mode x'' = -omega2 x - damping v grows in a step h, at most.

    method: a module out of `kernels.methods`, with `stability_function` or `amplification`.
    """
    if hasattr(method, "stability_function"):
        root = np.sqrt(complex(damping * damping / 4 - omega2))
        # The smaller root by the product of both: the difference would lose it to round-off.
        fast = -damping / 2 - root
        slow = omega2 / fast if fast else 0.0
        return max(abs(method.stability_function(h * mu)) for mu in (fast, slow))
    return float(np.abs(np.linalg.eigvals(method.amplification(h, omega2, damping))).max())


def largest_step(method, omega2: float, damping: float = 0.0) -> float:
    """The largest h up to which the mode does not grow; inf where none is too large, 0 where all.

    Found by bisection on `growth`; what is unconditionally stable by its claims is not asked.
    """
    if math.isinf(method.CLAIMS.stability_limit) or (omega2 <= 0 and damping <= 0):
        return math.inf
    if not (math.isfinite(omega2) and math.isfinite(damping)):
        return 0.0
    if damping <= 0:
        return method.CLAIMS.stability_limit / math.sqrt(omega2)
    # In units of time in which the faster of the two rates is 1.
    rate = max(math.sqrt(omega2), damping)
    omega2, damping = omega2 / rate**2, damping / rate
    return _largest_multiple(lambda h: growth(method, h, omega2, damping)) / rate


def _largest_multiple(grows) -> float:
    """The largest h up to which grows(h) <= 1, where rates are about 1."""
    low = 4.0
    while grows(low) <= 1 + ROUND_OFF:
        low *= 2
        if low > 2.0**20:
            return math.inf
    while grows(low) > 1 + ROUND_OFF:
        low /= 2
        if low < 2.0**-20:
            return 0.0
    high = 2 * low
    while high - low > 1e-9 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if grows(middle) <= 1 + ROUND_OFF else (low, middle)
    return low


def step_within(method, bounds: Bounds) -> float:
    """A step at which no mode inside `bounds` grows, whatever pairs of omega^2 and d there are."""
    if math.isinf(method.CLAIMS.stability_limit):
        return math.inf
    return min(largest_step(method, omega2, d) for omega2, d in _pairs(bounds))


def grows_within(method, bounds: Bounds, h: float) -> bool:
    """Whether h is above `step_within`, which takes a fiftieth of the time."""
    if math.isinf(method.CLAIMS.stability_limit):
        return False
    return any(growth(method, h, *pair) > 1 + ROUND_OFF for pair in _pairs(bounds) if any(pair))


def _pairs(bounds):
    """Pairs (omega^2, d) on the border of `bounds`, of which the worst is taken for the worst."""
    rates = np.linspace(bounds.least_damping, bounds.damping, 5)
    if bounds.least_damping == bounds.damping:
        rates = rates[:1]
    return [(0.0, bounds.damping), *((bounds.omega2, float(d)) for d in rates)]


# --- bounds that hold in every geometry ------------------------------------------------------


def gershgorin(network: Network) -> Bounds:
    """Gershgorin's bounds: the largest row sums of |M^-1 K| and |M^-1 C|, in every geometry.

    omega^2 <= max_i (1/m_i) (sum of k to all neighbours + sum of k to free neighbours).
    """
    springs = network.springs
    return _row_sums(network, springs.stiffness[:, None], springs.damping[:, None])


def gershgorin_here(network: Network) -> Bounds:
    """The same of the state's own geometry: closer where springs lie along the axes."""
    along, t = network.geometry
    # Row sums of |n n^T|, and of the whole Hessian.
    longitudinal = np.abs(along) * np.abs(along).sum(axis=1, keepdims=True)
    k = network.springs.stiffness[:, None]
    stiff = k * ((1 - t)[:, None] * longitudinal + t[:, None])
    return _row_sums(network, stiff, network.springs.damping[:, None] * longitudinal)


def _row_sums(network, stiff, damped) -> Bounds:
    """Bounds from what springs add to a row of K and of C, each (s, axes)."""
    particles = network.particles
    free, n = ~particles.fixed, len(network.position)
    if not free.any():
        return Bounds(0.0, -1, 0.0, -1, 0.0)
    a, b = network.springs.between.T
    drag = particles.viscous / particles.mass

    def rows(weights):
        sums = np.zeros(n)
        for w in weights.T:
            row = np.bincount(a, w * (1.0 + free[b]), n) + np.bincount(b, w * (1.0 + free[a]), n)
            np.maximum(sums, row / particles.mass, out=sums)
        return np.where(free, sums, 0.0)

    with np.errstate(over="ignore", invalid="ignore"):  # an infinite bound is a true answer
        omega2, damping = rows(stiff), rows(damped) + np.where(free, drag, 0.0)
    stiffest, damped_most = int(omega2.argmax()), int(damping.argmax())
    return Bounds(
        float(omega2[stiffest]),
        stiffest if omega2[stiffest] > 0 else -1,
        float(damping[damped_most]),
        damped_most if damping[damped_most] > 0 else -1,
        float(drag[free].min()),
    )


class AnyGeometry:
    """Bounds that hold however springs turn, followed from state to state.

    Since n n^T + t (I - n n^T) <= I, K is at most the Laplacian of the graph with weights k, one
    number a particle, and C that with weights c plus drag. Their largest eigenvalues are found
    starting from the vectors of the last time.
    """

    def __init__(self):
        self._vectors: list[np.ndarray | None] = [None, None]

    def bounds(self, network: Network) -> Bounds:
        """Bounds of this network."""
        rough = gershgorin(network)
        free = ~network.particles.fixed
        if not free.any() or not math.isfinite(rough.omega2 + rough.damping):
            return rough
        values = []
        for i, (weights, drag) in enumerate(_scalar_weights(network)):
            matrix = _laplacian(network, weights, drag)
            uniform = not weights.any() and (matrix.diagonal() == matrix.diagonal()[0]).all()
            if uniform:
                values.append(float(matrix.diagonal()[0]))
                continue
            start = self._vectors[i]
            if start is not None:
                start = np.concatenate([start, np.ones(max(len(free) - len(start), 0))])[free]
            value, vector = _top(matrix, start, rough=True)
            # What is left of the residual may belong to a larger eigenvalue.
            residual = float(np.sqrt(((matrix @ vector - value * vector) ** 2).sum()))
            bound = (rough.omega2, rough.damping)[i]
            values.append(min(value + residual, bound))
            self._vectors[i] = np.zeros(len(free))
            self._vectors[i][free] = vector
        return Bounds(values[0], rough.particle, values[1], rough.damped, rough.least_damping)

    def at_least(self, network: Network) -> Bounds:
        """What the bounds cannot fall below: Rayleigh's quotients of the last vectors.

        After springs broke it tells, without an eigenvalue, where the bounds cannot have changed.
        """
        quotients = []
        free, mass = ~network.particles.fixed, network.particles.mass
        a, b = network.springs.between.T
        for u, (weights, drag) in zip(self._vectors, _scalar_weights(network), strict=True):
            if u is None:
                quotients.append(0.0)
                continue
            scaled = np.where(free, u / np.sqrt(mass), 0.0)
            energy = (weights * (scaled[b] - scaled[a]) ** 2).sum() + (drag * scaled**2).sum()
            quotients.append(float(energy / (u * u).sum()))
        least = gershgorin(network).least_damping
        return Bounds(quotients[0], -1, max(quotients[1], least), -1, least)


def any_geometry(network: Network) -> Bounds:
    """Bounds that hold however springs turn; at most those of `gershgorin`."""
    return AnyGeometry().bounds(network)


def _scalar_weights(network):
    """(weights of springs, what is on the diagonal besides) of the Laplacians of K and C."""
    springs, particles = network.springs, network.particles
    yield springs.stiffness, np.zeros(len(particles))
    yield springs.damping, particles.viscous


def _laplacian(network, weights, diagonal):
    """M^-1/2 (Laplacian + diagonal) M^-1/2 among the free particles, (f, f) sparse."""
    return _free_block(network, *_edges(network.springs.between, weights), diagonal, 1)


def _edges(between, weights):
    """The Laplacian's entries: rows, columns, values."""
    a, b = between.T
    rows, columns = np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a])
    return rows, columns, np.concatenate([weights, weights, -weights, -weights])


def _free_block(network, rows, columns, values, diagonal, dim):
    """M^-1/2 (entries + diagonal) M^-1/2 of the free particles' degrees of freedom, sparse."""
    from scipy import sparse

    particles = network.particles
    n = len(particles)
    whole = sparse.csr_matrix((values, (rows, columns)), shape=(n * dim, n * dim))
    whole = whole + sparse.diags(np.repeat(diagonal, dim))
    free = np.repeat(~particles.fixed, dim)
    scale = sparse.diags(1.0 / np.sqrt(np.repeat(particles.mass, dim)[free]))
    return (scale @ whole.tocsr()[free][:, free] @ scale).tocsr()


def _top(matrix, start=None, rough=False):
    """The largest eigenvalue of a symmetric matrix, and its vector; the same on every run.

    rough: of a large matrix to some thousandths, where the residual is added as a precaution.
    """
    n = matrix.shape[0]
    if n <= 32:
        values, vectors = np.linalg.eigh(matrix.toarray())
        return float(values[-1]), vectors[:, -1]
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    if matrix.nnz == 0 or not abs(matrix).max():
        return 0.0, np.eye(n, 1)[:, 0]
    noise = np.random.default_rng(0).standard_normal(n)
    if start is not None and (start @ start) > 0:  # with a part along whatever it lacks
        noise = start / np.sqrt(start @ start) + 1e-3 * noise / math.sqrt(n)
    # An eigenvalue is off by the square of its residual, and by no more than it where the next
    # one is as near, as on a large cloth.
    tolerances = (1e-6, 1e-4, 1e-2) if n <= MANY else (1e-2, 5e-2) if rough else (1e-3, 1e-2)
    for tolerance in tolerances:
        with contextlib.suppress(ArpackNoConvergence):
            values, vectors = eigsh(
                matrix, 1, which="LA", v0=noise, tol=tolerance, ncv=min(n, 30), maxiter=100
            )
            return float(values[-1]), vectors[:, -1]
    return float(abs(matrix).sum(axis=1).max()), np.full(n, 1 / math.sqrt(n))


# --- the state's own geometry ----------------------------------------------------------------


def matrices(network: Network):
    """M^-1/2 K M^-1/2 and M^-1/2 C M^-1/2 of the free particles, sparse, in the geometry as it is.

    Rows are the free particles' coordinates, particle by particle.
    """
    dim = network.position.shape[1]
    along, t = network.geometry
    k, c = network.springs.stiffness, network.springs.damping
    nn = along[:, :, None] * along[:, None, :]
    stiff = k[:, None, None] * ((1 - t)[:, None, None] * nn + t[:, None, None] * np.eye(dim))
    found = []
    for blocks, diagonal in (
        (stiff, np.zeros(len(network.position))),
        (c[:, None, None] * nn, network.particles.viscous),
    ):
        ends, others, sign = _edges(network.springs.between, np.ones(len(blocks)))
        axis = np.arange(dim)
        shape = (len(ends), dim, dim)
        rows = np.broadcast_to(ends[:, None, None] * dim + axis[:, None], shape)
        columns = np.broadcast_to(others[:, None, None] * dim + axis, shape)
        values = sign[:, None, None] * np.concatenate([blocks] * 4)
        entries = rows.ravel(), columns.ravel(), values.ravel()
        found.append(_free_block(network, *entries, diagonal, dim))
    return found


def stable_step(method, network: Network, *, exact: bool = True) -> Limit:
    """The largest stable step of `method` around this state, and what is responsible for it.

    exact: of a Runge-Kutta method whose damping differs from place to place, the modes of the
    damped system, which take long; else a step that is safe, and up to a percent shorter.
    """
    bounds = gershgorin(network)
    if math.isinf(method.CLAIMS.stability_limit) or bounds.omega2 + bounds.damping <= 0:
        return Limit(math.inf)
    if not math.isfinite(bounds.omega2 + bounds.damping):
        return Limit(0.0, bounds.omega2, bounds.damping, particle=bounds.particle)
    stiffness, damping = matrices(network)
    diagonal = damping.diagonal()
    if (damping - diagonal[0] * _identity(len(diagonal))).count_nonzero() == 0:
        # K's modes are those of the whole; of two with the same d the faster is the first to grow.
        found = [_of_vector(method, stiffness, damping, _top(stiffness)[1])]
        if diagonal[0] > 0:
            still = largest_step(method, 0.0, diagonal[0])
            if still < found[0][0]:
                found = [(still, 0.0, float(diagonal[0]), np.eye(len(diagonal), 1)[:, 0])]
    elif exact and hasattr(method, "stability_function"):
        found = _damped_modes(method, stiffness, damping)
    else:
        found = _quadratic_forms(method, stiffness, damping)
    h, omega2, rate, u = min(found, key=lambda mode: mode[0])
    return _limit(network, h, omega2, rate, u)


def _identity(n):
    from scipy import sparse

    return sparse.identity(n)


def _of_vector(method, stiffness, damping, u):
    """(largest step, omega^2, d, u) of a vector u of length 1, real or complex."""
    omega2 = max(float((u.conj() @ (stiffness @ u)).real), 0.0)
    rate = max(float((u.conj() @ (damping @ u)).real), 0.0)
    return largest_step(method, omega2, rate), omega2, rate, u


def _quadratic_forms(method, stiffness, damping):
    """The least step over all quotients (omega^2, d) of K and C.

    Frank and Wolfe's iteration, An algorithm for quadratic programming, 1956: at the pair found so
    far the step falls fastest in one direction, and the largest eigenvalue of K and C weighted
    like that leads to the next pair. Exact where the pairs of one step lie on a line, as for
    symplectic Euler and Verlet.
    """
    found = [_of_vector(method, stiffness, damping, _top(m)[1]) for m in
             (stiffness, damping)]  # fmt: skip
    for _ in range(12):
        h, omega2, rate, u = best = min(found, key=lambda mode: mode[0])
        if h == 0:
            break
        small = 1e-4 * max(omega2, rate * rate)
        by_omega2 = (h - largest_step(method, omega2 + small, rate)) / small
        small = 1e-4 * max(math.sqrt(omega2), rate)
        by_rate = (h - largest_step(method, omega2, rate + small)) / small
        weighted = by_omega2 * stiffness + by_rate * damping
        found.append(_of_vector(method, stiffness, damping, _top(weighted, u)[1]))
        if found[-1][0] > best[0] * (1 - 1e-7):
            break
    return found


def _damped_modes(method, stiffness, damping):
    """The modes of u'' = -K u - C u' that matter: all where they are few, else the outermost.

    Of an eigenvector u the quotients omega^2 and d fulfil mu^2 + d mu + omega^2 = 0.
    """
    from scipy import sparse
    from scipy.sparse.linalg import ArpackNoConvergence, eigs

    n = stiffness.shape[0]
    system = sparse.bmat([[None, sparse.identity(n)], [-stiffness, -damping]], format="csr")
    if n <= DENSE:
        vectors = [np.linalg.eig(system.toarray())[1]]
    else:
        vectors = []
        start = np.random.default_rng(0).standard_normal(2 * n)
        for which in ("LM", "LI", "SR"):
            try:
                vectors.append(eigs(system, 8, which=which, v0=start, tol=1e-6, ncv=60)[1])
            except ArpackNoConvergence as error:
                vectors.append(error.eigenvectors)
        if not any(v.shape[1] for v in vectors):
            return _quadratic_forms(method, stiffness, damping)
    u = np.concatenate(vectors, axis=1)[:n]
    length = np.sqrt((np.abs(u) ** 2).sum(axis=0))
    u = u[:, length > 1e-12] / length[length > 1e-12]
    omega2 = np.maximum((u.conj() * (stiffness @ u)).sum(axis=0).real, 0.0)
    rate = np.maximum((u.conj() * (damping @ u)).sum(axis=0).real, 0.0)
    steps = [largest_step(method, *pair) for pair in zip(omega2, rate, strict=True)]
    first = int(np.argmin(steps))
    return [(steps[first], float(omega2[first]), float(rate[first]), u[:, first])]


def _limit(network, h, omega2, rate, u) -> Limit:
    """The limit with its mode in the particles' coordinates, and what is responsible."""
    dim = network.position.shape[1]
    free = ~network.particles.fixed
    mu = -rate / 2 + np.sqrt(complex(rate * rate / 4 - omega2))
    if np.isrealobj(u):  # any moment serves: one at which it has both energies
        moving = u * (math.sqrt(omega2) if omega2 > 0 else rate)
    else:
        u = u * np.exp(-1j * np.angle(u[np.abs(u).argmax()]))
        u, moving = u.real, (mu * u).real
    mode, velocity = np.zeros_like(network.position), np.zeros_like(network.position)
    mass = np.sqrt(network.particles.mass[free])[:, None]
    mode[free], velocity[free] = u.reshape(-1, dim) / mass, moving.reshape(-1, dim) / mass
    particle = int((network.particles.mass * (mode**2).sum(axis=1)).argmax())
    limit = Limit(h, omega2, rate, mode, velocity, particle=particle)
    if len(network.springs) == 0:
        return limit
    along, t = network.geometry
    a, b = network.springs.between.T
    stretch = mode[b] - mode[a]
    axial, whole = (along * stretch).sum(axis=1) ** 2, (stretch**2).sum(axis=1)
    # Both terms as they weigh in a step: h^2 K and h C.
    h = h if 0 < h < math.inf else 1.0
    energy = h * h * network.springs.stiffness * ((1 - t) * axial + t * whole)
    energy += h * network.springs.damping * axial
    drag = h * (network.particles.viscous * (mode**2).sum(axis=1)).sum()
    total = energy.sum() + drag
    if not energy.sum() > drag:
        return limit
    spring = int(energy.argmax())
    return Limit(
        limit.dt, omega2, rate, mode, velocity,
        spring=int(network.number[spring]),
        ends=tuple(int(end) for end in network.springs.between[spring]),
        share=float(energy[spring] / total),
        particle=particle,
    )  # fmt: skip


# --- what f32 can follow ---------------------------------------------------------------------


@dataclass(frozen=True)
class Stall:
    """The step below which a sum in f32 no longer changes: `what`, "x" or "v", of a particle.

    value: the largest coordinate or speed it has; rate: what it changes by per time.
    """

    dt: float
    what: str
    particle: int
    value: float
    rate: float

    def describe(self) -> str:
        if self.particle < 0:
            return "nothing: nothing moves"
        names = {"x": ("x", "speed"), "v": ("v", "acceleration")}[self.what]
        return (
            f"{names[0]} of particle {self.particle}: {self.value:.4g}, {names[1]} {self.rate:.3g}"
        )


# Slower than the fastest by this factor is at rest: round-off of a balance of forces.
AT_REST = 1e-3


def f32_stall(position, velocity, acceleration, fixed, dt: float) -> Stall:
    """The step below which f32 loses the motion that a scene starts with.

    A sum x + h v stays x where h v is less than half the distance of x to the next number. Looked
    at is each free particle's speed after one frame, |v| + |a| dt, at its largest coordinate, and
    the acceleration that has to change this speed. The answer is the largest step at which one
    particle's x or v stalls. position, velocity, acceleration: (n, dim); fixed: (n,) bool.
    """
    a = np.linalg.norm(acceleration, axis=1)
    speed = np.linalg.norm(velocity, axis=1) + a * dt
    place = np.abs(position).max(axis=1, initial=0.0)
    best = Stall(0.0, "x", -1, 0.0, 0.0)
    for what, value, rate in (("x", place, speed), ("v", speed, a)):
        rate = np.where(fixed, 0.0, rate)
        moving = rate > AT_REST * rate.max(initial=0.0)
        if not moving.any():
            continue
        with np.errstate(all="ignore"):
            half_ulp = 0.5 * np.spacing(value.astype(np.float32)).astype(np.float64)
            step = np.where(moving, half_ulp / rate, 0.0)
        worst = int(step.argmax())
        if step[worst] > best.dt:
            best = Stall(float(step[worst]), what, worst, float(value[worst]), float(rate[worst]))
    return best
