// What the normal equations of a reference's subsets are made of: sums down its columns, which subsets
// beside each other share, and from these the sums over each subset. Included only by loops_for_isa.cpp,
// after simd.hpp and block_sums.hpp.
#include <cstddef>

#include "loops.hpp"

namespace rgbd_dic::RGBD_DIC_ISA {

// Sums over the lanes of vectors, a few at a time.
struct LateSums {
  Floats vectors[kWidth];
  double* sums[kWidth];
  int count = 0;

  RGBD_DIC_INLINE void add(Floats vector, double& sum) {
    vectors[count] = vector;
    sums[count++] = &sum;
    if (count == kWidth) finish();
  }

  RGBD_DIC_INLINE void finish() {
    float values[kWidth];
    store(values, sums_of(vectors));
    for (int k = 0; k < count; ++k) *sums[k] = values[k];
    count = 0;
  }
};

// Which line of column sums is which. Of the products of J and D, jx dx, jx dy, jy dx and jy dy, the sums
// over each level of blocks come first, then those times eta, eta^2, ...; of J and J, jx jx, jx jy and jy jy,
// those times 1, eta, ...; of D and D, dx dx, dx dy and dy dy, those over each level; of jx, jy, dx and dy
// those times 1, eta, ..., and the same of their products with f, from which the column's mean is taken off;
// of that f, and of its square, those over each level; the mean.
template <int order>
struct ColumnSums {
  static constexpr int kPowers = 2 * order;
  static constexpr int jd(int product) { return product * (kSide + kPowers); }
  static constexpr int jj(int product) { return jd(4) + product * (kPowers + 1); }
  static constexpr int dd(int product) { return jj(3) + product * kSide; }
  static constexpr int single(int gradient) { return dd(3) + gradient * (order + 1); }
  static constexpr int with_f(int gradient) { return single(4) + gradient * (order + 1); }
  static constexpr int f = with_f(4), f_f = f + kSide, mean = f_f + kSide;
  static_assert(mean + 1 == column_sum_count(order));
};

template <int order>
void column_sums_of(const Layout& layout, const ReferencePixels& reference, std::ptrdiff_t count, float* sums,
                    std::ptrdiff_t stride) {
  using Sums = ColumnSums<order>;
  constexpr int kPowers = Sums::kPowers;
  const int size = layout.size();
  for (std::ptrdiff_t start = 0; start < count; start += kWidth) {
    const auto put = [&](int line, Floats sum)
                         __attribute__((always_inline)) { store(sums + line * stride + start, sum); };
    const std::ptrdiff_t first = start - layout.half * reference.stride;

    Floats jd[4][kPowers]{}, q = all_equal(static_cast<float>(-layout.half));
    std::ptrdiff_t at = first;
    for (int level = 0; level < kSide; ++level) {
      Floats jd_level[4]{};
      for (int k = block_length(level, size); k > 0; --k, at += reference.stride, q += 1.0f) {
        const Floats jx = load(reference.jx + at), jy = load(reference.jy + at);
        const Floats dx = load(reference.dx + at), dy = load(reference.dy + at);
        // Of the columns to come; a processor does not foresee that line after line is taken from anew.
        for (const float* plane : {reference.f, reference.jx, reference.jy, reference.dx, reference.dy})
          __builtin_prefetch(plane + at + 2 * kWidth);
        const Floats products[] = {jx * dx, jx * dy, jy * dx, jy * dy};
        Floats power = q;
        for (int p = 0; p < kPowers; ++p, power *= q)
          for (int i = 0; i < 4; ++i) jd[i][p] += products[i] * power;
        for (int i = 0; i < 4; ++i) jd_level[i] += products[i];
      }
      for (int i = 0; i < 4; ++i) put(Sums::jd(i) + level, jd_level[i]);
    }
    for (int i = 0; i < 4; ++i)
      for (int p = 0; p < kPowers; ++p) put(Sums::jd(i) + kSide + p, jd[i][p]);

    Floats jj[3][kPowers + 1]{};
    q = all_equal(static_cast<float>(-layout.half));
    at = first;
    for (int line = 0; line < size; ++line, at += reference.stride, q += 1.0f) {
      const Floats jx = load(reference.jx + at), jy = load(reference.jy + at);
      const Floats products[] = {jx * jx, jx * jy, jy * jy};
      Floats power = q;
      for (int i = 0; i < 3; ++i) jj[i][0] += products[i];
      for (int p = 1; p <= kPowers; ++p, power *= q)
        for (int i = 0; i < 3; ++i) jj[i][p] += products[i] * power;
    }
    for (int i = 0; i < 3; ++i)
      for (int p = 0; p <= kPowers; ++p) put(Sums::jj(i) + p, jj[i][p]);

    Floats single[4][order + 1]{};
    q = all_equal(static_cast<float>(-layout.half));
    at = first;
    for (int level = 0; level < kSide; ++level) {
      Floats dd_level[3]{};
      for (int k = block_length(level, size); k > 0; --k, at += reference.stride, q += 1.0f) {
        const Floats gradients[] = {load(reference.jx + at), load(reference.jy + at), load(reference.dx + at),
                                    load(reference.dy + at)};
        dd_level[0] += gradients[2] * gradients[2];
        dd_level[1] += gradients[2] * gradients[3];
        dd_level[2] += gradients[3] * gradients[3];
        Floats power = q;
        for (int i = 0; i < 4; ++i) single[i][0] += gradients[i];
        for (int p = 1; p <= order; ++p, power *= q)
          for (int i = 0; i < 4; ++i) single[i][p] += gradients[i] * power;
      }
      for (int i = 0; i < 3; ++i) put(Sums::dd(i) + level, dd_level[i]);
    }
    for (int i = 0; i < 4; ++i)
      for (int p = 0; p <= order; ++p) put(Sums::single(i) + p, single[i][p]);

    Floats mean{};
    at = first;
    for (int line = 0; line < size; ++line, at += reference.stride) mean += load(reference.f + at);
    mean *= 1.0f / static_cast<float>(size);
    put(Sums::mean, mean);
    Floats with_f[4][order + 1]{};
    q = all_equal(static_cast<float>(-layout.half));
    at = first;
    for (int level = 0; level < kSide; ++level) {
      Floats f_level{}, f_f_level{};
      for (int k = block_length(level, size); k > 0; --k, at += reference.stride, q += 1.0f) {
        const Floats f = load(reference.f + at) - mean;
        f_level += f;
        f_f_level += f * f;
        const Floats products[] = {load(reference.jx + at) * f, load(reference.jy + at) * f,
                                   load(reference.dx + at) * f, load(reference.dy + at) * f};
        Floats power = q;
        for (int i = 0; i < 4; ++i) with_f[i][0] += products[i];
        for (int p = 1; p <= order; ++p, power *= q)
          for (int i = 0; i < 4; ++i) with_f[i][p] += products[i] * power;
      }
      put(Sums::f + level, f_level);
      put(Sums::f_f + level, f_f_level);
    }
    for (int i = 0; i < 4; ++i)
      for (int p = 0; p <= order; ++p) put(Sums::with_f(i) + p, with_f[i][p]);
  }
}

void column_sums(const Layout& layout, const ReferencePixels& reference, int order, std::ptrdiff_t count,
                 float* sums, std::ptrdiff_t stride) {
  (order == 1 ? column_sums_of<1> : column_sums_of<2>)(layout, reference, count, sums, stride);
}

// Sums times eta^q xi^p, p + q <= powers, lane by lane, of columns of vectors.
template <int powers>
struct LaneSums {
  Floats total[powers + 1][powers + 1];  // by q and p

