// Which tiles a projected Gaussian may touch.
#pragma once
#include "geometry.hpp"

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

struct Footprints {
  Footprint print[W];
  uint32_t tiles[W];
};

// Mask of the tiles among 4x4, the first one at (left, top) relative to the centre of lane `i`, in
// which the ellipse alpha = 1/255 comes near a pixel centre. All tiles at once, one a lane.
struct TileTest {
  alignas(64) float l1[W], l2[W], l3[W], slope_x[W], slope_y[W], reach[W];

  uint32_t operator()(int i, float left, float top) const {
    alignas(64) float column[16], row[16];
    for (int k = 0; k < 16; ++k) {
      column[k] = float(k % 4 * kTile);
      row[k] = float(k / 4 * kTile);
    }
    const vf zero = 0.0f, last = float(kTile - 1);
    uint32_t mask = 0;
    for (int k = 0; k < 16; k += W) {
      const vf x0 = load(column + k) + vf(left), x1 = x0 + last;
      const vf y0 = load(row + k) + vf(top), y1 = y0 + last;
      const vf dx = vmax(vmin(zero, x1), x0), dy = vmax(vmin(zero, y1), y0);
      const vf ey = vmin(vmax(vf(slope_y[i]) * dx, y0), y1);
      const vf ex = vmin(vmax(vf(slope_x[i]) * dy, x0), x1);
      const vf u = fma(vf(l1[i]), dx, vf(l2[i]) * ey), v = vf(l3[i]) * ey;
      const vf p = fma(vf(l1[i]), ex, vf(l2[i]) * dy), q = vf(l3[i]) * dy;
      mask |= bits(vmin(fma(u, u, v * v), fma(p, p, q * q)) <= vf(reach[i])) << k;
    }
    return mask;
  }
};

static inline void find_footprints(const Frame& f, const Projection& o, vf extent_x, vf extent_y,
                                   vf log2_opacity, uint32_t visible, Footprints& out) {
  // Pixels whose centres lie in the box, with a little slack for rounding.
  alignas(64) int32_t x0[W], x1[W], y0[W], y1[W];
  const vf slack = 0.01f, one = 1.0f;
  const vf left = float(f.left), right = float(f.left + f.width);
  const vf above = float(f.top), below = float(f.top + f.height);
  store(x0, round_to_int(vmin(vmax(o.x - extent_x - slack, left), right)));
  store(x1, round_to_int(vmax(vmin(o.x + extent_x + slack, right), left) - one));
  store(y0, round_to_int(vmin(vmax(o.y - extent_y - slack, above), below)));
  store(y1, round_to_int(vmax(vmin(o.y + extent_y + slack, below), above) - one));
  alignas(64) float x[W], y[W];
  TileTest test;
  store(x, o.x);
  store(y, o.y);
  store(test.l1, o.l1);
  store(test.l2, o.l2);
  store(test.l3, o.l3);
  store(test.slope_x, o.slope_x);
  store(test.slope_y, o.slope_y);
  store(test.reach, log2_opacity - vf(kLog2AlphaThreshold - 0.01f));
  for (uint32_t m = visible; m; m &= m - 1) {
    const int i = __builtin_ctz(m);
    out.print[i] = 0;  // 1x1 tile with an empty mask: between the pixel centres
    out.tiles[i] = 0;
    if (x0[i] > x1[i] || y0[i] > y1[i]) continue;
    const uint32_t tx = uint32_t(x0[i]) / kTile, ty = uint32_t(y0[i]) / kTile;
    const uint32_t w = uint32_t(x1[i]) / kTile - tx, h = uint32_t(y1[i]) / kTile - ty;  // less 1
    uint32_t mask = 0;
    if (w > 3 || h > 3) {
      out.tiles[i] = (w + 1) * (h + 1);
    } else {
      mask = ((2u << w) - 1u) * (0x1111u & ((16u << (4 * h)) - 1u));
      if (w && h)
        mask &= test(i, float(tx * kTile) + 0.5f - x[i], float(ty * kTile) + 0.5f - y[i]);
      out.tiles[i] = uint32_t(__builtin_popcount(mask));
    }
    out.print[i] = Footprint(tx - uint32_t(f.first_tile_x)) << 52 |
                   Footprint(ty - uint32_t(f.first_tile_y)) << 40 | Footprint(w) << 28 |
                   Footprint(h) << 16 | mask;
  }
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
