// The warp of a subset: a quadratic seed map composed with a local affine increment.
#pragma once

#include <array>
#include <cmath>

namespace rgbd_dic {

// Order of the parameters of the local affine increment, as everywhere in this kernel.
enum Parameter { kU, kUx, kUy, kV, kVx, kVy, kParameterCount };

using Vector6 = std::array<double, kParameterCount>;

// x', y' as polynomials in [1, xi, eta, xi^2, xi eta, eta^2].
using Quadratic = std::array<std::array<double, 6>, 2>;

// The increment A: X = a[0] + a[1] xi + a[2] eta, Y = b[0] + b[1] xi + b[2] eta.
struct Affine {
  std::array<double, 3> a{0.0, 1.0, 0.0}, b{0.0, 0.0, 1.0};

  // S o A, again a quadratic map.
  Quadratic seeded(const Quadratic& seed) const {
    Quadratic warp;
    for (int axis = 0; axis < 2; ++axis) {
      const auto& s = seed[axis];
      warp[axis] = {
          s[0] + s[1] * a[0] + s[2] * b[0] + s[3] * a[0] * a[0] + s[4] * a[0] * b[0] + s[5] * b[0] * b[0],
          linear(s, 1),
          linear(s, 2),
          s[3] * a[1] * a[1] + s[4] * a[1] * b[1] + s[5] * b[1] * b[1],
          2.0 * s[3] * a[1] * a[2] + s[4] * (a[1] * b[2] + a[2] * b[1]) + 2.0 * s[5] * b[1] * b[2],
          s[3] * a[2] * a[2] + s[4] * a[2] * b[2] + s[5] * b[2] * b[2]};
    }
    return warp;
  }

  // A <- A o A(dp)^-1. False, and A unchanged, if A(dp) has no inverse that keeps the orientation.
  bool compose_inverse(const Vector6& dp) {
    const double m11 = 1.0 + dp[kUx], m12 = dp[kUy], m21 = dp[kVx], m22 = 1.0 + dp[kVy];
    const double det = m11 * m22 - m12 * m21;
    if (!(det > 1e-3)) return false;
    const double x = -(m22 * dp[kU] - m12 * dp[kV]) / det, y = -(m11 * dp[kV] - m21 * dp[kU]) / det;
    for (auto* line : {&a, &b}) {
      const auto old = *line;
      *line = {old[0] + old[1] * x + old[2] * y, (old[1] * m22 - old[2] * m21) / det,
               (old[2] * m11 - old[1] * m12) / det};
    }
    return true;
  }

  // False if a shift, px, or a gradient exceeds its limit, or is NaN.
  bool within(double max_shift, double max_gradient) const {
    return std::fabs(a[0]) <= max_shift && std::fabs(b[0]) <= max_shift &&
           std::fabs(a[1] - 1.0) <= max_gradient && std::fabs(a[2]) <= max_gradient &&
           std::fabs(b[1]) <= max_gradient && std::fabs(b[2] - 1.0) <= max_gradient;
  }

 private:
  double linear(const std::array<double, 6>& s, int k) const {
    return s[1] * a[k] + s[2] * b[k] + 2.0 * s[3] * a[0] * a[k] + s[4] * (a[0] * b[k] + a[k] * b[0]) +
           2.0 * s[5] * b[0] * b[k];
  }
};

}  // namespace rgbd_dic
