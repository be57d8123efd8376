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
bool blend(State& state, const Batch& batch, const uint8_t* list, int n, int block,
           float max_alpha) {
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
    const Splat& s = batch.splats[list[i]];
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

// Gaussians of the batch that may touch each block: W bits a group.
struct Touched {
  static constexpr int kBytes = kBatch / 8;
  alignas(64) uint8_t bits[kBlocks][kBytes];

  void set(int block, int first, uint32_t mask) {
    for (int i = 0; i < W / 8; ++i) bits[block][first / 8 + i] = uint8_t(mask >> (8 * i));
  }
  // Their indices; writes up to W past the end.
  int list(int block, uint8_t* out) const { return list_bits(bits[block], kBytes, out); }
};

void write_images(const Frame& f, const Tile& t, State& s) {
  const vf one = 1.0f;
  for (int i = 0; i < kTilePixels; i += W) {
    const vf through = load(s.final + i);
    store(s.r + i, fma(through, vf(f.background[0]), load(s.r + i)));
    store(s.g + i, fma(through, vf(f.background[1]), load(s.g + i)));
    store(s.b + i, fma(through, vf(f.background[2]), load(s.b + i)));
    store(s.final + i, one - through);
  }
  for (int y = 0; y < t.height; ++y) {
    const int64_t row = int64_t(t.y + y) * f.width + t.x;
    for (int x = 0; x < t.width; x += kBlockWidth) {
      const int at = block_offset(y, x / kBlockWidth);
      const int n = t.width - x < kBlockWidth ? t.width - x : kBlockWidth;
      float* rgb = f.rgb + 3 * (row + x);
      for (int i = 0; i < n; ++i) {
        rgb[3 * i] = s.r[at + i];
        rgb[3 * i + 1] = s.g[at + i];
        rgb[3 * i + 2] = s.b[at + i];
        f.depth[row + x + i] = s.depth[at + i];
        f.alpha[row + x + i] = s.final[at + i];
      }
    }
  }
}

}  // namespace

void raster_tile(const Frame& f, int64_t index) {
  const Tile t = tile_at(f, index);
  State state;
  Batch batch;
  Touched touched;
  __builtin_memset(&state, 0, sizeof state);
  for (int y = 0; y < t.height; ++y)
    for (int column = 0; column < kBlockColumns; ++column)
      for (int i = 0; i < kBlockWidth; ++i)
        if (column * kBlockWidth + i < t.width) state.open[block_offset(y, column) + i] = 1.0f;

  uint32_t alive = blocks_inside(t);
  for (uint32_t begin = t.begin; begin < t.end && alive; begin += kBatch) {
    const int count = int(t.end - begin < kBatch ? t.end - begin : kBatch);
    load_batch(f, t, begin, count, batch);
    __builtin_memset(&touched, 0, sizeof touched);
    for (int first = 0; first < count; first += W) {
      const uint32_t valid = count - first >= W ? (1u << W) - 1u : (1u << (count - first)) - 1u;
      test_blocks(batch, first, alive,
                  [&](int b, vm m) { touched.set(b, first, bits(m) & valid); });
    }
    for (uint32_t left = alive; left; left &= left - 1) {
      const int block = __builtin_ctz(left);
      uint8_t list[kBatch + W];
      const int n = touched.list(block, list);
      if (n && !blend(state, batch, list, n, block, f.max_alpha)) alive &= ~(1u << block);
    }
  }
  for (int i = 0; i < kTilePixels; i += W) {
    const vf open = load(state.open + i);
    store(state.final + i, select(open > vf(0.0f), open, load(state.final + i)));
  }
  if (f.training) {
    float* out = f.tile_state + index * 5 * kTilePixels;
    const float* planes[5] = {state.r, state.g, state.b, state.depth, state.final};
    for (int p = 0; p < 5; ++p)
      for (int i = 0; i < kTilePixels; i += W) store(out + p * kTilePixels + i, load(planes[p] + i));
  }
  write_images(f, t, state);
}

}  // namespace RECAST_ISA
}  // namespace recast
