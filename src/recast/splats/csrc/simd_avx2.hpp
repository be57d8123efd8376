// 8 lanes of AVX2 with FMA.
#pragma once
#include <immintrin.h>

#include <cstdint>

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

constexpr int W = 8;

struct vf {
  __m256 v;
  vf() = default;
  vf(__m256 x) : v(x) {}
  vf(float x) : v(_mm256_set1_ps(x)) {}
};
struct vm {
  __m256 m;
};
struct vi {
  __m256i v;
  vi() = default;
  vi(__m256i x) : v(x) {}
  vi(int32_t x) : v(_mm256_set1_epi32(x)) {}
};

static inline __m256i first_lanes(int n) {
  return _mm256_cmpgt_epi32(_mm256_set1_epi32(n), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
}
static inline vf load(const float* p) { return _mm256_loadu_ps(p); }
static inline void store(float* p, vf a) { _mm256_storeu_ps(p, a.v); }
// Past the caches: `p` aligned to the vector. `stream_end` before another thread reads it.
static inline void stream(float* p, vf a) { _mm256_stream_ps(p, a.v); }
static inline void stream_end() { _mm_sfence(); }
static inline vf load_half(const uint16_t* p) {
  return _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(p)));
}
static inline vf load_first(const float* p, int n) {
  return _mm256_maskload_ps(p, first_lanes(n));
}
static inline void store_first(float* p, vf a, int n) {
  _mm256_maskstore_ps(p, first_lanes(n), a.v);
}

static inline vf operator+(vf a, vf b) { return _mm256_add_ps(a.v, b.v); }
static inline vf operator-(vf a, vf b) { return _mm256_sub_ps(a.v, b.v); }
static inline vf operator*(vf a, vf b) { return _mm256_mul_ps(a.v, b.v); }
static inline vf operator/(vf a, vf b) { return _mm256_div_ps(a.v, b.v); }
static inline vf operator-(vf a) { return _mm256_xor_ps(a.v, _mm256_set1_ps(-0.0f)); }
static inline vf fma(vf a, vf b, vf c) { return _mm256_fmadd_ps(a.v, b.v, c.v); }
static inline vf fnma(vf a, vf b, vf c) { return _mm256_fnmadd_ps(a.v, b.v, c.v); }
static inline vf vmin(vf a, vf b) { return _mm256_min_ps(a.v, b.v); }
static inline vf vmax(vf a, vf b) { return _mm256_max_ps(a.v, b.v); }
static inline vf vsqrt(vf a) { return _mm256_sqrt_ps(a.v); }
static inline vf vabs(vf a) { return _mm256_andnot_ps(_mm256_set1_ps(-0.0f), a.v); }
static inline vf vceil(vf a) { return _mm256_ceil_ps(a.v); }
// Relative error below 2^-11.
static inline vf fast_rsqrt(vf a) { return _mm256_rsqrt_ps(a.v); }
static inline vf fast_reciprocal(vf a) {
  // rcpps has 12 bits and one Newton step gives 23.
  __m256 r = _mm256_rcp_ps(a.v);
  return _mm256_mul_ps(r, _mm256_fnmadd_ps(a.v, r, _mm256_set1_ps(2.0f)));
}

static inline vm operator<(vf a, vf b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_LT_OQ)}; }
static inline vm operator<=(vf a, vf b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_LE_OQ)}; }
static inline vm operator>(vf a, vf b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_GT_OQ)}; }
static inline vm operator>=(vf a, vf b) { return {_mm256_cmp_ps(a.v, b.v, _CMP_GE_OQ)}; }
static inline vm operator&(vm a, vm b) { return {_mm256_and_ps(a.m, b.m)}; }
static inline vm operator|(vm a, vm b) { return {_mm256_or_ps(a.m, b.m)}; }
static inline vm operator~(vm a) {
  return {_mm256_xor_ps(a.m, _mm256_castsi256_ps(_mm256_set1_epi32(-1)))};
}
static inline uint32_t bits(vm a) { return uint32_t(_mm256_movemask_ps(a.m)); }
static inline bool any(vm a) { return bits(a) != 0; }
static inline vm mask_from_bits(uint32_t b) {
  const __m256i lane = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
  __m256i x = _mm256_and_si256(_mm256_set1_epi32(int(b)), lane);
  return {_mm256_castsi256_ps(_mm256_cmpeq_epi32(x, lane))};
}
static inline vf select(vm m, vf a, vf b) { return _mm256_blendv_ps(b.v, a.v, m.m); }
static inline vf keep(vm m, vf a) { return _mm256_and_ps(m.m, a.v); }
static inline vf drop(vm m, vf a) { return _mm256_andnot_ps(m.m, a.v); }

