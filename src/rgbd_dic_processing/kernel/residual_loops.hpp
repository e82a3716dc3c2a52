// A subset's samples beside the reference: sums over all pixels, or block by block. Included only by
// loops_for_isa.cpp, after simd.hpp and block_sums.hpp.
#include <cstddef>

#include "loops.hpp"

namespace rgbd_dic::RGBD_DIC_ISA {

Moments moments(const Layout& layout, const float* g) {
  const int size = layout.size();
  Floats total{}, power{};
  const float* pixels = g;
  for (int column = 0; column < layout.columns; ++column) {
    Floats part{};
    for (int line = 0; line < size; ++line, pixels += kWidth) part += load(pixels);
    total += inside(layout, column) ? part : Floats{};
  }
  const float mean = sum(total) / static_cast<float>(layout.count());
  pixels = g;
  for (int column = 0; column < layout.columns; ++column) {
    Floats part{};
    for (int line = 0; line < size; ++line, pixels += kWidth) {
      const Floats away = load(pixels) - mean;
      part += away * away;
    }
    power += inside(layout, column) ? part : Floats{};
  }
  return {mean, sum(power)};
}

template <int order>
void residual_sums_of(const Layout& layout, const ReferencePixels& reference, float mean_f, const float* g,
                      float mean_g, float scale, ResidualSums& sums) {
  constexpr int kMonomials = monomial_count(order);
  const Ints lanes = lane_numbers();
  Floats r_r{}, r_f{}, r_1{}, r_x[kMonomials]{}, r_y[kMonomials]{};
  for (int column = 0; column < layout.columns; ++column) {
    const int start = column * kWidth - layout.half;
    const Floats xi = to_floats(start + lanes);
    const Ints within = inside(layout, column);
    Floats of_r{}, of_f{}, of_1{}, x[order + 1]{}, y[order + 1]{};  // x, y: times the powers of eta
    Floats q = all_equal(static_cast<float>(-layout.half));
    for (int eta = -layout.half; eta <= layout.half; ++eta, q += 1.0f, g += kWidth) {
      const std::ptrdiff_t at = eta * reference.stride + start;
      const Floats f = load(reference.f + at) - mean_f;
      const Floats r = f - scale * (load(g) - mean_g);
      of_r += r * r;
      of_f += r * f;
      of_1 += r;
      const Floats jx = load(reference.jx + at), jy = load(reference.jy + at);
      Floats term = r;
      for (int power = 0; power <= order; ++power, term *= q) {
        x[power] += term * jx;
        y[power] += term * jy;
      }
    }
    r_r += within ? of_r : Floats{};
    r_f += within ? of_f : Floats{};
    r_1 += within ? of_1 : Floats{};
    const auto gather = [&](const Floats(&s)[order + 1], Floats(&r)[kMonomials])
                            __attribute__((always_inline)) {
                              const Floats one = within ? s[0] : Floats{}, line = within ? s[1] : Floats{};
                              r[0] += one;
                              r[1] += one * xi;
                              r[2] += line;
                              if constexpr (order == 2) {
                                r[3] += one * xi * xi;
                                r[4] += line * xi;
                                r[5] += within ? s[2] : Floats{};
                              }
                            };
    gather(x, r_x);
    gather(y, r_y);
  }
  sums.r_r = sum(r_r);
  sums.r_f = sum(r_f);
  sums.r_1 = sum(r_1);
  for (int m = 0; m < kMonomials; ++m) {
    sums.r_j[m] = sum(r_x[m]);
    sums.r_j[kMonomials + m] = sum(r_y[m]);
  }
}

void residual_sums(const Layout& layout, const ReferencePixels& reference, float mean_f, const float* g,
                   float mean_g, float scale, int order, ResidualSums& sums) {
  const auto function = order == 1 ? residual_sums_of<1> : residual_sums_of<2>;
  function(layout, reference, mean_f, g, mean_g, scale, sums);
}

// Sums over the blocks: `terms(at, pixel, sums)` adds those of kWidth pixels, `at` is their place in the
// planes, `pixel` in a Layout.
template <int count, class Blocks, class Terms>
RGBD_DIC_INLINE void sum_blocks(const Layout& layout, std::ptrdiff_t stride, Blocks& blocks,
                                const Terms& terms) {
  const int size = layout.size();
  BlockSums<count> parts;
  std::ptrdiff_t pixel = 0;
  for (int column = 0; column < layout.columns; ++column) {
    const int start = column * kWidth - layout.half;
    for (int level = 0; level < kSide; ++level) {
      Floats sums[count]{};
      for (int line = block_start(level, size); line < block_start(level + 1, size); ++line, pixel += kWidth)
        terms((line - layout.half) * stride + start, pixel, sums);
      parts.add(layout, column, level, sums);
    }
  }
  parts.finish(blocks);
}

void block_residuals(const Layout& layout, const ReferencePixels& reference, float mean_f, const float* g,
                     float mean_g, float scale, BlockResiduals& blocks) {
  sum_blocks<3>(layout, reference.stride, blocks,
                [&](std::ptrdiff_t at, std::ptrdiff_t pixel, Floats(&s)[3]) __attribute__((always_inline)) {
                  const Floats r = load(reference.f + at) - mean_f - scale * (load(g + pixel) - mean_g);
                  s[0] += r * r;
                  s[1] += r * load(reference.jx + at);
                  s[2] += r * load(reference.jy + at);
                });
}

void block_samples(const Layout& layout, const ReferencePixels& reference, float mean_f, const float* g,
                   float mean_g, BlockSamples& blocks) {
  sum_blocks<3>(layout, reference.stride, blocks,
                [&](std::ptrdiff_t at, std::ptrdiff_t pixel, Floats(&s)[3]) __attribute__((always_inline)) {
                  const Floats away = load(g + pixel) - mean_g;
                  s[0] += away;
                  s[1] += away * away;
                  s[2] += away * (load(reference.f + at) - mean_f);
                });
}

}  // namespace rgbd_dic::RGBD_DIC_ISA
