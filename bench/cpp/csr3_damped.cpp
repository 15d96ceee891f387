// A cloth in space with dashpots, as one would write it by hand: compressed rows, one particle at a
// time, x, y and z side by side, three numbers for each half-spring. A dashpot reads its other end's
// velocity, so new velocities are kept apart until all are known.
#include <cmath>

extern "C" void csr3_damped_steps(long steps, int n, float dt, float gravity, const int *row,
                                  const int *far, const float *k, const float *rest, const float *c,
                                  const float *w, float *x, float *v, float *next) {
  for (long s = 0; s < steps; s++) {
#pragma omp parallel for
    for (int i = 0; i < n; i++) {
      const float xi = x[3 * i], yi = x[3 * i + 1], zi = x[3 * i + 2];
      const float ui = v[3 * i], vi = v[3 * i + 1], wi = v[3 * i + 2];
      float fx = 0, fy = 0, fz = 0;
      for (int h = row[i]; h < row[i + 1]; h++) {
        const int j = far[h];
        const float dx = x[3 * j] - xi, dy = x[3 * j + 1] - yi, dz = x[3 * j + 2] - zi;
        const float du = v[3 * j] - ui, dv = v[3 * j + 1] - vi, dw = v[3 * j + 2] - wi;
        const float length = std::sqrt(dx * dx + dy * dy + dz * dz);
        if (length > 0) {
          const float inverse = 1 / length, rate = (dx * du + dy * dv + dz * dw) * inverse;
          const float scale = (k[h] * (length - rest[h]) + c[h] * rate) * inverse;
          fx += scale * dx;
          fy += scale * dy;
          fz += scale * dz;
        }
      }
      const float free = w[i] > 0;
      next[3 * i] = ui + dt * w[i] * fx;
      next[3 * i + 1] = vi + dt * (w[i] * fy + free * gravity);
      next[3 * i + 2] = wi + dt * w[i] * fz;
    }
#pragma omp parallel for
    for (int i = 0; i < 3 * n; i++) {
      v[i] = next[i];
      x[i] += dt * v[i];
    }
  }
}
