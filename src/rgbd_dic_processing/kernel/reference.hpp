// The subsets of the reference image, with all that does not change from one target image to the next.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "bspline.hpp"
#include "image.hpp"
#include "loops.hpp"
#include "threads.hpp"

namespace rgbd_dic {

constexpr int kMaxSubsetSize = 1001;  // px; the memory of each thread grows with its square

// How subsets are made and matched.
struct SubsetModel {
  int size;          // px, odd
  int degree;        // of the B-spline
  int order;         // of the local increment: 1 affine, 2 quadratic
  double smoothing;  // of the steepest-descent gradients, px

  int parameters() const { return 2 * monomial_count(order); }
};

// Constants of one subset. J is the n x p matrix of steepest-descent images, D the same of the true
// gradients; what is subtracted below makes J orthogonal to the constant and to f, so that scale and offset
// of the grey values change along with the parameters without appearing in the equations.
struct Subset {
  enum class State : std::uint8_t { kUsable, kOutside, kSingular };

  std::int32_t x = 0, y = 0;     // centre, px
  float away_x = 0, away_y = 0;  // of the point to be followed from the centre, px
  State state = State::kOutside;
  double mean = 0.0;              // grey levels
  double power = 0.0;             // sum of (f - mean)^2
  double uu = 0, uv = 0, vv = 0;  // covariance of the point's displacement per variance of the residual, px^2
  // What share of the diagonal of J^T J and J^T D is noise, for noise of unit variance.
  float noise_jj_u = 0, noise_jj_v = 0, noise_jd_u = 0, noise_jd_v = 0;

  BlockProducts blocks = {};  // f with the mean taken off

  double contrast(int count) const { return std::sqrt(power / count); }
};

// Whether nothing but rounding in float32 makes the grey values of a subset differ. `power` is the sum of
// their squared deviations from the mean; NaN is uniform.
inline bool is_uniform(double mean, double power, int count) {
  const double contrast = std::max(1e-3, 1e-6 * std::fabs(mean));
  return !(power > count * contrast * contrast);
}

// The p x p matrix in front of the right-hand side, J^T 1 / n and J^T f / power, one after the other.
struct SubsetEquations {
  const double *inverse, *mean_j, *share_j;
};

constexpr int kMaxUnknowns = 20;
using Square = std::array<double, kMaxUnknowns * kMaxUnknowns>;  // p x p of it, row by row

// Inverts a matrix close to a symmetric positive definite one in place, by Gauss-Jordan elimination with its
// rows and columns scaled to a unit diagonal. False if a pivot falls below 1e-6: the texture does not
// determine all parameters.
inline bool invert(Square& matrix, int n) {
  std::array<double, kMaxUnknowns> scale{};
  for (int i = 0; i < n; ++i) {
    if (!(matrix[i * n + i] > 0.0)) return false;
    scale[i] = 1.0 / std::sqrt(matrix[i * n + i]);
  }
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) matrix[i * n + j] *= scale[i] * scale[j];
  for (int column = 0; column < n; ++column) {
    double* row = matrix.data() + column * n;
    if (!(row[column] > 1e-6)) return false;
    const double share = 1.0 / row[column];
    row[column] = 1.0;
    for (int j = 0; j < n; ++j) row[j] *= share;
    for (int i = 0; i < n; ++i) {
      if (i == column) continue;
      double* other = matrix.data() + i * n;
      const double factor = std::exchange(other[column], 0.0);
      for (int j = 0; j < n; ++j) other[j] -= factor * row[j];
    }
  }
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) matrix[i * n + j] *= scale[i] * scale[j];
  return true;
}

