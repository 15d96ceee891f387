// The cloth as a regular grid, as one would write it for speed by hand: an array for each number,
// rows shared among the threads, vectorised along each row; velocities, then positions.
//
// kx[i], ky[i]: stiffness of particle i's link to the right and down, zero where there is none, so
// that no border needs a branch. All arrays have at least one finite number more at either end.
#include <cmath>

namespace {

// Adds the force of the link from (x, y) to (far_x, far_y); none where both ends coincide.
inline void pull(float k, float rest, float x, float y, float far_x, float far_y, float &fx,
                 float &fy) {
  const float dx = far_x - x, dy = far_y - y, length2 = dx * dx + dy * dy;
  const float inverse = length2 > 0 ? 1 / std::sqrt(length2) : 0;
  const float scale = k * (1 - rest * inverse);
  fx += scale * dx;
  fy += scale * dy;
}

}  // namespace

extern "C" void grid_steps(long steps, int columns, int rows, float dt, float gravity,
                           float viscous, float rest, const float *__restrict kx,
                           const float *__restrict ky, const float *__restrict w,
                           float *__restrict x, float *__restrict y, float *__restrict u,
                           float *__restrict v) {
  const long n = long(columns) * rows;
  for (long s = 0; s < steps; s++) {
#pragma omp parallel for
    for (int row = 0; row < rows; row++) {
      const long begin = long(row) * columns, end = begin + columns;
      const long up = row > 0 ? columns : 0, down = row < rows - 1 ? columns : 0;
#pragma omp simd
      for (long i = begin; i < end; i++) {
        float fx = -viscous * u[i], fy = -viscous * v[i];
        pull(kx[i - 1], rest, x[i], y[i], x[i - 1], y[i - 1], fx, fy);
        pull(kx[i], rest, x[i], y[i], x[i + 1], y[i + 1], fx, fy);
        pull(ky[i - up], rest, x[i], y[i], x[i - up], y[i - up], fx, fy);
        pull(ky[i], rest, x[i], y[i], x[i + down], y[i + down], fx, fy);
        u[i] += dt * w[i] * fx;
        v[i] += dt * (w[i] * fy + (w[i] > 0 ? gravity : 0));
      }
    }
#pragma omp parallel for simd
    for (long i = 0; i < n; i++) {
      x[i] += dt * u[i];
      y[i] += dt * v[i];
    }
  }
}
