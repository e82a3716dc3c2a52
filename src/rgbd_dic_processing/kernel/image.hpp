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

  // A part of it, margin not filled.
  PaddedImage part(const Box& box) const {
    PaddedImage part(box.y1 - box.y0, box.x1 - box.x0);
    std::visit(
        [&](const auto& pixels) {
          for (std::ptrdiff_t y = box.y0; y < box.y1; ++y)
            std::copy_n(pixels.data() + y * cols_ + box.x0, box.x1 - box.x0, part.row(y - box.y0));
        },
        pixels_);
    return part;
  }

  PaddedImage whole() const { return part({0, 0, cols_, rows_}); }

 private:
  std::ptrdiff_t rows_, cols_;
  Pixels pixels_;
};

}  // namespace rgbd_dic
