// Sums over the pixels of a subset, over all of them or block by block. Included only by loops_for_isa.cpp,
// after simd.hpp.
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
    total += part * load(&layout.weight[column * kWidth]);
  }
  const float mean = sum(total) / static_cast<float>(layout.count());
  pixels = g;
  for (int column = 0; column < layout.columns; ++column) {
    Floats part{};
    for (int line = 0; line < size; ++line, pixels += kWidth) {
      const Floats away = load(pixels) - mean;
      part += away * away;
    }
    power += part * load(&layout.weight[column * kWidth]);
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
    const Floats xi = to_floats(start + lanes), weight = load(&layout.weight[column * kWidth]);
    Floats x[order + 1]{}, y[order + 1]{};  // times the powers of eta
    for (int eta = -layout.half; eta <= layout.half; ++eta, g += kWidth) {
      const std::ptrdiff_t at = eta * reference.stride + start;
      const Floats f = load(reference.f + at) - mean_f;
      const Floats r = (f - scale * (load(g) - mean_g)) * weight;
      r_r += r * r;
      r_f += r * f;
      r_1 += r;
      const float q = static_cast<float>(eta);
      Floats rx = r * load(reference.jx + at), ry = r * load(reference.jy + at);
      for (int power = 0; power <= order; ++power) {
        x[power] += rx;
        y[power] += ry;
        rx *= q;
        ry *= q;
      }
    }
    const auto gather = [&](const Floats(&s)[order + 1], Floats(&r)[kMonomials])
                            __attribute__((always_inline)) {
                              r[0] += s[0];
                              r[1] += s[0] * xi;
                              r[2] += s[1];
                              if constexpr (order == 2) {
                                r[3] += s[0] * xi * xi;
                                r[4] += s[1] * xi;
                                r[5] += s[2];
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

// Sums of terms over the blocks. `terms(at, pixel, sums)` adds those of kWidth pixels: `at` is their place in
// the planes, `pixel` in a Layout.
template <int count, class Terms>
RGBD_DIC_INLINE void sum_blocks(const Layout& layout, std::ptrdiff_t stride, float (&blocks)[kBlocks][count],
                                const Terms& terms) {
  const int size = layout.size();
  const Ints lanes = lane_numbers();
  for (auto& block : blocks)
    for (float& value : block) value = 0.0f;
  std::ptrdiff_t pixel = 0;
  for (int column = 0; column < layout.columns; ++column) {
    const int start = column * kWidth;
    for (int level = 0; level < kSide; ++level) {
      Floats sums[count]{};
      for (int line = block_start(level, size); line < block_start(level + 1, size); ++line, pixel += kWidth)
        terms((line - layout.half) * stride + start - layout.half, pixel, sums);
      for (int k = 0; k < kSide; ++k) {
        const int first = block_start(k, size), end = block_start(k + 1, size);
        if (end <= start || first >= start + kWidth) continue;
        const Ints within = (start + lanes >= first) & (start + lanes < end);
        for (int term = 0; term < count; ++term)
          blocks[level * kSide + k][term] += sum(within ? sums[term] : Floats{});
      }
    }
  }
}

void block_residuals(const Layout& layout, const ReferencePixels& reference, float mean_f, const float* g,
                     float mean_g, float scale, BlockResidual (&blocks)[kBlocks]) {
  float sums[kBlocks][3];
  sum_blocks(layout, reference.stride, sums,
             [&](std::ptrdiff_t at, std::ptrdiff_t pixel, Floats(&s)[3]) __attribute__((always_inline)) {
               const Floats r = load(reference.f + at) - mean_f - scale * (load(g + pixel) - mean_g);
               s[0] += r * r;
               s[1] += r * load(reference.jx + at);
               s[2] += r * load(reference.jy + at);
             });
  for (int q = 0; q < kBlocks; ++q) blocks[q] = {sums[q][0], sums[q][1], sums[q][2]};
}

void block_samples(const Layout& layout, const ReferencePixels& reference, float mean_f, const float* g,
                   float mean_g, BlockSamples (&blocks)[kBlocks]) {
  float sums[kBlocks][3];
  sum_blocks(layout, reference.stride, sums,
             [&](std::ptrdiff_t at, std::ptrdiff_t pixel, Floats(&s)[3]) __attribute__((always_inline)) {
               const Floats away = load(g + pixel) - mean_g;
               s[0] += away;
               s[1] += away * away;
               s[2] += away * (load(reference.f + at) - mean_f);
             });
  for (int q = 0; q < kBlocks; ++q) blocks[q] = {sums[q][0], sums[q][1], sums[q][2]};
}

void block_products(const Layout& layout, const ReferencePixels& reference, float mean_f,
                    BlockProducts (&blocks)[kBlocks]) {
  float sums[kBlocks][9];
  sum_blocks(layout, reference.stride, sums,
             [&](std::ptrdiff_t at, std::ptrdiff_t, Floats(&s)[9]) __attribute__((always_inline)) {
               const Floats f = load(reference.f + at) - mean_f;
               const Floats jx = load(reference.jx + at), jy = load(reference.jy + at);
               const Floats dx = load(reference.dx + at), dy = load(reference.dy + at);
               s[0] += f;
               s[1] += f * f;
               s[2] += jx * dx;
               s[3] += jx * dy;
               s[4] += jy * dx;
               s[5] += jy * dy;
               s[6] += dx * dx;
               s[7] += dx * dy;
               s[8] += dy * dy;
             });
  for (int q = 0; q < kBlocks; ++q) {
    const auto& s = sums[q];
    blocks[q] = {s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8]};
  }
}

// Sums of terms times eta^q xi^p, p + q <= powers, lane by lane: `add` takes the terms of a column of vectors
// line by line, `end_column` their powers of xi.
template <int powers>
struct LaneSums {
  Floats line[powers + 1]{}, total[powers + 1][powers + 1]{};  // by q; by q and p

  RGBD_DIC_INLINE void add(Floats term, float eta) {
    float power = 1.0f;
    for (int q = 0; q <= powers; ++q, power *= eta) line[q] += term * power;
  }

  RGBD_DIC_INLINE void end_column(Floats xi, Floats weight) {
    for (int q = 0; q <= powers; ++q) {
      Floats term = line[q] * weight;
      line[q] = Floats{};
      for (int p = 0; p + q <= powers; ++p) {
        total[q][p] += term;
        term *= xi;
      }
    }
  }

  template <int size>
  RGBD_DIC_INLINE void into(double (&sums)[size][size]) const {
    for (int q = 0; q <= powers; ++q)
      for (int p = 0; p + q <= powers; ++p) sums[q][p] = sum(total[q][p]);
  }
};

template <int order>
void product_sums_of(const Layout& layout, const ReferencePixels& reference, ProductSums& sums) {
  const Ints lanes = lane_numbers();
  sums = ProductSums{};
  Floats f_total{};
  for (int column = 0; column < layout.columns; ++column) {
    const int start = column * kWidth - layout.half;
    Floats f{};
    for (int eta = -layout.half; eta <= layout.half; ++eta)
      f += load(reference.f + eta * reference.stride + start);
    f_total += f * load(&layout.weight[column * kWidth]);
  }
  sums.f = sum(f_total);
  const float mean = static_cast<float>(sums.f / layout.count());
  LaneSums<2 * order> jx_dx, jx_dy, jy_dx, jy_dy, jx_jx, jx_jy, jy_jy;
  LaneSums<order> of_jx, of_jy, of_dx, of_dy, jx_f, jy_f, dx_f, dy_f;
  Floats f_f_total{};
  for (int column = 0; column < layout.columns; ++column) {
    const int start = column * kWidth - layout.half;
    const Floats xi = to_floats(start + lanes), weight = load(&layout.weight[column * kWidth]);
    const ReferencePixels middle = {reference.f + start,  reference.jx + start, reference.jy + start,
                                    reference.dx + start, reference.dy + start, reference.stride};
    for (int eta = -layout.half; eta <= layout.half; ++eta) {
      const std::ptrdiff_t at = eta * middle.stride;
      const float q = static_cast<float>(eta);
      const Floats jx = load(middle.jx + at), jy = load(middle.jy + at);
      const Floats dx = load(middle.dx + at), dy = load(middle.dy + at);
      jx_dx.add(jx * dx, q);
      jx_dy.add(jx * dy, q);
      jy_dx.add(jy * dx, q);
      jy_dy.add(jy * dy, q);
    }
    jx_dx.end_column(xi, weight);
    jx_dy.end_column(xi, weight);
    jy_dx.end_column(xi, weight);
    jy_dy.end_column(xi, weight);
    for (int eta = -layout.half; eta <= layout.half; ++eta) {
      const std::ptrdiff_t at = eta * middle.stride;
      const float q = static_cast<float>(eta);
      const Floats jx = load(middle.jx + at), jy = load(middle.jy + at);
      jx_jx.add(jx * jx, q);
      jx_jy.add(jx * jy, q);
      jy_jy.add(jy * jy, q);
    }
    jx_jx.end_column(xi, weight);
    jx_jy.end_column(xi, weight);
    jy_jy.end_column(xi, weight);
    Floats f_f{};
    for (int eta = -layout.half; eta <= layout.half; ++eta) {
      const std::ptrdiff_t at = eta * middle.stride;
      const float q = static_cast<float>(eta);
      const Floats f = load(middle.f + at) - mean;
      const Floats jx = load(middle.jx + at), jy = load(middle.jy + at);
      const Floats dx = load(middle.dx + at), dy = load(middle.dy + at);
      f_f += f * f;
      of_jx.add(jx, q);
      of_jy.add(jy, q);
      of_dx.add(dx, q);
      of_dy.add(dy, q);
      jx_f.add(jx * f, q);
      jy_f.add(jy * f, q);
      dx_f.add(dx * f, q);
      dy_f.add(dy * f, q);
    }
    f_f_total += f_f * weight;
    of_jx.end_column(xi, weight);
    of_jy.end_column(xi, weight);
    of_dx.end_column(xi, weight);
    of_dy.end_column(xi, weight);
    jx_f.end_column(xi, weight);
    jy_f.end_column(xi, weight);
    dx_f.end_column(xi, weight);
    dy_f.end_column(xi, weight);
  }
  sums.f_f = sum(f_f_total);
  jx_dx.into(sums.jx_dx);
  jx_dy.into(sums.jx_dy);
  jy_dx.into(sums.jy_dx);
  jy_dy.into(sums.jy_dy);
  jx_jx.into(sums.jx_jx);
  jx_jy.into(sums.jx_jy);
  jy_jy.into(sums.jy_jy);
  of_jx.into(sums.jx);
  of_jy.into(sums.jy);
  of_dx.into(sums.dx);
  of_dy.into(sums.dy);
  jx_f.into(sums.jx_f);
  jy_f.into(sums.jy_f);
  dx_f.into(sums.dx_f);
  dy_f.into(sums.dy_f);
}

void product_sums(const Layout& layout, const ReferencePixels& reference, int order, ProductSums& sums) {
  (order == 1 ? product_sums_of<1> : product_sums_of<2>)(layout, reference, sums);
}

}  // namespace rgbd_dic::RGBD_DIC_ISA
