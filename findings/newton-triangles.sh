#!/usr/bin/env bash
# Newton 1.8.0, triangles under SolverSemiImplicit: three coefficients do other than their names
# say.
# - `tri_kd` damps what turns, not only what deforms: a free square that spins at 1 rad/s has lost
#   98 % of its angular momentum after 1 s at tri_kd = 1 (VBD: 0.1 %). The force is k_d dF/dt, and
#   F of a rigid turn changes.
# - `tri_lift` brakes broadside: a square of 1 m² that falls flat at 1 m/s is held back by 3 pi /
#   2 = 4.7 times tri_lift, where a plate has no lift at all. (Along the normal goes the angle of
#   attack, and each of three corners takes the whole triangle.)
# - `tri_ka = 0` has no rest shape: a square at rest shrinks to 0.46 m in 0.2 s; under VBD it
#   stays 1 m. The pull of the stretched state is undone by the area's term alone, left out at 0.
# The documentation (`ModelBuilder.add_triangle`) says "damping", "lift" and "area stiffness" of
# the triangle, for all solvers. Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q newton==1.8.0 warp-lang==1.19.0 numpy==2.2.6
"$folder/venv/bin/python" - <<'PYTHON'
import math

import numpy as np
import warp as wp

wp.config.quiet = True
import newton

square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float) - [0.5, 0.5, 0]
triangles = [0, 1, 2, 0, 2, 3]


def after(solver, steps, dt, velocity, **materials):
    """Masses, positions and velocities of a free square without gravity."""
    values = dict.fromkeys(("tri_ke", "tri_ka", "tri_kd", "tri_drag", "tri_lift", "edge_ke"), 0.0)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_cloth_mesh(
        pos=wp.vec3(0, 0, 0), rot=wp.quat_identity(), scale=1.0, vel=wp.vec3(0, 0, 0),
        vertices=[wp.vec3(*p) for p in square], indices=triangles, density=1.0,
        particle_radius=1e-3, **(values | materials),
    )
    for i, v in enumerate(velocity):
        builder.particle_qd[i] = wp.vec3(*map(float, v))
    builder.color()
    model = builder.finalize(device="cpu")
    options = {"iterations": 20} if solver is newton.solvers.SolverVBD else {}
    engine, now, then = solver(model, **options), model.state(), model.state()
    for _ in range(steps):
        now.clear_forces()
        engine.step(now, then, model.control(), None, dt)
        now, then = then, now
    m, x, v = model.particle_mass, now.particle_q, now.particle_qd
    return m.numpy()[:, None], x.numpy().astype(float), v.numpy().astype(float)


def spin(m, x, v):
    """The angular momentum about the centre of mass, kg m²/s."""
    centre = (m * x).sum(0) / m.sum()
    return (m * np.cross(x - centre, v)).sum(0)[2]


semi, vbd = newton.solvers.SolverSemiImplicit, newton.solvers.SolverVBD
stiff = {"tri_ke": 1000.0, "tri_ka": 1000.0}
still = np.zeros((4, 3))
turning = np.cross([0, 0, 1.0], square)

kept = {}
for solver, kd in ((semi, 0.0), (semi, 1.0), (vbd, 1.0)):
    m, x, v = after(solver, 1000, 1e-3, turning, tri_kd=kd, **stiff)
    kept[solver, kd] = spin(m, x, v) / spin(m, square, turning)
    share = round(kept[solver, kd], 4)
    print(newton.__version__, solver.__name__, "tri_kd", kd, "spin kept", share)
assert kept[semi, 0.0] > 0.999 and kept[vbd, 1.0] > 0.99 and kept[semi, 1.0] < 0.05

m, x, v = after(semi, 1, 1e-3, still - [0, 0, 1.0], tri_lift=0.1, **stiff)
force = (m[:, 0] * (v[:, 2] + 1)).sum() / 1e-3
print("tri_lift 0.1, falling flat at 1 m/s: held back by", round(force, 4), "N")
assert abs(force / (0.1 * 3 * math.pi / 2) - 1) < 0.01

sides = {}
for solver in (semi, vbd):
    m, x, v = after(solver, 200, 1e-3, still, tri_ke=10.0)
    sides[solver] = np.ptp(x[:, 0])
    print(solver.__name__, "tri_ka 0: side after 0.2 s", round(sides[solver], 4), "m")
assert sides[semi] < 0.5 and abs(sides[vbd] - 1) < 1e-3
PYTHON
