// Inverse-compositional Gauss-Newton (IC-GN) of subsets with the zero-mean normalised sum of squared
// differences (ZNSSD), the warp being a given quadratic seed map composed with a local affine increment.
//
// S. Baker, I. Matthews, "Lucas-Kanade 20 years on", Int. J. of Computer Vision 56 (2004); B. Pan, K. Li, W.
// Tong, "Fast, robust and accurate DIC without redundant computations", Experimental Mechanics 53 (2013).
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "clones.hpp"
#include "reference.hpp"
#include "spline_image.hpp"
#include "threads.hpp"
#include "warp.hpp"

namespace rgbd_dic {

// Same numbers as rgbd_dic_msgs/msg/SubsetStatus.msg.
enum class SubsetStatus : std::uint8_t {
  kConverged = 0,
  kNotConverged = 1,
  kLowCorrelation = 2,
  kOutsideImage = 3,
  kLowTexture = 4,
  kDiverged = 5,
  kSkipped = 6,
};

struct Limits {
  int max_iterations;
  double tolerance_px;  // on the increment, its gradients multiplied by half the subset's size
  double min_zncc;
  double min_contrast;  // standard deviation of the reference subset, grey levels
  double max_shift_px;  // on |u| and |v|
};

constexpr double kMaxGradient = 0.5;         // on the gradients of the increment
constexpr double kMinTargetContrast = 1e-3;  // grey levels; below it the target is uniform but for rounding

struct SubsetResult {
  double x = std::numeric_limits<double>::quiet_NaN();  // found centre in the target, px
  double y = x;
  double sigma_x = x, sigma_y = x;  // standard uncertainty, px
  double zncc = x;
  int iterations = 0;
  SubsetStatus status = SubsetStatus::kNotConverged;
};

// Range of one coordinate that samples may have.
struct Range {
  float low, high;
};

// Evaluates both polynomials of a quadratic warp at all offsets; false if a position leaves its range.
RGBD_DIC_CLONES static bool warp_positions(const float* xi, const float* eta, int count, const float (&cx)[6],
                                           const float (&cy)[6], Range range_x, Range range_y, float* x,
                                           float* y) {
  int outside = 0;
#pragma omp simd reduction(| : outside)
  for (int i = 0; i < count; ++i) {
    const float p = xi[i], q = eta[i];
    const float at_x = cx[0] + p * (cx[1] + p * cx[3] + q * cx[4]) + q * (cx[2] + q * cx[5]);
    const float at_y = cy[0] + p * (cy[1] + p * cy[3] + q * cy[4]) + q * (cy[2] + q * cy[5]);
    // False for NaN, which a polynomial that overflows gives.
    const int inside =
        (at_x >= range_x.low) & (at_x <= range_x.high) & (at_y >= range_y.low) & (at_y <= range_y.high);
    outside |= inside ^ 1;
    x[i] = at_x;
    y[i] = at_y;
  }
  return outside == 0;
}

struct Moments {
  float mean, power;  // power: sum of squared deviations from the mean
};

RGBD_DIC_CLONES static Moments moments(const float* g, int count) {
  float sum = 0.0f, power = 0.0f;
#pragma omp simd reduction(+ : sum)
  for (int i = 0; i < count; ++i) sum += g[i];
  const float mean = sum / static_cast<float>(count);
#pragma omp simd reduction(+ : power)
  for (int i = 0; i < count; ++i) power += (g[i] - mean) * (g[i] - mean);
  return {mean, power};
}

// Sums over the subset of the residual r times itself, f, 1 and the columns of J.
struct ResidualSums {
  float r_r, r_f, r_1, r_j[kParameterCount];
};

RGBD_DIC_CLONES static ResidualSums residual_sums(const float* f, const float* fx, const float* fy,
                                                  const float* xi, const float* eta, const float* g,
                                                  int count, float mean, float scale) {
  float r_r = 0, r_f = 0, r_1 = 0, u = 0, ux = 0, uy = 0, v = 0, vx = 0, vy = 0;
#pragma omp simd reduction(+ : r_r, r_f, r_1, u, ux, uy, v, vx, vy)
  for (int i = 0; i < count; ++i) {
    const float r = f[i] - scale * (g[i] - mean), rx = r * fx[i], ry = r * fy[i];
    r_r += r * r;
    r_f += r * f[i];
    r_1 += r;
    u += rx;
    ux += rx * xi[i];
    uy += rx * eta[i];
    v += ry;
    vx += ry * xi[i];
    vy += ry * eta[i];
  }
  return {r_r, r_f, r_1, {u, ux, uy, v, vx, vy}};
}

// What one thread needs to correlate one subset after another.
struct Workspace {
  Patch patch;
  std::vector<float> x, y, g;

