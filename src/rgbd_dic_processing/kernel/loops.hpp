// The loops in which the time goes, compiled once for each instruction set (loops_for_isa.cpp) and chosen at
// run time.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rgbd_dic {

// Pixels of the image processed side by side need this many values beyond the last one to be readable.
constexpr int kReadAhead = 40;

constexpr int kMaxOrder = 2;      // of the local increment: 1 affine, 2 quadratic
constexpr int kMaxMonomials = 6;  // 1, xi, eta, xi^2, xi eta, eta^2
constexpr int kMaxParameters = 2 * kMaxMonomials;
constexpr int monomial_count(int order) { return order == 1 ? 3 : 6; }

// The pixels of a subset of half-width `half`, px, held in columns of `width` pixels beside each other (that
// of Loops; the last column may stick out of the subset), row by row within a column.
struct Layout {
  int half, columns;

  int size() const { return 2 * half + 1; }
  int count() const { return size() * size(); }
};

// One pixel of each plane that the reference has: its grey values f and the steepest-descent gradient j, and,
// while it is prepared, the spline's gradient d; gradients in grey levels per px. All have the same stride.
struct ReferencePixels {
  const float *f, *jx, *jy, *dx, *dy;
  std::ptrdiff_t stride;
};

// A subset is judged by its parts: kSide x kSide blocks, row by row.
constexpr int kSide = 4, kBlocks = kSide * kSide;
inline int block_start(int k, int size) { return k * size / kSide; }  // first column or line of the k-th
inline int block_length(int k, int size) { return block_start(k + 1, size) - block_start(k, size); }

// Sums down the columns of pixels through some subsets beside each other, lines of floats that are added up
// along the subsets: of products of gradients by level of blocks or power of eta, of the gradients and of
// them times f by power of eta, of f and f^2 by level, with the column's mean taken off f; and that mean.
constexpr int column_sum_count(int order) {
  return 4 * (kSide + 2 * order) + 3 * (2 * order + 1) + 3 * kSide + 8 * (order + 1) + 2 * kSide + 1;
}

// Sums over a subset for its normal equations: of products times xi^p eta^q, [q][p], and of f, f^2.
struct ProductSums {
  double f, f_f;
  double jx[3][3], jy[3][3], dx[3][3], dy[3][3];
  double jx_f[3][3], jy_f[3][3], dx_f[3][3], dy_f[3][3];
  double jx_dx[5][5], jx_dy[5][5], jy_dx[5][5], jy_dy[5][5];
  double jx_jx[5][5], jx_jy[5][5], jy_jy[5][5];
};

// The B-spline coefficients around a subset. Positions are relative to `origin`, a pixel; `low` and `high`
// are the least and the greatest ones allowed.
struct SplinePixels {
  const float* origin;
  std::ptrdiff_t stride;
  float low_x, high_x, low_y, high_y;
};

// x' - xi and y' - eta as polynomials in [1, xi, eta, xi^2, xi eta, eta^2], relative to SplinePixels::origin:
// float32 holds them better than x' and y'.
struct LocalWarp {
  float x[kMaxMonomials], y[kMaxMonomials];
};

struct Moments {
  float mean, power;  // power: sum of squared deviations from the mean
};

// Sums over the subset of the residual r times itself, f, 1 and the columns of J.
struct ResidualSums {
  float r_r, r_f, r_1, r_j[kMaxParameters];
};

// Sums over each block.
using BlockSum = float[kBlocks];
struct BlockProducts {
  BlockSum f, f_f, jx_dx, jx_dy, jy_dx, jy_dy, dx_dx, dx_dy, dy_dy;
};
struct BlockResiduals {
  BlockSum r_r, r_jx, r_jy;
};
struct BlockSamples {
  BlockSum g, g_g, f_g;
};

struct Loops {
  const char* name;
  int width;

  // Samples the target into g; false if a position is not within the limits. For degree 3, and 5.
  bool (*sample_cubic)(const Layout&, const SplinePixels&, const LocalWarp&, float* g);
  bool (*sample_quintic)(const Layout&, const SplinePixels&, const LocalWarp&, float* g);

  Moments (*moments)(const Layout&, const float* g);

  // r = f - mean_f - scale (g - mean_g).
  void (*residual_sums)(const Layout&, const ReferencePixels&, float mean_f, const float* g, float mean_g,
                        float scale, int order, ResidualSums&);
  void (*block_residuals)(const Layout&, const ReferencePixels&, float mean_f, const float* g, float mean_g,
                          float scale, BlockResiduals&);

  // Of f - mean_f and g - mean_g.
  void (*block_samples)(const Layout&, const ReferencePixels&, float mean_f, const float* g, float mean_g,
                        BlockSamples&);

  // Of `count` columns from the pixel on; the lines of sums are `stride` floats apart and take a whole number
  // of vectors.
  void (*column_sums)(const Layout&, const ReferencePixels&, int order, std::ptrdiff_t count, float* sums,
                      std::ptrdiff_t stride);

  // `columns`: those sums, from the first column of the subset on. In the blocks f - mean_f stands for f.
  void (*product_sums)(const Layout&, int order, const float* columns, std::ptrdiff_t stride, ProductSums&,
                       BlockProducts&);

  // Mean over the subset of gain(x) gain(y), each a polynomial of four coefficients in (t - 1/2)^2, where t
  // is the fraction of a coordinate.
  float (*mean_gain)(const Layout&, const LocalWarp&, const float (&gain)[4]);

  void (*to_floats)(const std::uint8_t* pixels, std::ptrdiff_t count, float* out);

  // Recursive filter along `count` values of some lines, in place; value k of line l is data[k * step + l].
  void (*filter_lines)(float* data, std::ptrdiff_t count, std::ptrdiff_t step, std::ptrdiff_t lines,
                       int pole_count, const double* poles);

  // to[k * to_step + l] = from[l * from_step + k] for l < lines and k < count.
  void (*transpose)(const float* from, std::ptrdiff_t from_step, std::ptrdiff_t lines, std::ptrdiff_t count,
                    float* to, std::ptrdiff_t to_step);

  // out[i] = sum over k of weights[k] lines[k][i], i < count.
  void (*weighted_sum)(const float* const* lines, const float* weights, int terms, std::ptrdiff_t count,
                       float* out);
};

// Those that this processor can run, the fastest first.
const std::vector<const Loops*>& available_loops();

}  // namespace rgbd_dic
