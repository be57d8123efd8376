// Projection of W Gaussians to the image: shared by the forward pass and its derivative.
#pragma once
#include "frame.hpp"
#include "simd.hpp"

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

// Raw parameters of W Gaussians; lanes past the end repeat the last row.
struct Parameters {
  vf mean[3], quat[4], log_scale[3], logit;
};

// Whether W ascending rows lie behind one another; a short group repeats its last row.
static inline bool contiguous(const uint32_t* rows) {
  return rows[W - 1] - rows[0] == W - 1 && rows[W - 2] != rows[W - 1];
}

template <int Stride>
static inline void gather_columns(const float* base, const uint32_t* rows, vf (&out)[Stride]) {
  if (contiguous(rows)) return load_columns(base + int64_t(rows[0]) * Stride, out);
  alignas(64) float stage[Stride][W];
  for (int lane = 0; lane < W; ++lane) {
    const float* p = base + int64_t(rows[lane]) * Stride;
    for (int c = 0; c < Stride; ++c) stage[c][lane] = p[c];
  }
  for (int c = 0; c < Stride; ++c) out[c] = load(stage[c]);
}

static inline void load_parameters(const Frame& f, const uint32_t* rows, Parameters& p) {
  gather_columns(f.means, rows, p.mean);
  gather_columns(f.quats, rows, p.quat);
  gather_columns(f.log_scales, rows, p.log_scale);
  alignas(64) float logits[W];
  for (int lane = 0; lane < W; ++lane) logits[lane] = f.logits[rows[lane]];
  p.logit = load(logits);
}

struct Projection {
  vf norm2, inverse_norm;
  vf q[4];             // unit quaternion
  vf rotation[9];      // of the quaternion
  vf scale[3];
  vf point[3];         // in the camera frame
  vf inverse_z;
  vf tangent_x, tangent_y;  // z times the clamped slope: where the Jacobian is taken
  vm clamped_x, clamped_y;
  vf image_from_world[6];   // J R_camera, 2x3
  vf axes[6];               // image_from_world * rotation * scale, 2x3
  vf xx, xy, yy;            // covariance, blurred
  vf minors[3];             // of axes; their squares add up to the determinant without blur
  vf exact_det, det;
  vf l1, l2, l3, slope_x, slope_y;  // see Splat
  vf sigmoid, opacity;      // before and after compensation
  vf x, y;                  // pixels
};

// R^T t: minus the centre of the camera.
static inline void camera_offset(const Frame& f, float (&offset)[3]) {
  for (int i = 0; i < 3; ++i)
    offset[i] = f.rotation[i] * f.translation[0] + f.rotation[3 + i] * f.translation[1] +
                f.rotation[6 + i] * f.translation[2];
}

// Where the centres lie, and how the image changes around them.
static inline void to_image(const Frame& f, const vf* mean, Projection& o) {
  for (int i = 0; i < 3; ++i)
    o.point[i] = fma(vf(f.rotation[3 * i]), mean[0],
                     fma(vf(f.rotation[3 * i + 1]), mean[1],
                         fma(vf(f.rotation[3 * i + 2]), mean[2], vf(f.translation[i]))));
  o.inverse_z = vf(1.0f) / o.point[2];
  const vf slope_x = o.point[0] * o.inverse_z, slope_y = o.point[1] * o.inverse_z;
  o.x = fma(vf(f.fx), slope_x, vf(f.cx));
  o.y = fma(vf(f.fy), slope_y, vf(f.cy));

  // The limit is that of the whole image: in a window of it a Gaussian is the same.
  const float width = float(f.whole_width), height = float(f.whole_height);
  const float margin_x = kTangentMargin * 0.5f * width / f.fx;
  const float margin_y = kTangentMargin * 0.5f * height / f.fy;
  const vf left = -(f.cx / f.fx + margin_x), right = (width - f.cx) / f.fx + margin_x;
  const vf top = -(f.cy / f.fy + margin_y), bottom = (height - f.cy) / f.fy + margin_y;
  o.clamped_x = (slope_x < left) | (slope_x > right);
  o.clamped_y = (slope_y < top) | (slope_y > bottom);
  const vf held_x = vmin(vmax(slope_x, left), right), held_y = vmin(vmax(slope_y, top), bottom);
  o.tangent_x = held_x * o.point[2];
  o.tangent_y = held_y * o.point[2];

  const vf jx = vf(f.fx) * o.inverse_z, jy = vf(f.fy) * o.inverse_z;
  for (int j = 0; j < 3; ++j) {
    o.image_from_world[j] = jx * fnma(held_x, vf(f.rotation[6 + j]), vf(f.rotation[j]));
    o.image_from_world[3 + j] = jy * fnma(held_y, vf(f.rotation[6 + j]), vf(f.rotation[3 + j]));
  }
}