  explicit Workspace(int count) : patch(count), x(count), y(count), g(count) {}
};

// Samples the target at the warped positions into work.g; false if one leaves the image.
inline bool sample_target(const SplineImage& target, const SubsetGrid& grid, const Quadratic& warp,
                          Workspace& work) {
  const double x0 = std::floor(warp[0][0]), y0 = std::floor(warp[1][0]);
  const double right = static_cast<double>(target.cols() - 1),
               bottom = static_cast<double>(target.rows() - 1);
  if (!(x0 >= 0.0 && x0 <= right && y0 >= 0.0 && y0 <= bottom)) return false;
  float cx[6], cy[6];
  for (int k = 0; k < 6; ++k) {
    cx[k] = static_cast<float>(k == 0 ? warp[0][0] - x0 : warp[0][k]);
    cy[k] = static_cast<float>(k == 0 ? warp[1][0] - y0 : warp[1][k]);
    if (!std::isfinite(cx[k]) || !std::isfinite(cy[k])) return false;
  }
  const Range range_x = {static_cast<float>(-x0), static_cast<float>(right - x0)};
  const Range range_y = {static_cast<float>(-y0), static_cast<float>(bottom - y0)};
  if (!warp_positions(grid.xi.data(), grid.eta.data(), grid.count, cx, cy, range_x, range_y, work.x.data(),
                      work.y.data()))
    return false;
  target.sample(static_cast<std::ptrdiff_t>(x0), static_cast<std::ptrdiff_t>(y0), work.x.data(),
                work.y.data(), grid.count, work.g.data());
  return true;
}

inline SubsetResult correlate_subset(const Reference& reference, const Subset& subset,
                                     const SplineImage& target, const Quadratic& seed, const Limits& limits,
                                     Workspace& work) {
  const SubsetGrid& grid = reference.grid();
  const int n = grid.count;
  SubsetResult result;
  const auto ended = [&result](SubsetStatus status) {
    result.status = status;
    return result;
  };
  for (const auto& line : seed)
    for (const double coefficient : line)
      if (std::isnan(coefficient)) return ended(SubsetStatus::kSkipped);
  if (!subset.invertible || subset.contrast(n) < limits.min_contrast) return ended(SubsetStatus::kLowTexture);

  reference.load(subset, work.patch);
  Affine increment;
  while (result.iterations < limits.max_iterations) {
    ++result.iterations;
    if (!sample_target(target, grid, increment.seeded(seed), work)) return ended(SubsetStatus::kOutsideImage);

    const Moments g = moments(work.g.data(), n);
    if (!(g.power > n * kMinTargetContrast * kMinTargetContrast)) return ended(SubsetStatus::kLowCorrelation);
    const double scale = std::sqrt(subset.power / g.power);
    const ResidualSums sums =
        residual_sums(work.patch.f.data(), work.patch.fx.data(), work.patch.fy.data(), grid.xi.data(),
                      grid.eta.data(), work.g.data(), n, g.mean, static_cast<float>(scale));
    result.zncc = 1.0 - sums.r_r / (2.0 * subset.power);  // ZNSSD is |r|^2 / |f|^2

    Vector6 gradient{}, dp{};
    for (int k = 0; k < kParameterCount; ++k)
      gradient[k] = sums.r_j[k] - subset.mean_j[k] * sums.r_1 - subset.share_j[k] * sums.r_f;
    for (int k = 0; k < kParameterCount; ++k)
      for (int m = 0; m < kParameterCount; ++m) dp[k] -= subset.inverse[k][m] * gradient[m];
    if (!increment.compose_inverse(dp) || !increment.within(limits.max_shift_px, kMaxGradient))
      return ended(SubsetStatus::kDiverged);

    double step = dp[kU] * dp[kU] + dp[kV] * dp[kV];
    for (const int k : {kUx, kUy, kVx, kVy}) step += dp[k] * dp[k] * grid.half * grid.half;
    if (!(std::sqrt(step) < limits.tolerance_px)) continue;
    if (result.zncc < limits.min_zncc) return ended(SubsetStatus::kLowCorrelation);

    const Quadratic warp = increment.seeded(seed);
    // Residual variance with 8 parameters estimated, for white noise of equal strength in both images:
    // sampling between pixels weakens the target's share of the residual, but not what it does to the
    // parameters, which depend on low frequencies only.
    const double gain = target.noise_gain().mean(work.x.data(), work.y.data(), n);
    const double variance = sums.r_r / static_cast<double>(n - kParameterCount - 2) * 2.0 / (1.0 + gain);
    const double uu = variance * subset.inverse[kU][kU], uv = variance * subset.inverse[kU][kV],
                 vv = variance * subset.inverse[kV][kV];
    const auto sigma = [&](const std::array<double, 6>& w) {  // through the Jacobian of the whole warp
      return std::sqrt(w[1] * w[1] * uu + 2.0 * w[1] * w[2] * uv + w[2] * w[2] * vv);
    };
    result.x = warp[0][0];
    result.y = warp[1][0];
    result.sigma_x = sigma(warp[0]);
    result.sigma_y = sigma(warp[1]);
    return ended(SubsetStatus::kConverged);
  }
  return ended(SubsetStatus::kNotConverged);
}

// Correlates subset indices[i] (or subset i, if indices is null) for i < count and hands each result to
// store(i, result). `seeds` has one map for every subset of the reference, selected or not. What a subset
// gives depends neither on the others nor on the number of threads.
template <class Store>
void correlate_subsets(const Reference& reference, const SplineImage& target, const std::int32_t* indices,
                       const Quadratic* seeds, std::ptrdiff_t count, const Limits& limits, int threads,
                       const Store& store) {
  std::vector<Workspace> workspaces(static_cast<std::size_t>(threads), Workspace(reference.grid().count));
  parallel_blocks(count, 16, threads, [&](int worker, std::ptrdiff_t begin, std::ptrdiff_t end) {
    for (std::ptrdiff_t i = begin; i < end; ++i) {
      const std::ptrdiff_t k = indices ? indices[i] : i;
      store(i, correlate_subset(reference, reference[k], target, seeds[k], limits, workspaces[worker]));
    }
  });
}

}  // namespace rgbd_dic
