// Backward, per Gaussian: from the ten sums of its tiles to the gradients of its parameters and of
// the camera pose.
#define RECAST_EIGHT_LANES  // rows lie scattered: wider vectors gain nothing and spill
#include "geometry.hpp"
#include "harmonics.hpp"
#include "kernels.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

constexpr int64_t kStreamRows = 1 << 16;  // 12 MB of harmonics

enum Sum { kSumU, kSumV, kSumUU, kSumUV, kSumVV, kSumOpacity, kSumR, kSumG, kSumB, kSumDepth };

// Sums of W Gaussians by column: of what their tiles wrote, added up in the order of the slots.
template <int Sums>
struct Collected {
  static constexpr int kVectors = (Sums + W - 1) / W;
  vf columns[kVectors * W];

  Collected(const Frame& f, const float* records, int64_t place, int lanes) {
    for (int lane = 0; lane < W; ++lane)
      for (int c = 0; c < kVectors; ++c) columns[c * W + lane] = vf(0.0f);
    for (int lane = 0; lane < lanes; ++lane) {
      const int64_t at = place + lane;
      if (f.folded) {
        add(records + at * Sums, lane);
        continue;
      }
      const Footprint print = f.placements[at].print;
      const uint32_t w = (print >> 28 & 0xFFF) + 1, h = (print >> 16 & 0xFFF) + 1;
      const uint32_t n =
          w > 4 || h > 4 ? w * h : uint32_t(__builtin_popcount(uint32_t(print & 0xFFFF)));
      const uint32_t first = f.chunk_slots[at / kChunk] + f.placements[at].slot;
      for (uint32_t k = first; k < first + n; ++k)
        if (f.record_used[k]) add(records + int64_t(k) * Sums, lane);
    }
    for (int c = 0; c < kVectors; ++c) transpose(columns + c * W);
  }

  // Reads past the end of the record, into columns that nobody asks for.
  void add(const float* record, int lane) {
    for (int c = 0; c < kVectors; ++c)
      columns[c * W + lane] = columns[c * W + lane] + load(record + c * W);
  }
};

struct PoseSums {
  vf rotation[9], translation[3];
};

// Gradients of M = J R_c R S (2x3) and of the log scales, from the sums over u = l1 dx + l2 dy and
// v = l3 dy. With A the matrix of that map and conic = c A^T A, c = 2 ln 2, the covariance gradient
// is c^2 / 2 A^T (sum q e e^T) A; staying in e keeps needles from cancelling.
void axes_gradient(const Frame& f, const Projection& o, const vf* sums, vf* axes_grad,
                   vf* log_scale_grad) {
  const vf c = 1.38629436111989f, c2 = c * c;
  const vf uu = c2 * sums[kSumUU], uv = c2 * sums[kSumUV], vv = c2 * sums[kSumVV];
  const vf* u = o.axes;
  const vf* v = o.axes + 3;
  // ln opacity holds (ln det exact - ln det blurred) / 2.
  const vm live = o.exact_det > vf(kMinCompensation) * o.det;
  const vf g = f.antialiased ? keep(live, sums[kSumOpacity]) : vf(0.0f);
  const vf gc = g * c, per_det = g / select(live, o.exact_det, vf(1.0f));
  const vf* m = o.minors;
  const vf exact[6] = {m[0] * v[1] + m[1] * v[2], m[2] * v[2] - m[0] * v[0],
                       -(m[1] * v[0] + m[2] * v[1]), -(m[0] * u[1] + m[1] * u[2]),
                       m[0] * u[0] - m[2] * u[2], m[1] * u[0] + m[2] * u[1]};
  for (int j = 0; j < 3; ++j) {
    const vf p = o.l1 * u[j] + o.l2 * v[j], q = o.l3 * v[j];  // A M
    const vf dp = uu * p + uv * q - gc * p, dq = uv * p + vv * q - gc * q;
    const vf du = per_det * exact[j], dv = per_det * exact[3 + j];
    axes_grad[j] = o.l1 * dp + du;
    axes_grad[3 + j] = o.l2 * dp + o.l3 * dq + dv;
    log_scale_grad[j] = dp * p + dq * q + du * u[j] + dv * v[j];
  }
}

