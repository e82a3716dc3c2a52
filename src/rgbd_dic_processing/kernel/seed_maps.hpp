// The map of each subset under a homography and the lens, to second order.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "warp.hpp"

namespace rgbd_dic {

// Ideal pixels -> raw pixels: focal lengths, centre, px, and radial distortion of two orders.
struct Lens {
  double fx, fy, cx, cy, k1, k2;

  std::array<double, 2> distorted(double x, double y) const {
    if (k1 == 0.0 && k2 == 0.0) return {x, y};
    const double away_x = (x - cx) / fx, away_y = (y - cy) / fy, square = away_x * away_x + away_y * away_y;
    const double factor = 1.0 + square * (k1 + k2 * square);
    return {cx + fx * away_x * factor, cy + fy * away_y * factor};
  }
};

// Where a subset is expected, by central differences over its centre and the points `reach`, px, around it:
// right, left, below, above, then right below, left above, right above, left below. Each is found in
// `stencil` at [point * step] as x, y in ideal pixels of the reference. NaN if the homography, row by row,
// sends one behind.
inline Quadratic seed_map(const double* stencil, std::ptrdiff_t step, const double* homography,
                          const Lens& lens, double reach) {
  std::array<std::array<double, 2>, 9> moved;
  const double* h = homography;
  for (int point = 0; point < 9; ++point, stencil += step) {
    const double x = stencil[0], y = stencil[1], w = h[6] * x + h[7] * y + h[8];
    const double scale = w > 0.0 ? 1.0 / w : std::numeric_limits<double>::quiet_NaN();
    moved[point] = lens.distorted((h[0] * x + h[1] * y + h[2]) * scale, (h[3] * x + h[4] * y + h[5]) * scale);
  }
  const auto& [centre, right, left, down, up, right_down, left_up, right_up, left_down] = moved;
  const double once = 1.0 / (2.0 * reach), twice = 1.0 / (2.0 * reach * reach);
  Quadratic map;
  for (int axis = 0; axis < 2; ++axis)
    map[axis] = {centre[axis],
                 (right[axis] - left[axis]) * once,
                 (down[axis] - up[axis]) * once,
                 (right[axis] - 2.0 * centre[axis] + left[axis]) * twice,
                 (right_down[axis] + left_up[axis] - right_up[axis] - left_down[axis]) * (0.5 * twice),
                 (down[axis] - 2.0 * centre[axis] + up[axis]) * twice};
  return map;
}

}  // namespace rgbd_dic
