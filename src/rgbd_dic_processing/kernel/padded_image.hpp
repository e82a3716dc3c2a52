// A float32 image in memory as interpolation wants it.
#pragma once

#include <cstddef>

#include "loops.hpp"
#include "memory.hpp"

namespace rgbd_dic {

// A float32 image with a margin on every side wide enough for the taps of any sample inside the image.
// Nothing is set, neither pixels nor margin. Lines begin where vectors do; an odd number of them makes up a
// line, as pixels below each other would displace each other from the cache if it were a power of two.
class PaddedImage {
 public:
  static constexpr int kMargin = 3;

  PaddedImage() = default;
  PaddedImage(std::ptrdiff_t rows, std::ptrdiff_t cols)
      : rows_(rows),
        cols_(cols),
        stride_((kLead + cols + kMargin + kVector - 1) / kVector / 2 * 2 * kVector + kVector),
        data_(static_cast<std::size_t>(stride_ * (rows + 2 * kMargin) + kReadAhead)) {}

  std::ptrdiff_t rows() const { return rows_; }
  std::ptrdiff_t cols() const { return cols_; }
  std::ptrdiff_t stride() const { return stride_; }

  // Pixel (0, y); x and y from -kMargin to size - 1 + kMargin are in memory.
  float* row(std::ptrdiff_t y) { return data_.data() + (y + kMargin) * stride_ + kLead; }
  const float* row(std::ptrdiff_t y) const { return data_.data() + (y + kMargin) * stride_ + kLead; }

 private:
  static constexpr std::ptrdiff_t kVector = 16, kLead = kVector;  // floats; the widest one; before pixel 0
  std::ptrdiff_t rows_ = 0, cols_ = 0, stride_ = 0;
  FloatBuffer data_;
};

}  // namespace rgbd_dic
