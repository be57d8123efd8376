// 8 lanes as two GCC/clang vectors of four: SSE2, NEON or whatever the compiler makes of it.
#pragma once
#include <cstdint>
#include <cstring>
#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

constexpr int W = 8;

typedef float f4 __attribute__((vector_size(16)));
typedef int32_t i4 __attribute__((vector_size(16)));

struct vf {
  f4 a, b;
  vf() = default;
  vf(f4 x, f4 y) : a(x), b(y) {}
  vf(float x) : a{x, x, x, x}, b{x, x, x, x} {}
};
struct vm {
  i4 a, b;
};
struct vi {
  i4 a, b;
  vi() = default;
  vi(i4 x, i4 y) : a(x), b(y) {}
  vi(int32_t x) : a{x, x, x, x}, b{x, x, x, x} {}
};

static inline vf load(const float* p) {
  vf r;
  std::memcpy(&r.a, p, 16);
  std::memcpy(&r.b, p + 4, 16);
  return r;
}
static inline void store(float* p, vf x) {
  std::memcpy(p, &x.a, 16);
  std::memcpy(p + 4, &x.b, 16);
}
// Past the caches where the machine can; here it is a store.
static inline void stream(float* p, vf a) { store(p, a); }
static inline void stream_end() {}
static inline f4 half4(const uint16_t* p) {
  const i4 h = {p[0], p[1], p[2], p[3]};
  // The exponent's bias is 112 too small; below the normal numbers the product is right as well.
  const f4 size = (f4)((h & 0x7FFF) << 13) * 5.192296858534828e33f;
  return (f4)((i4)size | (h & 0x8000) << 16);
}
static inline vf load_half(const uint16_t* p) { return {half4(p), half4(p + 4)}; }
static inline vf load_first(const float* p, int n) {
  float t[8] = {0, 0, 0, 0, 0, 0, 0, 0};
  for (int i = 0; i < n; ++i) t[i] = p[i];
  return load(t);
}
static inline void store_first(float* p, vf x, int n) {
  float t[8];
  store(t, x);
  for (int i = 0; i < n; ++i) p[i] = t[i];
}

static inline vf operator+(vf x, vf y) { return {x.a + y.a, x.b + y.b}; }
static inline vf operator-(vf x, vf y) { return {x.a - y.a, x.b - y.b}; }
static inline vf operator*(vf x, vf y) { return {x.a * y.a, x.b * y.b}; }
static inline vf operator/(vf x, vf y) { return {x.a / y.a, x.b / y.b}; }
static inline vf operator-(vf x) { return {-x.a, -x.b}; }
static inline vf fma(vf x, vf y, vf z) { return x * y + z; }
static inline vf fnma(vf x, vf y, vf z) { return z - x * y; }

