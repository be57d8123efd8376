// The sky behind an image, and back. Bound by looking up cells: nothing for vectors to do.
#include "sky.hpp"

#include "pool.hpp"

namespace recast {
namespace {

// The four cells about a place of the map, and their weights.
struct Cells {
  int64_t at[4];
  float weight[4];
  Cells(const Sky& s, int64_t pixel) {
    const float u = s.coordinates[2 * pixel], v = s.coordinates[2 * pixel + 1];
    const float width = float(s.width), most = float(s.height - 1);
    float x = (u - float(int64_t(u))) * width;
    x = (x < 0 ? x + width : x) - 0.5f;  // columns wrap around
    float y = v * float(s.height) - 0.5f;  // rows end
    x = x >= -0.5f ? (x < width ? x : -0.5f) : -0.5f;  // not so NaN
    y = y > 0 ? (y < most ? y : most) : 0;
    const int64_t left = int64_t(x + 1) - 1, row = int64_t(y);
    const int64_t column = left < 0 ? s.width - 1 : left, next = left + 1 < s.width ? left + 1 : 0;
    const int64_t below = row + 1 < s.height ? row + 1 : row;
    const float fx = x - float(left), fy = y - float(row);
    at[0] = 3 * (row * s.width + column);
    at[1] = 3 * (row * s.width + next);
    at[2] = 3 * (below * s.width + column);
    at[3] = 3 * (below * s.width + next);
    weight[0] = (1 - fx) * (1 - fy);
    weight[1] = fx * (1 - fy);
    weight[2] = (1 - fx) * fy;
    weight[3] = fx * fy;
  }
  float colour(const Sky& s, int c) const {
    float sum = 0;
    for (int k = 0; k < 4; ++k) sum += weight[k] * s.colours[at[k] + c];
    return sum;
  }
};

}  // namespace

void sky_forward(const Sky& s) {
  const int64_t part = 4096;
  parallel_for((s.pixels + part - 1) / part, [&](int64_t i) {
    const int64_t end = (i + 1) * part < s.pixels ? (i + 1) * part : s.pixels;
    for (int64_t pixel = i * part; pixel < end; ++pixel) {
      const float* rgb = s.rgb + 3 * pixel;
      float* image = s.image + 3 * pixel;
      for (int c = 0; c < 3; ++c) image[c] = rgb[c];
      if (!(s.alpha[pixel] < s.opaque)) continue;
      const Cells cells(s, pixel);
      for (int c = 0; c < 3; ++c) image[c] += (1 - s.alpha[pixel]) * cells.colour(s, c);
    }
  });
}

// Pixels share cells: one thread, so that sums are in one order.
void sky_backward(const Sky& s) {
  for (int64_t pixel = 0; pixel < s.pixels; ++pixel) {
    const float alpha = s.alpha[pixel];
    s.alpha_grad[pixel] = 0;
    if (!(alpha < s.opaque)) continue;
    const Cells cells(s, pixel);
    for (int c = 0; c < 3; ++c) {
      const float gradient = s.image_grad[3 * pixel + c];
      s.alpha_grad[pixel] -= gradient * cells.colour(s, c);
      for (int k = 0; k < 4; ++k)
        s.colours_grad[cells.at[k] + c] += cells.weight[k] * (1 - alpha) * gradient;
    }
  }
}

}  // namespace recast