static inline vi as_int(vf a) { return _mm256_castps_si256(a.v); }
static inline vf as_float(vi a) { return _mm256_castsi256_ps(a.v); }
static inline vi operator+(vi a, vi b) { return _mm256_add_epi32(a.v, b.v); }
static inline vi operator-(vi a, vi b) { return _mm256_sub_epi32(a.v, b.v); }
static inline vi operator&(vi a, vi b) { return _mm256_and_si256(a.v, b.v); }
static inline vi operator|(vi a, vi b) { return _mm256_or_si256(a.v, b.v); }
template <int n>
static inline vi shift_left(vi a) { return _mm256_slli_epi32(a.v, n); }
template <int n>
static inline vi shift_right(vi a) { return _mm256_srai_epi32(a.v, n); }
static inline vf to_float(vi a) { return _mm256_cvtepi32_ps(a.v); }
static inline vi round_to_int(vf a) { return _mm256_cvtps_epi32(a.v); }
static inline void store(int32_t* p, vi a) {
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), a.v);
}
static inline vi select(vm m, vi a, vi b) {
  return _mm256_blendv_epi8(b.v, a.v, _mm256_castps_si256(m.m));
}
constexpr bool kExp2Floor = false;

static inline void transpose(vf* r) {
  __m256 t[8];
  for (int i = 0; i < 8; i += 4) {
    __m256 a = _mm256_unpacklo_ps(r[i].v, r[i + 1].v), b = _mm256_unpackhi_ps(r[i].v, r[i + 1].v);
    __m256 c = _mm256_unpacklo_ps(r[i + 2].v, r[i + 3].v),
           d = _mm256_unpackhi_ps(r[i + 2].v, r[i + 3].v);
    t[i] = _mm256_shuffle_ps(a, c, 0x44);
    t[i + 1] = _mm256_shuffle_ps(a, c, 0xEE);
    t[i + 2] = _mm256_shuffle_ps(b, d, 0x44);
    t[i + 3] = _mm256_shuffle_ps(b, d, 0xEE);
  }
  for (int j = 0; j < 4; ++j) {
    r[j] = _mm256_permute2f128_ps(t[j], t[4 + j], 0x20);
    r[4 + j] = _mm256_permute2f128_ps(t[j], t[4 + j], 0x31);
  }
}

// Columns of W contiguous rows of three or four floats.
static inline void load_columns(const float* p, vf (&out)[3]) {
  const __m256 a = _mm256_loadu_ps(p), b = _mm256_loadu_ps(p + 8), c = _mm256_loadu_ps(p + 16);
  // Of each column every lane holds one element in exactly one of the three vectors.
  const int m0 = 0x49, m1 = 0x92, m2 = 0x24;  // lanes 3 i, 3 i + 1, 3 i + 2
  out[0] = _mm256_permutevar8x32_ps(_mm256_blend_ps(_mm256_blend_ps(a, b, m1), c, m2),
                                    _mm256_setr_epi32(0, 3, 6, 1, 4, 7, 2, 5));
  out[1] = _mm256_permutevar8x32_ps(_mm256_blend_ps(_mm256_blend_ps(a, b, m2), c, m0),
                                    _mm256_setr_epi32(1, 4, 7, 2, 5, 0, 3, 6));
  out[2] = _mm256_permutevar8x32_ps(_mm256_blend_ps(_mm256_blend_ps(a, b, m0), c, m1),
                                    _mm256_setr_epi32(2, 5, 0, 3, 6, 1, 4, 7));
}
static inline void load_columns(const float* p, vf (&out)[4]) {
  __m256 t[4];
  for (int i = 0; i < 4; ++i)
    t[i] = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p + 4 * i)),
                                _mm_loadu_ps(p + 16 + 4 * i), 1);
  const __m256 a = _mm256_unpacklo_ps(t[0], t[1]), b = _mm256_unpackhi_ps(t[0], t[1]);
  const __m256 c = _mm256_unpacklo_ps(t[2], t[3]), d = _mm256_unpackhi_ps(t[2], t[3]);
  out[0] = _mm256_shuffle_ps(a, c, 0x44);
  out[1] = _mm256_shuffle_ps(a, c, 0xEE);
  out[2] = _mm256_shuffle_ps(b, d, 0x44);
  out[3] = _mm256_shuffle_ps(b, d, 0xEE);
}