static inline vm operator<(vf x, vf y) { return {x.a < y.a, x.b < y.b}; }
static inline vm operator<=(vf x, vf y) { return {x.a <= y.a, x.b <= y.b}; }
static inline vm operator>(vf x, vf y) { return {x.a > y.a, x.b > y.b}; }
static inline vm operator>=(vf x, vf y) { return {x.a >= y.a, x.b >= y.b}; }
static inline vm operator&(vm x, vm y) { return {x.a & y.a, x.b & y.b}; }
static inline vm operator|(vm x, vm y) { return {x.a | y.a, x.b | y.b}; }
static inline vm operator~(vm x) { return {~x.a, ~x.b}; }
static inline f4 keep4(i4 m, f4 x) { return (f4)(m & (i4)x); }
static inline f4 drop4(i4 m, f4 x) { return (f4)(~m & (i4)x); }
static inline vf keep(vm m, vf x) { return {keep4(m.a, x.a), keep4(m.b, x.b)}; }
static inline vf drop(vm m, vf x) { return {drop4(m.a, x.a), drop4(m.b, x.b)}; }
static inline f4 select4(i4 m, f4 x, f4 y) { return (f4)((m & (i4)x) | (~m & (i4)y)); }
static inline vf select(vm m, vf x, vf y) { return {select4(m.a, x.a, y.a), select4(m.b, x.b, y.b)}; }
static inline vi select(vm m, vi x, vi y) {
  return {(m.a & x.a) | (~m.a & y.a), (m.b & x.b) | (~m.b & y.b)};
}
#if defined(__SSE2__)
static inline vf vmin(vf x, vf y) {
  return {(f4)_mm_min_ps((__m128)x.a, (__m128)y.a), (f4)_mm_min_ps((__m128)x.b, (__m128)y.b)};
}
static inline vf vmax(vf x, vf y) {
  return {(f4)_mm_max_ps((__m128)x.a, (__m128)y.a), (f4)_mm_max_ps((__m128)x.b, (__m128)y.b)};
}
static inline vf vsqrt(vf x) {
  return {(f4)_mm_sqrt_ps((__m128)x.a), (f4)_mm_sqrt_ps((__m128)x.b)};
}
static inline uint32_t bits(vm x) {
  return uint32_t(_mm_movemask_ps((__m128)x.a) | _mm_movemask_ps((__m128)x.b) << 4);
}
static inline vi round_to_int(vf x) {
  return {(i4)_mm_cvtps_epi32((__m128)x.a), (i4)_mm_cvtps_epi32((__m128)x.b)};
}
#else
static inline vf vmin(vf x, vf y) { return select(x < y, x, y); }
static inline vf vmax(vf x, vf y) { return select(x > y, x, y); }
static inline vf vsqrt(vf x) {
  vf r;
  for (int i = 0; i < 4; ++i) {
    r.a[i] = __builtin_sqrtf(x.a[i]);
    r.b[i] = __builtin_sqrtf(x.b[i]);
  }
  return r;
}
static inline uint32_t bits(vm x) {
  const i4 low = {1, 2, 4, 8}, high = {16, 32, 64, 128};
  i4 t = (x.a & low) | (x.b & high);
  return uint32_t(t[0] | t[1] | t[2] | t[3]);
}
static inline vi round_to_int(vf x) {
  vi r;
  for (int i = 0; i < 4; ++i) {
    r.a[i] = int32_t(__builtin_rintf(x.a[i]));
    r.b[i] = int32_t(__builtin_rintf(x.b[i]));
  }
  return r;
}
#endif
static inline vf vabs(vf x) {
  const i4 m = {0x7FFFFFFF, 0x7FFFFFFF, 0x7FFFFFFF, 0x7FFFFFFF};
  return {(f4)((i4)x.a & m), (f4)((i4)x.b & m)};
}
static inline vf vceil(vf x) {
  for (int i = 0; i < 4; ++i) {
    x.a[i] = __builtin_ceilf(x.a[i]);
    x.b[i] = __builtin_ceilf(x.b[i]);
  }
  return x;
}
static inline vf fast_reciprocal(vf x) { return vf(1.0f) / x; }
static inline bool any(vm x) { return bits(x) != 0; }
static inline vm mask_from_bits(uint32_t b) {
  const i4 low = {1, 2, 4, 8}, high = {16, 32, 64, 128};
  const int32_t v = int32_t(b);
  const i4 x = {v, v, v, v};
  return {(x & low) == low, (x & high) == high};
}

static inline vi as_int(vf x) { return {(i4)x.a, (i4)x.b}; }
static inline vf as_float(vi x) { return {(f4)x.a, (f4)x.b}; }
static inline vi operator+(vi x, vi y) { return {x.a + y.a, x.b + y.b}; }
static inline vi operator-(vi x, vi y) { return {x.a - y.a, x.b - y.b}; }
static inline vi operator&(vi x, vi y) { return {x.a & y.a, x.b & y.b}; }
static inline vi operator|(vi x, vi y) { return {x.a | y.a, x.b | y.b}; }
template <int n>
static inline vi shift_left(vi x) { return {x.a << n, x.b << n}; }
template <int n>
static inline vi shift_right(vi x) { return {x.a >> n, x.b >> n}; }
static inline vf to_float(vi x) {
  return {__builtin_convertvector(x.a, f4), __builtin_convertvector(x.b, f4)};
}
static inline void store(int32_t* p, vi x) {
  std::memcpy(p, &x.a, 16);
  std::memcpy(p + 4, &x.b, 16);
}
constexpr bool kExp2Floor = false;

