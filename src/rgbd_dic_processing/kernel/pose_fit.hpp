// The pose in which a camera sees known points again: robust least squares of the reprojection.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

namespace rgbd_dic {

// Of a fit: see core/compensation/h_pose.py, whose words these are.
struct PoseLimits {
  double robust_sigmas, median_length, converged_px;
  int max_iterations, misfit_iterations;
};

// Points in the reference frame, where they are seen and how surely; each in rows of three or two.
struct SeenPoints {
  std::ptrdiff_t count;
  const double *points, *target, *sigma;
  double fx, fy, cx, cy;
};

struct Pose {
  std::array<double, 9> R;  // row by row
  std::array<double, 3> t;
};

using Sixes = std::array<double, 6>;

// The rotation by a vector (Rodrigues).
inline std::array<double, 9> rotation(const double* w) {
  const double square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], angle = std::sqrt(square);
  const bool small = angle < 1e-4;  // the series' next terms are then less than rounding
  const double s = small ? 1 - square / 6 : std::sin(angle) / angle;
  const double half = small ? 1 - square / 24 : std::sin(angle / 2) / (angle / 2), c = half * half / 2;
  const double x = w[0], y = w[1], z = w[2];
  return {1 - c * (y * y + z * z), c * x * y - s * z,       c * x * z + s * y,
          c * x * y + s * z,       1 - c * (x * x + z * z), c * y * z - s * x,
          c * x * z - s * y,       c * y * z + s * x,       1 - c * (x * x + y * y)};
}

// Solves a symmetric positive definite system; false if it is not one.
inline bool solve(std::array<Sixes, 6> a, Sixes& b) {
  for (int k = 0; k < 6; ++k) {
    for (int j = 0; j < k; ++j) a[k][k] -= a[k][j] * a[k][j];
    if (!(a[k][k] > 0.0)) return false;
    a[k][k] = std::sqrt(a[k][k]);
    for (int i = k + 1; i < 6; ++i) {
      for (int j = 0; j < k; ++j) a[i][k] -= a[i][j] * a[k][j];
      a[i][k] /= a[k][k];
    }
  }
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < i; ++j) b[i] -= a[i][j] * b[j];
    b[i] /= a[i][i];
  }
  for (int i = 5; i >= 0; --i) {
    for (int j = i + 1; j < 6; ++j) b[i] -= a[j][i] * b[j];
    b[i] /= a[i][i];
  }
  return true;
}

class PoseFit {
 public:
  PoseFit(const SeenPoints& seen, const PoseLimits& limits, const Pose& start)
      : seen_(seen),
        limits_(limits),
        pose_(start),
        rows_(static_cast<std::size_t>(seen.count)),
        roots_(rows_.size()) {}

  // Iterates; whether it converged.
  bool run() {
    for (int iteration = 0; iteration < limits_.max_iterations; ++iteration) {
      if (!project()) return false;
      if (iteration < limits_.misfit_iterations) misfit2_ = misfit_variance();
      if (!std::isfinite(misfit2_)) return false;
      Sixes step = {};
      if (!solve(normal_equations(step), step)) return false;
      double squares = 0.0;
      for (const Row& row : rows_)
        for (int axis = 0; axis < 2; ++axis) {
          double change = 0.0;
          for (int k = 0; k < 6; ++k) change += step[k] * row.jacobian[axis][k];
          squares += change * change;
        }
      move(step);
      if (std::sqrt(squares / (2.0 * static_cast<double>(seen_.count))) < limits_.converged_px) return true;
    }
    return false;
  }

  const Pose& pose() const { return pose_; }
  double misfit_px() const { return std::sqrt(misfit2_); }

  // The Jacobian (6, count, 2) and the weights (count, 2) of the last iteration.
  void copy(double* jacobian, double* weights) const {
    for (std::size_t i = 0; i < rows_.size(); ++i)
      for (int axis = 0; axis < 2; ++axis) {
        weights[2 * i + axis] = rows_[i].weight[axis];
        for (int k = 0; k < 6; ++k) jacobian[2 * (k * rows_.size() + i) + axis] = rows_[i].jacobian[axis][k];
      }
  }

