// Samples of an image's interpolating B-spline.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <mutex>
#include <utility>

#include "bspline.hpp"
#include "image.hpp"
#include "loops.hpp"

namespace rgbd_dic {

// The B-spline coefficients that samples within a box need.
class SplineCoefficients {
 public:
  SplineCoefficients(const Loops& loops, const Image& image, const Box& box, const SplineDegree& spline,
                     int threads)
      : box_(box) {
    // A coefficient feels the pixels far around it less than float32 can tell.
    const std::ptrdiff_t reach = spline.reach() + PaddedImage::kMargin;
    filtered_ = {box.x0 - reach, box.y0 - reach, box.x1 + reach, box.y1 + reach};
    filtered_ = filtered_.within({0, 0, image.cols(), image.rows()});
    coefficients_ = image.part(filtered_);
    filter_along_columns(loops, coefficients_, spline, threads);
    filter_along_rows(loops, coefficients_, spline, threads);
    coefficients_.mirror_margin();
  }

  const Box& box() const { return box_; }

  // The surroundings of a pixel of the box.
  SplinePixels around(std::ptrdiff_t x, std::ptrdiff_t y) const {
    return {coefficients_.row(y - filtered_.y0) + (x - filtered_.x0),
            coefficients_.stride(),
            static_cast<float>(box_.x0 - x),
            static_cast<float>(box_.x1 - 1 - x),
            static_cast<float>(box_.y0 - y),
            static_cast<float>(box_.y1 - 1 - y)};
  }

 private:
  Box box_, filtered_;
  PaddedImage coefficients_;
};

// An image, and the coefficients of as much of it as was needed so far. May be used by several threads.
class SplineImage {
 public:
  SplineImage(const Loops& loops, Image image, int degree)
      : loops_(loops), spline_(SplineDegree::of(degree)), image_(std::move(image)) {}

  int degree() const { return spline_.degree; }
  std::ptrdiff_t rows() const { return image_.rows(); }
  std::ptrdiff_t cols() const { return image_.cols(); }
  Box whole() const { return {0, 0, cols(), rows()}; }
  const Loops& loops() const { return loops_; }

  // Coefficients for a box, which is not empty, and what lies around it.
  std::shared_ptr<const SplineCoefficients> covering(const Box& asked, int threads) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (coefficients_ && coefficients_->box().contains(asked)) return coefficients_;
    constexpr std::ptrdiff_t kTile = 64;  // so that boxes differ seldom
    const Box all = coefficients_ ? coefficients_->box().joined(asked) : asked;
    const Box tiled = {all.x0 / kTile * kTile, all.y0 / kTile * kTile, (all.x1 / kTile + 1) * kTile,
                       (all.y1 / kTile + 1) * kTile};
    coefficients_ =
        std::make_shared<SplineCoefficients>(loops_, image_, tiled.within(whole()), spline_, threads);
    return coefficients_;
  }

 private:
  const Loops& loops_;
  SplineDegree spline_;
  Image image_;
  std::mutex mutex_;
  std::shared_ptr<const SplineCoefficients> coefficients_;
};

}  // namespace rgbd_dic
