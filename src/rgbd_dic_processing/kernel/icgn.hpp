// Inverse-compositional Gauss-Newton (IC-GN) of subsets with the zero-mean normalised sum of squared
// differences (ZNSSD), the warp being a given quadratic seed map composed with a local increment.
//
// S. Baker, I. Matthews, "Lucas-Kanade 20 years on", Int. J. of Computer Vision 56 (2004); B. Pan, K. Li, W.
// Tong, "Fast, robust and accurate DIC without redundant computations", Experimental Mechanics 53 (2013).
//
// The normal equations are J^T D dp = -J^T r with D the gradient of the reference and J that of the reference
// smoothed. J only weighs the residuals: where J^T r is zero does not depend on the noise, which is as often
// positive as negative there, and a smooth J lets less of it in. Where it is zero with J free of f does:
// noise makes f longer than the pattern in it (docs/method.md).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "loops.hpp"
#include "reference.hpp"
#include "spline_image.hpp"
#include "subset_parts.hpp"
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
  kTorn = 7,
};

struct Limits {
  int max_iterations;
  double tolerance_px;  // on what is left to go, gradients multiplied by half the subset's size
  double min_zncc;
  double min_contrast;   // standard deviation of the reference subset, grey levels
  double max_shift_px;   // on |u| and |v|
  double max_misfit_px;  // on what a quadratic leaves of displacements in the subset, RMS
};

constexpr double kMaxGradient = 0.5;  // on the gradients of the increment

// Rates by which the error shrinks: after a single step, and the least that is ever counted on.
constexpr double kFirstRate = 0.1, kLeastRate = 0.002;
// What noise in J^T D leaves when its mean is made up for, over that mean: it is not the same for each
// parameter, and the target's gradients are noisy too (measured).
constexpr double kNoiseRest = 2.0;
// The last step is at most this long, so that the residual before it tells of the one after it.
constexpr double kLongestLastStep = 0.02;  // px
// A subset with a ZNCC as low as kAbsurd after three iterations, or as kHopeless after kPatience, is not
// there.
constexpr double kAbsurd = 0.1, kHopeless = 0.3;
constexpr int kPatience = 6;

struct SubsetResult {
  double x = std::numeric_limits<double>::quiet_NaN();  // the point in the target, px
  double y = x;
  double sigma_x = x, sigma_y = x;  // standard uncertainty, px
  double zncc = x;
  int iterations = 0;
  SubsetStatus status = SubsetStatus::kNotConverged;
};

// Whether a subset can be searched at all.
inline SubsetStatus status_in_reference(const Reference& reference, std::ptrdiff_t index,
                                        double min_contrast) {
  const Subset& subset = reference[index];
  if (subset.state == Subset::State::kOutside) return SubsetStatus::kOutsideImage;
  const bool textured =
      subset.state == Subset::State::kUsable && subset.contrast(reference.layout().count()) >= min_contrast;
  return textured ? SubsetStatus::kConverged : SubsetStatus::kLowTexture;
}

// By how much the standard uncertainty that follows from J^T J and J^T D is wrong because the reference's
// noise is in them. It adds to J^T J, but acts with the target's noise only (with its own it cancels, J
// being an odd filter): half of it counts. In J^T D it is no gradient at all.
inline double noise_factor(double noise_variance, double jj, double jd) {
  return std::sqrt(std::max(1.0 - 0.5 * noise_variance * jj, 0.5)) /
         (1.0 - std::min(noise_variance * jd, 0.5));
}

// Standard uncertainty of a subset's point, x and y, px, that an image which differs from the reference by
// noise alone will have: white noise of this strength, grey levels, in both.
inline std::array<double, 2> expected_sigma(const Subset& subset, double noise) {
  const double variance = noise * noise;
  return {
      noise_factor(variance, subset.noise_jj_u, subset.noise_jd_u) * std::sqrt(2.0 * variance * subset.uu),
      noise_factor(variance, subset.noise_jj_v, subset.noise_jd_v) * std::sqrt(2.0 * variance * subset.vv)};
}

// One subset against the target.
class SubsetMatch {
 public:
  SubsetMatch(const Reference& reference, const SplineBox& target, const Limits& limits, FloatBuffer& samples)
      : reference_(reference),
        loops_(reference.loops()),
        layout_(reference.layout()),
        shapes_(layout_.size()),
        target_(target),
        limits_(limits),
        g_(samples.data()) {}

