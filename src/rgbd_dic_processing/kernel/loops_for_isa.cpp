// The loops for one instruction set: this file is compiled once for each, RGBD_DIC_ISA being its name.
//
// Nothing here may be an inline function or a template of a namespace that other files share: the linker
// could take the copy compiled here for all of them.
#include <cmath>

#include "loops.hpp"
#include "simd.hpp"

namespace rgbd_dic::RGBD_DIC_ISA {

// Basis of the uniform B-spline, its pieces as polynomials of the fraction t: tap k of a sample weighs
// sum over d of at[d][k] t^d. The first tap is the pixel floor(x) - (degree - 1) / 2.
template <int degree>
struct Pieces;

template <>
struct Pieces<3> {
  static constexpr double kOver = 6, at[4][4] = {{1, 4, 1, 0}, {-3, 0, 3, 0}, {3, -6, 3, 0}, {-1, 3, -3, 1}};
};

template <>
struct Pieces<5> {
  static constexpr double kOver = 120, at[6][6] = {{1, 26, 66, 26, 1, 0},    {-5, -50, 0, 50, 5, 0},
                                                   {10, 20, -60, 20, 10, 0}, {-10, 20, 0, -20, 10, 0},
                                                   {5, -20, 30, -20, 5, 0},  {-1, 5, -10, 10, -5, 1}};
};

// The same about t = 1/2, where tap degree - k is tap k mirrored: even and odd powers of s = t - 1/2 apart.
template <int degree>
struct MirroredPieces {
  float at[degree + 1][(degree + 1) / 2];  // power of s, tap

