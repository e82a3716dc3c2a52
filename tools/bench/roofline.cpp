// What one core of this machine can do at best with float32: fused multiply-adds, and loads from the
// first-level cache. Prints {"fma_per_s": ..., "loads_bytes_per_s": ..., "vector_bytes": ...}. Compile with
// -O3 -march=native.
#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdio>

#if defined(__AVX512F__)
constexpr std::size_t vector_bytes = 64;
#elif defined(__AVX__)
constexpr std::size_t vector_bytes = 32;
#else
constexpr std::size_t vector_bytes = 16;
#endif
typedef float vector __attribute__((vector_size(vector_bytes)));
constexpr int lanes = vector_bytes / sizeof(float);
constexpr int chains = 12;  // independent sums: enough to hide the latency of two units
constexpr std::size_t buffer_vectors = 16384 / vector_bytes;

// Seconds of the fastest of several runs.
template <typename Work>
double fastest(Work work) {
  double best = 1e9;
  for (int run = 0; run < 20; ++run) {
    const auto start = std::chrono::steady_clock::now();
    work();
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  return best;
}

void keep(const vector (&sums)[chains]) {
  for (const vector& sum : sums) asm volatile("" : : "m"(sum) : "memory");
}

int main() {
  constexpr long rounds = 2000000;
  vector factor, term;
  for (int i = 0; i < lanes; ++i) factor[i] = 0.999f, term[i] = 1e-3f;
  asm volatile("" : "+m"(factor), "+m"(term));
  const double fma_s = fastest([&] {
    vector sums[chains] = {};
    const vector a = factor, b = term;
    for (long i = 0; i < rounds; ++i)
#pragma GCC unroll 12
      for (int k = 0; k < chains; ++k) sums[k] = sums[k] * a + b;
    keep(sums);
  });

  static vector buffer[buffer_vectors];
  constexpr long passes = 100000;
  constexpr std::size_t used = buffer_vectors / chains * chains;
  const double load_s = fastest([&] {
    vector sums[chains] = {};
    for (long pass = 0; pass < passes; ++pass) {
      asm volatile("" : : "r"(buffer) : "memory");  // load again in each pass
      for (std::size_t i = 0; i < used; i += chains)
#pragma GCC unroll 12
        for (int k = 0; k < chains; ++k) sums[k] += buffer[i + k];
    }
    keep(sums);
  });
  std::printf("{\"fma_per_s\": %.4g, \"loads_bytes_per_s\": %.4g, \"vector_bytes\": %zu}\n",
              double(rounds) * chains * lanes / fma_s, double(passes) * used * vector_bytes / load_s,
              vector_bytes);
}
