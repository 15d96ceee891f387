// The cloth on a graph, as one would write it by hand: compressed rows, one particle at a time,
// x and y side by side, a stiffness and a rest length for each half-spring.
#include <cmath>

extern "C" void csr_steps(long steps, int n, float dt, float gravity, float viscous, const int *row,
                          const int *far, const float *k, const float *rest, const float *w,
                          float *x, float *v) {
  for (long s = 0; s < steps; s++) {
#pragma omp parallel for
    for (int i = 0; i < n; i++) {
      const float xi = x[2 * i], yi = x[2 * i + 1], ui = v[2 * i], vi = v[2 * i + 1];
      float fx = -viscous * ui, fy = -viscous * vi;
      for (int h = row[i]; h < row[i + 1]; h++) {
        const int j = far[h];
        const float dx = x[2 * j] - xi, dy = x[2 * j + 1] - yi;
        const float length = std::sqrt(dx * dx + dy * dy);
        if (length > 0) {
          const float scale = k[h] * (length - rest[h]) / length;
          fx += scale * dx;
          fy += scale * dy;
        }
      }
      const float free = w[i] > 0;
      v[2 * i] = ui + dt * w[i] * fx;
      v[2 * i + 1] = vi + dt * (w[i] * fy + free * gravity);
    }
#pragma omp parallel for
    for (int i = 0; i < 2 * n; i++) x[i] += dt * v[i];
  }
}
