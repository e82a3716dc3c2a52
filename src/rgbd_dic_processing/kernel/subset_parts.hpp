// What the parts of a subset tell: its blocks, and the strips that they form.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "loops.hpp"
#include "reference.hpp"
#include "warp.hpp"

namespace rgbd_dic {

// Of what the last step takes off the residual's power, the part that stays in doubt: a step is not linear.
constexpr float kNotLinear = 0.01f;

// The blocks of subsets of one size.
struct BlockShapes {
  int size;                    // of the subset, px
  BlockSum xi, eta;            // of a block's middle from the subset's centre, px
  BlockSum wide, high, count;  // mean square of its pixels' way from there along x and y, px^2; its pixels

  explicit BlockShapes(int size) : size(size) {
    for (int k = 0; k < kBlocks; ++k) {
      const int column = k % kSide, level = k / kSide;
      const auto length = static_cast<float>(block_length(column, size)),
                 height = static_cast<float>(block_length(level, size));
      xi[k] = static_cast<float>(block_start(column, size)) + 0.5f * (length - static_cast<float>(size));
      eta[k] = static_cast<float>(block_start(level, size)) + 0.5f * (height - static_cast<float>(size));
      wide[k] = (length * length - 1.0f) / 12.0f;
      high[k] = (height * height - 1.0f) / 12.0f;
      count[k] = length * height;
    }
  }
};

// Turns residuals into those after the step that follows from them: r + D dp, dp with as many monomials along
// each axis.
inline void take_step(const Subset& subset, const BlockShapes& shapes,
                      const std::array<double, kMaxParameters>& dp, int monomials,
                      BlockResiduals& residuals) {
  float u[kMaxMonomials] = {}, v[kMaxMonomials] = {};
  for (int m = 0; m < monomials; ++m) {
    u[m] = static_cast<float>(dp[m]);
    v[m] = static_cast<float>(dp[monomials + m]);
  }
  const BlockProducts& sums = subset.blocks;
  for (int k = 0; k < kBlocks; ++k) {
    const float xi = shapes.xi[k], eta = shapes.eta[k], wide = shapes.wide[k], high = shapes.high[k];
    const float u_0 = u[0] + xi * (u[1] + xi * u[3] + eta * u[4]) + eta * (u[2] + eta * u[5]),
                u_x = u[1] + 2.0f * u[3] * xi + u[4] * eta, u_y = u[2] + u[4] * xi + 2.0f * u[5] * eta;
    const float v_0 = v[0] + xi * (v[1] + xi * v[3] + eta * v[4]) + eta * (v[2] + eta * v[5]),
                v_x = v[1] + 2.0f * v[3] * xi + v[4] * eta, v_y = v[2] + v[4] * xi + 2.0f * v[5] * eta;
    const float u_u = u_0 * u_0 + u_x * u_x * wide + u_y * u_y * high,  // means over the block
        u_v = u_0 * v_0 + u_x * v_x * wide + u_y * v_y * high,
                v_v = v_0 * v_0 + v_x * v_x * wide + v_y * v_y * high;
    const float r_jx = residuals.r_jx[k] + sums.jx_dx[k] * u_0 + sums.jx_dy[k] * v_0;
    const float r_jy = residuals.r_jy[k] + sums.jy_dx[k] * u_0 + sums.jy_dy[k] * v_0;
    // |r|^2 = |(r + D dp) - D dp|^2; across the pattern what is left is as little along D as along J.
    const float taken = sums.dx_dx[k] * u_u + 2.0f * sums.dx_dy[k] * u_v + sums.dy_dy[k] * v_v;
    const float r_r = residuals.r_r[k] + 2.0f * (r_jx * u_0 + r_jy * v_0) - taken;
    residuals.r_jx[k] = r_jx;
    residuals.r_jy[k] = r_jy;
    residuals.r_r[k] = std::max(r_r, kNotLinear * taken);
  }
}

// How the parts of a subset that came to rest are displaced against the whole.
struct Misfit {
  bool torn = false;
  double noise = 1.0;                 // variance of the noise that moves the parts, over that of the residual
  double bias_u = 0.0, bias_v = 0.0;  // of the point, for want of second-order terms, px
  double variance = 0.0;              // of the point, for what a quadratic displacement leaves, px^2
};

struct BlockDisplacement {
  double explained = 0.0;   // of the residual's power
  double u = 0.0, v = 0.0;  // in the middle of the subset, px
};

// The displacement that explains most of the block residuals, a polynomial in each direction, of the first
// `monomials` of [1, xi, eta, xi^2, xi eta, eta^2, xi^3, ...]. Zero if it is not determined.
inline BlockDisplacement block_displacement(const Subset& subset, int size, const BlockResiduals& residuals,
                                            int monomials) {
  const int p = 2 * monomials;
  Square normal{};
  std::array<double, kMaxUnknowns> right{};
  const auto middle = [&](int k) {  // of a block, -1 to 1 over the subset, and half of its width
    const double whole = size, first = block_start(k, size), end = block_start(k + 1, size);
    return std::pair((first + end) / whole - 1.0, (end - first) / whole);
  };
  for (int k = 0; k < kBlocks; ++k) {
    const auto [x, wide] = middle(k % kSide);
    const auto [y, high] = middle(k / kSide);
    const double xx = x * x + wide * wide / 3.0, yy = y * y + high * high / 3.0;  // means over the block
    const double powers[] = {
        1.0, x, y, xx, x * y, yy, x * (x * x + wide * wide), xx * y, x * yy, y * (y * y + high * high)};
    for (int a = 0; a < monomials; ++a) {
      right[a] += powers[a] * residuals.r_jx[k];
      right[monomials + a] += powers[a] * residuals.r_jy[k];
      for (int b = 0; b < monomials; ++b) {
        const double share = powers[a] * powers[b];
        normal[a * p + b] += share * subset.blocks.jx_dx[k];
        normal[a * p + monomials + b] += share * subset.blocks.jx_dy[k];
        normal[(monomials + a) * p + b] += share * subset.blocks.jy_dx[k];
        normal[(monomials + a) * p + monomials + b] += share * subset.blocks.jy_dy[k];
      }
    }
  }
  BlockDisplacement result;
  if (!invert(normal, p)) return result;
  for (int a = 0; a < p; ++a) {
    double parameter = 0.0;
    for (int b = 0; b < p; ++b) parameter += normal[a * p + b] * right[b];
    result.explained += parameter * right[a];
    if (a == 0) result.u = parameter;
    if (a == monomials) result.v = parameter;
  }
  return result;
}

// A subset is torn, by a crack or the border of something in front, if a strip of it is far less like the
// reference than another, or if its blocks, each free to move by itself, move as a step makes them, by more
// than max_misfit_px. Blocks are weighed by their texture: with s = J^T r and N = J^T D of a block, it
// moves by N^-1 s, which takes s^T N^-1 s off the residual's power. White noise would explain little by
// that. If more is explained, a quadratic displacement comes first; it says how far an affine fit is off.
// Next come cubic terms, which a step is mostly made of. What is left is noise that is not white.
// `strength` is the noise's variance per variance of the residual.
inline Misfit misfit(const Subset& subset, const BlockShapes& shapes, const BlockResiduals& residuals,
                     double strength, double max_misfit_px) {
  constexpr double kUnlike = 0.1 /* 1 - ZNCC */, kUneven = 4.0 /* between residual variances */;
  constexpr double kSignificant = 2.0;  // ratio of variances; hardly ever by chance
  const BlockProducts& sums = subset.blocks;
  Misfit result;

  BlockSum taken, at_rest;  // of a residual's power; its variance in blocks that were moved into place
  bool clear[kBlocks];      // others say little across their texture
  for (int k = 0; k < kBlocks; ++k) {
    const float r_jx = residuals.r_jx[k], r_jy = residuals.r_jy[k], r_r = residuals.r_r[k];
    const float both = sums.jx_dx[k] * sums.jy_dy[k], determinant = both - sums.jx_dy[k] * sums.jy_dx[k];
    clear[k] = (sums.jx_dx[k] > 0.0f) & (determinant > 0.05f * both);
    const float share = (sums.jy_dy[k] * r_jx * r_jx - (sums.jx_dy[k] + sums.jy_dx[k]) * r_jx * r_jy +
                         sums.jx_dx[k] * r_jy * r_jy) /
                        determinant;
    taken[k] = clear[k] ? std::min(std::max(share, 0.0f), r_r) : 0.0f;
    at_rest[k] = (r_r - taken[k]) / (clear[k] ? shapes.count[k] - 2.0f : shapes.count[k]);
  }
  std::array<double, 2 * kSide> r_r{}, f_f{}, count{};  // of the strips
  double explained = 0.0, texture = 0.0;
  int free = 0;
  for (int k = 0; k < kBlocks; ++k) {
    for (const int strip : {k / kSide, kSide + k % kSide}) {
      r_r[strip] += residuals.r_r[k];
      f_f[strip] += sums.f_f[k];
      count[strip] += shapes.count[k];
    }
    explained += taken[k];
    texture += clear[k] ? 0.5 * (sums.jx_dx[k] + sums.jy_dy[k]) : 0.0;
    free += 2 * clear[k];
  }
  double least = std::numeric_limits<double>::infinity();
  for (int strip = 0; strip < 2 * kSide; ++strip) least = std::min(least, r_r[strip] / count[strip]);
  for (int strip = 0; strip < 2 * kSide; ++strip)
    result.torn |= r_r[strip] > 2.0 * kUnlike * f_f[strip] && r_r[strip] > kUneven * least * count[strip];

  constexpr int kQuadratic = 6, kCubic = 10;  // monomials
  constexpr int kSmallest = 13;               // px; the blocks of smaller subsets tell nothing
  if (result.torn || free <= 2 * kCubic || shapes.size < kSmallest) return result;
  // White noise is what the median of the blocks has: one with something foreign in it cannot be moved into
  // place. That it is too little to explain so much is so seldom that the median is not sought before.
  const double at_most = explained / (kSignificant * strength * free);
  if (std::count_if(at_rest, at_rest + kBlocks, [&](float variance) { return variance < at_most; }) <=
      kBlocks / 2)
    return result;
  std::nth_element(at_rest, at_rest + kBlocks / 2, at_rest + kBlocks);
  const double white = strength * at_rest[kBlocks / 2];
  if (!(white > 0.0)) return result;

  const BlockDisplacement quadratic = block_displacement(subset, shapes.size, residuals, kQuadratic);
  const double cubic =
      block_displacement(subset, shapes.size, residuals, kCubic).explained - quadratic.explained;
  const double rest = std::max(explained - quadratic.explained - cubic, 0.0) / (free - 2 * kCubic);
  if (rest > kSignificant * white) result.noise = rest / white;
  const double noise = std::max(rest, white);
  if (quadratic.explained > kSignificant * noise * 2 * kQuadratic) {
    result.bias_u = quadratic.u;
    result.bias_v = quadratic.v;
  }
  if (cubic > kSignificant * noise * 2 * (kCubic - kQuadratic)) {
    // A step of 1 px through the middle moves the centre by 0.5 px and leaves 0.22 px beside a quadratic.
    constexpr double kStep = 0.5 / 0.22;
    const double unexplained = cubic / texture;
    result.torn = unexplained > max_misfit_px * max_misfit_px;
    result.variance = kStep * kStep * unexplained;
  }
  return result;
}

// Whether one strip of a subset matches its samples and another does not.
inline bool is_partly_there(const Subset& subset, const BlockShapes& shapes, const BlockSamples& samples) {
  constexpr double kMatches = 0.8, kDoesNot = 0.5;  // ZNCC of a strip
  double best = -1.0, worst = 1.0;
  for (int strip = 0; strip < 2 * kSide; ++strip) {
    double count = 0, f = 0, g = 0, f_f = 0, g_g = 0, f_g = 0;
    for (int k = 0; k < kSide; ++k) {
      const int at = strip < kSide ? strip * kSide + k : k * kSide + strip - kSide;
      count += shapes.count[at];
      f += subset.blocks.f[at];
      f_f += subset.blocks.f_f[at];
      g += samples.g[at];
      g_g += samples.g_g[at];
      f_g += samples.f_g[at];
    }
    const double powers = (f_f - f * f / count) * (g_g - g * g / count);
    const double zncc = powers > 0.0 ? (f_g - f * g / count) / std::sqrt(powers) : 0.0;
    best = std::max(best, zncc);
    worst = std::min(worst, zncc);
  }
  return best > kMatches && worst < kDoesNot;
}

}  // namespace rgbd_dic
