// L1 and SSIM of an image against a target, and their gradient.
//
// With S = A B / (C D), A = 2 mx my + C1, B = 2 sxy + C2, C = mx^2 + my^2 + C1, D = sx + sy + C2,
// the image enters S through mx, blur(x^2) and blur(x y). The window is symmetric, so the adjoint
// of a blur is the same blur: forward keeps dS by each of the three, backward blurs these once more.
#include "kernels.hpp"
#include "simd.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

constexpr int kTaps = 2 * kWindowHalf + 1;
constexpr int kChannels = 3;
constexpr int kReach = kWindowHalf * kChannels;  // floats of a row to either side of the centre
constexpr int kSpan = 480;                       // floats of a row that are worked on at once
constexpr int kRoom = kSpan + 2 * kReach + 16;

const float kNothing[kRoom] = {};  // rows above and below the image

// The part [begin, end) of row y, and what of [begin - kReach, end + kReach) is in the image.
struct Stretch {
  int64_t y, begin, end, from, to;
  Stretch(const Photometric& p, int64_t row, int64_t column) : y(row), begin(column) {
    end = begin + kSpan < p.row ? begin + kSpan : p.row;
    from = begin > kReach ? begin - kReach : 0;
    to = end + kReach < p.row ? end + kReach : p.row;
  }
};

// The rows under the window, each from column `from` on.
struct Rows {
  const float* at[kTaps];
  Rows(const Photometric& p, const Stretch& s, const float* image) {
    for (int k = 0; k < kTaps; ++k) {
      const int64_t row = s.y + k - kWindowHalf;
      at[k] = row >= 0 && row < p.height ? image + row * p.row + s.from : kNothing;
    }
  }
};

inline vf load_some(const float* p, int n) { return n == W ? load(p) : load_first(p, n); }
inline void store_some(float* p, vf x, int n) { n == W ? store(p, x) : store_first(p, x, n); }

// `each(i, n)` for the vectors of [0, count). With n a constant in all calls but the last, its
// branches go.
template <typename Each>
inline __attribute__((always_inline)) void for_vectors(int64_t count, Each each) {
  int64_t i = 0;
  for (; i + W <= count; i += W) each(i, W);
  if (i < count) each(i, int(count - i));
}

// Zeros beyond the image to both sides; lanes past `to` of what is stored later are zeros too.
inline void clear_rims(float* blurred, const Stretch& s) {
  const int64_t filled = s.to - s.begin + kReach;
  for (int64_t i = 0; i < s.from - s.begin + kReach; ++i) blurred[i] = 0;
  for (int64_t i = filled; i < kRoom; ++i) blurred[i] = 0;
}

inline vf along_row(const float* blurred, const float* window) {
  vf sum = vf(window[kWindowHalf]) * load(blurred + kReach);
  for (int k = 0; k < kWindowHalf; ++k)
    sum = fma(vf(window[k]),
              load(blurred + kChannels * k) + load(blurred + kChannels * (kTaps - 1 - k)), sum);
  return sum;
}

// Blurs down the columns of x, y, x^2 + y^2 (variances enter only as their sum) and x y.
inline void moments_down(const Photometric& p, const Stretch& s, float (&out)[4][kRoom]) {
  for (float* one : out) clear_rims(one, s);
  const Rows x(p, s, p.image), y(p, s, p.target);
  const int64_t place = s.from - s.begin + kReach, count = s.to - s.from;
  for_vectors(count, [&](int64_t i, int n) __attribute__((always_inline)) {
    vf mx(0.0f), my(0.0f), square(0.0f), product(0.0f);
    for (int k = 0; k < kWindowHalf; ++k) {
      const int m = kTaps - 1 - k;
      const vf w(p.window[k]);
      const vf x0 = load_some(x.at[k] + i, n), x1 = load_some(x.at[m] + i, n);
      const vf y0 = load_some(y.at[k] + i, n), y1 = load_some(y.at[m] + i, n);
      mx = fma(w, x0 + x1, mx);
      my = fma(w, y0 + y1, my);
      square = fma(w, fma(x0, x0, x1 * x1) + fma(y0, y0, y1 * y1), square);
      product = fma(w, fma(x0, y0, x1 * y1), product);
    }
    const vf w(p.window[kWindowHalf]);
    const vf x0 = load_some(x.at[kWindowHalf] + i, n), y0 = load_some(y.at[kWindowHalf] + i, n);
    store(out[0] + place + i, fma(w, x0, mx));
    store(out[1] + place + i, fma(w, y0, my));
    store(out[2] + place + i, fma(w, fma(x0, x0, y0 * y0), square));
    store(out[3] + place + i, fma(w, x0 * y0, product));
  });
}