// Writes the sums over the lanes of two vectors.
static inline void store_two_sums(float* out, vf a, vf b) {
  __m256 x = _mm256_hadd_ps(a.v, b.v);
  x = _mm256_hadd_ps(x, x);
  const __m128 sums = _mm_add_ps(_mm256_castps256_ps128(x), _mm256_extractf128_ps(x, 1));
  _mm_storel_pi(reinterpret_cast<__m64*>(out), sums);
}
// Writes the sums over the lanes of ten vectors.
static inline void store_ten_sums(float* out, const vf* a) {
  auto four = [](__m256 p, __m256 q, __m256 r, __m256 s) {
    __m256 x = _mm256_hadd_ps(_mm256_hadd_ps(p, q), _mm256_hadd_ps(r, s));
    return _mm_add_ps(_mm256_castps256_ps128(x), _mm256_extractf128_ps(x, 1));
  };
  _mm_storeu_ps(out, four(a[0].v, a[1].v, a[2].v, a[3].v));
  _mm_storeu_ps(out + 4, four(a[4].v, a[5].v, a[6].v, a[7].v));
  store_two_sums(out + 8, a[8], a[9]);
}

// Bits shift .. shift + 3 without as many of the lowest as `skip` says and of the highest as `miss` says,
// both rounded, from 0 to 4.
static inline vi run_of_four(vf skip, vf miss, int shift) {
  const __m256i four = _mm256_set1_epi32(int(0xFu << shift));
  return _mm256_and_si256(_mm256_sllv_epi32(four, _mm256_cvtps_epi32(skip.v)),
                          _mm256_srlv_epi32(four, _mm256_cvtps_epi32(miss.v)));
}

// bits[b] gets bit i of Gaussian i of 32 whose masks hold bit b.
static inline void bits_of_blocks(const int32_t* masks, void* rows, int stride) {
  uint8_t* bits = static_cast<uint8_t*>(rows);
  const __m256i planes = _mm256_setr_epi8(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15, 0, 4,
                                          8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
  __m256i m[4];
  for (int k = 0; k < 4; ++k)
    m[k] = _mm256_shuffle_epi8(
        _mm256_loadu_si256(reinterpret_cast<const __m256i*>(masks + 8 * k)), planes);
  const __m256i a = _mm256_unpacklo_epi32(m[0], m[1]), b = _mm256_unpackhi_epi32(m[0], m[1]);
  const __m256i c = _mm256_unpacklo_epi32(m[2], m[3]), d = _mm256_unpackhi_epi32(m[2], m[3]);
  __m256i plane[4] = {_mm256_unpacklo_epi64(a, c), _mm256_unpackhi_epi64(a, c),
                      _mm256_unpacklo_epi64(b, d), _mm256_unpackhi_epi64(b, d)};
  const __m256i order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
  for (int p = 0; p < 4; ++p) {
    __m256i bytes = _mm256_permutevar8x32_epi32(plane[p], order);
    for (int bit = 7; bit >= 0; --bit) {
      const uint32_t word = uint32_t(_mm256_movemask_epi8(bytes));
      __builtin_memcpy(bits + (8 * p + bit) * stride, &word, 4);
      bytes = _mm256_add_epi8(bytes, bytes);
    }
  }
}

// Writes four pixels of three planes, interleaved.
static inline void store_pixels(float* out, const float* r, const float* g, const float* b) {
  const __m128 red = _mm_loadu_ps(r), green = _mm_loadu_ps(g), blue = _mm_loadu_ps(b);
  const __m128 b0_r1 = _mm_shuffle_ps(blue, red, 0x50), g1_b1 = _mm_shuffle_ps(green, blue, 0x55);
  const __m128 b2_r3 = _mm_shuffle_ps(blue, red, 0xFA), g3_b3 = _mm_shuffle_ps(green, blue, 0xFF);
  _mm_storeu_ps(out, _mm_shuffle_ps(_mm_unpacklo_ps(red, green), b0_r1, 0x84));
  _mm_storeu_ps(out + 4, _mm_shuffle_ps(g1_b1, _mm_unpackhi_ps(red, green), 0x48));
  _mm_storeu_ps(out + 8, _mm_shuffle_ps(b2_r3, g3_b3, 0x88));
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
