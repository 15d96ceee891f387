#!/usr/bin/env bash
# Newton 1.8.0: the friction of cloth on a shape is the mean of the two coefficients under
# SolverSemiImplicit and SolverXPBD, and the root of their product under SolverVBD.
# Seen: a flat cloth on a plane of 40 degrees, g = 10 m/s², 0.5 s. With 0.5 on both sides all
# three slide 0.33 to 0.34 m (a body: 0.325). With 0.5 on one side and 0 on the other SemiImplicit
# and XPBD slide 0.57 m, as with 0.25; VBD 0.81 m, as without friction (0.803), whichever side has
# the 0. So a slippery cloth (soft_contact_mu = 0) is not slippery in two of three.
# The documentation has "coefficient of friction" for both, and no rule by which they are mixed.
# Exits with a status other than 0 if that changes.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q newton==1.8.0 warp-lang==1.19.0 numpy==2.2.6
"$folder/venv/bin/python" - <<'PYTHON'
import math
import warnings

import warp as wp

wp.config.quiet = True
import newton

warnings.simplefilter("ignore")
slope = math.radians(40)


def slid(solver, shape, cloth, **options):
    """The way down the slope after 0.5 s, m."""
    builder = newton.ModelBuilder(gravity=(10 * math.sin(slope), 0.0, -10 * math.cos(slope)))
    builder.add_ground_plane(cfg=newton.ModelBuilder.ShapeConfig(ke=1e4, kd=0.0, kf=1e3, mu=shape))
    builder.add_cloth_grid(
        pos=wp.vec3(0, 0, 0.0999), rot=wp.quat_identity(), vel=wp.vec3(0, 0, 0),
        dim_x=2, dim_y=2, cell_x=0.5, cell_y=0.5, mass=1.0,
        tri_ke=1e3, tri_ka=1e3, tri_kd=0.0, edge_ke=0.0, particle_radius=0.1,
    )
    builder.color()
    model = builder.finalize(device="cpu")
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_kf = 1e4, 10.0, 1e3
    model.soft_contact_mu = cloth
    engine, now, then = solver(model, **options), model.state(), model.state()
    contacts = model.contacts()
    for _ in range(300):
        now.clear_forces()
        model.collide(now, contacts)
        engine.step(now, then, model.control(), contacts, 1 / 600)
        now, then = then, now
    return float(now.particle_q.numpy()[:, 0].mean()) - 0.5


def body(mu):
    return 0.5 * 10 * (math.sin(slope) - mu * math.cos(slope)) * 0.5**2


semi, xpbd, vbd = (
    newton.solvers.SolverSemiImplicit, newton.solvers.SolverXPBD, newton.solvers.SolverVBD,
)
for solver, options in ((semi, {}), (xpbd, {"iterations": 10}), (vbd, {"iterations": 10})):
    both, shape, cloth = (slid(solver, *mu, **options) for mu in ((0.5, 0.5), (0.5, 0), (0, 0.5)))
    found = f"both {both:.3f}, shape {shape:.3f}, cloth {cloth:.3f} m"
    print(newton.__version__, solver.__name__, found)
    assert abs(both - body(0.5)) < 0.02
    mixed = body(0.0 if solver is vbd else 0.25)
    assert abs(shape - mixed) < 0.02 and abs(cloth - mixed) < 0.02
PYTHON
