// Which projected Gaussians touch the image, and the list of those that do.
#pragma once
#include "footprint.hpp"

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

struct Seen {
  vf log2_opacity;
  vf extent_x, extent_y;  // half the box around the ellipse alpha = 1/255, pixels
  vm mask;
  uint32_t lanes;
};

// Those among the lanes `valid` whose alpha reaches 1/255 at a pixel centre; `opaque`: which may.
static inline void find_visible(const Frame& f, const Projection& o, vm opaque, vf log2_opacity,
                                uint32_t valid, Seen& seen) {
  // 2 ln(255 o) = 2 ln 2 * reach.
  const vf reach = log2_opacity - vf(kLog2AlphaThreshold);
  const vf spread = vmax(reach, vf(0.0f)) * vf(1.38629436f);
  const vf extent_x = vsqrt(spread * o.xx), extent_y = vsqrt(spread * o.yy);
  const vf left = float(f.left) + 0.5f, right = float(f.left + f.width) - 0.5f;
  const vf above = float(f.top) + 0.5f, below = float(f.top + f.height) - 0.5f;
  seen.log2_opacity = log2_opacity;
  seen.extent_x = extent_x;
  seen.extent_y = extent_y;
  seen.mask = (o.point[2] >= vf(f.near_plane)) & (o.point[2] <= vf(f.far_plane)) & opaque &
              (o.det > vf(0.0f)) & (o.det < vf(kLargestDeterminant)) &
              (o.x + extent_x > left) & (o.x - extent_x < right) &
              (o.y + extent_y > above) & (o.y - extent_y < below);
  seen.lanes = bits(seen.mask) & valid;
}

// Appends the visible ones to the places of a chunk from `base` on; `rgb` may be filled in later.
static inline void list_visible(const Frame& f, const Projection& o, const Seen& seen,
                                const vf (&rgb)[3], uint32_t first_row, int64_t base,
                                ChunkResult& result) {
  vf columns[16];
  columns[0] = o.x;
  columns[1] = o.y;
  columns[2] = o.l1;
  columns[3] = o.l2;
  columns[4] = o.l3;
  columns[5] = seen.log2_opacity;
  for (int i = 0; i < 3; ++i) columns[6 + i] = rgb[i];
  columns[9] = o.point[2];
  columns[10] = o.slope_x;
  for (int i = 11; i < 16; ++i) columns[i] = vf(0.0f);
  for (int c = 0; c < 16; c += W) {
    transpose(columns + c);
    float* out = &f.splats[base + result.visible].x + c;
    for (uint32_t m = seen.lanes; m; m &= m - 1, out += 16)
      store(out, columns[c + __builtin_ctz(m)]);
  }

  Footprints prints;
  find_footprints(f, o, seen.extent_x, seen.extent_y, seen.log2_opacity, seen.lanes, prints);
  alignas(64) int32_t depth_bits[W];  // positive floats sort as integers
  store(depth_bits, as_int(o.point[2]));
  for (uint32_t m = seen.lanes; m; m &= m - 1) {
    const int i = __builtin_ctz(m);
    const uint32_t key = uint32_t(depth_bits[i]);
    const int64_t place = base + result.visible++;
    f.rows[place] = first_row + uint32_t(i);
    f.placements[place] = {prints.print[i], uint32_t(result.intersections), key};
    result.intersections += prints.tiles[i];
    if (key < result.key_min) result.key_min = key;
    if (key > result.key_max) result.key_max = key;
  }
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