// The blurred covariance and its factor, from the axes in the image.
static inline void blurred(const Frame& f, Projection& o) {
  const vf* u = o.axes;
  const vf* v = o.axes + 3;
  const vf exact_xx = u[0] * u[0] + u[1] * u[1] + u[2] * u[2];
  const vf exact_yy = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
  o.xy = u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
  // Cauchy-Binet: the determinant as a sum of squares does not cancel on needles.
  const vf m0 = u[0] * v[1] - u[1] * v[0], m1 = u[0] * v[2] - u[2] * v[0],
           m2 = u[1] * v[2] - u[2] * v[1];
  o.minors[0] = m0;
  o.minors[1] = m1;
  o.minors[2] = m2;
  const vf eps = f.eps2d;
  o.exact_det = m0 * m0 + m1 * m1 + m2 * m2;
  o.det = o.exact_det + eps * (exact_xx + exact_yy + eps);
  o.xx = exact_xx + eps;
  o.yy = exact_yy + eps;
  const vf unit = kSplatUnit;
  o.l1 = unit * vsqrt(o.yy / o.det);
  o.slope_x = o.xy / o.yy;
  o.slope_y = o.xy / o.xx;
  o.l2 = -o.l1 * o.slope_x;
  o.l3 = unit / vsqrt(o.yy);
}

static inline void project(const Frame& f, const Parameters& p, Projection& o) {
  o.norm2 = p.quat[0] * p.quat[0] + p.quat[1] * p.quat[1] + p.quat[2] * p.quat[2] +
            p.quat[3] * p.quat[3];
  o.inverse_norm = vf(1.0f) / vsqrt(o.norm2);
  for (int i = 0; i < 4; ++i) o.q[i] = p.quat[i] * o.inverse_norm;
  const vf w = o.q[0], x = o.q[1], y = o.q[2], z = o.q[3], one = 1.0f, two = 2.0f;
  o.rotation[0] = one - two * (y * y + z * z);
  o.rotation[1] = two * (x * y - w * z);
  o.rotation[2] = two * (x * z + w * y);
  o.rotation[3] = two * (x * y + w * z);
  o.rotation[4] = one - two * (x * x + z * z);
  o.rotation[5] = two * (y * z - w * x);
  o.rotation[6] = two * (x * z - w * y);
  o.rotation[7] = two * (y * z + w * x);
  o.rotation[8] = one - two * (x * x + y * y);
  for (int i = 0; i < 3; ++i) o.scale[i] = vexp(p.log_scale[i]);
  to_image(f, p.mean, o);
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j) {
      const vf* t = o.image_from_world + 3 * i;
      o.axes[3 * i + j] = (t[0] * o.rotation[j] + t[1] * o.rotation[3 + j] +
                           t[2] * o.rotation[6 + j]) * o.scale[j];
    }
  blurred(f, o);
  o.sigmoid = one / (one + vexp(-p.logit));
  o.opacity = o.sigmoid;
  if (f.antialiased)
    o.opacity = o.opacity * vsqrt(vmax(o.exact_det / o.det, vf(kMinCompensation)));
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
