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
constexpr double kNotLinear = 0.01;

// Of the blocks, and over all of them.
struct Residuals {
  BlockResidual blocks[kBlocks];
  double power;  // sum of r^2
};

// Those of a subset of this size after the step that follows from the residuals of its blocks: r + D dp, dp
// with as many monomials along each axis.
inline Residuals after_step(const Subset& subset, int size, const BlockResidual (&blocks)[kBlocks],
                            const std::array<double, kMaxParameters>& dp, int monomials) {
  Residuals after{};
  std::copy_n(blocks, kBlocks, after.blocks);
  Polynomial u{}, v{};
  std::copy_n(dp.begin(), monomials, u.begin());
  std::copy_n(dp.begin() + monomials, monomials, v.begin());
  const auto extent = [size](int k) {  // of a block: its middle from the subset's centre, and its variance
    const double length = block_length(k, size);
    return std::pair(block_start(k, size) + 0.5 * (length - size), (length * length - 1.0) / 12.0);
  };
  for (int k = 0; k < kBlocks; ++k) {
    const auto [xi, wide] = extent(k % kSide);
    const auto [eta, high] = extent(k / kSide);
    const double u_0 = evaluated(u, xi, eta), u_x = u[1] + 2.0 * u[3] * xi + u[4] * eta,
                 u_y = u[2] + u[4] * xi + 2.0 * u[5] * eta;
    const double v_0 = evaluated(v, xi, eta), v_x = v[1] + 2.0 * v[3] * xi + v[4] * eta,
                 v_y = v[2] + v[4] * xi + 2.0 * v[5] * eta;
    const double u_u = u_0 * u_0 + u_x * u_x * wide + u_y * u_y * high,  // means over the block
        u_v = u_0 * v_0 + u_x * v_x * wide + u_y * v_y * high,
                 v_v = v_0 * v_0 + v_x * v_x * wide + v_y * v_y * high;
    const BlockProducts& block = subset.blocks[k];
    BlockResidual& r = after.blocks[k];
    r.r_jx += static_cast<float>(block.jx_dx * u_0 + block.jx_dy * v_0);
    r.r_jy += static_cast<float>(block.jy_dx * u_0 + block.jy_dy * v_0);
    // |r|^2 = |(r + D dp) - D dp|^2; across the pattern what is left is as little along D as along J.
    const double taken = block.dx_dx * u_u + 2.0 * block.dx_dy * u_v + block.dy_dy * v_v;
    r.r_r += static_cast<float>(2.0 * (r.r_jx * u_0 + r.r_jy * v_0) - taken);
    r.r_r = std::max(r.r_r, static_cast<float>(kNotLinear * taken));
    after.power += r.r_r;
  }
  return after;
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
inline BlockDisplacement block_displacement(const Subset& subset, int size,
                                            const BlockResidual (&residuals)[kBlocks], int monomials) {
  const int p = 2 * monomials;
  Square normal{}, inverse{};
  std::array<double, kMaxUnknowns> right{};
  const auto middle = [&](int k) {  // of a block, -1 to 1 over the subset, and half of its width
    const double whole = size, first = block_start(k, size), end = block_start(k + 1, size);
    return std::pair((first + end) / whole - 1.0, (end - first) / whole);
  };
  for (int k = 0; k < kBlocks; ++k) {
    const BlockProducts& block = subset.blocks[k];
    const auto [x, wide] = middle(k % kSide);
    const auto [y, high] = middle(k / kSide);
    const double xx = x * x + wide * wide / 3.0, yy = y * y + high * high / 3.0;  // means over the block
    const double powers[] = {
        1.0, x, y, xx, x * y, yy, x * (x * x + wide * wide), xx * y, x * yy, y * (y * y + high * high)};
    for (int a = 0; a < monomials; ++a) {
      right[a] += powers[a] * residuals[k].r_jx;
      right[monomials + a] += powers[a] * residuals[k].r_jy;
      for (int b = 0; b < monomials; ++b) {
        const double share = powers[a] * powers[b];
        normal[a * p + b] += share * block.jx_dx;
        normal[a * p + monomials + b] += share * block.jx_dy;
        normal[(monomials + a) * p + b] += share * block.jy_dx;
        normal[(monomials + a) * p + monomials + b] += share * block.jy_dy;
      }
    }
  }
  BlockDisplacement result;
  if (!invert(normal, p, inverse.data())) return result;
  for (int a = 0; a < p; ++a) {
    double parameter = 0.0;
    for (int b = 0; b < p; ++b) parameter += inverse[a * p + b] * right[b];
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
inline Misfit misfit(const Subset& subset, int size, const Residuals& residuals, double strength,
                     double max_misfit_px) {
  constexpr double kUnlike = 0.1 /* 1 - ZNCC */, kUneven = 4.0 /* between residual variances */;
  constexpr double kSignificant = 2.0;  // ratio of variances; hardly ever by chance
  Misfit result;

  std::array<double, 2 * kSide> r_r{}, f_f{}, count{};  // of the strips
  std::array<double, kBlocks> at_rest{};  // variance of the residual in blocks that were moved into place
  double explained = 0.0, texture = 0.0;
  int free = 0;
  for (int k = 0; k < kBlocks; ++k) {
    const BlockProducts& block = subset.blocks[k];
    const BlockResidual& r = residuals.blocks[k];
    for (const int strip : {k / kSide, kSide + k % kSide}) {
      r_r[strip] += r.r_r;
      f_f[strip] += block.f_f;
      count[strip] += block_count(k, size);
    }
    const double determinant =
        static_cast<double>(block.jx_dx) * block.jy_dy - static_cast<double>(block.jx_dy) * block.jy_dx;
    at_rest[k] = r.r_r / block_count(k, size);
    if (!(block.jx_dx > 0.0f && determinant > 0.05 * block.jx_dx * block.jy_dy))
      continue;  // says little across its texture
    const double share = (block.jy_dy * r.r_jx * r.r_jx - (block.jx_dy + block.jy_dx) * r.r_jx * r.r_jy +
                          block.jx_dx * r.r_jy * r.r_jy) /
                         determinant;
    const double taken = std::min(std::max(share, 0.0), static_cast<double>(r.r_r));
    at_rest[k] = (r.r_r - taken) / (block_count(k, size) - 2.0);
    explained += taken;
    texture += 0.5 * (block.jx_dx + block.jy_dy);
    free += 2;
  }
  double least = std::numeric_limits<double>::infinity();
  for (int strip = 0; strip < 2 * kSide; ++strip) least = std::min(least, r_r[strip] / count[strip]);
  for (int strip = 0; strip < 2 * kSide; ++strip)
    result.torn |= r_r[strip] > 2.0 * kUnlike * f_f[strip] && r_r[strip] > kUneven * least * count[strip];

  constexpr int kQuadratic = 6, kCubic = 10;  // monomials
  constexpr int kSmallest = 13;               // px; the blocks of smaller subsets tell nothing
  if (result.torn || free <= 2 * kCubic || size < kSmallest) return result;
  // Of the blocks, the median: one with something foreign in it cannot be moved into place.
  std::nth_element(at_rest.begin(), at_rest.begin() + kBlocks / 2, at_rest.end());
  const double white = strength * at_rest[kBlocks / 2];
  if (!(white > 0.0 && explained > kSignificant * white * free)) return result;

  const BlockDisplacement quadratic = block_displacement(subset, size, residuals.blocks, kQuadratic);
  const double cubic =
      block_displacement(subset, size, residuals.blocks, kCubic).explained - quadratic.explained;
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
inline bool is_partly_there(const Subset& subset, int size, const BlockSamples (&samples)[kBlocks]) {
  constexpr double kMatches = 0.8, kDoesNot = 0.5;  // ZNCC of a strip
  double best = -1.0, worst = 1.0;
  for (int strip = 0; strip < 2 * kSide; ++strip) {
    double count = 0, f = 0, g = 0, f_f = 0, g_g = 0, f_g = 0;
    for (int k = 0; k < kSide; ++k) {
      const int at = strip < kSide ? strip * kSide + k : k * kSide + strip - kSide;
      const BlockProducts& block = subset.blocks[at];
      count += block_count(at, size);
      f += block.f;
      f_f += block.f_f;
      g += samples[at].g;
      g_g += samples[at].g_g;
      f_g += samples[at].f_g;
    }
    const double powers = (f_f - f * f / count) * (g_g - g * g / count);
    const double zncc = powers > 0.0 ? (f_g - f * g / count) / std::sqrt(powers) : 0.0;
    best = std::max(best, zncc);
    worst = std::min(worst, zncc);
  }
  return best > kMatches && worst < kDoesNot;
}

}  // namespace rgbd_dic
