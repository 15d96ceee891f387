// A mesh in space, as one would write it by hand: compressed rows, one particle at a time, x, y and
// z side by side, a stiffness and a rest length for each half-spring.
#include <cmath>

extern "C" void csr3_steps(long steps, int n, float dt, float gravity, float viscous,
                           const int *row, const int *far, const float *k, const float *rest,
                           const float *w, float *x, float *v) {
  for (long s = 0; s < steps; s++) {
#pragma omp parallel for
    for (int i = 0; i < n; i++) {
      const float xi = x[3 * i], yi = x[3 * i + 1], zi = x[3 * i + 2];
      float fx = -viscous * v[3 * i], fy = -viscous * v[3 * i + 1], fz = -viscous * v[3 * i + 2];
      for (int h = row[i]; h < row[i + 1]; h++) {
        const int j = far[h];
        const float dx = x[3 * j] - xi, dy = x[3 * j + 1] - yi, dz = x[3 * j + 2] - zi;
        const float length = std::sqrt(dx * dx + dy * dy + dz * dz);
        if (length > 0) {
          const float scale = k[h] * (length - rest[h]) / length;
          fx += scale * dx;
          fy += scale * dy;
          fz += scale * dz;
        }
      }
      const float free = w[i] > 0;
      v[3 * i] += dt * w[i] * fx;
      v[3 * i + 1] += dt * (w[i] * fy + free * gravity);
      v[3 * i + 2] += dt * w[i] * fz;
    }
#pragma omp parallel for
    for (int i = 0; i < 3 * n; i++) x[i] += dt * v[i];
  }
}
