// The warp of a subset: a quadratic seed map composed with a local increment.
#pragma once

#include <array>
#include <cmath>

#include "loops.hpp"

namespace rgbd_dic {

// A polynomial in [1, xi, eta, xi^2, xi eta, eta^2], and x', y' as two of them.
using Polynomial = std::array<double, kMaxMonomials>;
using Quadratic = std::array<Polynomial, 2>;

constexpr int kDegreeOf[kMaxMonomials] = {0, 1, 1, 2, 2, 2};

constexpr Quadratic kIdentity = {{{0, 1, 0, 0, 0, 0}, {0, 0, 1, 0, 0, 0}}};

// The product of two polynomials without what is beyond second order.
inline Polynomial truncated_product(const Polynomial& p, const Polynomial& q) {
  return {p[0] * q[0],
          p[0] * q[1] + p[1] * q[0],
          p[0] * q[2] + p[2] * q[0],
          p[0] * q[3] + p[3] * q[0] + p[1] * q[1],
          p[0] * q[4] + p[4] * q[0] + p[1] * q[2] + p[2] * q[1],
          p[0] * q[5] + p[5] * q[0] + p[2] * q[2]};
}

// outer o inner without what is beyond second order; exact if one of them is affine.
inline Quadratic composed(const Quadratic& outer, const Quadratic& inner) {
  const Polynomial& x = inner[0];
  const Polynomial& y = inner[1];
  const Polynomial xx = truncated_product(x, x), xy = truncated_product(x, y), yy = truncated_product(y, y);
  Quadratic result;
  for (int axis = 0; axis < 2; ++axis) {
    const Polynomial& o = outer[axis];
    for (int k = 0; k < kMaxMonomials; ++k)
      result[axis][k] = o[1] * x[k] + o[2] * y[k] + o[3] * xx[k] + o[4] * xy[k] + o[5] * yy[k];
    result[axis][0] += o[0];
  }
  return result;
}

inline double evaluated(const Polynomial& p, double xi, double eta) {
  return p[0] + xi * (p[1] + xi * p[3] + eta * p[4]) + eta * (p[2] + eta * p[5]);
}

// The inverse of a map near the identity, without what is beyond second order. False if it has none that
// keeps the orientation.
inline bool inverted(const Quadratic& map, Quadratic& inverse) {
  const double m11 = map[0][1], m12 = map[0][2], m21 = map[1][1], m22 = map[1][2];
  const double determinant = m11 * m22 - m12 * m21;
  if (!(determinant > 1e-3)) return false;
  // Of the affine part: L^-1 (y - d).
  const auto solved = [&](const Quadratic& y) {
    Quadratic result;
    for (int k = 0; k < kMaxMonomials; ++k) {
      result[0][k] = (m22 * y[0][k] - m12 * y[1][k]) / determinant;
      result[1][k] = (m11 * y[1][k] - m21 * y[0][k]) / determinant;
    }
    return result;
  };
  Quadratic shifted = kIdentity;
  for (int axis = 0; axis < 2; ++axis) shifted[axis][0] = -map[axis][0];
  const Quadratic affine = solved(shifted);
  Quadratic bend = map;  // the quadratic part alone
  bool bent = false;
  for (Polynomial& p : bend) {
    p[0] = p[1] = p[2] = 0.0;
    bent |= p[3] != 0.0 || p[4] != 0.0 || p[5] != 0.0;
  }
  inverse = affine;
  if (!bent) return true;
  // y = d + L x + Q(x), so x = L^-1 (y - d) - L^-1 Q(x), with the affine x in Q to this order.
  const Quadratic correction = solved(composed(bend, affine));
  for (int axis = 0; axis < 2; ++axis)
    for (int k = 0; k < kMaxMonomials; ++k) inverse[axis][k] -= correction[axis][k];
  return true;
}

// False if the increment moves the centre farther than max_shift, px, on an axis, or stretches the subset of
// half-width `half` by more than max_gradient, or is NaN.
inline bool is_plausible(const Quadratic& increment, int half, double max_shift, double max_gradient) {
  for (int axis = 0; axis < 2; ++axis) {
    const Polynomial& p = increment[axis];
    if (!(std::fabs(p[0]) <= max_shift)) return false;
    for (int k = 1; k < kMaxMonomials; ++k) {
      const double gradient = (p[k] - kIdentity[axis][k]) * (kDegreeOf[k] == 2 ? half : 1);
      if (!(std::fabs(gradient) <= max_gradient)) return false;
    }
  }
  return true;
}

}  // namespace rgbd_dic
