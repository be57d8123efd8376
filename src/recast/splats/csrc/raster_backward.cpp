// Backward, per tile: the image gradients to ten sums a Gaussian and tile.
//
// The loss is linear in the image: F = sum_i c_i alpha_i T_i + (v.background - v_alpha) T_end with one
// scalar c_i = v_rgb . rgb_i + v_depth z_i a pixel and Gaussian. So d F / d alpha_i is
// T_i c_i - rest_i / (1 - alpha_i), where rest_i is what F holds behind Gaussian i. Walking front to
// back like the forward pass repeats its transmittances bit by bit.
#include "kernels.hpp"
#include "tile.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

constexpr int kLook = 32;  // Gaussians between looks at which blocks have stopped

struct Pixels {
  alignas(64) float x[kTilePixels], y[kTilePixels];
  alignas(64) float r[kTilePixels], g[kTilePixels], b[kTilePixels], depth[kTilePixels];
  alignas(64) float open[kTilePixels];  // transmittance, zero once stopped
  alignas(64) float rest[kTilePixels];  // part of the loss still to come
};

// Copies an image of `channels` interleaved channels into block order; zero outside of the window.
void load_plane(const Frame& f, const Tile& t, const float* image, int channels, float* out) {
  if (!image) return;
  for_each_run(t, [&](int y, int x, int first, int end) {
    float* to = out + block_offset(y, x / kBlockWidth) - x;
    const int64_t row = image_row(f, t, y);
    for (int i = first; i < end; ++i) to[i] = image[(row + i) * channels];
  });
}

void load_pixels(const Frame& f, const Tile& t, int64_t index, Pixels& p) {
  __builtin_memset(&p, 0, sizeof p);
  alignas(64) float alpha[kTilePixels] = {};
  for (int y = 0; y < kTile; ++y)
    for (int x = 0; x < kTile; ++x) {
      const int at = block_offset(y, x / kBlockWidth) + x % kBlockWidth;
      p.x[at] = float(x) + 0.5f;
      p.y[at] = float(y) + 0.5f;
      p.open[at] = x >= t.x0 && x < t.x1 && y >= t.y0 && y < t.y1 ? 1.0f : 0.0f;
    }
  const float* rgb = f.rgb_grad;
  load_plane(f, t, rgb, 3, p.r);
  load_plane(f, t, rgb ? rgb + 1 : rgb, 3, p.g);
  load_plane(f, t, rgb ? rgb + 2 : rgb, 3, p.b);
  load_plane(f, t, f.depth_grad, 1, p.depth);
  load_plane(f, t, f.alpha_grad, 1, alpha);
  const float* back = f.background;
  for (int i = 0; i < kTilePixels; i += W) {
    const float* saved = f.tile_state + index * 5 * kTilePixels + i;
    const vf r = load(p.r + i), g = load(p.g + i), b = load(p.b + i);
    const vf behind = fma(r, vf(back[0]), fma(g, vf(back[1]), fma(b, vf(back[2]), -load(alpha + i))));
    vf rest = behind * load(saved + 4 * kTilePixels);
    rest = fma(load(p.depth + i), load(saved + 3 * kTilePixels), rest);
    rest = fma(b, load(saved + 2 * kTilePixels), rest);
    rest = fma(g, load(saved + kTilePixels), rest);
    store(p.rest + i, fma(r, load(saved), rest));
  }
}

// What the pixels of the blocks that a Gaussian reaches add to its sums.
struct Visits {
  int count = 0;
  int at[kBlocks];  // first pixel
  // d F / d ln alpha, none where alpha is capped; alpha T; and the Gaussian's u and v.
  alignas(64) float q[kTilePixels], weight[kTilePixels], u[kTilePixels], v[kTilePixels];
};

// Blends Gaussian i over the blocks in `mask` once more.
void visit(Pixels& p, const Batch& batch, int i, uint32_t mask, float max_alpha, Visits& visits) {
  const vf sr = batch.of(kR, i), sg = batch.of(kG, i), sb = batch.of(kB, i);
  const vf sd = batch.of(kDepth, i);
  const vf threshold = kLog2AlphaThreshold, stop_at = kTransmittanceThreshold, cap = max_alpha;
  const vf one = 1.0f;
  int n = 0;
  for (uint32_t left = mask; left; left &= left - 1, ++n) {
    const int at = __builtin_ctz(left) * W;
    vf u, v;
    const vf power = power_at(batch, i, load(p.x + at), load(p.y + at), u, v);
    const vf bare = exp2_bounded(power);
    const vf full = keep(power >= threshold, vmin(bare, cap));
    const vf open = load(p.open + at);
    const vf next = fnma(full, open, open);
    const vm stopped = next <= stop_at;  // now, or before
    const vf alpha = drop(stopped, full), weight = alpha * open;
    store(p.open + at, drop(stopped, next));
    const vf c = fma(load(p.r + at), sr,
                     fma(load(p.g + at), sg, fma(load(p.b + at), sb, load(p.depth + at) * sd)));
    const vf rest = fnma(weight, c, load(p.rest + at));
    store(p.rest + at, rest);
    const vf alpha_grad = fnma(rest, fast_reciprocal(one - alpha), open * c);
    visits.at[n] = at;
    store(visits.q + n * W, keep(bare <= cap, alpha * alpha_grad));
    store(visits.weight + n * W, weight);
    store(visits.u + n * W, u);
    store(visits.v + n * W, v);
  }
  visits.count = n;
}

