// A float32 image in memory as interpolation wants it.
#pragma once

#include <algorithm>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace rgbd_dic {

// A float32 image with a margin on every side wide enough for the taps of any sample inside the image.
class PaddedImage {
 public:
  static constexpr int kMargin = 3;
  static constexpr int kMinSize = 8;  // px; smaller images are refused

  template <class Pixel>
  PaddedImage(const Pixel* pixels, std::ptrdiff_t rows, std::ptrdiff_t cols) : rows_(rows), cols_(cols) {
    if (rows < kMinSize || cols < kMinSize)
      throw std::invalid_argument("image of " + std::to_string(rows) + " rows and " + std::to_string(cols) +
                                  " columns: at least " + std::to_string(kMinSize) + " of each are needed");
    stride_ = cols + 2 * kMargin;
    data_.assign(static_cast<std::size_t>(stride_ * (rows + 2 * kMargin)), 0.0f);
    for (std::ptrdiff_t y = 0; y < rows; ++y) std::copy_n(pixels + y * cols, cols, row(y));
  }

  std::ptrdiff_t rows() const { return rows_; }
  std::ptrdiff_t cols() const { return cols_; }
  std::ptrdiff_t stride() const { return stride_; }

  // Pixel (0, y); x and y from -kMargin to size - 1 + kMargin are in memory.
  float* row(std::ptrdiff_t y) { return data_.data() + (y + kMargin) * stride_ + kMargin; }
  const float* row(std::ptrdiff_t y) const { return data_.data() + (y + kMargin) * stride_ + kMargin; }

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
  std::ptrdiff_t rows_, cols_, stride_ = 0;
  std::vector<float> data_;
};

}  // namespace rgbd_dic