// Gradient of the quaternion (before normalisation) from that of M = J R_c R S.
void quat_gradient(const Projection& o, const vf* axes_grad, vf* quat_grad) {
  vf v[9];
  for (int j = 0; j < 3; ++j) {
    for (int i = 0; i < 3; ++i) {
      const vf d =
          o.image_from_world[i] * axes_grad[j] + o.image_from_world[3 + i] * axes_grad[3 + j];
      v[3 * i + j] = d * o.scale[j];
    }
  }
  const vf w = o.q[0], x = o.q[1], y = o.q[2], z = o.q[3], two = 2.0f;
  const vf s01 = v[1] + v[3], s02 = v[2] + v[6], s12 = v[5] + v[7];
  const vf d21 = v[7] - v[5], d02 = v[2] - v[6], d10 = v[3] - v[1];
  vf g[4];
  g[0] = two * (x * d21 + y * d02 + z * d10);
  g[1] = two * (y * s01 + z * s02 + w * d21 - two * x * (v[4] + v[8]));
  g[2] = two * (x * s01 + z * s12 + w * d02 - two * y * (v[0] + v[8]));
  g[3] = two * (x * s02 + y * s12 + w * d10 - two * z * (v[0] + v[4]));
  const vf radial = w * g[0] + x * g[1] + y * g[2] + z * g[3];
  for (int i = 0; i < 4; ++i) quat_grad[i] = (g[i] - o.q[i] * radial) * o.inverse_norm;
}

// Whether the harmonics' gradient goes past the caches: where it is too large for them, reading its
// lines before they are overwritten would cost as much as writing.
template <int K>
bool streams(const Frame& f) {
  return K == 16 && f.count >= kStreamRows && reinterpret_cast<uintptr_t>(f.sh_grad) % 64 == 0;
}

template <int K>
void colour_gradient(const Frame& f, const uint32_t* rows, int64_t place, int lanes, vm valid, const Parameters& p,
                     const vf* sums, const float* offset, vf* mean_grad, PoseSums& pose) {
  vf d[3], b[16], columns[kPadded<3 * K>];
  const vf inverse = view_direction(p.mean, offset, d);
  harmonics<K>(d, b);
  uint32_t lit[3] = {};
  for (int i = 0; i < lanes; ++i)
    for (int j = 0; j < 3; ++j) lit[j] |= uint32_t(f.lit[place + i] >> j & 1) << i;
  vf v[3];
  for (int j = 0; j < 3; ++j)  // none where the colour was clamped at zero
    v[j] = keep(mask_from_bits(lit[j]) & valid, sums[kSumR + j]);
  if (K > 1) {
    load_rows<3 * K>(f.sh, rows, columns);
    vf s[16], along[3];
    for (int k = 1; k < K; ++k)
      s[k] = columns[3 * k] * v[0] + columns[3 * k + 1] * v[1] + columns[3 * k + 2] * v[2];
    harmonics_gradient<K>(d, s, along);
    const vf radial = d[0] * along[0] + d[1] * along[1] + d[2] * along[2];
    for (int i = 0; i < 3; ++i) along[i] = (along[i] - d[i] * radial) * inverse;
    // The direction is mean + R^T t before normalisation.
    for (int i = 0; i < 3; ++i) {
      mean_grad[i] = mean_grad[i] + along[i];
      for (int j = 0; j < 3; ++j) {
        pose.rotation[3 * i + j] = fma(vf(f.translation[i]), along[j], pose.rotation[3 * i + j]);
        pose.translation[i] = fma(vf(f.rotation[3 * i + j]), along[j], pose.translation[i]);
      }
    }
  }
  for (int k = 0; k < K; ++k)
    for (int j = 0; j < 3; ++j) columns[3 * k + j] = b[k] * v[j];
  if constexpr (K == 16)
    if (streams<K>(f)) return stream_rows<48>(f.sh_grad, rows, lanes, columns);
  store_rows<3 * K>(f.sh_grad, rows, lanes, columns);
}