  constexpr MirroredPieces() : at() {
    for (int k = 0; k < (degree + 1) / 2; ++k)
      for (int power = 0; power <= degree; ++power) {
        double coefficient = 0, binomial_half = 1;  // of s^power in (s + 1/2)^d
        for (int d = power; d <= degree; ++d) {
          coefficient += Pieces<degree>::at[d][k] * binomial_half;
          binomial_half *= 0.5 * (d + 1) / (d + 1 - power);
        }
        at[power][k] = static_cast<float>(coefficient / Pieces<degree>::kOver);
      }
  }
};

template <int degree>
RGBD_DIC_INLINE void spline_weights(Floats t, Floats (&weights)[degree + 1]) {
  constexpr MirroredPieces<degree> pieces;
  const Floats s = t - 0.5f, square = s * s;
  for (int k = 0; k < (degree + 1) / 2; ++k) {
    Floats even = all_equal(pieces.at[degree - 1][k]), odd = all_equal(pieces.at[degree][k]);
    for (int power = degree - 3; power >= 0; power -= 2) {
      even = even * square + pieces.at[power][k];
      odd = odd * square + pieces.at[power + 1][k];
    }
    weights[k] = even + s * odd;
    weights[degree - k] = even - s * odd;
  }
}

// Sum over lines and taps of the weights times tap(line, k). Lane l starts `below[l]` lines, at most
// `spread`, below the first one.
template <int degree, class Tap>
RGBD_DIC_INLINE Floats interpolated(const Floats (&wx)[degree + 1], const Floats (&wy)[degree + 1],
                                    Ints below, int spread, const Tap& tap) {
  Floats value{};
  const auto along = [&](int line) __attribute__((always_inline)) {
    Floats total = wx[0] * tap(line, 0);
    for (int k = 1; k <= degree; ++k) total += wx[k] * tap(line, k);
    return total;
  };
  if (spread == 0) {
    for (int j = 0; j <= degree; ++j) value += wy[j] * along(j);
    return value;
  }
  for (int line = 0; line <= degree + spread; ++line) {
    Floats weight{};
    const int first = line > degree ? line - degree : 0, last = line < spread ? line : spread;
    for (int start = first; start <= last; ++start) weight = below == start ? wy[line - start] : weight;
    value += weight * along(line);
  }
  return value;
}

// Whether a polynomial of offsets up to `half` is certain to stay within the bounds, rounding included.
RGBD_DIC_INLINE bool stays_within(const float (&w)[kMaxMonomials], int half, float low, float high) {
  const float reach = static_cast<float>(half), bend = std::fabs(w[3]) + std::fabs(w[4]) + std::fabs(w[5]);
  const float way = 1.0f + reach * (std::fabs(w[1]) + std::fabs(w[2]) + reach * bend);
  return w[0] - way >= low && w[0] + way <= high;
}

template <int degree>
bool sample(const Layout& layout, const SplinePixels& target, const LocalWarp& warp, float* g) {
  constexpr int kTapsBefore = (degree - 1) / 2;
  const Ints lanes = lane_numbers();
  const bool far_inside = stays_within(warp.x, layout.half, target.low_x, target.high_x) &&
                          stays_within(warp.y, layout.half, target.low_y, target.high_y);
  for (int column = 0; column < layout.columns; ++column) {
    const int start = column * kWidth - layout.half;
    const Ints reaching = start + lanes;
    // Lanes beyond the subset repeat its last pixel.
    const Ints within = reaching <= layout.half;
    const Floats xi = to_floats(within ? reaching : Ints{} + layout.half);
    for (int eta = -layout.half; eta <= layout.half; ++eta, g += kWidth) {
      const float q = static_cast<float>(eta);
      const Floats x =
          (warp.x[0] + q * (warp.x[2] + q * warp.x[5])) + xi * ((warp.x[1] + q * warp.x[4]) + xi * warp.x[3]);
      const Floats y =
          (warp.y[0] + q * (warp.y[2] + q * warp.y[5])) + xi * ((warp.y[1] + q * warp.y[4]) + xi * warp.y[3]);
      if (!far_inside) {  // NaN, which a polynomial that overflows gives, is not inside either
        const Ints inside =
            (x >= target.low_x) & (x <= target.high_x) & (y >= target.low_y) & (y <= target.high_y);
        if (any(~inside)) return false;
      }

      const Ints whole_x = floor_of(x), whole_y = floor_of(y);
      Floats wx[degree + 1], wy[degree + 1];
      spline_weights<degree>(x - to_floats(whole_x), wx);
      spline_weights<degree>(y - to_floats(whole_y), wy);

      const bool level = !any(whole_y != whole_y[0]);
      const int top = level ? whole_y[0] : smallest(whole_y);
      const int spread = level ? 0 : largest(whole_y) - top;
      const float* lines = target.origin + (top - kTapsBefore) * target.stride - kTapsBefore;
      const Ints below = whole_y - top;

      const Ints ahead = whole_x - lanes;
      if (!any((ahead != ahead[0]) & within)) {  // neighbours in the subset are neighbours in the target
        const float* taps = lines + ahead[0];
        store(g, interpolated<degree>(wx, wy, below, spread,
                                      [&](int line, int k) __attribute__((always_inline)) {
                                        return load(taps + line * target.stride + k);
                                      }));
        continue;
      }
      const int left = smallest(whole_x);
      const Ints index = whole_x - left;
      const float* taps = lines + left;
      if (kWidth >= 8 && !any(index >= 2 * kWidth - degree)) {
        store(g, interpolated<degree>(wx, wy, below, spread,
                                      [&](int line, int k) __attribute__((always_inline)) {
                                        const float* from = taps + line * target.stride;
                                        return pick(load(from), load(from + kWidth), index + k);
                                      }));
      } else if (!any(index >= 2 * kWidth)) {
        store(g, interpolated<degree>(wx, wy, below, spread,
                                      [&](int line, int k) __attribute__((always_inline)) {
                                        const float* from = taps + line * target.stride + k;
                                        return pick(load(from), load(from + kWidth), index);
                                      }));
      } else {
        store(g, interpolated<degree>(wx, wy, below, spread,
                                      [&](int line, int k) __attribute__((always_inline)) {
                                        Floats picked;
                                        for (int l = 0; l < kWidth; ++l)
                                          picked[l] = taps[line * target.stride + k + index[l]];
                                        return picked;
                                      }));
      }
    }
  }
  return true;
}

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

float mean_gain(const Layout& layout, const LocalWarp& warp, const float (&gain)[4]) {
  const Ints lanes = lane_numbers();
  const auto at = [&](Floats position) __attribute__((always_inline)) {
    const Floats s = position - to_floats(floor_of(position)) - 0.5f, square = s * s;
    return gain[0] + square * (gain[1] + square * (gain[2] + square * gain[3]));
  };
  Floats total{};
  float lines = 0;
  for (int eta = -layout.half; eta <= layout.half; eta += 3, ++lines) {
    const float q = static_cast<float>(eta);
    for (int column = 0; column < layout.columns; ++column) {
      const Floats xi = to_floats(column * kWidth - layout.half + lanes);
      const Floats x =
          (warp.x[0] + q * (warp.x[2] + q * warp.x[5])) + xi * ((warp.x[1] + q * warp.x[4]) + xi * warp.x[3]);
      const Floats y =
          (warp.y[0] + q * (warp.y[2] + q * warp.y[5])) + xi * ((warp.y[1] + q * warp.y[4]) + xi * warp.y[3]);
      total += at(x) * at(y) * load(&layout.weight[column * kWidth]);
    }
  }
  return sum(total) / (lines * static_cast<float>(layout.size()));
}

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

#define RGBD_DIC_STRINGIFIED(text) #text
#define RGBD_DIC_NAME_OF(isa) RGBD_DIC_STRINGIFIED(isa)

extern const Loops kLoops;
const Loops kLoops = {RGBD_DIC_NAME_OF(RGBD_DIC_ISA),
                      kWidth,
                      sample<3>,
                      sample<5>,
                      moments,
                      residual_sums,
                      block_residuals,
                      block_samples,
                      product_sums,
                      block_products,
                      mean_gain,
                      filter_lines,
                      weighted_sum};

}  // namespace rgbd_dic::RGBD_DIC_ISA
