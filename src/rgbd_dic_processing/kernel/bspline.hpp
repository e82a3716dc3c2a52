// Interpolating uniform B-splines of degree 3 and 5 on an image: prefilter, derivatives at the knots, noise.
//
// The image is continued by mirroring about its first and last pixels (period 2 n - 2). Coefficients and
// samples are float32. Prefilter: M. Unser, A. Aldroubi, M. Eden, "B-spline signal processing", IEEE
// Transactions on Signal Processing 41 (1993).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "image.hpp"
#include "loops.hpp"
#include "padded_image.hpp"
#include "threads.hpp"

namespace rgbd_dic {

// What the degree fixes apart from the weights: the poles of the prefilter, and the derivative of the spline
// at a knot, sum over k of derivative[k - 1] * (c[+k] - c[-k]).
struct SplineDegree {
  int degree;
  int pole_count;
  double poles[2];
  float derivative[2];

  static SplineDegree of(int degree) {
    if (degree == 3) return {3, 1, {std::sqrt(3.0) - 2.0, 0.0}, {0.5f, 0.0f}};
    if (degree == 5) {
      const double root = std::sqrt(17745.0 / 4.0), outer = std::sqrt(105.0 / 4.0);
      return {5,
              2,
              {std::sqrt(67.5 - root) + outer - 6.5, std::sqrt(67.5 + root) - outer - 6.5},
              {10.0f / 24.0f, 1.0f / 24.0f}};
    }
    throw std::invalid_argument("degree = " + std::to_string(degree) +
                                ": the B-spline degree must be 3 or 5");
  }