template <int Stride>
void store_columns(float* base, const uint32_t* rows, int lanes, const vf* columns) {
  alignas(64) float stage[Stride][W];
  for (int c = 0; c < Stride; ++c) store(stage[c], columns[c]);
  for (int lane = 0; lane < lanes; ++lane)
    for (int c = 0; c < Stride; ++c) base[int64_t(rows[lane]) * Stride + c] = stage[c][lane];
}

// The sum over pixels of each component's size: x is 2 ln 2 l1 q u, y is 2 ln 2 (l2 q u + l3 q v).
void absolute_gradient(const Frame& f, const uint32_t* rows, int64_t place, int lanes,
                       const Projection& o) {
  const Collected<kAbsoluteSums> sums(f, f.absolute_records, place, lanes);
  const vf c = 1.38629436111989f;
  const vf pixel_absgrad[2] = {c * o.l1 * sums.columns[0], c * sums.columns[1]};
  store_columns<2>(f.means2d_absgrad, rows, lanes, pixel_absgrad);
}

template <int K>
void group(const Frame& f, const uint32_t* rows, int64_t place, int lanes, const float* offset,
           PoseSums& pose) {
  const Collected<kSums> collected(f, f.records, place, lanes);
  const vf* sums = collected.columns;
  const vm valid = mask_from_bits((1u << lanes) - 1u);
  Parameters p;
  Projection o;
  load_parameters(f, rows, p);
  project(f, p, o);

  const vf c = 1.38629436111989f;
  vf pixel_grad[2];
  pixel_grad[0] = c * o.l1 * sums[kSumU];
  pixel_grad[1] = c * (o.l2 * sums[kSumU] + o.l3 * sums[kSumV]);
  store_columns<2>(f.means2d_grad, rows, lanes, pixel_grad);
  if (f.absolute_records) absolute_gradient(f, rows, place, lanes, o);

  vf logit_grad = sums[kSumOpacity] * (vf(1.0f) - o.sigmoid);
  store_columns<1>(f.logits_grad, rows, lanes, &logit_grad);

  vf axes_grad[6], quat_grad[4], log_scale_grad[3];
  axes_gradient(f, o, sums, axes_grad, log_scale_grad);
  quat_gradient(o, axes_grad, quat_grad);
  store_columns<4>(f.quats_grad, rows, lanes, quat_grad);
  store_columns<3>(f.log_scales_grad, rows, lanes, log_scale_grad);

  // d F / d (J R_c) = axes_grad (R S)^T, then to J and to R_c.
  vf chain[6];
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j) {
      vf s = vf(0.0f);
      for (int k = 0; k < 3; ++k)
        s = fma(axes_grad[3 * i + k], o.rotation[3 * j + k] * o.scale[k], s);
      chain[3 * i + j] = s;
    }
  const vf z = o.inverse_z, jx = vf(f.fx) * z, jy = vf(f.fy) * z;
  const vf slope_x = o.tangent_x * z, slope_y = o.tangent_y * z;
  vf jacobian_grad[6];  // of J, 2x3
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j)
      jacobian_grad[3 * i + j] = chain[3 * i] * vf(f.rotation[3 * j]) +
                                 chain[3 * i + 1] * vf(f.rotation[3 * j + 1]) +
                                 chain[3 * i + 2] * vf(f.rotation[3 * j + 2]);
  for (int j = 0; j < 3; ++j) {
    const vf top = jx * chain[j], bottom = jy * chain[3 + j];
    pose.rotation[j] = pose.rotation[j] + keep(valid, top);
    pose.rotation[3 + j] = pose.rotation[3 + j] + keep(valid, bottom);
    pose.rotation[6 + j] = pose.rotation[6 + j] - keep(valid, slope_x * top + slope_y * bottom);
  }
  const vf true_x = o.point[0] * z, true_y = o.point[1] * z, two = 2.0f;
  const vf from_x = jx * z * jacobian_grad[2], from_y = jy * z * jacobian_grad[5];
  vf point_grad[3];
  point_grad[0] = jx * pixel_grad[0] - drop(o.clamped_x, from_x);
  point_grad[1] = jy * pixel_grad[1] - drop(o.clamped_y, from_y);
  // J_xz = -fx slope / z: the slope itself depends on z unless it was clamped.
  point_grad[2] = sums[kSumDepth] - jx * true_x * pixel_grad[0] - jy * true_y * pixel_grad[1] -
                  jx * z * jacobian_grad[0] - jy * z * jacobian_grad[4] +
                  from_x * slope_x * select(o.clamped_x, vf(1.0f), two) +
                  from_y * slope_y * select(o.clamped_y, vf(1.0f), two);
  vf mean_grad[3];
  for (int j = 0; j < 3; ++j) {
    mean_grad[j] = point_grad[0] * vf(f.rotation[j]) + point_grad[1] * vf(f.rotation[3 + j]) +
                   point_grad[2] * vf(f.rotation[6 + j]);
    const vf v = keep(valid, point_grad[j]);
    pose.translation[j] = pose.translation[j] + v;
    for (int k = 0; k < 3; ++k)
      pose.rotation[3 * j + k] = fma(v, p.mean[k], pose.rotation[3 * j + k]);
  }
  colour_gradient<K>(f, rows, place, lanes, valid, p, sums, offset, mean_grad, pose);
  store_columns<3>(f.means_grad, rows, lanes, mean_grad);
}

