// Interpolating uniform B-splines of degree 3 and 5 on an image: prefilter, samples, derivatives at the
// knots.
//
// The image is continued by mirroring about its first and last pixels (period 2 n - 2). Coefficients and
// samples are float32. Prefilter: M. Unser, A. Aldroubi, M. Eden, "B-spline signal processing", IEEE
// Transactions on Signal Processing 41 (1993).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "clones.hpp"
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
};

// The polynomial pieces of the basis: tap k of a sample at fraction t weighs sum over d of kPieces[d][k] t^d.
// The first tap is the pixel floor(x) - (degree - 1) / 2.
template <int degree>
struct SplinePieces;

template <>
struct SplinePieces<3> {
  static constexpr float kPieces[4][4] = {{1.f / 6, 4.f / 6, 1.f / 6, 0.f},
                                          {-3.f / 6, 0.f, 3.f / 6, 0.f},
                                          {3.f / 6, -6.f / 6, 3.f / 6, 0.f},
                                          {-1.f / 6, 3.f / 6, -3.f / 6, 1.f / 6}};
};

template <>
struct SplinePieces<5> {
  static constexpr float kPieces[6][6] = {
      {1.f / 120, 26.f / 120, 66.f / 120, 26.f / 120, 1.f / 120, 0.f},
      {-5.f / 120, -50.f / 120, 0.f, 50.f / 120, 5.f / 120, 0.f},
      {10.f / 120, 20.f / 120, -60.f / 120, 20.f / 120, 10.f / 120, 0.f},
      {-10.f / 120, 20.f / 120, 0.f, -20.f / 120, 10.f / 120, 0.f},
      {5.f / 120, -20.f / 120, 30.f / 120, -20.f / 120, 5.f / 120, 0.f},
      {-1.f / 120, 5.f / 120, -10.f / 120, 10.f / 120, -5.f / 120, 1.f / 120}};
};

// The degree + 1 weights at fraction t.
template <int degree>
RGBD_DIC_INLINE void spline_weights(float t, float* weights) {
  constexpr auto& pieces = SplinePieces<degree>::kPieces;
  for (int k = 0; k <= degree; ++k) {
    weights[k] = pieces[degree][k];
    for (int d = degree - 1; d >= 0; --d) weights[k] = weights[k] * t + pieces[d][k];
  }
}

// Lines that are filtered side by side, so that the recursion along them runs on vectors across them.
constexpr int kFilterLanes = 32;

// Filters `lanes` lines of `count` values in place; value k of line l is data[k * step + l].
RGBD_DIC_CLONES static void filter_lines(float* data, std::ptrdiff_t count, std::ptrdiff_t step, int lanes,
                                         const SplineDegree& spline) {
  float sum[kFilterLanes];
  for (int p = 0; p < spline.pole_count; ++p) {
    const double pole = spline.poles[p];
    const float z = static_cast<float>(pole);
    const float gain = static_cast<float>((1.0 - pole) * (1.0 - 1.0 / pole));
    for (std::ptrdiff_t k = 0; k < count; ++k)
      for (int l = 0; l < lanes; ++l) data[k * step + l] *= gain;

    // Forward, started by the mirrored line's sum of z^k c[k], cut where it is below float32's resolution.
    const int horizon = static_cast<int>(std::ceil(std::log(1e-9) / std::log(std::fabs(pole))));
    for (int l = 0; l < lanes; ++l) sum[l] = 0.0f;
    for (int k = horizon; k >= 0; --k) {
      const std::ptrdiff_t folded = k % (2 * count - 2);
      const float* value = data + (folded < count ? folded : 2 * count - 2 - folded) * step;
      for (int l = 0; l < lanes; ++l) sum[l] = sum[l] * z + value[l];
    }
    for (int l = 0; l < lanes; ++l) data[l] = sum[l];
    for (std::ptrdiff_t k = 1; k < count; ++k) {
      float* value = data + k * step;
#pragma omp simd
      for (int l = 0; l < lanes; ++l) value[l] += z * value[l - step];
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

inline void filter_along_columns(PaddedImage& image, const SplineDegree& spline, int threads) {
  parallel_blocks(image.cols(), kFilterLanes, threads, [&](int, std::ptrdiff_t begin, std::ptrdiff_t end) {
    filter_lines(image.row(0) + begin, image.rows(), image.stride(), static_cast<int>(end - begin), spline);
  });
}

inline void filter_along_rows(PaddedImage& image, const SplineDegree& spline, int threads) {
  const std::ptrdiff_t cols = image.cols();
  std::vector<float> transposed(static_cast<std::size_t>(threads * cols * kFilterLanes));
  parallel_blocks(image.rows(), kFilterLanes, threads,
                  [&](int worker, std::ptrdiff_t begin, std::ptrdiff_t end) {
                    float* lines = transposed.data() + worker * cols * kFilterLanes;
                    for (std::ptrdiff_t y = begin; y < end; ++y)
                      for (std::ptrdiff_t x = 0; x < cols; ++x)
                        lines[x * kFilterLanes + y - begin] = image.row(y)[x];
                    filter_lines(lines, cols, kFilterLanes, static_cast<int>(end - begin), spline);
                    for (std::ptrdiff_t y = begin; y < end; ++y)
                      for (std::ptrdiff_t x = 0; x < cols; ++x)
                        image.row(y)[x] = lines[x * kFilterLanes + y - begin];
                  });
}

// Partial derivatives of the interpolating spline at the pixels. Along the other axis the spline passes
// through the pixels, so that each derivative is that of a one-dimensional spline along its own axis.
inline PaddedImage derivative_x(PaddedImage image, const SplineDegree& spline, int threads) {
  filter_along_rows(image, spline, threads);
  image.mirror_margin();
  std::vector<float> line(static_cast<std::size_t>(image.cols()));
  for (std::ptrdiff_t y = 0; y < image.rows(); ++y) {
    float* c = image.row(y);
    for (std::ptrdiff_t x = 0; x < image.cols(); ++x)
      line[x] = spline.derivative[0] * (c[x + 1] - c[x - 1]) + spline.derivative[1] * (c[x + 2] - c[x - 2]);
    std::copy(line.begin(), line.end(), c);
  }
  return image;
}

inline PaddedImage derivative_y(PaddedImage image, const SplineDegree& spline, int threads) {
  filter_along_columns(image, spline, threads);
  image.mirror_margin();
  PaddedImage derivative = image;
  for (std::ptrdiff_t y = 0; y < image.rows(); ++y) {
    const float *up2 = image.row(y - 2), *up1 = image.row(y - 1);
    const float *down1 = image.row(y + 1), *down2 = image.row(y + 2);
    float* out = derivative.row(y);
    for (std::ptrdiff_t x = 0; x < image.cols(); ++x)
      out[x] = spline.derivative[0] * (down1[x] - up1[x]) + spline.derivative[1] * (down2[x] - up2[x]);
  }
  return derivative;
}

}  // namespace rgbd_dic
