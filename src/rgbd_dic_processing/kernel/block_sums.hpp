// Sums over the blocks of a subset. Included only by loops_for_isa.cpp, after simd.hpp.
#include <cstring>

#include "loops.hpp"

namespace rgbd_dic::RGBD_DIC_ISA {

// Sums over the blocks of some terms, which come as vectors of sums over a column within a level of blocks.
template <int count>
struct BlockSums {
  Floats parts[kBlocks * count]{};

  RGBD_DIC_INLINE void add(const Layout& layout, int column, int level, const Floats (&sums)[count]) {
    const Ints pixels = column * kWidth + lane_numbers();
    for (int k = 0; k < kSide; ++k) {
      const int first = block_start(k, layout.size()), end = block_start(k + 1, layout.size());
      if (end <= column * kWidth || first >= (column + 1) * kWidth) continue;
      const Ints within = (pixels >= first) & (pixels < end);
      for (int term = 0; term < count; ++term)
        parts[term * kBlocks + level * kSide + k] += within ? sums[term] : Floats{};
    }
  }

  // Into a structure of as many BlockSum.
  template <class Blocks>
  RGBD_DIC_INLINE void finish(Blocks& blocks) const {
    static_assert(kBlocks % kWidth == 0, "so that whole vectors of sums are stored");
    float values[kBlocks * count];
    static_assert(sizeof values == sizeof blocks);
    for (int first = 0; first < kBlocks * count; first += kWidth) {
      Floats some[kWidth];
      for (int k = 0; k < kWidth; ++k) some[k] = parts[first + k];
      store(values + first, sums_of(some));
    }
    std::memcpy(&blocks, values, sizeof blocks);
  }
};

}  // namespace rgbd_dic::RGBD_DIC_ISA