  SubsetResult correlate(std::ptrdiff_t index, const Quadratic& seed) {
    subset_ = &reference_[index];
    result_ = SubsetResult{};
    const int half = layout_.half, n = layout_.count(), p = reference_.model().parameters();
    for (const Polynomial& line : seed)
      for (const double coefficient : line)
        if (std::isnan(coefficient)) return ended(SubsetStatus::kSkipped);
    const SubsetStatus before = status_in_reference(reference_, index, limits_.min_contrast);
    if (before != SubsetStatus::kConverged) return ended(before);

    const SubsetEquations equations = reference_.equations(index);
    pixels_ = reference_.pixels(*subset_);
    mean_g_ = static_cast<float>(subset_->mean);  // the light as it was
    scale_ = 1.0f;
    Quadratic increment = kIdentity;
    double last_step = std::numeric_limits<double>::infinity(), relaxation = 1.0;
    std::array<double, kMaxParameters> last_edge{};
    while (result_.iterations < limits_.max_iterations) {
      ++result_.iterations;
      if (result_.zncc < (result_.iterations > kPatience ? kHopeless : kAbsurd) && result_.iterations > 3)
        return failed(SubsetStatus::kNotConverged, seed);
      if (!sample(composed(seed, increment))) return ended(SubsetStatus::kOutsideImage);
      std::array<double, kMaxParameters> gradient{}, dp{};  // gradient: J^T r
      double r_r = 0.0;
      if (!compare(equations, gradient, r_r)) return ended(SubsetStatus::kLowCorrelation);
      result_.zncc = 1.0 - r_r / (2.0 * subset_->power);  // ZNSSD is |r|^2 / |f|^2
      for (int k = 0; k < p; ++k)
        for (int m = 0; m < p; ++m) dp[k] -= equations.inverse[k * p + m] * gradient[m];
      std::array<double, kMaxParameters> edge{};  // motion of the subset's edge by each parameter, px
      double square = 0.0, turn = 0.0, turn_last = 0.0;
      for (int k = 0; k < p; ++k) {
        const int degree = kDegreeOf[k % (p / 2)];
        edge[k] = dp[k] * (degree == 0 ? 1 : degree == 1 ? half : half * half);
        square += edge[k] * edge[k];
        turn += (edge[k] - last_edge[k]) * (edge[k] - last_edge[k]);
        turn_last += (edge[k] - last_edge[k]) * last_edge[k];
      }
      // Noise in J^T D makes steps too short. The residual tells by how much once it is noise, after the
      // first step; after the second, the steps themselves (B. Irons, R. Tuck, "A version of the Aitken
      // accelerator for computer iteration", Int. J. for Numerical Methods in Engineering 1 (1969)).
      const double noise =
          std::min(0.5 * r_r / (n - p - 2) * std::max(subset_->noise_jd_u, subset_->noise_jd_v), 0.5);
      if (result_.iterations == 2) relaxation = 1.0 / (1.0 - noise);
      if (result_.iterations > 2) relaxation = std::min(std::max(-relaxation * turn_last / turn, 0.5), 2.5);
      last_edge = edge;
      Quadratic change = kIdentity, inverse;
      for (int k = 0; k < p; ++k) change[k / (p / 2)][k % (p / 2)] += relaxation * dp[k];
      if (!inverted(change, inverse)) return failed(SubsetStatus::kDiverged, seed);
      increment = composed(increment, inverse);
      if (!is_plausible(increment, half, limits_.max_shift_px, kMaxGradient))
        return failed(SubsetStatus::kDiverged, seed);

      // The error shrinks by what is left of the noise's share, and by a factor in proportion to itself, as
      // Gauss-Newton converges. The first two steps cannot tell the one from the other.
      const double step = std::sqrt(square), rate = step / last_step;  // of the step before
      const double next = result_.iterations == 1   ? kFirstRate
                          : result_.iterations == 2 ? rate * std::max(rate - noise, 0.0) + kNoiseRest * noise
                                                    : rate;
      const double left = step * std::max(next, kLeastRate);
      last_step = step;
      const bool arrived =
          next < 0.5 && left < (1.0 - next) * limits_.tolerance_px && step < kLongestLastStep;
      if (!arrived) continue;
      if (result_.zncc < limits_.min_zncc) return failed(SubsetStatus::kLowCorrelation, seed);
      for (double& parameter : dp) parameter *= relaxation;
      return judged(dp, composed(seed, increment));
    }
    return failed(SubsetStatus::kNotConverged, seed);
  }

 private:
  const SubsetResult& ended(SubsetStatus status) {
    result_.status = status;
    return result_;
  }

