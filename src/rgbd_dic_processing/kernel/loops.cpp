#include "loops.hpp"

namespace rgbd_dic {

// What the instances of loops_for_isa.cpp define.
namespace avx512 {
extern const Loops kLoops;
}
namespace avx2 {
extern const Loops kLoops;
}
namespace baseline {
extern const Loops kLoops;
}

const std::vector<const Loops*>& available_loops() {
  static const std::vector<const Loops*> found = [] {
    std::vector<const Loops*> loops;
#if defined(__x86_64__)
    // What -march=x86-64-v4 and -v3 let the compiler use and these loops can meet.
    const bool v3 =
        __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
    if (v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl"))
      loops.push_back(&avx512::kLoops);
    if (v3) loops.push_back(&avx2::kLoops);
#endif
    loops.push_back(&baseline::kLoops);
    return loops;
  }();
  return found;
}

}  // namespace rgbd_dic
