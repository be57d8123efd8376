// The vector type of this build, and the transcendental functions on it.
//
// Sources that include this are compiled once an instruction set, each time into its own namespace
// RECAST_ISA. They must not use templates or inline functions of the standard library: the linker
// keeps one copy of such a function for all builds, and it could be one that the machine cannot run.
#pragma once

// An AVX-512 build has both widths, apart by the name of their namespace: of inline functions of one
// name, too, the linker keeps one.
#if defined(RECAST_AVX512) && !defined(RECAST_EIGHT_LANES)
#define RECAST_LANES lanes16
#include "simd_avx512.hpp"
#else
#define RECAST_LANES lanes8
#if defined(RECAST_AVX512) || defined(RECAST_AVX2)
#include "simd_avx2.hpp"
#else
#include "simd_portable.hpp"
#endif
#endif

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

// 2^x, relative error 1e-7, for -126 < x < 126; anything elsewhere, but no trap.
static inline vf exp2_bounded(vf x) {
#if defined(RECAST_AVX512) && !defined(RECAST_EIGHT_LANES)
  vf f = exp2_fraction(x);
  vf p = vf(0.001877576645f);
  p = fma(p, f, vf(0.008989340163f));
  p = fma(p, f, vf(0.05582631799f));
  p = fma(p, f, vf(0.2401536171f));
  p = fma(p, f, vf(0.6931530732f));
  p = fma(p, f, vf(0.9999999251f));
  return exp2_scale(p, x);
#else
  const vf shifter = vf(12582912.0f);  // 1.5 * 2^23: rounds to integers in the low bits
  vf t = x + shifter;
  vf f = x - (t - shifter);
  vf p = vf(0.001327647178f);
  p = fma(p, f, vf(0.009675541333f));
  p = fma(p, f, vf(0.05550713274f));
  p = fma(p, f, vf(0.2402211972f));
  p = fma(p, f, vf(0.6931469671f));
  p = fma(p, f, vf(1.000000072f));
  return as_float(as_int(p) + shift_left<23>(as_int(t)));
#endif
}

// e^x, relative error 1e-7; x is clamped to where the result is a normal number.
static inline vf vexp(vf x) {
  x = vmin(vmax(x, vf(-87.0f)), vf(87.0f));
  vi n = round_to_int(x * vf(1.44269504f));
  vf nf = to_float(n);
  vf r = fnma(nf, vf(0.693359375f), x);  // ln 2 in two parts, the first one short
  r = fnma(nf, vf(-2.12194440e-4f), r);
  vf p = vf(0.001383684582f);
  p = fma(p, r, vf(0.008374815803f));
  p = fma(p, r, vf(0.04166822557f));
  p = fma(p, r, vf(0.1666642017f));
  p = fma(p, r, vf(0.4999999208f));
  p = fma(p, r, vf(1.0f));
  p = fma(p, r, vf(1.0f));
  return as_float(as_int(p) + shift_left<23>(n));
}

// log2(x) for normal x > 0, absolute error 1e-7.
static inline vf vlog2(vf x) {
  vi i = as_int(x);
  vi e = shift_right<23>(i) - vi(127);
  vf m = as_float((i & vi(0x007FFFFF)) | vi(0x3F800000));
  vm high = m > vf(1.41421356f);
  m = select(high, m * vf(0.5f), m);
  vf ef = to_float(e) + keep(high, vf(1.0f));
  vf t = (m - vf(1.0f)) / (m + vf(1.0f));
  vf t2 = t * t;
  vf s = vf(1.0f / 9.0f);
  s = fma(s, t2, vf(1.0f / 7.0f));
  s = fma(s, t2, vf(1.0f / 5.0f));
  s = fma(s, t2, vf(1.0f / 3.0f));
  s = fma(s, t2, vf(1.0f));
  return fma(vf(2.88539008f) * t, s, ef);
}

// Indices of the bits set in `bytes` bytes (a multiple of eight); writes up to W past the end.
static inline int list_bits(const uint8_t* from, int bytes, uint8_t* out) {
  int n = 0;
#if defined(RECAST_AVX512) && !defined(RECAST_EIGHT_LANES)
  const __m512i lane = _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0);
  for (int k = 0; k < bytes; k += 2) {
    const __mmask16 mask = __mmask16(from[k] | from[k + 1] << 8);
    const __m512i index = _mm512_add_epi32(lane, _mm512_set1_epi32(8 * k));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(out + n),
                     _mm512_cvtepi32_epi8(_mm512_maskz_compress_epi32(mask, index)));
    n += __builtin_popcount(mask);
  }
#else
  for (int k = 0; k < bytes; k += 8) {
    uint64_t m = 0;
    for (int i = 0; i < 8; ++i) m |= uint64_t(from[k + i]) << (8 * i);  // one load where it may be
    for (; m; m &= m - 1) out[n++] = uint8_t(8 * k + __builtin_ctzll(m));
  }
#endif
  return n;
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