template <int K>
void chunk_gradient(const Frame& f, int64_t chunk) {
  const int64_t begin = chunk * kChunk;
  const int64_t end = begin + kChunk < f.count ? begin + kChunk : f.count;
  for (int64_t row = begin; row < end; ++row) {
    if (f.visible[row]) continue;
    __builtin_memset(f.means_grad + 3 * row, 0, 3 * sizeof(float));
    __builtin_memset(f.quats_grad + 4 * row, 0, 4 * sizeof(float));
    __builtin_memset(f.log_scales_grad + 3 * row, 0, 3 * sizeof(float));
    __builtin_memset(f.means2d_grad + 2 * row, 0, 2 * sizeof(float));
    if (f.means2d_absgrad) __builtin_memset(f.means2d_absgrad + 2 * row, 0, 2 * sizeof(float));
    if (streams<K>(f))
      for (int i = 0; i < 3 * K; i += W) stream(f.sh_grad + 3 * K * row + i, vf(0.0f));
    else
      __builtin_memset(f.sh_grad + 3 * K * row, 0, 3 * K * sizeof(float));
    f.logits_grad[row] = 0.0f;
  }
  float offset[3];
  camera_offset(f, offset);
  PoseSums pose;
  for (int i = 0; i < 9; ++i) pose.rotation[i] = vf(0.0f);
  for (int i = 0; i < 3; ++i) pose.translation[i] = vf(0.0f);
  const uint32_t* ids = f.rows + begin;
  const int n = int(f.chunks[chunk].visible);
  for (int first = 0; first < n; first += W) {
    uint32_t rows[W];
    for (int i = 0; i < W; ++i) rows[i] = ids[first + i < n ? first + i : n - 1];
    const int ahead = first + 2 * W, more = n - ahead < W ? n - ahead : W;
    if (K > 1) prefetch_rows<3 * K>(f.sh, ids + ahead, more);
    group<K>(f, rows, begin + first, n - first < W ? n - first : W, offset, pose);
  }
  if (streams<K>(f)) stream_end();
  double* out = f.pose_grad_chunks + 12 * chunk;
  for (int i = 0; i < 12; ++i) {
    alignas(64) float lanes[W];
    store(lanes, i < 9 ? pose.rotation[i] : pose.translation[i - 9]);
    out[i] = 0.0;
    for (int k = 0; k < W; ++k) out[i] += double(lanes[k]);
  }
}

}  // namespace

void project_chunk_backward(const Frame& f, int64_t chunk) {
  if (f.sh_bases == 1) chunk_gradient<1>(f, chunk);
  if (f.sh_bases == 4) chunk_gradient<4>(f, chunk);
  if (f.sh_bases == 9) chunk_gradient<9>(f, chunk);
  if (f.sh_bases == 16) chunk_gradient<16>(f, chunk);
}

}  // namespace RECAST_ISA
}  // namespace recast
