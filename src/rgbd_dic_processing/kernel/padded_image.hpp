// A float32 image in memory as interpolation wants it.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>

#include "loops.hpp"

namespace rgbd_dic {

// A float32 image with a margin on every side wide enough for the taps of any sample inside the image.
class PaddedImage {
 public:
  static constexpr int kMargin = 3;

  PaddedImage() = default;

  // Its pixels are not set; the margin is zero.
  PaddedImage(std::ptrdiff_t rows, std::ptrdiff_t cols)
      : rows_(rows), cols_(cols), stride_(cols + 2 * kMargin), data_(new float[size()]) {
    const std::ptrdiff_t border = kMargin * stride_ + kMargin;
    std::fill_n(data_.get(), border, 0.0f);
    for (std::ptrdiff_t y = 0; y < rows; ++y) std::fill_n(row(y) + cols, 2 * kMargin, 0.0f);
    std::fill_n(row(rows), data_.get() + size() - row(rows), 0.0f);
  }

  std::ptrdiff_t rows() const { return rows_; }
  std::ptrdiff_t cols() const { return cols_; }
  std::ptrdiff_t stride() const { return stride_; }

  // Pixel (0, y); x and y from -kMargin to size - 1 + kMargin are in memory.
  float* row(std::ptrdiff_t y) { return data_.get() + (y + kMargin) * stride_ + kMargin; }
  const float* row(std::ptrdiff_t y) const { return data_.get() + (y + kMargin) * stride_ + kMargin; }

  // Fills the margin with the mirrored inside.
  void mirror_margin() {
    for (std::ptrdiff_t y = 0; y < rows_; ++y) {
      float* line = row(y);
      for (int k = 1; k <= kMargin; ++k) {
        line[-k] = line[k];
        line[cols_ - 1 + k] = line[cols_ - 1 - k];
      }
    }
    for (int k = 1; k <= kMargin; ++k) {
      std::copy_n(row(k) - kMargin, stride_, row(-k) - kMargin);
      std::copy_n(row(rows_ - 1 - k) - kMargin, stride_, row(rows_ - 1 + k) - kMargin);
    }
  }

 private:
  std::size_t size() const { return static_cast<std::size_t>(stride_ * (rows_ + 2 * kMargin) + kReadAhead); }

  std::ptrdiff_t rows_ = 0, cols_ = 0, stride_ = 0;
  std::unique_ptr<float[]> data_;
};

}  // namespace rgbd_dic