  // Pixels beyond which a coefficient feels less than this share of a change; 1e-9 is nothing in float32.
  int reach(double share = 1e-9) const {
    return static_cast<int>(std::ceil(std::log(share) / std::log(std::fabs(poles[0]))));
  }
};

// A sampled Gaussian of standard deviation `sigma`, px, cut at four of them, of sum 1; just 1 for sigma = 0.
inline std::vector<double> gaussian_weights(double sigma) {
  const int reach = static_cast<int>(std::ceil(4.0 * sigma));
  std::vector<double> weights;
  double total = 0.0;
  for (int k = -reach; k <= reach; ++k) {
    weights.push_back(k == 0 ? 1.0 : std::exp(-0.5 * k * k / (sigma * sigma)));
    total += weights.back();
  }
  for (double& weight : weights) weight /= total;
  return weights;
}

// The spline's derivative at a pixel, along its axis, as the sum of these weights times the pixels around it.
// Along the other axis the spline passes through the pixels. What is cut off is below 1e-7 of it.
inline std::vector<double> derivative_weights(const SplineDegree& spline) {
  const int reach = spline.reach(1e-7);
  std::vector<double>
      cardinal;  // coefficients of the spline through a single 1: those of the poles, convolved
  const int wide = reach + 2;
  for (int k = -wide; k <= wide; ++k) cardinal.push_back(k == 0 ? 1.0 : 0.0);
  for (int p = 0; p < spline.pole_count; ++p) {
    const double z = spline.poles[p], gain = (1.0 - z) * (1.0 - z) / (1.0 - z * z);
    std::vector<double> next(cardinal.size(), 0.0);
    for (int at = -wide; at <= wide; ++at)
      for (int from = -wide; from <= wide; ++from)
        next[wide + at] += gain * std::pow(z, std::abs(at - from)) * cardinal[wide + from];
    cardinal = next;
  }
  std::vector<double> weights;
  for (int k = -reach; k <= reach; ++k)  // of the pixel k further on
    weights.push_back(spline.derivative[0] * (cardinal[wide - k + 1] - cardinal[wide - k - 1]) +
                      spline.derivative[1] * (cardinal[wide - k + 2] - cardinal[wide - k - 2]));
  return weights;
}

// Of two odd-sized symmetric or antisymmetric sets of weights about their middle.
inline std::vector<double> convolved(const std::vector<double>& one, const std::vector<double>& other) {
  std::vector<double> result(one.size() + other.size() - 1, 0.0);
  for (std::size_t i = 0; i < one.size(); ++i)
    for (std::size_t k = 0; k < other.size(); ++k) result[i + k] += one[i] * other[k];
  return result;
}

// A box of the image with weights applied along both axes, into the same place of another one. The image is
// continued by mirroring.
inline void weigh(const Loops& loops, const PaddedImage& image, const std::vector<double>& along_x,
                  const std::vector<double>& along_y, const Box& box, PaddedImage& result, int threads) {
  const std::ptrdiff_t reach_x = along_x.size() / 2, reach_y = along_y.size() / 2;
  const std::vector<float> x_weights(along_x.begin(), along_x.end()),
      y_weights(along_y.begin(), along_y.end());
  const auto mirrored = [](std::ptrdiff_t k, std::ptrdiff_t count) {
    const std::ptrdiff_t folded = std::abs(k) % (2 * count - 2);
    return folded < count ? folded : 2 * count - 2 - folded;
  };
  const std::ptrdiff_t first = box.x0 - reach_x,
                       end = box.x1 + reach_x;  // columns that the sums along x take
  const std::ptrdiff_t begin_known = std::max<std::ptrdiff_t>(first, 0),
                       end_known = std::min(end, image.cols());
  // A few lines at a time, and of the sums along y a strip at a time: what they take then stays in the cache.
  constexpr std::ptrdiff_t kLines = 16, kStrip = 128;
  const std::ptrdiff_t before = (reach_x + 15) / 16 * 16, stride = (before + end + 15) / 16 * 16;
  const std::size_t taken = kLines - 1 + y_weights.size();
  struct Workspace {
    FloatBuffer lines;
    std::vector<const float*> around, shifted;
  };
  std::vector<Workspace> workspaces;
  for (int worker = 0; worker < threads; ++worker)
    workspaces.push_back({FloatBuffer(static_cast<std::size_t>(kLines * stride)),
                          std::vector<const float*>(taken), std::vector<const float*>(x_weights.size())});
  parallel_blocks(
      box.y1 - box.y0, kLines, threads, [&](int worker, std::ptrdiff_t begin, std::ptrdiff_t stop) {
        auto& [lines, around, shifted] = workspaces[static_cast<std::size_t>(worker)];
        for (std::ptrdiff_t x = begin_known / 16 * 16; x < end_known; x += kStrip) {
          for (std::size_t k = 0; k < taken; ++k)
            around[k] =
                image.row(mirrored(box.y0 + begin + static_cast<std::ptrdiff_t>(k) - reach_y, image.rows())) +
                x;
          for (std::ptrdiff_t y = begin; y < stop; ++y)
            loops.weighted_sum(around.data() + (y - begin), y_weights.data(),
                               static_cast<int>(y_weights.size()), std::min(kStrip, end_known - x),
                               lines.data() + (y - begin) * stride + before + x);
        }
        for (std::ptrdiff_t y = begin; y < stop; ++y) {
          float* line = lines.data() + (y - begin) * stride + before;
          for (std::ptrdiff_t x = first; x < begin_known; ++x) line[x] = line[mirrored(x, image.cols())];
          for (std::ptrdiff_t x = end_known; x < end; ++x) line[x] = line[mirrored(x, image.cols())];
          for (std::size_t k = 0; k < x_weights.size(); ++k) shifted[k] = line + first + k;
          loops.weighted_sum(shifted.data(), x_weights.data(), static_cast<int>(x_weights.size()),
                             box.x1 - box.x0, result.row(box.y0 + y) + box.x0);
        }
      });
}

// What white noise of unit variance in the pixels leaves in what is made of them.
class NoiseGain {
 public:
  NoiseGain(const Loops& loops, const SplineDegree& spline, double smoothing) {
    Line coefficients{};  // of the spline through a single 1; nothing is left of it at the ends
    coefficients[kReach] = 1.0f;
    loops.filter_lines(coefficients.data(), kCount, 1, 1, spline.pole_count, spline.poles);

    // The variance of a sample at fraction t along one axis is the sum of the squared cardinal spline at all
    // t + k. It is even about t = 1/2; here as a polynomial through four points in (t - 1/2)^2.
    constexpr int kPoints = 4;
    std::array<double, kPoints> square{}, slope{};
    for (int point = 0; point < kPoints; ++point) {
      const double s = 0.5 * std::sqrt(0.5 - 0.5 * std::cos((point + 0.5) * M_PI / kPoints));
      square[point] = s * s;
      slope[point] = sample_variance(coefficients, spline.degree, 0.5 + s);
    }
    for (int level = 1; level < kPoints; ++level)  // divided differences (Newton)
      for (int k = kPoints - 1; k >= level; --k)
        slope[k] = (slope[k] - slope[k - 1]) / (square[k] - square[k - level]);
    std::array<double, kPoints> polynomial{};
    for (int k = kPoints - 1; k >= 0; --k) {
      for (int power = kPoints - 1; power > 0; --power)
        polynomial[power] = polynomial[power - 1] - square[k] * polynomial[power];
      polynomial[0] = slope[k] - square[k] * polynomial[0];
    }
    for (int power = 0; power < kPoints; ++power) sample_[power] = static_cast<float>(polynomial[power]);

    const std::vector<double> gaussian = gaussian_weights(smoothing), plain = derivative_weights(spline);
    const std::vector<double> smooth = convolved(plain, gaussian);
    double across = 0.0;
    for (const double weight : gaussian) across += weight * weight;
    const std::size_t reach = gaussian.size() / 2;
    for (std::size_t k = 0; k < plain.size(); ++k) j_d_ += smooth[k + reach] * plain[k] * gaussian[reach];
    for (const double weight : smooth) j_j_ += weight * weight * across;
  }

  // The variance of a sample is p(x) p(y), p the polynomial of these coefficients in (fraction - 1/2)^2.
  const float (&sample() const)[4] { return sample_; }

  // Of products of the two gradients of ReferencePixels, along the same axis.
  double j_d() const { return j_d_; }
  double j_j() const { return j_j_; }

 private:
  static constexpr int kReach = 48, kCount = 2 * kReach + 1;
  using Line = std::array<float, kCount>;

  static double basis(int degree, double x) {  // the B-spline about 0, by its truncated powers
    double value = 0.0, sign = 1.0, binomial = 1.0, factorial = 1.0;
    for (int k = 0; k <= degree + 1; ++k) {
      value += sign * binomial * std::pow(std::max(0.0, x + 0.5 * (degree + 1) - k), degree);
      sign = -sign;
      binomial *= static_cast<double>(degree + 1 - k) / (k + 1);
    }
    for (int k = 2; k <= degree; ++k) factorial *= k;
    return value / factorial;
  }

  static double sample_variance(const Line& coefficients, int degree, double t) {
    double variance = 0.0;
    for (int at = 3; at < kCount - 3; ++at) {
      double cardinal = 0.0;
      for (int k = -3; k <= 3; ++k) cardinal += coefficients[at + k] * basis(degree, t - k);
      variance += cardinal * cardinal;
    }
    return variance;
  }

  float sample_[4];
  double j_d_ = 0.0, j_j_ = 0.0;
};

}  // namespace rgbd_dic