  // `line` has those of a column times the powers of eta.
  RGBD_DIC_INLINE void add(int column, const Floats (&line)[powers + 1], Floats xi, Ints within) {
    for (int q = 0; q <= powers; ++q) {
      Floats term = within ? line[q] : Floats{};
      for (int p = 0; p + q <= powers; ++p) {
        total[q][p] = column == 0 ? term : total[q][p] + term;
        term *= xi;
      }
    }
  }

  template <int size>
  RGBD_DIC_INLINE void into(double (*sums)[size], LateSums& late) const {
    for (int q = 0; q <= powers; ++q)
      for (int p = 0; p + q <= powers; ++p) late.add(total[q][p], sums[q][p]);
  }
};

template <int order>
void product_sums_of(const Layout& layout, const float* columns, std::ptrdiff_t stride, ProductSums& sums,
                     BlockProducts& blocks) {
  using Sums = ColumnSums<order>;
  constexpr int kPowers = Sums::kPowers, kTerms = 9;
  const int size = layout.size();
  const auto at_line = [&](int line, int column) __attribute__((always_inline)) {
    return load(columns + line * stride + column * kWidth);
  };
  Floats f_total{};
  for (int column = 0; column < layout.columns; ++column) {
    Floats part = static_cast<float>(size) * at_line(Sums::mean, column);  // and what its rounding left:
    for (int level = 0; level < kSide; ++level) part += at_line(Sums::f + level, column);
    f_total += inside(layout, column) ? part : Floats{};
  }
  sums.f = sum(f_total);
  const float mean = static_cast<float>(sums.f / layout.count());

  LaneSums<kPowers> jd[4], jj[3];
  LaneSums<order> single[4], of_f[4];
  BlockSums<kTerms> parts;
  Floats f_f{};
  for (int column = 0; column < layout.columns; ++column) {
    const Floats xi = to_floats(column * kWidth - layout.half + lane_numbers());
    const Ints within = inside(layout, column);
    Floats terms[kSide][kTerms], line[kPowers + 1];
    for (int i = 0; i < 4; ++i) {
      line[0] = Floats{};
      for (int level = 0; level < kSide; ++level) {
        terms[level][2 + i] = at_line(Sums::jd(i) + level, column);
        line[0] += terms[level][2 + i];
      }
      for (int p = 1; p <= kPowers; ++p) line[p] = at_line(Sums::jd(i) + kSide + p - 1, column);
      jd[i].add(column, line, xi, within);
    }
    for (int i = 0; i < 3; ++i) {
      for (int p = 0; p <= kPowers; ++p) line[p] = at_line(Sums::jj(i) + p, column);
      jj[i].add(column, line, xi, within);
      for (int level = 0; level < kSide; ++level) terms[level][6 + i] = at_line(Sums::dd(i) + level, column);
    }
    // With the subset's mean taken off f instead of the column's:
    const Floats away = at_line(Sums::mean, column) - mean;
    for (int level = 0; level < kSide; ++level) {
      const Floats f = at_line(Sums::f + level, column),
                   all_away = static_cast<float>(block_length(level, size)) * away;
      terms[level][0] = f + all_away;
      terms[level][1] = at_line(Sums::f_f + level, column) + away * (2.0f * f + all_away);
      f_f += within ? terms[level][1] : Floats{};
      parts.add(layout, column, level, terms[level]);
    }
    for (int i = 0; i < 4; ++i) {
      Floats alone[order + 1], with_f[order + 1];
      for (int p = 0; p <= order; ++p) {
        alone[p] = at_line(Sums::single(i) + p, column);
        with_f[p] = at_line(Sums::with_f(i) + p, column) + away * alone[p];
      }
      single[i].add(column, alone, xi, within);
      of_f[i].add(column, with_f, xi, within);
    }
  }

  parts.finish(blocks);
  LateSums late;
  late.add(f_f, sums.f_f);
  double (*const to_jd[])[5] = {sums.jx_dx, sums.jx_dy, sums.jy_dx, sums.jy_dy};
  double (*const to_jj[])[5] = {sums.jx_jx, sums.jx_jy, sums.jy_jy};
  double (*const to_single[])[3] = {sums.jx, sums.jy, sums.dx, sums.dy};
  double (*const to_f[])[3] = {sums.jx_f, sums.jy_f, sums.dx_f, sums.dy_f};
  for (int i = 0; i < 4; ++i) jd[i].into(to_jd[i], late);
  for (int i = 0; i < 3; ++i) jj[i].into(to_jj[i], late);
  for (int i = 0; i < 4; ++i) single[i].into(to_single[i], late);
  for (int i = 0; i < 4; ++i) of_f[i].into(to_f[i], late);
  late.finish();
}

void product_sums(const Layout& layout, int order, const float* columns, std::ptrdiff_t stride,
                  ProductSums& sums, BlockProducts& blocks) {
  (order == 1 ? product_sums_of<1> : product_sums_of<2>)(layout, columns, stride, sums, blocks);
}

}  // namespace rgbd_dic::RGBD_DIC_ISA