class Reference {
 public:
  // `centres` holds x, y of the point to be followed in each subset, px; the subset is centred at the nearest
  // pixel.
  Reference(const Loops& loops, const Image& image, const double* centres, std::ptrdiff_t count,
            const SubsetModel& model, int threads)
      : loops_(loops),
        model_(checked(model)),
        noise_gain_(loops, SplineDegree::of(model.degree), model.smoothing),
        subsets_(static_cast<std::size_t>(count)),
        equations_(static_cast<std::size_t>(count * equation_size())) {
    Box seen = {image.cols(), image.rows(), 0, 0};
    for (std::ptrdiff_t i = 0; i < count; ++i) {
      const Box pixels = place(subsets_[i], centres[2 * i], centres[2 * i + 1], image.whole());
      if (!pixels.empty()) seen = seen.joined(pixels);
    }
    if (seen.empty()) return;
    const std::vector<double> one = {1.0}, gaussian = gaussian_weights(model.smoothing);
    const std::vector<double> derivative = derivative_weights(SplineDegree::of(model.degree));
    const auto reach = [](const std::vector<double>& weights) {
      return static_cast<std::ptrdiff_t>(weights.size() / 2);
    };
    const Box smoothed = seen.grown(reach(gaussian)).within(image.whole());
    frame_ = smoothed.grown(reach(derivative)).within(image.whole());
    const std::ptrdiff_t rows = frame_.y1 - frame_.y0, cols = frame_.x1 - frame_.x0;
    f_ = PaddedImage(rows, cols);
    image.copy(loops, frame_, f_.row(0), f_.stride());
    PaddedImage dx(rows, cols), dy(rows, cols);
    jx_ = PaddedImage(rows, cols);
    jy_ = PaddedImage(rows, cols);
    weigh(loops, f_, derivative, one, smoothed.from(frame_), dx, threads);
    weigh(loops, f_, one, derivative, smoothed.from(frame_), dy, threads);
    weigh(loops, dx, gaussian, gaussian, seen.from(frame_), jx_, threads);
    weigh(loops, dy, gaussian, gaussian, seen.from(frame_), jy_, threads);
    std::vector<std::vector<float>> columns(static_cast<std::size_t>(threads));
    parallel_blocks(count, 64, threads, [&](int worker, std::ptrdiff_t begin, std::ptrdiff_t end) {
      while (begin < end) {
        const std::ptrdiff_t next = end_of_run(begin, end);
        prepare(begin, next, dx, dy, columns[static_cast<std::size_t>(worker)]);
        begin = next;
      }
    });
  }

  const Loops& loops() const { return loops_; }
  const SubsetModel& model() const { return model_; }
  const NoiseGain& noise_gain() const { return noise_gain_; }
  std::ptrdiff_t size() const { return static_cast<std::ptrdiff_t>(subsets_.size()); }
  const Subset& operator[](std::ptrdiff_t i) const { return subsets_[i]; }

  Layout layout() const { return {model_.size / 2, (model_.size + loops_.width - 1) / loops_.width}; }

  SubsetEquations equations(std::ptrdiff_t i) const {
    const int p = model_.parameters();
    const double* first = equations_.data() + i * equation_size();
    return {first, first + p * p, first + p * p + p};
  }

  // The pixels around a subset's centre.
  ReferencePixels pixels(const Subset& subset) const {
    return {at(f_, subset), at(jx_, subset), at(jy_, subset), nullptr, nullptr, f_.stride()};
  }

 private:
  static const SubsetModel& checked(const SubsetModel& model) {
    if (model.size < 5 || model.size > kMaxSubsetSize || model.size % 2 == 0)
      throw std::invalid_argument("subset_size = " + std::to_string(model.size) +
                                  " px: must be odd and 5 to " + std::to_string(kMaxSubsetSize));
    if (model.order < 1 || model.order > kMaxOrder)
      throw std::invalid_argument("order = " + std::to_string(model.order) + ": must be 1 or 2");
    if (!(model.smoothing >= 0.0 && model.smoothing <= 5.0))
      throw std::invalid_argument("smoothing = " + std::to_string(model.smoothing) + " px: must be 0 to 5");
    return model;
  }

  std::ptrdiff_t equation_size() const {
    const std::ptrdiff_t p = model_.parameters();
    return p * p + 2 * p;
  }

  const float* at(const PaddedImage& plane, const Subset& subset) const {
    return plane.row(subset.y - frame_.y0) + (subset.x - frame_.x0);
  }