 private:
  struct Row {
    double residual[2], weight[2];
    Sixes jacobian[2];  // of x and of y by rotation vector and translation
  };

  // Residuals and Jacobian at the present pose; false if a point is behind the camera.
  bool project() {
    const auto& [R, t] = pose_;
    const double focal[2] = {seen_.fx, seen_.fy}, centre[2] = {seen_.cx, seen_.cy};
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      const double* p = seen_.points + 3 * i;
      const double x = R[0] * p[0] + R[1] * p[1] + R[2] * p[2], y = R[3] * p[0] + R[4] * p[1] + R[5] * p[2],
                   z = R[6] * p[0] + R[7] * p[1] + R[8] * p[2], depth = z + t[2];
      if (!(depth > 0.0)) return false;
      const double u = (x + t[0]) / depth, v = (y + t[1]) / depth, at[2] = {u, v};
      Row& row = rows_[i];
      row.jacobian[0] = {-u * y, z + u * x, -y, 1.0, 0.0, -u};
      row.jacobian[1] = {-z - v * y, v * x, x, 0.0, 1.0, -v};
      for (int axis = 0; axis < 2; ++axis) {
        row.residual[axis] = seen_.target[2 * i + axis] - (focal[axis] * at[axis] + centre[axis]);
        const double scale = focal[axis] / depth;
        for (double& value : row.jacobian[axis]) value *= scale;
      }
    }
    return true;
  }

  // As core/compensation/motion.py; NaN if a residual or an uncertainty is not a finite number.
  double misfit_variance() {
    const double length2 = limits_.median_length * limits_.median_length;
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      const double of_x = variance(i, 0), of_y = variance(i, 1), x = rows_[i].residual[0],
                   y = rows_[i].residual[1];
      const double half = (length2 * (of_x + of_y) - (x * x + y * y)) / 2;
      const double constant = length2 * (of_x * of_y) - (x * x * of_y + y * y * of_x);
      roots_[i] = (-half + std::sqrt(std::max(half * half - length2 * constant, 0.0))) / length2;
      if (!std::isfinite(roots_[i])) return std::numeric_limits<double>::quiet_NaN();
    }
    const auto middle = roots_.begin() + static_cast<std::ptrdiff_t>(roots_.size() / 2);
    std::nth_element(roots_.begin(), middle, roots_.end());
    const double below = roots_.size() % 2 ? *middle : *std::max_element(roots_.begin(), middle);
    return std::max(0.0, (below + *middle) / 2);
  }

  double variance(std::size_t i, int axis) const {
    const double sigma = seen_.sigma[2 * i + axis];
    return sigma * sigma;
  }

  // Sets the weights (Huber); the right side goes into `right`.
  std::array<Sixes, 6> normal_equations(Sixes& right) {
    std::array<Sixes, 6> matrix = {};
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      Row& row = rows_[i];
      const double variances[2] = {variance(i, 0) + misfit2_, variance(i, 1) + misfit2_};
      const double length = std::sqrt(row.residual[0] * row.residual[0] / variances[0] +
                                      row.residual[1] * row.residual[1] / variances[1]);
      const double trust = std::min(1.0, limits_.robust_sigmas / std::max(length, 1e-12));
      for (int axis = 0; axis < 2; ++axis) {
        row.weight[axis] = trust / variances[axis];
        const Sixes& jacobian = row.jacobian[axis];
        for (int k = 0; k < 6; ++k) {
          const double weighted = row.weight[axis] * jacobian[k];
          for (int j = 0; j < 6; ++j) matrix[k][j] += weighted * jacobian[j];
          right[k] += weighted * row.residual[axis];
        }
      }
    }
    return matrix;
  }

  void move(const Sixes& step) {
    const std::array<double, 9> turn = rotation(step.data()), before = pose_.R;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j)
        pose_.R[3 * i + j] =
            turn[3 * i] * before[j] + turn[3 * i + 1] * before[3 + j] + turn[3 * i + 2] * before[6 + j];
      pose_.t[i] += step[3 + i];
    }
  }

  SeenPoints seen_;
  PoseLimits limits_;
  Pose pose_;
  double misfit2_ = 0.0;
  std::vector<Row> rows_;
  std::vector<double> roots_;
};

}  // namespace rgbd_dic
