// Samples of an image's interpolating B-spline.
#pragma once

#include <algorithm>
#include <cstddef>
#include <utility>

#include "bspline.hpp"
#include "clones.hpp"
#include "noise_gain.hpp"
#include "padded_image.hpp"

namespace rgbd_dic {

// Pixels whose weights are held at a time.
constexpr int kSampleBlock = 64;

// Samples a spline at (x[i], y[i]), i < count, positions relative to the pixel that `origin` points at. Kept
// relative and small, a float32 position is good to 1e-6 px wherever in the image the subset lies.
template <int degree>
RGBD_DIC_INLINE void sample_spline(const float* origin, std::ptrdiff_t stride, const float* x, const float* y,
                                   int count, float* value) {
  constexpr int kTaps = degree + 1;
  constexpr auto& pieces = SplinePieces<degree>::kPieces;
  const float* corner = origin - (degree - 1) / 2 * (stride + 1);
  const int pitch = static_cast<int>(stride);
  int first[kSampleBlock];
  float tx[kSampleBlock], ty[kSampleBlock], wx[kTaps][kSampleBlock], wy[kTaps][kSampleBlock];
  for (int begin = 0; begin < count; begin += kSampleBlock) {
    const int size = std::min(kSampleBlock, count - begin);
    const float *xs = x + begin, *ys = y + begin;
    float* out = value + begin;
#pragma omp simd
    for (int i = 0; i < size; ++i) {
      int column = static_cast<int>(xs[i]), line = static_cast<int>(ys[i]);
      column -= xs[i] < static_cast<float>(column) ? 1 : 0;
      line -= ys[i] < static_cast<float>(line) ? 1 : 0;
      tx[i] = xs[i] - static_cast<float>(column);
      ty[i] = ys[i] - static_cast<float>(line);
      first[i] = line * pitch + column;
      out[i] = 0.0f;
    }
    for (int k = 0; k < kTaps; ++k) {
#pragma omp simd
      for (int i = 0; i < size; ++i) {
        float at_x = pieces[degree][k], at_y = pieces[degree][k];
        for (int d = degree - 1; d >= 0; --d) {
          at_x = at_x * tx[i] + pieces[d][k];
          at_y = at_y * ty[i] + pieces[d][k];
        }
        wx[k][i] = at_x;
        wy[k][i] = at_y;
      }
    }
    for (int j = 0; j < kTaps; ++j) {
      const float* taps = corner + j * stride;
#pragma omp simd
      for (int i = 0; i < size; ++i) {
        float along_x = 0.0f;
        for (int k = 0; k < kTaps; ++k) along_x += wx[k][i] * taps[first[i] + k];
        out[i] += wy[j][i] * along_x;
      }
    }
  }
}

RGBD_DIC_CLONES static void sample_cubic(const float* origin, std::ptrdiff_t stride, const float* x,
                                         const float* y, int count, float* value) {
  sample_spline<3>(origin, stride, x, y, count, value);
}

RGBD_DIC_CLONES static void sample_quintic(const float* origin, std::ptrdiff_t stride, const float* x,
                                           const float* y, int count, float* value) {
  sample_spline<5>(origin, stride, x, y, count, value);
}

// The B-spline coefficients of one image.
class SplineImage {
 public:
  SplineImage(PaddedImage image, int degree, int threads)
      : spline_(SplineDegree::of(degree)), noise_gain_(degree), coefficients_(std::move(image)) {
    filter_along_columns(coefficients_, spline_, threads);
    filter_along_rows(coefficients_, spline_, threads);
    coefficients_.mirror_margin();
  }

  int degree() const { return spline_.degree; }
  std::ptrdiff_t rows() const { return coefficients_.rows(); }
  std::ptrdiff_t cols() const { return coefficients_.cols(); }

  // Samples at (x[i], y[i]) relative to pixel (x0, y0); each must lie within the image, which is not checked.
  void sample(std::ptrdiff_t x0, std::ptrdiff_t y0, const float* x, const float* y, int count,
              float* value) const {
    const auto function = spline_.degree == 3 ? sample_cubic : sample_quintic;
    function(coefficients_.row(y0) + x0, coefficients_.stride(), x, y, count, value);
  }

  const NoiseGain& noise_gain() const { return noise_gain_; }

 private:
  SplineDegree spline_;
  NoiseGain noise_gain_;
  PaddedImage coefficients_;
};

}  // namespace rgbd_dic
