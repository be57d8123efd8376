// Forward, per tile: alpha compositing, front to back, one block of pixels at a time.
#include "kernels.hpp"
#include "tile.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

struct State {
  alignas(64) float r[kTilePixels], g[kTilePixels], b[kTilePixels], depth[kTilePixels];
  // Transmittance: zero once a pixel has stopped, its last value then being in `final`.
  alignas(64) float open[kTilePixels], final[kTilePixels];
};

// Blends the listed Gaussians over block `block`; false once all its pixels have stopped.
bool blend(State& state, const Batch& batch, const int32_t* list, int n, int block, float max_alpha) {
  alignas(64) float lane_x[W], lane_y[W];
  for (int i = 0; i < W; ++i) {
    lane_x[i] = float(block % kBlockColumns * kBlockWidth + i % kBlockWidth) + 0.5f;
    lane_y[i] = float(block / kBlockColumns * kBlockHeight + i / kBlockWidth) + 0.5f;
  }
  const vf px = load(lane_x), py = load(lane_y);
  const vf threshold = kLog2AlphaThreshold, stop_at = kTransmittanceThreshold, cap = max_alpha;
  const int at = block * W;
  vf r = load(state.r + at), g = load(state.g + at), b = load(state.b + at);
  vf depth = load(state.depth + at), open = load(state.open + at);
  bool alive = true;
  for (int i = 0; i < n; ++i) {
    const Splat& s =
        *reinterpret_cast<const Splat*>(reinterpret_cast<const char*>(batch.splats) + list[i]);
    const vf dx = px - vf(s.x), dy = py - vf(s.y);
    const vf u = fma(vf(s.l1), dx, vf(s.l2) * dy), v = vf(s.l3) * dy;
    const vf power = fnma(v, v, fnma(u, u, vf(s.log2_opacity)));
    const vf alpha = keep(power >= threshold, vmin(exp2_bounded(power), cap));
    vf weight = alpha * open;
    vf next = fnma(alpha, open, open);
    const vm stopped = (next <= stop_at) & (open > vf(0.0f));
    if (__builtin_expect(any(stopped), 0)) {
      store(state.final + at, select(stopped, open, load(state.final + at)));
      weight = drop(stopped, weight);
      next = drop(stopped, next);
      alive = any(next > vf(0.0f));
      if (!alive) n = i;  // this Gaussian is the last one
    }
    open = next;
    r = fma(weight, vf(s.r), r);
    g = fma(weight, vf(s.g), g);
    b = fma(weight, vf(s.b), b);
    depth = fma(weight, vf(s.depth), depth);
  }
  store(state.r + at, r);
  store(state.g + at, g);
  store(state.b + at, b);
  store(state.depth + at, depth);
  store(state.open + at, open);
  return alive;
}

void write_images(const Frame& f, const Tile& t, const State& state) {
  const float* back = f.background;
  for (int y = 0; y < t.height; ++y) {
    for (int column = 0; column * kBlockWidth < t.width; ++column) {
      const int at = block_offset(y, column);
      const int64_t pixel = int64_t(t.y + y) * f.width + t.x + column * kBlockWidth;
      const int n = t.width - column * kBlockWidth < kBlockWidth ? t.width - column * kBlockWidth
                                                                 : kBlockWidth;
      for (int i = 0; i < n; ++i) {
        const float through = state.final[at + i];
        float* rgb = f.rgb + 3 * (pixel + i);
        rgb[0] = state.r[at + i] + through * back[0];
        rgb[1] = state.g[at + i] + through * back[1];
        rgb[2] = state.b[at + i] + through * back[2];
        f.depth[pixel + i] = state.depth[at + i];
        f.alpha[pixel + i] = 1.0f - through;
      }
    }
  }
}

}  // namespace

void raster_tile(const Frame& f, int64_t index) {
  const Tile t = tile_at(f, index);
  State state;
  Batch batch;
  __builtin_memset(&state, 0, sizeof state);
  for (int y = 0; y < t.height; ++y)
    for (int column = 0; column < kBlockColumns; ++column)
      for (int i = 0; i < kBlockWidth; ++i)
        if (column * kBlockWidth + i < t.width) state.open[block_offset(y, column) + i] = 1.0f;

  uint32_t alive = blocks_inside(t);
  for (uint32_t begin = t.begin; begin < t.end && alive; begin += kBatch) {
    const int count = int(t.end - begin < kBatch ? t.end - begin : kBatch);
    load_batch(f, t, begin, count, batch);
    uint32_t touched[kBatch / W][kBlocks];
    for (int first = 0; first < count; first += W) {
      const uint32_t valid = count - first >= W ? (1u << W) - 1u : (1u << (count - first)) - 1u;
      uint32_t* masks = touched[first / W];
      test_blocks(batch, first, alive, [&](int b, vm m) { masks[b] = bits(m) & valid; });
    }
    for (uint32_t left = alive; left; left &= left - 1) {
      const int block = __builtin_ctz(left);
      int32_t list[kBatch + W];
      int n = 0;
      for (int first = 0; first < count; first += W)
        n = append_lanes(list, n, touched[first / W][block], first * int(sizeof(Splat)),
                         int(sizeof(Splat)));
      if (n && !blend(state, batch, list, n, block, f.max_alpha)) alive &= ~(1u << block);
    }
  }
  for (int i = 0; i < kTilePixels; i += W) {
    const vf open = load(state.open + i);
    store(state.final + i, select(open > vf(0.0f), open, load(state.final + i)));
  }
  write_images(f, t, state);
  if (f.training) {
    float* out = f.tile_state + index * 5 * kTilePixels;
    const float* planes[5] = {state.r, state.g, state.b, state.depth, state.final};
    for (int p = 0; p < 5; ++p)
      for (int i = 0; i < kTilePixels; i += W) store(out + p * kTilePixels + i, load(planes[p] + i));
  }
}

}  // namespace RECAST_ISA
}  // namespace recast
