// The cloth on a graph, as one would write it by hand: compressed rows, OpenMP, one precision.
// Reads a problem that speed.py wrote, advances it, prints the seconds of each round, and writes
// the final positions back, so that speed is compared only where the trajectories agree.
//
// usage: graph_cloth FILE.in FILE.out ROUNDS STEPS_PER_ROUND
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

using real = float;

template <class T>
static std::vector<T> read(FILE* file, size_t count) {
  std::vector<T> values(count);
  if (fread(values.data(), sizeof(T), count, file) != count) exit(1);
  return values;
}

int main(int argc, char** argv) {
  if (argc != 5) return 1;
  FILE* in = fopen(argv[1], "rb");
  if (!in) return 1;
  const int n = read<int>(in, 1)[0], half = read<int>(in, 1)[0];
  const auto constants = read<real>(in, 3);  // dt, gravity, viscous
  const real dt = constants[0], gravity = constants[1], viscous = constants[2];
  const auto row = read<int>(in, n + 1), far = read<int>(in, half);
  const auto k = read<real>(in, half), rest = read<real>(in, half), w = read<real>(in, n);
  auto x = read<real>(in, 2 * n), v = read<real>(in, 2 * n);
  fclose(in);

  auto step = [&] {
#pragma omp parallel for
    for (int i = 0; i < n; i++) {
      const real xi = x[2 * i], yi = x[2 * i + 1], u = v[2 * i], s = v[2 * i + 1];
      real fx = -viscous * u, fy = -viscous * s;
      for (int h = row[i]; h < row[i + 1]; h++) {
        const int j = far[h];
        const real dx = x[2 * j] - xi, dy = x[2 * j + 1] - yi;
        const real length = std::sqrt(dx * dx + dy * dy);
        if (length > 0) {
          const real scale = k[h] * (length - rest[h]) / length;
          fx += scale * dx;
          fy += scale * dy;
        }
      }
      const real free = w[i] > 0;
      v[2 * i] = u + dt * w[i] * fx;
      v[2 * i + 1] = s + dt * (w[i] * fy + free * gravity);
    }
#pragma omp parallel for
    for (int i = 0; i < 2 * n; i++) x[i] += dt * v[i];
  };

  const int rounds = atoi(argv[3]), steps = atoi(argv[4]);
  for (int r = 0; r < rounds; r++) {
    const auto begin = std::chrono::steady_clock::now();
    for (int s = 0; s < steps; s++) step();
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begin;
    printf("%.9f\n", took.count());
  }
  FILE* out = fopen(argv[2], "wb");
  fwrite(x.data(), sizeof(real), x.size(), out);
  fclose(out);
}