  // Centres a subset at the pixel nearest to its point; returns its pixels, none if they are not all in the
  // image.
  Box place(Subset& subset, double x, double y, const Box& image) const {
    const double half = model_.size / 2, column = std::nearbyint(x), line = std::nearbyint(y);
    if (!(column >= half && column + half <= static_cast<double>(image.x1 - 1) && line >= half &&
          line + half <= static_cast<double>(image.y1 - 1)))  // NaN is not inside either
      return {};
    subset.x = static_cast<std::int32_t>(column);
    subset.y = static_cast<std::int32_t>(line);
    subset.away_x = static_cast<float>(x - column);
    subset.away_y = static_cast<float>(y - line);
    subset.state = Subset::State::kSingular;
    return Box{subset.x, subset.y, subset.x + 1, subset.y + 1}.grown(model_.size / 2);
  }

  // The end of those subsets from `begin` on that lie beside each other in a row, as in a grid.
  std::ptrdiff_t end_of_run(std::ptrdiff_t begin, std::ptrdiff_t end) const {
    std::ptrdiff_t next = begin + 1;
    for (; next < end; ++next) {
      const Subset &one = subsets_[next - 1], &other = subsets_[next];
      if (one.state == Subset::State::kOutside || other.state == Subset::State::kOutside ||
          one.y != other.y || std::abs(one.x - other.x) > model_.size)
        break;
    }
    return next;
  }

  // A run of subsets; what they share is summed up once, in `columns`.
  void prepare(std::ptrdiff_t begin, std::ptrdiff_t end, const PaddedImage& dx, const PaddedImage& dy,
               std::vector<float>& columns) {
    if (subsets_[begin].state == Subset::State::kOutside) return;
    const auto [left, right] =
        std::minmax_element(subsets_.begin() + begin, subsets_.begin() + end,
                            [](const Subset& one, const Subset& other) { return one.x < other.x; });
    const Layout layout = this->layout();
    const std::ptrdiff_t first = left->x - layout.half, last_start = right->x - layout.half,
                         count = last_start - first + layout.columns * loops_.width,
                         stride = (count / loops_.width + 1) * loops_.width;
    columns.resize(
        std::max(columns.size(), static_cast<std::size_t>(column_sum_count(model_.order) * stride)));
    Subset corner = *left;
    corner.x -= layout.half;
    loops_.column_sums(layout, pixels(corner, dx, dy), model_.order, count, columns.data(), stride);
    for (std::ptrdiff_t i = begin; i < end; ++i) {
      const float* from = columns.data() + (subsets_[i].x - layout.half - first);
      model_.order == 1 ? prepare<1>(i, from, stride) : prepare<2>(i, from, stride);
    }
  }

  ReferencePixels pixels(const Subset& subset, const PaddedImage& dx, const PaddedImage& dy) const {
    ReferencePixels found = pixels(subset);
    found.dx = at(dx, subset);
    found.dy = at(dy, subset);
    return found;
  }

