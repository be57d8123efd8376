// Real spherical harmonics up to degree 3 and their derivatives, W directions at a time.
// Order and signs as in gaussians.py.
#pragma once
#include "simd.hpp"

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

// The K harmonics at unit direction d.
template <int K>
static inline void harmonics(const vf* d, vf* out) {
  out[0] = vf(0.28209479177387814f);
  if (K == 1) return;
  const vf x = d[0], y = d[1], z = d[2];
  out[1] = vf(-0.4886025119029199f) * y;
  out[2] = vf(0.4886025119029199f) * z;
  out[3] = vf(-0.4886025119029199f) * x;
  if (K == 4) return;
  const vf xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
  out[4] = vf(1.0925484305920792f) * xy;
  out[5] = vf(-1.0925484305920792f) * yz;
  out[6] = vf(0.31539156525252005f) * (zz + zz - xx - yy);
  out[7] = vf(-1.0925484305920792f) * xz;
  out[8] = vf(0.5462742152960396f) * (xx - yy);
  if (K == 9) return;
  const vf four_zz = vf(4.0f) * zz - xx - yy;
  out[9] = vf(-0.5900435899266435f) * y * (vf(3.0f) * xx - yy);
  out[10] = vf(2.890611442640554f) * xy * z;
  out[11] = vf(-0.4570457994644658f) * y * four_zz;
  out[12] = vf(0.3731763325901154f) * z * (zz + zz - vf(3.0f) * (xx + yy));
  out[13] = vf(-0.4570457994644658f) * x * four_zz;
  out[14] = vf(1.445305721320277f) * z * (xx - yy);
  out[15] = vf(-0.5900435899266435f) * x * (xx - vf(3.0f) * yy);
}

// out = sum of s[k] times the gradient of harmonic k at d.
template <int K>
static inline void harmonics_gradient(const vf* d, const vf* s, vf* out) {
  out[0] = out[1] = out[2] = vf(0.0f);
  if (K == 1) return;
  const vf x = d[0], y = d[1], z = d[2];
  const float c1 = 0.4886025119029199f, c2 = 1.0925484305920792f;
  out[0] = vf(-c1) * s[3];
  out[1] = vf(-c1) * s[1];
  out[2] = vf(c1) * s[2];
  if (K == 4) return;
  const vf a = vf(c2) * s[4], b = vf(-c2) * s[5], c = vf(2 * 0.31539156525252005f) * s[6],
           e = vf(-c2) * s[7], g = vf(2 * 0.5462742152960396f) * s[8];
  out[0] = out[0] + a * y + e * z + (g - c) * x;
  out[1] = out[1] + a * x + b * z - (g + c) * y;
  out[2] = out[2] + b * y + e * x + (c + c) * z;
  if (K == 9) return;
  const vf xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z, two = 2.0f,
           three = 3.0f, six = 6.0f, eight = 8.0f;
  const vf p = vf(-0.5900435899266435f) * s[9], q = vf(2.890611442640554f) * s[10],
           r = vf(-0.4570457994644658f) * s[11], t = vf(0.3731763325901154f) * s[12],
           u = vf(-0.4570457994644658f) * s[13], v = vf(1.445305721320277f) * s[14],
           w = vf(-0.5900435899266435f) * s[15];
  const vf four_zz = vf(4.0f) * zz - xx - yy;
  out[0] = out[0] + p * six * xy + q * yz - r * two * xy - t * six * xz +
           u * (four_zz - two * xx) + v * two * xz + w * three * (xx - yy);
  out[1] = out[1] + p * three * (xx - yy) + q * xz + r * (four_zz - two * yy) - t * six * yz -
           u * two * xy - v * two * yz - w * six * xy;
  out[2] = out[2] + q * xy + r * eight * yz + t * (six * zz - three * (xx + yy)) +
           u * eight * xz + v * (xx - yy);
}

// Columns of rows of Floats floats, whole vectors of them.
template <int Floats>
constexpr int kPadded = (Floats + W - 1) / W * W;

// Reads rows of Floats floats of W Gaussians into columns.
template <int Floats>
static inline void load_rows(const float* base, const uint32_t* rows,
                             vf (&columns)[kPadded<Floats>]) {
  for (int c = 0; c < Floats; c += W) {
    const int n = Floats - c < W ? Floats - c : W;
    for (int lane = 0; lane < W; ++lane) {
      const float* p = base + int64_t(rows[lane]) * Floats + c;
      columns[c + lane] = n == W ? load(p) : load_first(p, n);
    }
    transpose(columns + c);
  }
}

// Rows that a later group will read: too far apart for the machine to foresee.
template <int Floats>
static inline void prefetch_rows(const float* base, const uint32_t* rows, int count) {
  for (int i = 0; i < count; ++i)
    for (int c = 0; c < Floats; c += 16) __builtin_prefetch(base + int64_t(rows[i]) * Floats + c);
}

// Writes columns back as rows, of which `lanes` are valid. The columns are lost.
template <int Floats>
static inline void store_rows(float* base, const uint32_t* rows, int lanes,
                              vf (&columns)[kPadded<Floats>]) {
  for (int c = 0; c < Floats; c += W) {
    const int n = Floats - c < W ? Floats - c : W;
    for (int j = n; j < W; ++j) columns[c + j] = vf(0.0f);
    transpose(columns + c);
    for (int lane = 0; lane < lanes; ++lane) {
      float* p = base + int64_t(rows[lane]) * Floats + c;
      if (n == W)
        store(p, columns[c + lane]);
      else
        store_first(p, columns[c + lane], n);
    }
  }
}

// The same past the caches, a cache line at a time: `base` aligned to one, and Floats a whole number
// of lines.
template <int Floats>
static inline void stream_rows(float* base, const uint32_t* rows, int lanes, vf (&columns)[Floats]) {
  constexpr int kLine = 16;
  static_assert(Floats % kLine == 0, "rows of whole lines");
  for (int c = 0; c < Floats; c += kLine) {
    for (int k = 0; k < kLine; k += W) transpose(columns + c + k);
    for (int lane = 0; lane < lanes; ++lane)
      for (int k = 0; k < kLine; k += W)
        stream(base + int64_t(rows[lane]) * Floats + c + k, columns[c + k + lane]);
  }
}

// Unit vectors from the camera centre to W points, and the reciprocal of the distance.
// offset = R^T t, minus the camera centre.
static inline vf view_direction(const vf* mean, const float* offset, vf* d) {
  for (int i = 0; i < 3; ++i) d[i] = mean[i] + vf(offset[i]);
  const vf inverse = vf(1.0f) / vsqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
  for (int i = 0; i < 3; ++i) d[i] = d[i] * inverse;
  return inverse;
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
