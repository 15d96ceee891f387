// The triad of McCalpin's STREAM benchmark: a = b + s * c. 12 bytes a number in floats: two read,
// one written (not counted: the reading that a write causes).
extern "C" void stream_triad(long repeats, long n, float s, float *__restrict a,
                             const float *__restrict b, const float *__restrict c) {
  for (long r = 0; r < repeats; r++) {
#pragma omp parallel for simd
    for (long i = 0; i < n; i++) a[i] = b[i] + s * c[i];
  }
}