  template <int order>
  void prepare(std::ptrdiff_t i, const float* columns, std::ptrdiff_t stride) {
    Subset& subset = subsets_[i];
    const Layout layout = this->layout();
    const int n = layout.count();
    constexpr int monomials = monomial_count(order), p = 2 * monomials;
    ProductSums sums;
    loops_.product_sums(layout, order, columns, stride, sums, subset.blocks);
    subset.mean = static_cast<float>(sums.f / n);
    subset.power = sums.f_f;
    if (is_uniform(subset.mean, subset.power, n)) return;

    // Powers of xi and eta of each monomial.
    constexpr int kXi[] = {0, 1, 0, 2, 1, 0}, kEta[] = {0, 0, 1, 0, 1, 2};
    double* inverse = equations_.data() + i * equation_size();
    double *mean_j = inverse + p * p, *share_j = mean_j + p;
    std::array<double, kMaxParameters> mean_d{}, share_d{};
    for (int m = 0; m < monomials; ++m) {
      const int u = kXi[m], v = kEta[m];
      mean_j[m] = sums.jx[v][u] / n;
      mean_j[monomials + m] = sums.jy[v][u] / n;
      share_j[m] = sums.jx_f[v][u] / subset.power;
      share_j[monomials + m] = sums.jy_f[v][u] / subset.power;
      mean_d[m] = sums.dx[v][u] / n;
      mean_d[monomials + m] = sums.dy[v][u] / n;
      share_d[m] = sums.dx_f[v][u] / subset.power;
      share_d[monomials + m] = sums.dy_f[v][u] / subset.power;
    }
    Square jd, jj;
    for (int a = 0; a < p; ++a)
      for (int b = 0; b < p; ++b) {
        const int m = a % monomials, k = b % monomials, u = kXi[m] + kXi[k], v = kEta[m] + kEta[k];
        const bool y_first = a >= monomials, y_second = b >= monomials;
        const auto& of_jd =
            y_first ? (y_second ? sums.jy_dy : sums.jy_dx) : (y_second ? sums.jx_dy : sums.jx_dx);
        const auto& of_jj = y_first != y_second ? sums.jx_jy : (y_first ? sums.jy_jy : sums.jx_jx);
        jd[a * p + b] = of_jd[v][u] - n * mean_j[a] * mean_d[b] - subset.power * share_j[a] * share_d[b];
        jj[a * p + b] = of_jj[v][u] - n * mean_j[a] * mean_j[b] - subset.power * share_j[a] * share_j[b];
      }
    const double j_j = noise_gain_.j_j() * n, j_d = noise_gain_.j_d() * n;
    subset.noise_jj_u = static_cast<float>(j_j / jj[0]);
    subset.noise_jj_v = static_cast<float>(j_j / jj[monomials * (p + 1)]);
    subset.noise_jd_u = static_cast<float>(j_d / jd[0]);
    subset.noise_jd_v = static_cast<float>(j_d / jd[monomials * (p + 1)]);
    // A ramp of grey values looks like the constant or f; what is left of its gradients is rounding.
    constexpr double kRounding = 1e-5;
    for (int a = 0; a < p; ++a) {
      const double taken_off = n * mean_j[a] * mean_d[a] + subset.power * share_j[a] * share_d[a];
      if (!(jd[a * (p + 1)] > kRounding * taken_off)) return;
    }
    // Along stripes the gradient is but rounding, which the scaling in invert() would hide.
    const double along_x = jd[0], along_y = jd[monomials * (p + 1)];
    if (!(std::min(along_x, along_y) > 1e-6 * std::max(along_x, along_y)) || !invert(jd, p)) return;
    std::copy_n(jd.begin(), p * p, inverse);

    // Rows of the inverse that give the displacement of the point: with its powers as weights.
    const double xi = subset.away_x, eta = subset.away_y;
    const double powers[kMaxMonomials] = {1.0, xi, eta, xi * xi, xi * eta, eta * eta};
    std::array<double, kMaxParameters> to_u{}, to_v{};
    for (int m = 0; m < monomials; ++m)
      for (int b = 0; b < p; ++b) {
        to_u[b] += powers[m] * inverse[m * p + b];
        to_v[b] += powers[m] * inverse[(monomials + m) * p + b];
      }
    for (int a = 0; a < p; ++a) {
      double along_u = 0.0, along_v = 0.0;
      for (int b = 0; b < p; ++b) {
        along_u += jj[a * p + b] * to_u[b];
        along_v += jj[a * p + b] * to_v[b];
      }
      subset.uu += to_u[a] * along_u;
      subset.uv += to_u[a] * along_v;
      subset.vv += to_v[a] * along_v;
    }
    if (subset.uu > 0.0 && subset.uu * subset.vv > subset.uv * subset.uv)
      subset.state = Subset::State::kUsable;
  }

  const Loops& loops_;
  SubsetModel model_;
  NoiseGain noise_gain_;
  Box frame_;  // the part of the image that is needed, in which the planes are
  PaddedImage f_, jx_, jy_;
  std::vector<Subset, Allocator<Subset>> subsets_;
  std::vector<double, Allocator<double>> equations_;
};

}  // namespace rgbd_dic
