// Forward, per block of a frozen set of Gaussians: cull, project, find the tiles, colour.
#include "geometry.hpp"
#include "harmonics.hpp"
#include "kernels.hpp"
#include "visible.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

// The most standard deviations at which an opacity of at most one reaches 1/255, a little more.
constexpr float kMostDeviations = 3.34f;

// Whether no Gaussian of the block can touch the image. Exact: for a centre at depth z the reach in
// pixels is at most kMostDeviations (fx scale / z sqrt(1 + slope^2) + sqrt(eps2d)), slope held to the
// range in which the Jacobian is taken; times z this is a plane.
bool out_of_view(const Frame& f, const Part& part, const float* bounds) {
  float c[3];
  for (int i = 0; i < 3; ++i)
    c[i] = part.rotation[3 * i] * bounds[0] + part.rotation[3 * i + 1] * bounds[1] +
           part.rotation[3 * i + 2] * bounds[2] + part.translation[i];
  const float radius = bounds[3], scale = kMostDeviations * bounds[4];
  if (c[2] + radius < f.near_plane || c[2] - radius > f.far_plane) return true;
  const float blur = kMostDeviations * __builtin_sqrtf(f.eps2d) + 0.5f;
  const float focal[2] = {f.fx, f.fy}, centre[2] = {f.cx, f.cy};
  const float whole[2] = {float(f.whole_width), float(f.whole_height)};
  const float begin[2] = {float(f.left), float(f.top)};
  const float size[2] = {float(f.width), float(f.height)};
  for (int i = 0; i < 2; ++i) {
    const float margin = kTangentMargin * 0.5f * whole[i] / focal[i];
    const float low = centre[i] / focal[i] + margin;
    const float high = (whole[i] - centre[i]) / focal[i] + margin;
    const float slope = __builtin_fabsf(low) > __builtin_fabsf(high) ? low : high;
    const float reach = focal[i] * scale * __builtin_sqrtf(1.0f + slope * slope);
    // Pixel times z, from the first and from the last column or row on.
    const float before = centre[i] - begin[i] + blur;
    const float after = begin[i] + size[i] - centre[i] + blur;
    const float left = focal[i] * c[i] + before * c[2];
    const float right = after * c[2] - focal[i] * c[i];
    const float far_left = radius * __builtin_sqrtf(focal[i] * focal[i] + before * before);
    const float far_right = radius * __builtin_sqrtf(focal[i] * focal[i] + after * after);
    if (left + far_left + reach < 0.0f || right + far_right + reach < 0.0f) return true;
  }
  return false;
}

template <int K>
void colour(const float* offset, const vf* mean, const uint16_t* halves, vf (&rgb)[3]) {
  vf d[3], b[16];
  view_direction(mean, offset, d);
  harmonics<K>(d, b);
  for (int j = 0; j < 3; ++j) {
    vf c = vf(0.5f);
    for (int k = 0; k < K; ++k) c = fma(b[k], load_half(halves + (3 * k + j) * kFrozenLanes), c);
    rgb[j] = vmax(c, vf(0.0f));
  }
}

template <int K>
void project_block(const Frame& f, const Part& part, int64_t block, const float* offset,
                   int64_t base, ChunkResult& result) {
  for (int64_t row = block * kFrozenBlock; row < (block + 1) * kFrozenBlock; row += W) {
    const int64_t lanes = row / kFrozenLanes, lane = row % kFrozenLanes;
    const float* at = part.geometry + lanes * kFrozenColumns * kFrozenLanes + lane;
    vf mean[3], rgb[3];
    Projection o;
    for (int i = 0; i < 3; ++i) mean[i] = load(at + i * kFrozenLanes);
    to_image(f, mean, o);
    for (int i = 0; i < 3; ++i) {
      const vf a = load(at + (3 + i) * kFrozenLanes), b = load(at + (6 + i) * kFrozenLanes),
               c = load(at + (9 + i) * kFrozenLanes);
      for (int r = 0; r < 6; r += 3)
        o.axes[r + i] = o.image_from_world[r] * a + o.image_from_world[r + 1] * b +
                        o.image_from_world[r + 2] * c;
    }
    blurred(f, o);
    vf log2_opacity = load(at + 12 * kFrozenLanes);
    if (f.antialiased)
      log2_opacity =
          fma(vf(0.5f), vlog2(vmax(o.exact_det / o.det, vf(kMinCompensation))), log2_opacity);
    Seen seen;
    find_visible(f, o, log2_opacity >= vf(kLog2AlphaThreshold), log2_opacity, (1ull << W) - 1, seen);
    if (!seen.lanes) continue;
    colour<K>(offset, mean, part.colours + lanes * 3 * K * kFrozenLanes + lane, rgb);
    list_visible(f, o, seen, rgb, uint32_t(row), base, result);
  }
}

}  // namespace

void project_frozen_chunk(const Frame& given, int64_t chunk) {
  const Part* part = given.parts;
  while (chunk >= part[1].first_chunk) ++part;
  Frame f = given;
  __builtin_memcpy(f.rotation, part->rotation, sizeof f.rotation);
  __builtin_memcpy(f.translation, part->translation, sizeof f.translation);
  f.eps2d = part->eps2d;
  f.antialiased = int32_t(part->antialiased);
  float offset[3];
  camera_offset(f, offset);
  ChunkResult result = {};
  result.key_min = ~0u;
  constexpr int kBlocksAChunk = kChunk / kFrozenBlock;
  const int64_t first = (chunk - part->first_chunk) * kBlocksAChunk;
  for (int64_t block = first; block < first + kBlocksAChunk && block < part->blocks; ++block) {
    if (out_of_view(f, *part, part->bounds + block * kFrozenBounds)) continue;
    const int64_t base = chunk * kChunk;
    if (part->sh_bases == 1) project_block<1>(f, *part, block, offset, base, result);
    if (part->sh_bases == 4) project_block<4>(f, *part, block, offset, base, result);
    if (part->sh_bases == 9) project_block<9>(f, *part, block, offset, base, result);
    if (part->sh_bases == 16) project_block<16>(f, *part, block, offset, base, result);
  }
  given.chunks[chunk] = result;
}

}  // namespace RECAST_ISA
}  // namespace recast
