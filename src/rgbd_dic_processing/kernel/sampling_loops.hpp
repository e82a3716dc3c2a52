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

// Of a sample s beyond the middle between two pixels.
template <int degree>
RGBD_DIC_INLINE void spline_weights(Floats s, Floats (&weights)[degree + 1]) {
  constexpr MirroredPieces<degree> pieces;
  const Floats square = s * s;
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

// The whole part of values, 0 to `most`.
RGBD_DIC_INLINE Ints whole_between(Floats values, int most) {
  const Ints whole = floor_of(values), up = whole > 0 ? whole : Ints{};
  return up < most ? up : Ints{} + most;
}

// A line of taps, weighed: lane l takes those from taps + l on.
template <int degree>
RGBD_DIC_INLINE Floats along_line(const Floats (&weights)[degree + 1], const float* taps) {
  Floats total = weights[0] * load(taps);
  for (int k = 1; k <= degree; ++k) total += weights[k] * load(taps + k);
  return total;
}

// Sum over lines of the weights times along(line). Lane l starts `below[l]` lines, at most `spread`, below
// the first one.
template <int degree, class Along>
RGBD_DIC_INLINE Floats interpolated(const Floats (&wy)[degree + 1], Ints below, int spread,
                                    const Along& along) {
  Floats value{};
  if (spread == 0) {
    for (int j = 0; j <= degree; ++j) value += wy[j] * along(j);
    return value;
  }
  if (spread == 1) {
    const Ints lower = below > 0;
    for (int line = 0; line <= degree + 1; ++line) {
      const Floats weight =
          lower ? (line == 0 ? Floats{} : wy[line - 1]) : (line > degree ? Floats{} : wy[line]);
      value += weight * along(line);
    }
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

// Where kWidth lines of pixels are along one axis of the target: pixel l of line k at begin[k] + start[k] + l
// (slope[k]
// + l bend), begin[k] being whole.
struct LinesAlong {
  float begin[kWidth], start[kWidth], slope[kWidth], bend;
  std::int32_t first[kWidth], last[kWidth];  // pixels: the least and the greatest that a position is beyond
  float from[kWidth];  // begin + start, from the middle between first and the pixel after it

  // Of lines `length` px long in the positions from low to high.
  RGBD_DIC_INLINE LinesAlong(Ints begins, Floats starts, Floats slopes, float bend, float length, float low,
                             float high)
      : bend(bend) {
    const Floats ends = starts + length * (slopes + length * bend);
    const float off = 0.25f * length * length * std::fabs(bend);  // the straight way, at most
    const Floats least = (starts < ends ? starts : ends) - off, most = (starts < ends ? ends : starts) + off;
    const Floats lowest = low - to_floats(begins), highest = high - to_floats(begins);
    const auto pixels = [&](Floats at) __attribute__((always_inline)) {  // NaN is at low
      const Floats not_before = at > lowest ? at : lowest;
      return floor_of(not_before < highest ? not_before : highest);
    };
    const Ints firsts = pixels(least);
    store(begin, to_floats(begins));
    store(start, starts);
    store(slope, slopes);
    store(first, begins + firsts);
    store(last, begins + pixels(most));
    store(from, starts - to_floats(firsts) - 0.5f);
  }

  RGBD_DIC_INLINE Floats positions(int line, Floats l) const {
    return begin[line] + (start[line] + l * (slope[line] + l * bend));
  }
  RGBD_DIC_INLINE Floats beyond_first(int line, Floats l) const {
    return from[line] + l * (slope[line] + l * bend);
  }
};

// Whether an offset of up to `half` and a polynomial of such are certain to stay within the bounds, rounding
// included.
RGBD_DIC_INLINE bool stays_within(const float (&w)[kMaxMonomials], int half, float low, float high) {
  const float reach = static_cast<float>(half), bend = std::fabs(w[3]) + std::fabs(w[4]) + std::fabs(w[5]);
  const float way = 1.0f + reach * (1.0f + std::fabs(w[1]) + std::fabs(w[2]) + reach * bend);
  return w[0] - way >= low && w[0] + way <= high;
}

template <int degree>
bool sample(const Layout& layout, const SplinePixels& target, const LocalWarp& warp, float* g) {
  constexpr int kTapsBefore = (degree - 1) / 2;
  const Ints lanes = lane_numbers();
  const bool far_inside = stays_within(warp.x, layout.half, target.low_x, target.high_x) &&
                          stays_within(warp.y, layout.half, target.low_y, target.high_y);
  for (int column = 0; column < layout.columns; ++column) {
    const int begin = column * kWidth - layout.half,
              end = begin + kWidth <= layout.half ? begin + kWidth : layout.half + 1;
    // Lanes beyond the subset repeat its last pixel.
    const Floats l = to_floats(lanes < end - begin ? lanes : Ints{} + (end - begin - 1));
    const float xi = static_cast<float>(begin), length = static_cast<float>(end - begin - 1);
    for (int top = -layout.half; top <= layout.half; top += kWidth) {
      const Floats eta = to_floats(top + lanes);
      // `step`: what a pixel further adds of itself.
      const auto along = [&](const float (&w)[kMaxMonomials], Ints begins, float step, float low,
                             float high) __attribute__((always_inline)) {
        const Floats slope = w[1] + eta * w[4];
        return LinesAlong(begins, (w[0] + eta * (w[2] + eta * w[5])) + xi * (slope + xi * w[3]),
                          slope + (2.0f * xi * w[3] + step), w[3], length, low, high);
      };
      const LinesAlong x = along(warp.x, Ints{} + begin, 1.0f, target.low_x, target.high_x);
      const LinesAlong y = along(warp.y, top + lanes, 0.0f, target.low_y, target.high_y);
      // x less the pixels gone:
      const LinesAlong ahead = along(warp.x, Ints{} + begin, 0.0f, target.low_x - length, target.high_x);
      const int lines = top + kWidth <= layout.half ? kWidth : layout.half - top + 1;
      for (int line = 0; line < lines; ++line, g += kWidth) {
        if (!far_inside) {  // NaN, which a polynomial that overflows gives, is not inside either
          const Floats at_x = x.positions(line, l), at_y = y.positions(line, l);
          const Ints inside = (at_x >= target.low_x) & (at_x <= target.high_x) & (at_y >= target.low_y) &
                              (at_y <= target.high_y);
          if (any(~inside)) return false;
        }
        Floats wx[degree + 1], wy[degree + 1];
        const int spread = y.last[line] - y.first[line];
        Floats s = y.beyond_first(line, l);
        Ints below{};
        if (spread > 0) {
          below = whole_between(s + 0.5f, spread);
          s -= to_floats(below);
        }
        spline_weights<degree>(s, wy);
        const float* taps = target.origin + (y.first[line] - kTapsBefore) * target.stride - kTapsBefore;

        const auto put = [&](const auto& along) __attribute__((always_inline)) {
          store(g, interpolated<degree>(wy, below, spread, along));
        };
        if (ahead.first[line] == ahead.last[line]) {  // neighbours in the subset are neighbours in the target
          spline_weights<degree>(ahead.beyond_first(line, l), wx);
          taps += ahead.first[line];
          put([&](int row) __attribute__((always_inline)) {
            return along_line<degree>(wx, taps + row * target.stride);
          });
          continue;
        }
        s = x.beyond_first(line, l);
        const int reach = x.last[line] - x.first[line];
        const Ints index = whole_between(s + 0.5f, reach);
        spline_weights<degree>(s - to_floats(index), wx);
        taps += x.first[line];
        if (kWidth >= 8 && reach < 2 * kWidth - degree) {
          put([&](int row) __attribute__((always_inline)) {
            const Floats low = load(taps + row * target.stride),
                         high = load(taps + row * target.stride + kWidth);
            Floats total = wx[0] * pick(low, high, index);
            for (int tap = 1; tap <= degree; ++tap) total += wx[tap] * pick(low, high, index + tap);
            return total;
          });
        } else if (reach < 2 * kWidth) {
          put([&](int row) __attribute__((always_inline)) {
            Floats total{};
            for (int tap = 0; tap <= degree; ++tap) {
              const float* from = taps + row * target.stride + tap;
              total += wx[tap] * pick(load(from), load(from + kWidth), index);
            }
            return total;
          });
        } else {
          put([&](int row) __attribute__((always_inline)) {
            Floats total{};
            for (int tap = 0; tap <= degree; ++tap) {
              const float* from = taps + row * target.stride + tap;
              Floats picked;
              for (int lane = 0; lane < kWidth; ++lane) picked[lane] = from[index[lane]];
              total += wx[tap] * picked;
            }
            return total;
          });
        }
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
      total += inside(layout, column) ? at(x) * at(y) : Floats{};
    }
  }
  return sum(total) / (lines * static_cast<float>(layout.size()));
}

}  // namespace rgbd_dic::RGBD_DIC_ISA
