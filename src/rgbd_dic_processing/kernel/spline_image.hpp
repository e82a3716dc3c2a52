// The interpolating B-spline of an image, as far as samples of it are wanted.
#pragma once

#include <algorithm>
#include <cstddef>
#include <mutex>
#include <shared_mutex>
#include <utility>
#include <vector>

#include "bspline.hpp"
#include "image.hpp"
#include "loops.hpp"
#include "padded_image.hpp"
#include "threads.hpp"

namespace rgbd_dic {

// Coefficients for all samples within a box. While this is held, none are added.
struct SplineBox {
  std::shared_lock<std::shared_mutex> held;
  Box box;
  const PaddedImage* coefficients;

  // The surroundings of a pixel of the box.
  SplinePixels around(std::ptrdiff_t x, std::ptrdiff_t y) const {
    return {coefficients->row(y) + x,       coefficients->stride(),
            static_cast<float>(box.x0 - x), static_cast<float>(box.x1 - 1 - x),
            static_cast<float>(box.y0 - y), static_cast<float>(box.y1 - 1 - y)};
  }
};

// An image, and the coefficients of as much of it as was needed so far. May be used by several threads.
class SplineImage {
 public:
  SplineImage(const Loops& loops, Image image, int degree)
      : loops_(loops),
        spline_(SplineDegree::of(degree)),
        image_(std::move(image)),
        coefficients_(image_.rows(), image_.cols()) {}

  int degree() const { return spline_.degree; }
  std::ptrdiff_t rows() const { return image_.rows(); }
  std::ptrdiff_t cols() const { return image_.cols(); }
  Box whole() const { return image_.whole(); }
  const Loops& loops() const { return loops_; }

  // Coefficients for a box, which is not empty, and what lies around it. They are made once; a larger box
  // adds what it lacks.
  SplineBox covering(const Box& asked, int threads) {
    std::shared_lock<std::shared_mutex> reading(mutex_);
    if (!box_.contains(asked)) {
      reading.unlock();
      add(asked, threads);
      reading.lock();
    }
    return {std::move(reading), box_, &coefficients_};
  }

 private:
  static constexpr std::ptrdiff_t kTile = 64;   // px; so that boxes differ seldom
  static constexpr std::ptrdiff_t kBand = 128;  // lines; with those around them they stay in the cache
  static constexpr std::ptrdiff_t kLines = 32;  // that are filtered beside each other

  void add(const Box& asked, int threads) {
    const std::unique_lock<std::shared_mutex> writing(mutex_);
    if (box_.contains(asked)) return;  // another thread has added it
    const Box wanted = rounded(box_.empty() ? asked : box_.joined(asked));
    const Box all = with_taps(wanted),
              had = box_.empty() ? Box{all.x0, all.y1, all.x1, all.y1} : with_taps(box_);
    for (const Box& part : {Box{all.x0, all.y0, all.x1, had.y0}, Box{all.x0, had.y1, all.x1, all.y1},
                            Box{all.x0, had.y0, had.x0, had.y1}, Box{had.x1, had.y0, all.x1, had.y1}})
      if (!part.empty()) filter(part, threads);
    box_ = wanted;
  }

  // In whole tiles, and to the border of the image where that is near.
  Box rounded(const Box& box) const {
    const auto down = [](std::ptrdiff_t at) { return at / kTile * kTile; };
    const auto up = [](std::ptrdiff_t at, std::ptrdiff_t end) {
      const std::ptrdiff_t tiles = (at / kTile + 1) * kTile;
      return tiles + 2 * PaddedImage::kMargin < end ? tiles : end;
    };
    return {down(box.x0), down(box.y0), up(box.x1, cols()), up(box.y1, rows())};
  }

  // The pixels whose coefficients samples in a box need.
  Box with_taps(const Box& box) const { return box.grown(PaddedImage::kMargin).within(whole()); }

  // Makes the coefficients of a part of the image, and of the margin beside it if it lies at the border.
  void filter(const Box& part, int threads) {
    // A coefficient feels the pixels far around it less than float32 can tell.
    const Box around = part.grown(spline_.reach()).within(whole());
    const std::ptrdiff_t cols = around.x1 - around.x0, left = part.x0 - around.x0, count = part.x1 - part.x0;
    const std::ptrdiff_t stride = (cols + 15) / 16 * 16;
    std::vector<FloatBuffer> bands, turned;
    for (int worker = 0; worker < threads; ++worker) {
      bands.emplace_back(static_cast<std::size_t>((kBand + 2 * spline_.reach()) * stride));
      turned.emplace_back(static_cast<std::size_t>(cols * kLines));
    }
    parallel_blocks(
        part.y1 - part.y0, kBand, threads, [&](int worker, std::ptrdiff_t begin, std::ptrdiff_t end) {
          const Box band = {around.x0, std::max(part.y0 + begin - spline_.reach(), around.y0), around.x1,
                            std::min(part.y0 + end + spline_.reach(), around.y1)};
          float *pixels = bands[worker].data(), *lines = turned[worker].data();
          image_.copy(loops_, band, pixels, stride);
          loops_.filter_lines(pixels, band.y1 - band.y0, stride, cols, spline_.pole_count, spline_.poles);
          for (std::ptrdiff_t y = part.y0 + begin; y < part.y0 + end; y += kLines) {
            const std::ptrdiff_t some = std::min(kLines, part.y0 + end - y);
            loops_.transpose(pixels + (y - band.y0) * stride, stride, some, cols, lines, kLines);
            loops_.filter_lines(lines, cols, kLines, some, spline_.pole_count, spline_.poles);
            loops_.transpose(lines + left * kLines, kLines, count, some, coefficients_.row(y) + part.x0,
                             coefficients_.stride());
          }
        });
    mirror_margin(part);
  }

  // Fills the margin beside a part at the border, which holds more lines than the margin.
  void mirror_margin(const Box& part) {
    constexpr int kMargin = PaddedImage::kMargin;
    const bool at_left = part.x0 == 0, at_right = part.x1 == cols();
    for (std::ptrdiff_t y = part.y0; y < part.y1; ++y) {
      float* line = coefficients_.row(y);
      for (int k = 1; k <= kMargin; ++k) {
        if (at_left) line[-k] = line[k];
        if (at_right) line[cols() - 1 + k] = line[cols() - 1 - k];
      }
    }
    const std::ptrdiff_t first = at_left ? -kMargin : part.x0, end = at_right ? cols() + kMargin : part.x1;
    const auto copy = [&](std::ptrdiff_t from, std::ptrdiff_t to) {
      std::copy(coefficients_.row(from) + first, coefficients_.row(from) + end,
                coefficients_.row(to) + first);
    };
    for (int k = 1; k <= kMargin; ++k) {
      if (part.y0 == 0) copy(k, -k);
      if (part.y1 == rows()) copy(rows() - 1 - k, rows() - 1 + k);
    }
  }

  const Loops& loops_;
  SplineDegree spline_;
  Image image_;
  std::shared_mutex mutex_;
  Box box_;
  PaddedImage coefficients_;
};

}  // namespace rgbd_dic
