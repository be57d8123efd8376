// Adam on the visible rows of one parameter tensor.
#include "kernels.hpp"
#include "simd.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

struct Constants {
  vf correction, beta1, beta2, rest1, rest2, epsilon;
};

// Rows that are seen but never hit decay for ever; denormal numbers would slow each step down.
inline vf flush(vf x) { return keep(vabs(x) > vf(1e-36f), x); }

inline vf update(vf value, vf gradient, vf& first, vf& second, vf step, vf low, vf high,
                 const Constants& c) {
  first = flush(fma(c.beta1, first, c.rest1 * gradient));
  second = flush(fma(c.beta2, second, c.rest2 * (gradient * gradient)));
  value = value - step * first / fma(vsqrt(second), c.correction, c.epsilon);
  return vmin(vmax(value, low), high);
}

}  // namespace

void adam_rows(const AdamRows& a, const AdamSettings& settings, const uint8_t* visible,
               int64_t begin, int64_t end) {
  const Constants c = {settings.correction, settings.beta1, settings.beta2,
                       settings.rest1,      settings.rest2, settings.epsilon};
  const int64_t period = a.width * kAdamLanes;
  int64_t row = begin;
  while (row < end) {
    if (!visible[row]) {
      ++row;
      continue;
    }
    // A run of visible rows is one contiguous stretch of memory.
    const int64_t from = row;
    while (row < end && visible[row]) ++row;
    const int64_t stop = row * a.width;
    int64_t column = 0;  // into the patterns, which repeat the row's columns
    for (int64_t i = from * a.width; i < stop; i += W) {
      const int n = stop - i < W ? int(stop - i) : W;
      const vf step = load(a.steps + column), low = load(a.low + column);
      const vf high = load(a.high + column);
      if (n == W) {
        vf m = load(a.first + i), v = load(a.second + i);
        const vf x = update(load(a.value + i), load(a.gradient + i), m, v, step, low, high, c);
        store(a.first + i, m);
        store(a.second + i, v);
        store(a.value + i, x);
      } else {
        vf m = load_first(a.first + i, n), v = load_first(a.second + i, n);
        const vf x = update(load_first(a.value + i, n), load_first(a.gradient + i, n), m, v, step,
                            low, high, c);
        store_first(a.first + i, m, n);
        store_first(a.second + i, v, n);
        store_first(a.value + i, x, n);
      }
      column += W;
      if (column == period) column = 0;
    }
  }
}

}  // namespace RECAST_ISA
}  // namespace recast