inline void map_down(const Photometric& p, const Stretch& s, const float* map, float (&out)[kRoom]) {
  clear_rims(out, s);
  const Rows rows(p, s, map);
  const int64_t place = s.from - s.begin + kReach, count = s.to - s.from;
  for_vectors(count, [&](int64_t i, int n) __attribute__((always_inline)) {
    vf sum = vf(p.window[kWindowHalf]) * load_some(rows.at[kWindowHalf] + i, n);
    for (int k = 0; k < kWindowHalf; ++k)
      sum = fma(vf(p.window[k]),
                load_some(rows.at[k] + i, n) + load_some(rows.at[kTaps - 1 - k] + i, n), sum);
    store(out + place + i, sum);
  });
}

// Adds |x - y| and SSIM of a stretch to sums[0] and sums[1]; stores its derivatives.
inline void stretch_forward(const Photometric& p, const Stretch& s, double* sums) {
  float blurred[4][kRoom];
  moments_down(p, s, blurred);
  vf difference(0.0f), similarity(0.0f);
  for_vectors(s.end - s.begin, [&](int64_t j, int n) __attribute__((always_inline)) {
    const int64_t at = s.y * p.row + s.begin + j;
    const vf mx = along_row(blurred[0] + j, p.window), my = along_row(blurred[1] + j, p.window);
    const vf square = along_row(blurred[2] + j, p.window);
    const vf product = along_row(blurred[3] + j, p.window);
    const vf mxy = mx * my, means = fma(mx, mx, my * my);
    const vf a = fma(vf(2.0f), mxy, vf(p.c1)), b = fma(vf(2.0f), product - mxy, vf(p.c2));
    const vf c = means + vf(p.c1), d = square - means + vf(p.c2);
    const vf inverse = vf(1.0f) / (c * d);
    const vf by_product = vf(2.0f) * a * inverse, value = vf(0.5f) * by_product * b;
    const vf by_mean = vf(2.0f) * inverse * fma(my, b - a, value * mx * (c - d));
    const vf by_square = -(value * c * inverse);
    const vm inside = mask_from_bits(n == W ? (1u << W) - 1 : (1u << n) - 1);
    similarity = similarity + keep(inside, value);
    difference = difference + vabs(load_some(p.image + at, n) - load_some(p.target + at, n));
    store_some(p.by_mean + at, by_mean, n);
    store_some(p.by_square + at, by_square, n);
    store_some(p.by_product + at, by_product, n);
  });
  float both[2];
  store_two_sums(both, difference, similarity);
  sums[0] += double(both[0]);
  sums[1] += double(both[1]);
}

inline void stretch_backward(const Photometric& p, const Stretch& s) {
  float by_mean[kRoom], by_square[kRoom], by_product[kRoom];
  map_down(p, s, p.by_mean, by_mean);
  map_down(p, s, p.by_square, by_square);
  map_down(p, s, p.by_product, by_product);
  const vf l1(p.l1), ssim(p.ssim);
  for_vectors(s.end - s.begin, [&](int64_t j, int n) __attribute__((always_inline)) {
    const int64_t at = s.y * p.row + s.begin + j;
    const vf x = load_some(p.image + at, n), y = load_some(p.target + at, n);
    vf sum = along_row(by_mean + j, p.window);
    sum = fma(x + x, along_row(by_square + j, p.window), sum);
    sum = fma(y, along_row(by_product + j, p.window), sum);
    const vf sign = keep(x > y, l1) - keep(x < y, l1);
    store_some(p.gradient + at, fma(ssim, sum, sign), n);
  });
}

}  // namespace

void photometric_rows(const Photometric& p, int64_t begin, int64_t end) {
  for (int64_t y = begin; y < end; ++y) {
    p.sums[2 * y] = p.sums[2 * y + 1] = 0;
    for (int64_t column = 0; column < p.row; column += kSpan)
      stretch_forward(p, Stretch(p, y, column), p.sums + 2 * y);
  }
}

void photometric_rows_backward(const Photometric& p, int64_t begin, int64_t end) {
  for (int64_t y = begin; y < end; ++y)
    for (int64_t column = 0; column < p.row; column += kSpan)
      stretch_backward(p, Stretch(p, y, column));
}

}  // namespace RECAST_ISA
}  // namespace recast
