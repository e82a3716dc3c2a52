// Vectors of float32 as wide as the instruction set that the including file is compiled for. Included only by
// loops_for_isa.cpp: everything here is in the namespace of that instruction set.
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>

#if defined(__AVX512F__) || defined(__AVX2__) || defined(__SSE2__)
#include <immintrin.h>
#elif defined(__ARM_NEON) && defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace rgbd_dic::RGBD_DIC_ISA {

#define RGBD_DIC_INLINE inline __attribute__((always_inline))

#if defined(__AVX512F__)
constexpr int kWidth = 16;
#elif defined(__AVX2__)
constexpr int kWidth = 8;
#else
constexpr int kWidth = 4;
#endif

typedef float Floats __attribute__((vector_size(4 * kWidth)));
typedef std::int32_t Ints __attribute__((vector_size(4 * kWidth)));  // also masks: -1 is true, 0 is false

RGBD_DIC_INLINE Floats load(const float* values) {
  Floats vector;
  std::memcpy(&vector, values, sizeof vector);
  return vector;
}

RGBD_DIC_INLINE void store(float* values, Floats vector) { std::memcpy(values, &vector, sizeof vector); }
RGBD_DIC_INLINE void store(std::int32_t* values, Ints vector) { std::memcpy(values, &vector, sizeof vector); }

RGBD_DIC_INLINE Floats all_equal(float value) { return Floats{} + value; }

// 0, 1, 2, ...
RGBD_DIC_INLINE Ints lane_numbers() {
  Ints lanes;
  for (int l = 0; l < kWidth; ++l) lanes[l] = l;
  return lanes;
}

// Which pixels of a column belong to the subset. In those beyond may be anything.
RGBD_DIC_INLINE Ints inside(const Layout& layout, int column) {
  return lane_numbers() < layout.size() - column * kWidth;
}

RGBD_DIC_INLINE bool any(Ints mask) {
#if defined(__AVX512F__)
  return _mm512_test_epi32_mask((__m512i)mask, (__m512i)mask) != 0;
#elif defined(__AVX2__)
  return !_mm256_testz_si256((__m256i)mask, (__m256i)mask);
#elif defined(__SSE2__)
  return _mm_movemask_epi8((__m128i)mask) != 0;
#elif defined(__ARM_NEON) && defined(__aarch64__)
  return vmaxvq_u32((uint32x4_t)mask) != 0;
#else
  bool found = false;
  for (int l = 0; l < kWidth; ++l) found |= mask[l] != 0;
  return found;
#endif
}

RGBD_DIC_INLINE float sum(Floats v) {
#if defined(__AVX512F__)
  return _mm512_reduce_add_ps((__m512)v);
#elif defined(__AVX2__)
  const __m128 four = _mm_add_ps(_mm256_castps256_ps128((__m256)v), _mm256_extractf128_ps((__m256)v, 1));
  const __m128 two = _mm_add_ps(four, _mm_movehl_ps(four, four));
  return _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps(two, two, 1)));
#else
  return (v[0] + v[2]) + (v[1] + v[3]);
#endif
}

// Lane l is element index[l], 0 <= index[l] < 2 kWidth, of the two vectors end to end.
RGBD_DIC_INLINE Floats pick(Floats low, Floats high, Ints index) {
#if defined(__AVX512F__)
  return (Floats)_mm512_permutex2var_ps((__m512)low, (__m512i)index, (__m512)high);
#elif defined(__AVX2__)
  const __m256 from_low = _mm256_permutevar8x32_ps((__m256)low, (__m256i)index);
  const __m256 from_high = _mm256_permutevar8x32_ps((__m256)high, (__m256i)index);
  return (Floats)_mm256_blendv_ps(from_low, from_high, (__m256)(index > kWidth - 1));
#elif defined(__ARM_NEON) && defined(__aarch64__)
  const uint8x16x2_t bytes = {(uint8x16_t)low, (uint8x16_t)high};
  return (Floats)vqtbl2q_u8(bytes, (uint8x16_t)(index * 0x04040404 + 0x03020100));
#else
  Floats picked;
  for (int l = 0; l < kWidth; ++l) picked[l] = index[l] < kWidth ? low[index[l]] : high[index[l] - kWidth];
  return picked;
#endif
}

// The elements of two vectors in turn: of their first halves, and of their second ones.
template <int... lane>
RGBD_DIC_INLINE void interleave(Floats one, Floats other, Floats& first, Floats& second,
                                std::integer_sequence<int, lane...>) {
#if defined(__clang__) || __GNUC__ >= 12
  first = __builtin_shufflevector(one, other, (lane / 2 + lane % 2 * kWidth)...);
  second = __builtin_shufflevector(one, other, (kWidth / 2 + lane / 2 + lane % 2 * kWidth)...);
#else
  first = __builtin_shuffle(one, other, Ints{(lane / 2 + lane % 2 * kWidth)...});
  second = __builtin_shuffle(one, other, Ints{(kWidth / 2 + lane / 2 + lane % 2 * kWidth)...});
#endif
}

RGBD_DIC_INLINE void interleave(Floats one, Floats other, Floats& first, Floats& second) {
  interleave(one, other, first, second, std::make_integer_sequence<int, kWidth>{});
}

// Element k of row l becomes element l of row k.
RGBD_DIC_INLINE void transpose_block(Floats (&rows)[kWidth]) {
  for (int done = 1; done < kWidth; done *= 2) {
    Floats next[kWidth];
    for (int k = 0; k < kWidth / 2; ++k)
      interleave(rows[k], rows[k + kWidth / 2], next[2 * k], next[2 * k + 1]);
    for (int k = 0; k < kWidth; ++k) rows[k] = next[k];
  }
}

// Element k is the sum of vector k.
RGBD_DIC_INLINE Floats sums_of(const Floats (&vectors)[kWidth]) {
  Floats part[kWidth];
  for (int k = 0; k < kWidth; ++k) part[k] = vectors[k];
  for (int half = kWidth / 2; half > 0; half /= 2)
    for (int k = 0; k < half; ++k) {
      Floats first, second;
      interleave(part[k], part[k + half], first, second);
      part[k] = first + second;
    }
  return part[0];
}

// The greatest integers that are not greater, |v| < 2^31.
RGBD_DIC_INLINE Ints floor_of(Floats v) {
  const Ints towards_zero = __builtin_convertvector(v, Ints);
  return towards_zero + (v < __builtin_convertvector(towards_zero, Floats));  // true is -1
}

RGBD_DIC_INLINE Floats to_floats(Ints v) { return __builtin_convertvector(v, Floats); }

}  // namespace rgbd_dic::RGBD_DIC_ISA
