// How much of the pixels' noise is left in a sample between them.
#pragma once

#include <array>

#include "bspline.hpp"
#include "clones.hpp"

namespace rgbd_dic {

// Variance of a sample at fraction t along one axis when the pixels carry white noise of unit variance: the
// sum of the squared weights of all pixels, prefilter included. It is 1 at a pixel and least between two.
class NoiseGain {
 public:
  explicit NoiseGain(int degree) {
    std::array<float, kReach>
        impulse_response;  // of the prefilter; symmetric, and nothing is left at the ends
    impulse_response.fill(0.0f);
    impulse_response[kReach / 2] = 1.0f;
    filter_lines(impulse_response.data(), kReach, 1, 1, SplineDegree::of(degree));
    for (int node = 0; node <= kNodes; ++node) {
      const float t = static_cast<float>(node) / kNodes;
      std::array<float, 6> weights{};
      if (degree == 3)
        spline_weights<3>(t, weights.data());
      else
        spline_weights<5>(t, weights.data());
      double sum = 0.0;
      for (int first = 0; first + degree < kReach; ++first) {
        double weight = 0.0;
        for (int k = 0; k <= degree; ++k) weight += weights[k] * impulse_response[first + k];
        sum += weight * weight;
      }
      nodes_[node] = static_cast<float>(sum);
    }
    nodes_[kNodes + 1] = nodes_[kNodes];
  }

  // Mean of the variance of samples at (x[i], y[i]), i < count, positions in px; good to 1e-3.
  double mean(const float* x, const float* y, int count) const {
    return mean_of_products(nodes_.data(), x, y, count);
  }

 private:
  static constexpr int kNodes = 32, kReach = 65;

  // Linear between the nodes.
  static RGBD_DIC_INLINE float at(const float* nodes, float position) {
    int whole = static_cast<int>(position);
    whole -= position < static_cast<float>(whole) ? 1 : 0;
    const float scaled = (position - static_cast<float>(whole)) * kNodes;
    const int node = static_cast<int>(scaled);
    return nodes[node] + (scaled - static_cast<float>(node)) * (nodes[node + 1] - nodes[node]);
  }

  RGBD_DIC_CLONES static double mean_of_products(const float* nodes, const float* x, const float* y,
                                                 int count) {
    float sum = 0.0f;
#pragma omp simd reduction(+ : sum)
    for (int i = 0; i < count; ++i) sum += at(nodes, x[i]) * at(nodes, y[i]);
    return sum / static_cast<float>(count);
  }

  std::array<float, kNodes + 2> nodes_{};  // the last repeats the one before, for a fraction that rounds to 1
};

}  // namespace rgbd_dic
