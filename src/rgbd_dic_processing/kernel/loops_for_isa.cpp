// The loops for one instruction set: this file is compiled once for each, RGBD_DIC_ISA being its name.
//
// Nothing here, and in what is included here alone, may be an inline function or a template of a namespace
// that other files share: the linker could take the copy compiled here for all of them.
#include "loops.hpp"
#include "simd.hpp"
// After simd.hpp:
#include "block_sums.hpp"
#include "filter_loops.hpp"
#include "sampling_loops.hpp"
// After block_sums.hpp:
#include "product_loops.hpp"
#include "residual_loops.hpp"

namespace rgbd_dic::RGBD_DIC_ISA {

#define RGBD_DIC_STRINGIFIED(text) #text
#define RGBD_DIC_NAME_OF(isa) RGBD_DIC_STRINGIFIED(isa)

extern const Loops kLoops;
const Loops kLoops = {RGBD_DIC_NAME_OF(RGBD_DIC_ISA),
                      kWidth,
                      sample<3>,
                      sample<5>,
                      moments,
                      residual_sums,
                      block_residuals,
                      block_samples,
                      column_sums,
                      product_sums,
                      mean_gain,
                      to_floats,
                      filter_lines,
                      transpose,
                      weighted_sum};

}  // namespace rgbd_dic::RGBD_DIC_ISA
