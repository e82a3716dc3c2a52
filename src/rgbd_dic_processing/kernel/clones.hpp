// One source, several instruction sets: a function marked RGBD_DIC_CLONES is compiled for AVX-512, AVX2 and
// the baseline, and the loader picks the best that the processor has. Elsewhere the mark means nothing.
#pragma once

#include <cstddef>  // defines __GLIBC__ where the C library can resolve such functions

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__GLIBC__)
#define RGBD_DIC_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define RGBD_DIC_CLONES
#endif

// Code shared by marked functions must end up inside of them to be compiled for their instruction set.
#define RGBD_DIC_INLINE inline __attribute__((always_inline))
