// 16 lanes of AVX-512 (F, DQ, BW, VL).
#pragma once
#include <immintrin.h>

#include <cstdint>

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

constexpr int W = 16;

struct vf {
  __m512 v;
  vf() = default;
  vf(__m512 x) : v(x) {}
  vf(float x) : v(_mm512_set1_ps(x)) {}
};
struct vm {
  __mmask16 m;
};
struct vi {
  __m512i v;
  vi() = default;
  vi(__m512i x) : v(x) {}
  vi(int32_t x) : v(_mm512_set1_epi32(x)) {}
};

static inline vf load(const float* p) { return _mm512_loadu_ps(p); }
static inline void store(float* p, vf a) { _mm512_storeu_ps(p, a.v); }
// Past the caches: `p` aligned to the vector. `stream_end` before another thread reads it.
static inline void stream(float* p, vf a) { _mm512_stream_ps(p, a.v); }
static inline void stream_end() { _mm_sfence(); }
static inline vf load_half(const uint16_t* p) {
  return _mm512_cvtph_ps(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(p)));
}
static inline vf load_first(const float* p, int n) {
  return _mm512_maskz_loadu_ps(__mmask16((1u << n) - 1u), p);
}
static inline void store_first(float* p, vf a, int n) {
  _mm512_mask_storeu_ps(p, __mmask16((1u << n) - 1u), a.v);
}

static inline vf operator+(vf a, vf b) { return _mm512_add_ps(a.v, b.v); }
static inline vf operator-(vf a, vf b) { return _mm512_sub_ps(a.v, b.v); }
static inline vf operator*(vf a, vf b) { return _mm512_mul_ps(a.v, b.v); }
static inline vf operator/(vf a, vf b) { return _mm512_div_ps(a.v, b.v); }
static inline vf operator-(vf a) { return _mm512_xor_ps(a.v, _mm512_set1_ps(-0.0f)); }
static inline vf fma(vf a, vf b, vf c) { return _mm512_fmadd_ps(a.v, b.v, c.v); }
static inline vf fnma(vf a, vf b, vf c) { return _mm512_fnmadd_ps(a.v, b.v, c.v); }
static inline vf vmin(vf a, vf b) { return _mm512_min_ps(a.v, b.v); }
static inline vf vmax(vf a, vf b) { return _mm512_max_ps(a.v, b.v); }
static inline vf vsqrt(vf a) { return _mm512_sqrt_ps(a.v); }
static inline vf vabs(vf a) { return _mm512_abs_ps(a.v); }
static inline vf vceil(vf a) { return _mm512_roundscale_ps(a.v, _MM_FROUND_TO_POS_INF | _MM_FROUND_NO_EXC); }
// Relative error below 2^-11.
static inline vf fast_rsqrt(vf a) { return _mm512_rsqrt14_ps(a.v); }
static inline vf fast_reciprocal(vf a) {
  __m512 r = _mm512_rcp14_ps(a.v);
  return _mm512_mul_ps(r, _mm512_fnmadd_ps(a.v, r, _mm512_set1_ps(2.0f)));
}

static inline vm operator<(vf a, vf b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LT_OQ)}; }
static inline vm operator<=(vf a, vf b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_LE_OQ)}; }
static inline vm operator>(vf a, vf b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_GT_OQ)}; }
static inline vm operator>=(vf a, vf b) { return {_mm512_cmp_ps_mask(a.v, b.v, _CMP_GE_OQ)}; }
static inline vm operator&(vm a, vm b) { return {__mmask16(a.m & b.m)}; }
static inline vm operator|(vm a, vm b) { return {__mmask16(a.m | b.m)}; }
static inline vm operator~(vm a) { return {__mmask16(~a.m)}; }
static inline uint32_t bits(vm a) { return a.m; }
static inline bool any(vm a) { return a.m != 0; }
static inline vm mask_from_bits(uint32_t b) { return {__mmask16(b)}; }
static inline vf select(vm m, vf a, vf b) { return _mm512_mask_blend_ps(m.m, b.v, a.v); }
static inline vf keep(vm m, vf a) { return _mm512_maskz_mov_ps(m.m, a.v); }
static inline vf drop(vm m, vf a) { return _mm512_maskz_mov_ps(__mmask16(~m.m), a.v); }

