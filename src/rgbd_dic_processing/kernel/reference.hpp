// The subsets of the reference image, with all that does not change from one target image to the next.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "bspline.hpp"
#include "threads.hpp"
#include "warp.hpp"

namespace rgbd_dic {

using Matrix6 = std::array<Vector6, kParameterCount>;

// Offsets of a subset's pixels from its centre, row by row.
struct SubsetGrid {
  int half = 0;   // (size - 1) / 2, px
  int count = 0;  // number of pixels
  std::vector<float> xi, eta;

  explicit SubsetGrid(int size) : half((size - 1) / 2), count(size * size) {
    if (size < 5 || size % 2 == 0)
      throw std::invalid_argument("subset_size = " + std::to_string(size) +
                                  " px: must be odd and at least 5");
    for (int y = -half; y <= half; ++y)
      for (int x = -half; x <= half; ++x) {
        xi.push_back(static_cast<float>(x));
        eta.push_back(static_cast<float>(y));
      }
  }
};

// One subset's pixels in the order of the grid.
struct Patch {
  std::vector<float> f, fx, fy;  // grey value minus the subset's mean; gradient, grey levels per px

  explicit Patch(int count) : f(count), fx(count), fy(count) {}
};

// Constants of the least-squares problem of one subset. J is the n x 6 matrix of steepest-descent images;
// what is subtracted below makes it orthogonal to the constant and to f, so that scale and offset of the grey
// values are estimated along with the six parameters without appearing in the equations.
struct Subset {
  int x = 0, y = 0;         // centre, px
  double mean = 0.0;        // grey levels
  double power = 0.0;       // sum of f^2
  bool invertible = false;  // the normal matrix has a safe inverse
  Vector6 mean_j{};         // J^T 1 / n
  Vector6 share_j{};        // J^T f / power
  Matrix6 inverse{};        // (J^T J)^-1 of the projected J

  double contrast(int count) const { return std::sqrt(power / count); }
};

// Inverts a symmetric positive definite matrix, its rows and columns scaled by `scale` first. False if a
// pivot of the scaled matrix is below 1e-6: the texture does not determine all parameters.
inline bool invert_spd(const Matrix6& matrix, const Vector6& scale, Matrix6& inverse) {
  constexpr int n = kParameterCount;
  Matrix6 lower{};
  for (int i = 0; i < n; ++i)
    for (int j = 0; j <= i; ++j) {
      double value = matrix[i][j] * scale[i] * scale[j];
      for (int k = 0; k < j; ++k) value -= lower[i][k] * lower[j][k];
      if (i == j && !(value > 1e-6)) return false;
      lower[i][j] = i == j ? std::sqrt(value) : value / lower[j][j];
    }
  for (int column = 0; column < n; ++column) {
    Vector6 solution{};
    for (int i = 0; i < n; ++i) {
      double value = i == column ? 1.0 : 0.0;
      for (int k = 0; k < i; ++k) value -= lower[i][k] * solution[k];
      solution[i] = value / lower[i][i];
    }
    for (int i = n - 1; i >= 0; --i) {
      double value = solution[i];
      for (int k = i + 1; k < n; ++k) value -= lower[k][i] * solution[k];
      solution[i] = value / lower[i][i];
    }
    for (int i = 0; i < n; ++i) inverse[i][column] = solution[i] * scale[i] * scale[column];
  }
  return true;
}

class Reference {
 public:
  // `centres` holds x, y of each subset.
  Reference(PaddedImage image, const std::int32_t* centres, std::ptrdiff_t count, int subset_size, int degree,
            int threads)
      : spline_(SplineDegree::of(degree)),
        grid_(subset_size),
        image_(std::move(image)),
        fx_(derivative_x(image_, spline_, threads)),
        fy_(derivative_y(image_, spline_, threads)),
        subsets_(static_cast<std::size_t>(count)) {
    for (std::ptrdiff_t i = 0; i < count; ++i) {
      subsets_[i].x = centres[2 * i];
      subsets_[i].y = centres[2 * i + 1];
      check_inside(i);
    }
    std::vector<Patch> patches(static_cast<std::size_t>(threads), Patch(grid_.count));
    parallel_blocks(count, 64, threads, [&](int worker, std::ptrdiff_t begin, std::ptrdiff_t end) {
      for (std::ptrdiff_t i = begin; i < end; ++i) prepare(subsets_[i], patches[worker]);
    });
  }

  int degree() const { return spline_.degree; }
  const SubsetGrid& grid() const { return grid_; }
  std::ptrdiff_t size() const { return static_cast<std::ptrdiff_t>(subsets_.size()); }
  const Subset& operator[](std::ptrdiff_t i) const { return subsets_[i]; }

  void load(const Subset& subset, Patch& patch) const {
    const float mean = static_cast<float>(subset.mean);
    const int size = 2 * grid_.half + 1;
    for (int line = 0; line < size; ++line) {
      const std::ptrdiff_t y = subset.y - grid_.half + line, x = subset.x - grid_.half;
      const float *f = image_.row(y) + x, *fx = fx_.row(y) + x, *fy = fy_.row(y) + x;
      const int start = line * size;
      for (int k = 0; k < size; ++k) {
        patch.f[start + k] = f[k] - mean;
        patch.fx[start + k] = fx[k];
        patch.fy[start + k] = fy[k];
      }
    }
  }

 private:
  void check_inside(std::ptrdiff_t i) const {
    const std::ptrdiff_t x = subsets_[i].x, y = subsets_[i].y, half = grid_.half;
    if (x >= half && y >= half && x + half < image_.cols() && y + half < image_.rows()) return;
    throw std::invalid_argument("centre " + std::to_string(i) + " at (" + std::to_string(x) + ", " +
                                std::to_string(y) + ") px: its subset of " + std::to_string(2 * half + 1) +
                                " px leaves the reference image of " + std::to_string(image_.cols()) + " x " +
                                std::to_string(image_.rows()) + " px");
  }

  void prepare(Subset& subset, Patch& patch) const {
    const int n = grid_.count;
    subset.mean = 0.0;
    load(subset, patch);
    double sum = 0.0;
    for (int i = 0; i < n; ++i) sum += patch.f[i];
    subset.mean = sum / n;
    load(subset, patch);

    Matrix6 normal{};
    Vector6 scale{};
    for (int i = 0; i < n; ++i) {
      const double f = patch.f[i], fx = patch.fx[i], fy = patch.fy[i], xi = grid_.xi[i], eta = grid_.eta[i];
      const Vector6 j = {fx, fx * xi, fx * eta, fy, fy * xi, fy * eta};
      subset.power += f * f;
      for (int a = 0; a < kParameterCount; ++a) {
        subset.mean_j[a] += j[a];
        subset.share_j[a] += j[a] * f;
        for (int b = 0; b <= a; ++b) normal[a][b] += j[a] * j[b];
      }
    }
    for (int a = 0; a < kParameterCount; ++a) {
      subset.mean_j[a] /= n;
      subset.share_j[a] /= subset.power;
      scale[a] = 1.0 / std::sqrt(normal[a][a]);
    }
    for (int a = 0; a < kParameterCount; ++a)
      for (int b = 0; b <= a; ++b)
        normal[a][b] -=
            n * subset.mean_j[a] * subset.mean_j[b] + subset.power * subset.share_j[a] * subset.share_j[b];
    subset.invertible = invert_spd(normal, scale, subset.inverse);
  }

  SplineDegree spline_;
  SubsetGrid grid_;
  PaddedImage image_, fx_, fy_;
  std::vector<Subset> subsets_;
};

}  // namespace rgbd_dic