static inline void transpose(vf* r) {
  float t[8][8];
  for (int i = 0; i < 8; ++i) store(t[i], r[i]);
  for (int i = 0; i < 8; ++i) {
    r[i].a = f4{t[0][i], t[1][i], t[2][i], t[3][i]};
    r[i].b = f4{t[4][i], t[5][i], t[6][i], t[7][i]};
  }
}

// Columns of W contiguous rows of three or four floats.
template <int Stride>
static inline void load_columns(const float* p, vf (&out)[Stride]) {
  for (int c = 0; c < Stride; ++c) {
    const float* q = p + c;
    out[c].a = f4{q[0], q[Stride], q[2 * Stride], q[3 * Stride]};
    q += 4 * Stride;
    out[c].b = f4{q[0], q[Stride], q[2 * Stride], q[3 * Stride]};
  }
}

static inline float lane_sum(vf x) {
  f4 s = x.a + x.b;
  return (s[0] + s[2]) + (s[1] + s[3]);
}
// Writes the sums over the lanes of two vectors.
static inline void store_two_sums(float* out, vf a, vf b) {
  out[0] = lane_sum(a);
  out[1] = lane_sum(b);
}
// Writes the sums over the lanes of ten vectors.
static inline void store_ten_sums(float* out, const vf* x) {
  for (int i = 0; i < 10; ++i) out[i] = lane_sum(x[i]);
}

// Relative error below 2^-9: the exponent halved in the bits, and one step of Newton's.
static inline vf fast_rsqrt(vf x) {
#if defined(__SSE2__)
  return {(f4)_mm_rsqrt_ps((__m128)x.a), (f4)_mm_rsqrt_ps((__m128)x.b)};
#else
  const vf y = as_float(vi(0x5F3759DF) - shift_right<1>(as_int(x)));
  return y * fnma(vf(0.5f) * x * y, y, vf(1.5f));
#endif
}

// Bits shift .. shift + 3 without as many of the lowest as `skip` says and of the highest as `miss` says,
// both rounded, from 0 to 4.
static inline vi run_of_four(vf skip, vf miss, int shift) {
  // Powers of two by their exponents, since SSE2 cannot shift each lane by its own count.
  const auto power = [](vi n) { return round_to_int(as_float(shift_left<23>(n + vi(127)))); };
  const vi four = (vi(16) - power(round_to_int(skip))) & (power(vi(4) - round_to_int(miss)) - vi(1));
  return {four.a << shift, four.b << shift};
}

// bits[b] gets bit i of Gaussian i of 32 whose masks hold bit b.
static inline void bits_of_blocks(const int32_t* masks, void* rows, int stride) {
  uint8_t* bits = static_cast<uint8_t*>(rows);
  for (int i = 0; i < 32; i += 8)
    for (int k = 0; k < 4; ++k) {
      uint64_t x = 0;  // eight bits of eight Gaussians, then turned over
      for (int j = 0; j < 8; ++j) x |= uint64_t(uint32_t(masks[i + j]) >> (8 * k) & 0xFF) << (8 * j);
      if (!x) continue;
      uint64_t t = (x ^ x >> 7) & 0x00AA00AA00AA00AAull;
      x ^= t ^ t << 7;
      t = (x ^ x >> 14) & 0x0000CCCC0000CCCCull;
      x ^= t ^ t << 14;
      t = (x ^ x >> 28) & 0x00000000F0F0F0F0ull;
      x ^= t ^ t << 28;
      for (int j = 0; j < 8; ++j) bits[(8 * k + j) * stride + i / 8] = uint8_t(x >> (8 * j));
    }
}

// Writes four pixels of three planes, interleaved.
static inline void store_pixels(float* out, const float* r, const float* g, const float* b) {
  for (int i = 0; i < 4; ++i) {
    out[3 * i] = r[i];
    out[3 * i + 1] = g[i];
    out[3 * i + 2] = b[i];
  }
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
