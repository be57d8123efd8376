// Adam on the visible rows of one parameter tensor.
#include "kernels.hpp"
#include "simd.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

inline vf update(vf value, vf gradient, vf& first, vf& second, vf step, vf correction, vf beta1,
                 vf beta2, vf epsilon) {
  first = fma(beta1, first - gradient, gradient);
  const vf square = gradient * gradient;
  second = fma(beta2, second - square, square);
  return value - step * first / fma(vsqrt(second), correction, epsilon);
}

}  // namespace

void adam_rows(const AdamRows& a, const uint8_t* visible, int64_t begin, int64_t end, float beta1,
               float beta2, float epsilon) {
  const vf step = a.step, correction = a.second_correction, b1 = beta1, b2 = beta2, eps = epsilon;
  int64_t row = begin;
  while (row < end) {
    if (!visible[row]) {
      ++row;
      continue;
    }
    // A run of visible rows is one contiguous stretch of memory.
    const int64_t from = row;
    while (row < end && visible[row]) ++row;
    int64_t i = from * a.width;
    const int64_t stop = row * a.width;
    for (; i + W <= stop; i += W) {
      vf m = load(a.first + i), v = load(a.second + i);
      const vf x = update(load(a.value + i), load(a.gradient + i), m, v, step, correction, b1, b2, eps);
      store(a.first + i, m);
      store(a.second + i, v);
      store(a.value + i, x);
    }
    if (i < stop) {
      const int n = int(stop - i);
      vf m = load_first(a.first + i, n), v = load_first(a.second + i, n);
      const vf x = update(load_first(a.value + i, n), load_first(a.gradient + i, n), m, v, step,
                          correction, b1, b2, eps);
      store_first(a.first + i, m, n);
      store_first(a.second + i, v, n);
      store_first(a.value + i, x, n);
    }
  }
}

}  // namespace RECAST_ISA
}  // namespace recast
