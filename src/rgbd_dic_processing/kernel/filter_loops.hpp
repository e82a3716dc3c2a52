// Filters of whole images: the recursive prefilter, and weighted sums of lines. Included only by
// loops_for_isa.cpp, after simd.hpp.
#include <cmath>
#include <cstddef>

#include "loops.hpp"

namespace rgbd_dic::RGBD_DIC_ISA {

void filter_lines(float* data, std::ptrdiff_t count, std::ptrdiff_t step, int lanes, int pole_count,
                  const double* poles) {
  float total[kFilterLanes];
  for (int p = 0; p < pole_count; ++p) {
    const double pole = poles[p];
    const float z = static_cast<float>(pole);
    const float gain = static_cast<float>((1.0 - pole) * (1.0 - 1.0 / pole));
    // Forward, started by the mirrored line's sum of z^k c[k], cut where it is below float32's resolution.
    const int horizon = static_cast<int>(std::ceil(std::log(1e-9) / std::log(std::fabs(pole))));
    for (int l = 0; l < lanes; ++l) total[l] = 0.0f;
    for (int k = horizon; k >= 0; --k) {
      const std::ptrdiff_t folded = k % (2 * count - 2);
      const float* value = data + (folded < count ? folded : 2 * count - 2 - folded) * step;
      for (int l = 0; l < lanes; ++l) total[l] = total[l] * z + gain * value[l];
    }
    for (int l = 0; l < lanes; ++l) data[l] = total[l];
    for (std::ptrdiff_t k = 1; k < count; ++k) {
      float* value = data + k * step;
#pragma omp simd
      for (int l = 0; l < lanes; ++l) value[l] = gain * value[l] + z * value[l - step];
    }

    // Backward.
    float* last = data + (count - 1) * step;
    const float end = static_cast<float>(pole / (pole * pole - 1.0));
    for (int l = 0; l < lanes; ++l) last[l] = end * (last[l] + z * last[l - step]);
    for (std::ptrdiff_t k = count - 2; k >= 0; --k) {
      float* value = data + k * step;
#pragma omp simd
      for (int l = 0; l < lanes; ++l) value[l] = z * (value[l + step] - value[l]);
    }
  }
}

// Some vectors of sums from `begin` on at once, so that a weight is fetched once for all of them.
template <int vectors>
RGBD_DIC_INLINE void weighted_sums_at(std::ptrdiff_t begin, const float* const* lines, const float* weights,
                                      int terms, float* out) {
  Floats total[vectors]{};
  for (int k = 0; k < terms; ++k) {
    const float weight = weights[k];
    const float* line = lines[k] + begin;
    for (int v = 0; v < vectors; ++v) total[v] += weight * load(line + v * kWidth);
  }
  for (int v = 0; v < vectors; ++v) store(out + begin + v * kWidth, total[v]);
}

void weighted_sum(const float* const* lines, const float* weights, int terms, std::ptrdiff_t count,
                  float* out) {
  std::ptrdiff_t i = 0;
  for (; i + 4 * kWidth <= count; i += 4 * kWidth) weighted_sums_at<4>(i, lines, weights, terms, out);
  for (; i + kWidth <= count; i += kWidth) weighted_sums_at<1>(i, lines, weights, terms, out);
  for (; i < count; ++i) {
    float total = 0.0f;
    for (int k = 0; k < terms; ++k) total += weights[k] * lines[k][i];
    out[i] = total;
  }
}

}  // namespace rgbd_dic::RGBD_DIC_ISA
