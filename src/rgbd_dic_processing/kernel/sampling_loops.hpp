// Samples of a B-spline at warped positions, and what noise is left in them. Included only by
// loops_for_isa.cpp, after simd.hpp.
#include <cmath>
#include <cstddef>

#include "loops.hpp"

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

}  // namespace rgbd_dic::RGBD_DIC_ISA
