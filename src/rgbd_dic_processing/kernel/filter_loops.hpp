// Filters of whole images: the recursive prefilter, and weighted sums of lines. Included only by
// loops_for_isa.cpp, after simd.hpp.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "loops.hpp"

namespace rgbd_dic::RGBD_DIC_ISA {

void to_floats(const std::uint8_t* pixels, std::ptrdiff_t count, float* out) {
  // Compilers make vectors of this loop, but not of a conversion of vectors of bytes.
#pragma omp simd
  for (std::ptrdiff_t i = 0; i < count; ++i) out[i] = static_cast<float>(pixels[i]);
}

// The filter along some lines beside each other: as many as `vectors` Lanes hold, vectors or single floats.
template <class Lanes, int vectors>
RGBD_DIC_INLINE void filter_some_lines(float* data, std::ptrdiff_t count, std::ptrdiff_t step, int pole_count,
                                       const double* poles) {
  constexpr std::ptrdiff_t kLanes = sizeof(Lanes) / sizeof(float);
  const auto at = [](const float* values) __attribute__((always_inline)) {
    Lanes lanes;
    std::memcpy(&lanes, values, sizeof lanes);
    return lanes;
  };
  const auto set = [](float* values, Lanes lanes)
                       __attribute__((always_inline)) { std::memcpy(values, &lanes, sizeof lanes); };
  for (int p = 0; p < pole_count; ++p) {
    const double pole = poles[p];
    const float z = static_cast<float>(pole);
    const float gain = static_cast<float>((1.0 - pole) * (1.0 - 1.0 / pole));
    // Forward, started by the mirrored line's sum of z^k c[k], cut where it is below float32's resolution.
    const int horizon = static_cast<int>(std::ceil(std::log(1e-9) / std::log(std::fabs(pole))));
    Lanes total[vectors]{};
    for (int k = horizon; k >= 0; --k) {
      const std::ptrdiff_t folded = k % (2 * count - 2);
      const float* value = data + (folded < count ? folded : 2 * count - 2 - folded) * step;
      for (int v = 0; v < vectors; ++v) total[v] = gain * at(value + v * kLanes) + z * total[v];
    }
    for (int v = 0; v < vectors; ++v) set(data + v * kLanes, total[v]);
    float* value = data + step;
    for (std::ptrdiff_t k = 1; k < count; ++k, value += step)
      for (int v = 0; v < vectors; ++v) {
        total[v] = gain * at(value + v * kLanes) + z * total[v];
        set(value + v * kLanes, total[v]);
      }

    // Backward.
    value = data + (count - 1) * step;
    const float end = static_cast<float>(pole / (pole * pole - 1.0));
    for (int v = 0; v < vectors; ++v) {
      total[v] = end * (at(value + v * kLanes) + z * at(value - step + v * kLanes));
      set(value + v * kLanes, total[v]);
    }
    for (std::ptrdiff_t k = count - 2; k >= 0; --k) {
      value -= step;
      for (int v = 0; v < vectors; ++v) {
        total[v] = z * (total[v] - at(value + v * kLanes));
        set(value + v * kLanes, total[v]);
      }
    }
  }
}

void filter_lines(float* data, std::ptrdiff_t count, std::ptrdiff_t step, std::ptrdiff_t lines,
                  int pole_count, const double* poles) {
  std::ptrdiff_t l = 0;
  for (; l + 4 * kWidth <= lines; l += 4 * kWidth)
    filter_some_lines<Floats, 4>(data + l, count, step, pole_count, poles);
  for (; l + 2 * kWidth <= lines; l += 2 * kWidth)
    filter_some_lines<Floats, 2>(data + l, count, step, pole_count, poles);
  for (; l + kWidth <= lines; l += kWidth)
    filter_some_lines<Floats, 1>(data + l, count, step, pole_count, poles);
  for (; l < lines; ++l) filter_some_lines<float, 1>(data + l, count, step, pole_count, poles);
}

void transpose(const float* from, std::ptrdiff_t from_step, std::ptrdiff_t lines, std::ptrdiff_t count,
               float* to, std::ptrdiff_t to_step) {
  std::ptrdiff_t y = 0;
  for (; y + kWidth <= lines; y += kWidth) {
    std::ptrdiff_t x = 0;
    for (; x + kWidth <= count; x += kWidth) {
      Floats block[kWidth];
      for (int k = 0; k < kWidth; ++k) block[k] = load(from + (y + k) * from_step + x);
      transpose_block(block);
      for (int k = 0; k < kWidth; ++k) store(to + (x + k) * to_step + y, block[k]);
    }
    for (; x < count; ++x)
      for (int k = 0; k < kWidth; ++k) to[x * to_step + y + k] = from[(y + k) * from_step + x];
  }
  for (; y < lines; ++y)
    for (std::ptrdiff_t x = 0; x < count; ++x) to[x * to_step + y] = from[y * from_step + x];
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
