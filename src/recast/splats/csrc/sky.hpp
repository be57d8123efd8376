// The equirectangular sky that shows where an image lets light through.
#pragma once
#include <cstdint>

namespace recast {

struct Sky {
  const float *rgb, *alpha;    // pixels x 3, pixels
  const float* colours;        // height x width x 3
  const float* coordinates;    // pixels x 2: shares of the map's width and height
  float* image;                // forward: pixels x 3
  const float* image_grad;     // backward
  float *alpha_grad, *colours_grad;  // backward; the second one is added to
  int64_t pixels, height, width;
  float opaque;                // pixels of at least this opacity show none
};

void sky_forward(const Sky& s);
void sky_backward(const Sky& s);

}  // namespace recast