  // Samples the target at the warped positions; false if one leaves the image.
  bool sample(const Quadratic& warp) {
    const double x0 = std::floor(warp[0][0]), y0 = std::floor(warp[1][0]);
    const Box& box = target_.box;
    if (!(x0 >= static_cast<double>(box.x0) && x0 < static_cast<double>(box.x1) &&
          y0 >= static_cast<double>(box.y0) && y0 < static_cast<double>(box.y1)))
      return false;
    for (int k = 0; k < kMaxMonomials; ++k) {
      local_.x[k] = static_cast<float>(warp[0][k] - (k == 0 ? x0 : kIdentity[0][k]));
      local_.y[k] = static_cast<float>(warp[1][k] - (k == 0 ? y0 : kIdentity[1][k]));
    }
    const auto function = reference_.model().degree == 3 ? loops_.sample_cubic : loops_.sample_quintic;
    return function(layout_, target_.around(static_cast<std::ptrdiff_t>(x0), static_cast<std::ptrdiff_t>(y0)),
                    local_, g_);
  }

  // J^T r and |r|^2 of the residual r = f - mean_f - scale (g - mean_g) that has the scale |f| / |g|; false
  // if the samples are uniform, or too large to be squared. Scale and mean are those of the iteration before,
  // and follow from the residual as they should have been; they are measured where that would lose digits.
  bool compare(const SubsetEquations& equations, std::array<double, kMaxParameters>& j_r, double& r_r) {
    const SubsetModel& model = reference_.model();
    const double n = layout_.count(), power = subset_->power;
    const auto mean_f = static_cast<float>(subset_->mean);
    for (bool measured = false;; measured = true) {
      ResidualSums sums;
      loops_.residual_sums(layout_, pixels_, mean_f, g_, mean_g_, scale_, model.order, sums);
      // Of scale (g - mean_g) = f - mean_f - r:
      const double mean = -sums.r_1 / n, power_g = power - 2.0 * sums.r_f + sums.r_r - n * mean * mean;
      const bool near = n * mean * mean < 0.25 * power && power_g > 0.25 * power && power_g < 4.0 * power;
      if (!near && !measured) {
        const Moments g = loops_.moments(layout_, g_);
        if (is_uniform(g.mean, g.power, layout_.count()) || !std::isfinite(g.power)) return false;
        mean_g_ = g.mean;
        scale_ = static_cast<float>(std::sqrt(power / g.power));
        continue;
      }
      const double s = std::sqrt(power / power_g);
      // The residual is to be s r + (1 - s) f, both less their means.
      for (int k = 0; k < model.parameters(); ++k)
        j_r[k] =
            s * (sums.r_j[k] - equations.mean_j[k] * sums.r_1) + (1.0 - s) * equations.share_j[k] * power;
      const double rest = (1.0 - s) * ((1.0 - s) * power + 2.0 * s * sums.r_f);
      r_r = std::max(rest + s * s * (sums.r_r - n * mean * mean), 0.0);
      mean_g_ += static_cast<float>(mean / scale_);
      scale_ *= static_cast<float>(s);
      return true;
    }
  }

  // The result of a subset that comes to rest with the step dp.
  const SubsetResult& judged(const std::array<double, kMaxParameters>& dp, const Quadratic& warp) {
    BlockResiduals residuals;
    loops_.block_residuals(layout_, pixels_, static_cast<float>(subset_->mean), g_, mean_g_, scale_,
                           residuals);
    take_step(*subset_, shapes_, dp, reference_.model().parameters() / 2, residuals);
    const double power = std::accumulate(residuals.r_r, residuals.r_r + kBlocks, 0.0);
    // Residual variance with p + 2 parameters estimated, for white noise of equal strength in both images:
    // sampling between pixels weakens the target's share of the residual, but not what it does to the
    // parameters, which depend on low frequencies only.
    const double gain = loops_.mean_gain(layout_, local_, reference_.noise_gain().sample());
    const double strength = 2.0 / (1.0 + gain);
    const double variance = strength * power / (layout_.count() - reference_.model().parameters() - 2);
    const Misfit misfit = rgbd_dic::misfit(*subset_, shapes_, residuals, strength, limits_.max_misfit_px);
    if (misfit.torn) return ended(SubsetStatus::kTorn);

    const double u = noise_factor(0.5 * variance, subset_->noise_jj_u, subset_->noise_jd_u);
    const double v = noise_factor(0.5 * variance, subset_->noise_jj_v, subset_->noise_jd_v);
    // A pixel of the target is more or less than one of the reference.
    const double determinant = warp[0][1] * warp[1][2] - warp[0][2] * warp[1][1];
    const double spread = misfit.noise * variance * 0.5 * (1.0 + 1.0 / std::fabs(determinant));
    const double uu = spread * u * u * subset_->uu + misfit.bias_u * misfit.bias_u + misfit.variance;
    const double uv = spread * u * v * subset_->uv + misfit.bias_u * misfit.bias_v;
    const double vv = spread * v * v * subset_->vv + misfit.bias_v * misfit.bias_v + misfit.variance;
    const double xi = subset_->away_x, eta = subset_->away_y;
    const auto sigma = [&](const Polynomial& w) {  // through the Jacobian of the whole warp
      const double along_xi = w[1] + 2.0 * w[3] * xi + w[4] * eta,
                   along_eta = w[2] + w[4] * xi + 2.0 * w[5] * eta;
      return std::sqrt(along_xi * along_xi * uu + 2.0 * along_xi * along_eta * uv +
                       along_eta * along_eta * vv);
    };
    result_.x = evaluated(warp[0], xi, eta);
    result_.y = evaluated(warp[1], xi, eta);
    result_.sigma_x = sigma(warp[0]);
    result_.sigma_y = sigma(warp[1]);
    return ended(SubsetStatus::kConverged);
  }

