// The pixels of an image as they come.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "padded_image.hpp"

namespace rgbd_dic {

// A rectangle of pixels: x0 <= x < x1, y0 <= y < y1.
struct Box {
  std::ptrdiff_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;

  bool empty() const { return x0 >= x1 || y0 >= y1; }
  bool contains(const Box& other) const {
    return x0 <= other.x0 && y0 <= other.y0 && x1 >= other.x1 && y1 >= other.y1;
  }
  Box within(const Box& other) const {
    return {std::max(x0, other.x0), std::max(y0, other.y0), std::min(x1, other.x1), std::min(y1, other.y1)};
  }
  Box grown(std::ptrdiff_t by) const { return {x0 - by, y0 - by, x1 + by, y1 + by}; }
  Box from(const Box& frame) const {  // in coordinates that begin with the frame
    return {x0 - frame.x0, y0 - frame.y0, x1 - frame.x0, y1 - frame.y0};
  }
  Box joined(const Box& other) const {
    return {std::min(x0, other.x0), std::min(y0, other.y0), std::max(x1, other.x1), std::max(y1, other.y1)};
  }
};

class Image {
 public:
  static constexpr int kMinSize = 8;  // px; smaller images are refused

  using Pixels = std::variant<std::vector<std::uint8_t>, std::vector<float>>;

  Image(Pixels pixels, std::ptrdiff_t rows, std::ptrdiff_t cols)
      : rows_(rows), cols_(cols), pixels_(std::move(pixels)) {
    if (rows < kMinSize || cols < kMinSize)
      throw std::invalid_argument("image of " + std::to_string(rows) + " rows and " + std::to_string(cols) +
                                  " columns: at least " + std::to_string(kMinSize) + " of each are needed");
  }

  std::ptrdiff_t rows() const { return rows_; }
  std::ptrdiff_t cols() const { return cols_; }

  Box whole() const { return {0, 0, cols_, rows_}; }

  // A part of it, line by line `stride` floats apart.
  void copy(const Loops& loops, const Box& box, float* out, std::ptrdiff_t stride) const {
    for (std::ptrdiff_t y = box.y0; y < box.y1; ++y, out += stride) {
      const std::ptrdiff_t first = y * cols_ + box.x0, count = box.x1 - box.x0;
      if (const auto* bytes = std::get_if<std::vector<std::uint8_t>>(&pixels_))
        loops.to_floats(bytes->data() + first, count, out);
      else
        std::copy_n(std::get<std::vector<float>>(pixels_).data() + first, count, out);
    }
  }

 private:
  std::ptrdiff_t rows_, cols_;
  Pixels pixels_;
};

}  // namespace rgbd_dic