static inline vi as_int(vf a) { return _mm512_castps_si512(a.v); }
static inline vf as_float(vi a) { return _mm512_castsi512_ps(a.v); }
static inline vi operator+(vi a, vi b) { return _mm512_add_epi32(a.v, b.v); }
static inline vi operator-(vi a, vi b) { return _mm512_sub_epi32(a.v, b.v); }
static inline vi operator&(vi a, vi b) { return _mm512_and_si512(a.v, b.v); }
static inline vi operator|(vi a, vi b) { return _mm512_or_si512(a.v, b.v); }
template <int n>
static inline vi shift_left(vi a) { return _mm512_slli_epi32(a.v, n); }
template <int n>
static inline vi shift_right(vi a) { return _mm512_srai_epi32(a.v, n); }
static inline vf to_float(vi a) { return _mm512_cvtepi32_ps(a.v); }
static inline vi round_to_int(vf a) { return _mm512_cvtps_epi32(a.v); }
static inline void store(int32_t* p, vi a) { _mm512_storeu_si512(p, a.v); }
static inline vi select(vm m, vi a, vi b) { return _mm512_mask_blend_epi32(m.m, b.v, a.v); }

// x = floor(x) + fraction, and a number in [1, 2) times 2^floor(x).
static inline vf exp2_fraction(vf x) {
  return _mm512_reduce_ps(x.v, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
}
static inline vf exp2_scale(vf mantissa, vf x) { return _mm512_scalef_ps(mantissa.v, x.v); }
constexpr bool kExp2Floor = true;

static inline void transpose(vf* r) {
  __m512 t[16], s[16];
  for (int i = 0; i < 16; i += 4) {
    __m512 a = _mm512_unpacklo_ps(r[i].v, r[i + 1].v), b = _mm512_unpackhi_ps(r[i].v, r[i + 1].v);
    __m512 c = _mm512_unpacklo_ps(r[i + 2].v, r[i + 3].v),
           d = _mm512_unpackhi_ps(r[i + 2].v, r[i + 3].v);
    t[i] = _mm512_shuffle_ps(a, c, 0x44);
    t[i + 1] = _mm512_shuffle_ps(a, c, 0xEE);
    t[i + 2] = _mm512_shuffle_ps(b, d, 0x44);
    t[i + 3] = _mm512_shuffle_ps(b, d, 0xEE);
  }
  // t[4 k + j] holds, for lane group g, element (column 4 g + j) of rows 4 k .. 4 k + 3.
  for (int j = 0; j < 4; ++j) {
    s[j] = _mm512_shuffle_f32x4(t[j], t[4 + j], 0x44);
    s[4 + j] = _mm512_shuffle_f32x4(t[j], t[4 + j], 0xEE);
    s[8 + j] = _mm512_shuffle_f32x4(t[8 + j], t[12 + j], 0x44);
    s[12 + j] = _mm512_shuffle_f32x4(t[8 + j], t[12 + j], 0xEE);
  }
  for (int j = 0; j < 4; ++j) {
    r[j] = _mm512_shuffle_f32x4(s[j], s[8 + j], 0x88);
    r[4 + j] = _mm512_shuffle_f32x4(s[j], s[8 + j], 0xDD);
    r[8 + j] = _mm512_shuffle_f32x4(s[4 + j], s[12 + j], 0x88);
    r[12 + j] = _mm512_shuffle_f32x4(s[4 + j], s[12 + j], 0xDD);
  }
}

// Columns of W contiguous rows of three or four floats, and back.
static inline __m512i three_times_lane(int offset) {
  alignas(64) int32_t i[16];
  for (int l = 0; l < 16; ++l) i[l] = (3 * l + offset) % 16;
  return _mm512_load_si512(i);
}
static inline void load_columns(const float* p, vf (&out)[3]) {
  const __m512 a = _mm512_loadu_ps(p), b = _mm512_loadu_ps(p + 16), c = _mm512_loadu_ps(p + 32);
  // Of each column every lane holds one element in exactly one of the three vectors.
  const __mmask16 m0 = 0x9249, m1 = 0x2492, m2 = 0x4924;  // lanes 3 i, 3 i + 1, 3 i + 2
  out[0] = _mm512_permutexvar_ps(three_times_lane(0),
                                 _mm512_mask_mov_ps(_mm512_mask_mov_ps(a, m2, b), m1, c));
  out[1] = _mm512_permutexvar_ps(three_times_lane(1),
                                 _mm512_mask_mov_ps(_mm512_mask_mov_ps(a, m0, b), m2, c));
  out[2] = _mm512_permutexvar_ps(three_times_lane(2),
                                 _mm512_mask_mov_ps(_mm512_mask_mov_ps(a, m1, b), m0, c));
}
static inline void load_columns(const float* p, vf (&out)[4]) {
  const __m512i perm = _mm512_set_epi32(15, 11, 7, 3, 14, 10, 6, 2, 13, 9, 5, 1, 12, 8, 4, 0);
  __m512 r[4];
  for (int i = 0; i < 4; ++i) r[i] = _mm512_permutexvar_ps(perm, _mm512_loadu_ps(p + 16 * i));
  // r[i] holds, in lane group c, component c of rows 4 i .. 4 i + 3.
  const __m512 a = _mm512_shuffle_f32x4(r[0], r[1], 0x44), b = _mm512_shuffle_f32x4(r[0], r[1], 0xEE);
  const __m512 c = _mm512_shuffle_f32x4(r[2], r[3], 0x44), d = _mm512_shuffle_f32x4(r[2], r[3], 0xEE);
  out[0] = _mm512_shuffle_f32x4(a, c, 0x88);
  out[1] = _mm512_shuffle_f32x4(a, c, 0xDD);
  out[2] = _mm512_shuffle_f32x4(b, d, 0x88);
  out[3] = _mm512_shuffle_f32x4(b, d, 0xDD);
}

static inline __m512 pair_sum(__m512 a, __m512 b) {
  return _mm512_add_ps(_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
}
static inline __m512 quad_sum(__m512 a, __m512 b) {
  __m512d x = _mm512_castps_pd(a), y = _mm512_castps_pd(b);
  return _mm512_add_ps(_mm512_castpd_ps(_mm512_unpacklo_pd(x, y)),
                       _mm512_castpd_ps(_mm512_unpackhi_pd(x, y)));
}
// Writes the sums over the lanes of two vectors.
static inline void store_two_sums(float* out, vf a, vf b) {
  out[0] = _mm512_reduce_add_ps(a.v);
  out[1] = _mm512_reduce_add_ps(b.v);
}
// Writes the sums over the lanes of ten vectors.
static inline void store_ten_sums(float* out, const vf* a) {
  const __m512 zero = _mm512_setzero_ps();
  __m512 first = quad_sum(pair_sum(a[0].v, a[1].v), pair_sum(a[2].v, a[3].v));
  __m512 second = quad_sum(pair_sum(a[4].v, a[5].v), pair_sum(a[6].v, a[7].v));
  __m512 third = quad_sum(pair_sum(a[8].v, a[9].v), zero);
  __m512 x = _mm512_add_ps(_mm512_shuffle_f32x4(first, second, 0x44),
                           _mm512_shuffle_f32x4(first, second, 0xEE));
  __m512 y = _mm512_add_ps(_mm512_shuffle_f32x4(third, zero, 0x44),
                           _mm512_shuffle_f32x4(third, zero, 0xEE));
  __m512 sums = _mm512_add_ps(_mm512_shuffle_f32x4(x, y, 0x88), _mm512_shuffle_f32x4(x, y, 0xDD));
  _mm512_mask_storeu_ps(out, __mmask16(0x3FF), sums);
}

// Bits shift .. shift + 3 without as many of the lowest as `skip` says and of the highest as `miss` says,
// both rounded, from 0 to 4.
static inline vi run_of_four(vf skip, vf miss, int shift) {
  const __m512i four = _mm512_set1_epi32(int(0xFu << shift));
  return _mm512_and_si512(_mm512_sllv_epi32(four, _mm512_cvtps_epi32(skip.v)),
                          _mm512_srlv_epi32(four, _mm512_cvtps_epi32(miss.v)));
}

// bits[b] gets bit i of Gaussian i of 32 whose masks hold bit b.
static inline void bits_of_blocks(const int32_t* masks, void* rows, int stride) {
  uint8_t* bits = static_cast<uint8_t*>(rows);
  const __m512i low = _mm512_loadu_si512(masks), high = _mm512_loadu_si512(masks + 16);
  for (int b = 0; b < 16; ++b) {
    const __m512i bit = _mm512_set1_epi32(1 << b);
    const uint32_t word = uint32_t(_mm512_test_epi32_mask(low, bit)) |
                          uint32_t(_mm512_test_epi32_mask(high, bit)) << 16;
    __builtin_memcpy(bits + b * stride, &word, 4);
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