  // The end of a subset that was not found: torn, if where the seed puts it a strip matches and another does
  // not.
  const SubsetResult& failed(SubsetStatus status, const Quadratic& seed) {
    if (!sample(seed)) return ended(status);
    BlockSamples samples;
    const float mean_g = loops_.moments(layout_, g_).mean;
    loops_.block_samples(layout_, pixels_, static_cast<float>(subset_->mean), g_, mean_g, samples);
    return ended(is_partly_there(*subset_, shapes_, samples) ? SubsetStatus::kTorn : status);
  }

  const Reference& reference_;
  const Loops& loops_;
  const Layout layout_;
  const BlockShapes shapes_;
  const SplineBox& target_;
  const Limits& limits_;
  float* g_;
  const Subset* subset_ = nullptr;
  ReferencePixels pixels_{};
  LocalWarp local_{};
  SubsetResult result_;
  float mean_g_ = 0.0f, scale_ = 1.0f;
};

// The part of the target that a subset can reach from its seed with a plausible increment.
inline Box reachable(const Quadratic& seed, int half, double max_shift, const Box& image) {
  const double way = half * (1.0 + 2.0 * kMaxGradient) + max_shift;
  std::array<double, 2> low{}, high{};
  for (int axis = 0; axis < 2; ++axis) {
    const Polynomial& s = seed[axis];
    const double reach = way * (std::fabs(s[1]) + std::fabs(s[2])) +
                         way * way * (std::fabs(s[3]) + std::fabs(s[4]) + std::fabs(s[5]));
    low[axis] = s[0] - reach - 1.0;
    high[axis] = s[0] + reach + 2.0;
    if (!(low[axis] <= high[axis])) return {};  // NaN
  }
  const auto pixel = [](double at, std::ptrdiff_t end) {
    return static_cast<std::ptrdiff_t>(std::min(std::max(at, 0.0), static_cast<double>(end)));
  };
  return {pixel(low[0], image.x1), pixel(low[1], image.y1), pixel(high[0], image.x1),
          pixel(high[1], image.y1)};
}

// Correlates subset indices[i] (or subset i, if indices is null) for i < count and hands each result to
// store(i, result). `seeds` has one map for every subset of the reference, selected or not. What a subset
// gives does not depend on the number of threads.
template <class Store>
void correlate_subsets(const Reference& reference, SplineImage& target, const std::int32_t* indices,
                       const Quadratic* seeds, std::ptrdiff_t count, const Limits& limits, int threads,
                       const Store& store) {
  const Layout layout = reference.layout();
  Box box = {target.cols(), target.rows(), 0, 0};
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    const Box reach =
        reachable(seeds[indices ? indices[i] : i], layout.half, limits.max_shift_px, target.whole());
    if (!reach.empty()) box = box.joined(reach);
  }
  const SplineBox coefficients = target.covering(box.empty() ? Box{0, 0, 1, 1} : box, threads);
  const std::size_t stored =
      static_cast<std::size_t>(layout.columns) * reference.loops().width * layout.size();
  std::vector<FloatBuffer> samples;
  for (int worker = 0; worker < threads; ++worker) samples.emplace_back(stored);
  parallel_blocks(count, 32, threads, [&](int worker, std::ptrdiff_t begin, std::ptrdiff_t end) {
    SubsetMatch match(reference, coefficients, limits, samples[worker]);
    for (std::ptrdiff_t i = begin; i < end; ++i) {
      const std::ptrdiff_t k = indices ? indices[i] : i;
      store(i, match.correlate(k, seeds[k]));
    }
  });
}

}  // namespace rgbd_dic
