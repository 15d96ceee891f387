// Colliding spheres in a box, as one would write them for speed by hand: a uniform grid of cells
// that the spheres are sorted into by a counting sort, each thread its share of them; the cells near
// a sphere are read row by row along x, each row as one range; position, velocity and radius of a
// sphere lie side by side. Collisions, walls and the move are those of the program's own step.
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

namespace {

struct Sphere {
  float x[3], radius, v[3];
  int index;
};

struct Grid {
  int size[3];
  float low[3], per_cell[3];

  int along(float place, int axis) const {
    const int c = int((place - low[axis]) * per_cell[axis]);
    return std::min(std::max(c, 0), size[axis] - 1);
  }
  int at(int i, int j, int k) const { return (k * size[1] + j) * size[0] + i; }
};

// Whether what is `gap` short of a wall and moves outward with vn is turned by it.
inline float bounce(float gap, float vn, float e) { return gap < 0 && vn > 0 ? -(1 + e) * vn : 0; }

}  // namespace

// x, v: (n, 3); low, high: corners of the box, whose third axis is centred; gravity along y.
// width: of a cell along y and z, at least a diameter; along x cells are half as wide, or a diameter.
// Returns how many collisions there were.
extern "C" long sphere_steps(long steps, int n, float dt, float gravity, float viscous,
                             float inverse_mass, float radius, float e, float width, float *low,
                             float *high, float *x, float *v) {
  Grid grid;
  for (int axis = 0; axis < 3; axis++) {
    const float wide = axis == 0 ? std::max(2 * radius, width / 2) : width;
    grid.size[axis] = std::max(1, int((high[axis] - low[axis]) / wide));
    grid.low[axis] = low[axis];
    grid.per_cell[axis] = grid.size[axis] / (high[axis] - low[axis]);
  }
  const int cells = grid.size[0] * grid.size[1] * grid.size[2];
  const int threads = omp_get_max_threads();
  std::vector<int> fill(size_t(cells) * threads), start(cells + 1), cell(n), sums(threads + 1);
  std::vector<Sphere> sorted(n);
  long collisions = 0;
  for (long s = 0; s < steps; s++) {
#pragma omp parallel num_threads(threads) reduction(+ : collisions)
    {
      const int t = omp_get_thread_num();
      int *mine = fill.data() + size_t(t) * cells;
      const int begin = long(n) * t / threads, end = long(n) * (t + 1) / threads;
      std::memset(mine, 0, cells * sizeof(int));
      for (int i = begin; i < end; i++) {
        const float *p = x + 3 * i;
        cell[i] = grid.at(grid.along(p[0], 0), grid.along(p[1], 1), grid.along(p[2], 2));
        mine[cell[i]]++;
      }
#pragma omp barrier
      const int first = long(cells) * t / threads, last = long(cells) * (t + 1) / threads;
      int total = 0;
      for (int c = first; c < last; c++) {
        for (int other = 0; other < threads; other++) total += fill[size_t(other) * cells + c];
      }
      sums[t + 1] = total;
#pragma omp barrier
      int place = 0;
      for (int other = 0; other <= t; other++) place += other ? sums[other] : 0;
      for (int c = first; c < last; c++) {
        start[c] = place;
        for (int other = 0; other < threads; other++) {
          int &count = fill[size_t(other) * cells + c];
          const int before = place;
          place += count;
          count = before;
        }
      }
      if (t == threads - 1) start[cells] = n;
#pragma omp barrier
      for (int i = begin; i < end; i++) {
        Sphere &to = sorted[mine[cell[i]]++];
        std::memcpy(to.x, x + 3 * i, sizeof to.x);
        std::memcpy(to.v, v + 3 * i, sizeof to.v);
        to.radius = radius;
        to.index = i;
      }
#pragma omp barrier
#pragma omp for schedule(static)
      for (int at = 0; at < n; at++) {
        const Sphere &a = sorted[at];
        float jump[3] = {0, 0, 0};
        int from[3], to[3];
        for (int axis = 0; axis < 3; axis++) {
          from[axis] = grid.along(a.x[axis] - 2 * radius, axis);
          to[axis] = grid.along(a.x[axis] + 2 * radius, axis);
        }
        for (int k = from[2]; k <= to[2]; k++) {
          for (int j = from[1]; j <= to[1]; j++) {
            const int past = start[grid.at(to[0], j, k) + 1];
            for (int other = start[grid.at(from[0], j, k)]; other < past; other++) {
              const Sphere &b = sorted[other];
              const float dx = b.x[0] - a.x[0], dy = b.x[1] - a.x[1], dz = b.x[2] - a.x[2];
              const float reach = a.radius + b.radius, d2 = dx * dx + dy * dy + dz * dz;
              if (d2 > reach * reach || other == at || d2 == 0) continue;
              const float scale = 1 / std::sqrt(d2);
              const float closing = scale * (dx * (a.v[0] - b.v[0]) + dy * (a.v[1] - b.v[1]) +
                                             dz * (a.v[2] - b.v[2]));
              if (closing < 0) continue;
              const float change = -(1 + e * e) * closing * 0.5f * scale;
              jump[0] += change * dx;
              jump[1] += change * dy;
              jump[2] += change * dz;
              collisions++;
            }
          }
        }
        const int i = a.index;
        for (int axis = 0; axis < 3; axis++) {
          const float old_x = a.x[axis], old_v = a.v[axis];
          jump[axis] += bounce(high[axis] - old_x - radius, old_v, e) -
                        bounce(old_x - low[axis] - radius, -old_v, e);
          const float g = axis == 1 ? gravity : 0;
          float new_v = old_v + dt * (g - inverse_mass * viscous * old_v) + jump[axis];
          float new_x = old_x + dt * new_v;
          for (int side = -1; side <= 1; side += 2) {
            const float bound = side > 0 ? high[axis] : low[axis];
            const float gap = side * (bound - old_x) - radius, vn = side * old_v;
            const float new_gap = side * (bound - new_x) - radius, new_vn = side * new_v;
            const bool floor = axis == 1 && side > 0;
            const bool pressed = (gap + dt * vn < 0 && vn >= 0 && new_vn >= 0 && vn + new_vn > 0) ||
                                 (floor && gap < 0 && vn > 0 && new_vn > 0);
            const bool far = new_gap < -2 * radius;
            if (!pressed && !far) continue;
            const float way = side * (new_x - old_x), part = gap > 0 ? gap / way : 0;
            const float left = -e * std::max(vn + part * (new_vn - vn), 0.0f);
            new_x = bound - side * radius;
            if (!pressed) new_v = new_vn > 0 ? side * left : new_v;
            if (pressed && !floor) new_v = 0;
          }
          x[3 * i + axis] = new_x;
          v[3 * i + axis] = new_v;
        }
      }
    }
  }
  return collisions;
}