// Adds visits up to ten sums: a loop of its own, since those fill the registers. Where `Absolute`, the
// sizes of the pixels' gradients along x and y, up to common factors, go to two more.
template <bool Absolute>
void gather(const Pixels& p, const Batch& batch, int i, const Visits& visits, float* record,
            float* absolute) {
  const vf zero = 0.0f;
  vf sum_u = zero, sum_v = zero, sum_uu = zero, sum_uv = zero, sum_vv = zero, sum = zero;
  vf sum_r = zero, sum_g = zero, sum_b = zero, sum_d = zero;
  for (int k = 0; k < visits.count; ++k) {
    const int at = visits.at[k];
    const vf q = load(visits.q + k * W), weight = load(visits.weight + k * W);
    const vf u = load(visits.u + k * W), v = load(visits.v + k * W);
    const vf qu = q * u, qv = q * v;
    sum = sum + q;
    sum_u = sum_u + qu;
    sum_v = sum_v + qv;
    sum_uu = fma(qu, u, sum_uu);
    sum_uv = fma(qu, v, sum_uv);
    sum_vv = fma(qv, v, sum_vv);
    sum_r = fma(weight, load(p.r + at), sum_r);
    sum_g = fma(weight, load(p.g + at), sum_g);
    sum_b = fma(weight, load(p.b + at), sum_b);
    sum_d = fma(weight, load(p.depth + at), sum_d);
  }
  const vf sums[kSums] = {sum_u, sum_v, sum_uu, sum_uv, sum_vv, sum, sum_r, sum_g, sum_b, sum_d};
  store_ten_sums(record, sums);
  if (!Absolute) return;
  const vf l2 = batch.of(kL2, i), l3 = batch.of(kL3, i);
  vf sum_x = zero, sum_y = zero;
  for (int k = 0; k < visits.count; ++k) {
    const vf q = load(visits.q + k * W);
    const vf qu = q * load(visits.u + k * W), qv = q * load(visits.v + k * W);
    sum_x = sum_x + vabs(qu);
    sum_y = sum_y + vabs(fma(l2, qu, l3 * qv));
  }
  store_two_sums(absolute, sum_x, sum_y);
}

// Those of the blocks in `alive` that have a pixel that has not stopped.
uint32_t still_open(const Pixels& p, uint32_t alive) {
  uint32_t found = 0;
  for (uint32_t left = alive; left; left &= left - 1) {
    const int block = __builtin_ctz(left);
    if (any(load(p.open + block * W) > vf(0.0f))) found |= 1u << block;
  }
  return found;
}

template <bool Absolute>
void tile_gradient(const Frame& f, int64_t index) {
  const Tile t = tile_at(f, index);
  if (t.begin == t.end) return;
  Pixels pixels;
  Batch batch;
  Visits visits;
  load_pixels(f, t, index, pixels);
  uint32_t alive = blocks_inside(t);
  for (uint32_t begin = t.begin; begin < t.end; begin += kBatch) {
    const int count = int(t.end - begin < kBatch ? t.end - begin : kBatch);
    if (!(alive = still_open(pixels, alive))) break;
    load_batch(f, t, begin, count, batch);
    alignas(64) int32_t touched[kBatch];
    if (f.blocks)
      __builtin_memcpy(touched, f.blocks + begin, size_t(count) * sizeof(int32_t));
    else
      find_blocks(batch, touched);
    for (int i = 0; i < count; ++i) {
      if (i && i % kLook == 0 && !(alive = still_open(pixels, alive))) break;
      const uint32_t mask = uint32_t(touched[i]) & alive;
      if (i + 6 < count)
        __builtin_prefetch(
            f.records + int64_t(f.intersections[begin + uint32_t(i) + 6].slot) * kSums, 1);
      if (!mask) continue;
      const uint32_t slot = f.intersections[begin + uint32_t(i)].slot;
      f.record_used[slot] = 1;
      visit(pixels, batch, i, mask, f.max_alpha, visits);
      gather<Absolute>(pixels, batch, i, visits, f.records + int64_t(slot) * kSums,
                       Absolute ? f.absolute_records + int64_t(slot) * kAbsoluteSums : nullptr);
    }
  }
}

}  // namespace

void raster_tile_backward(const Frame& f, int64_t index) {
  if (f.absolute_records)
    tile_gradient<true>(f, index);
  else
    tile_gradient<false>(f, index);
}

}  // namespace RECAST_ISA
}  // namespace recast
