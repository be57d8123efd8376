// Forward, per tile: alpha compositing, front to back, one block of pixels at a time.
#include "kernels.hpp"
#include "tile.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

struct State {
  alignas(64) float r[kTilePixels], g[kTilePixels], b[kTilePixels], depth[kTilePixels];
  alignas(64) float through[kTilePixels];  // transmittance
  // The same while the pixel is open; zero once it has stopped and outside of the window, so that no
  // branch is needed, which no machine could foresee.
  alignas(64) float open[kTilePixels];
};

constexpr int kLook = 16;  // Gaussians between looks at whether a block has stopped

// Blends the listed Gaussians over block `block`; false once all its pixels have stopped.
bool blend(State& state, const Batch& batch, const uint8_t* list, int n, int block,
           float max_alpha) {
  alignas(64) float lane_x[W], lane_y[W];
  for (int i = 0; i < W; ++i) {
    lane_x[i] = float(i % kBlockWidth) + 0.5f;
    lane_y[i] = float(i / kBlockWidth) + 0.5f;
  }
  const vf px = load(lane_x) + vf(float(block % kBlockColumns * kBlockWidth));
  const vf py = load(lane_y) + vf(float(block / kBlockColumns * kBlockHeight));
  const vf threshold = kLog2AlphaThreshold, stop_at = kTransmittanceThreshold, cap = max_alpha;
  const int at = block * W;
  vf r = load(state.r + at), g = load(state.g + at), b = load(state.b + at);
  vf depth = load(state.depth + at), open = load(state.open + at);
  vf through = load(state.through + at);
  bool alive = true;
  for (int begin = 0; begin < n && alive; begin += kLook) {
    const int end = begin + kLook < n ? begin + kLook : n;
    for (int i = begin; i < end; ++i) {
      const int which = list[i];
      vf u, v;
      const vf power = power_at(batch, which, px, py, u, v);
      const vf alpha = keep(power >= threshold, vmin(exp2_bounded(power), cap));
      const vf next = fnma(alpha, open, open);
      const vm stopped = next <= stop_at;
      const vf weight = drop(stopped, alpha * open);
      open = drop(stopped, next);
      through = select(stopped, through, next);
      r = fma(weight, batch.of(kR, which), r);
      g = fma(weight, batch.of(kG, which), g);
      b = fma(weight, batch.of(kB, which), b);
      depth = fma(weight, batch.of(kDepth, which), depth);
    }
    alive = any(open > vf(0.0f));
  }
  store(state.r + at, r);
  store(state.g + at, g);
  store(state.b + at, b);
  store(state.depth + at, depth);
  store(state.open + at, open);
  store(state.through + at, through);
  return alive;
}

// Gaussians of the batch that may touch each block, one bit each.
struct Touched {
  static constexpr int kBytes = kBatch / 8;
  alignas(64) uint8_t bits[kBlocks][kBytes];

  // Their indices; writes up to W past the end.
  int list(int block, uint8_t* out) const { return list_bits(bits[block], kBytes, out); }
};

void write_images(const Frame& f, const Tile& t, State& s) {
  const vf one = 1.0f;
  for (int i = 0; i < kTilePixels; i += W) {
    const vf through = load(s.through + i);
    store(s.r + i, fma(through, vf(f.background[0]), load(s.r + i)));
    store(s.g + i, fma(through, vf(f.background[1]), load(s.g + i)));
    store(s.b + i, fma(through, vf(f.background[2]), load(s.b + i)));
    store(s.open + i, one - through);
  }
  for_each_run(t, [&](int y, int x, int first, int end) {
    const int at = block_offset(y, x / kBlockWidth), skip = first - x, n = end - first;
    const int64_t pixel = image_row(f, t, y) + first;
    alignas(16) float part[3 * kBlockWidth];
    float* rgb = f.rgb + 3 * pixel;
    store_pixels(n == kBlockWidth ? rgb : part, s.r + at, s.g + at, s.b + at);
    if (n < kBlockWidth) __builtin_memcpy(rgb, part + 3 * skip, size_t(3 * n) * sizeof(float));
    __builtin_memcpy(f.depth + pixel, s.depth + at + skip, size_t(n) * sizeof(float));
    __builtin_memcpy(f.alpha + pixel, s.open + at + skip, size_t(n) * sizeof(float));
  });
}

}  // namespace

void raster_tile(const Frame& f, int64_t index) {
  const Tile t = tile_at(f, index);
  State state;
  Batch batch;
  Touched touched;
  __builtin_memset(&state, 0, sizeof state);
  for (int i = 0; i < kTilePixels; i += W) store(state.through + i, vf(1.0f));
  for_each_run(t, [&](int y, int x, int first, int end) {
    for (int i = first; i < end; ++i)
      state.open[block_offset(y, x / kBlockWidth) + i - x] = 1.0f;
  });

  uint32_t alive = blocks_inside(t);
  for (uint32_t begin = t.begin; begin < t.end && alive; begin += kBatch) {
    const int count = int(t.end - begin < kBatch ? t.end - begin : kBatch);
    load_batch(f, t, begin, count, batch);
    alignas(64) int32_t masks[kBatch];
    find_blocks(batch, masks);
    if (f.blocks) __builtin_memcpy(f.blocks + begin, masks, size_t(count) * sizeof(int32_t));
    __builtin_memset(&touched, 0, sizeof touched);
    for (int first = 0; first < count; first += 32)
      bits_of_blocks(masks + first, reinterpret_cast<uint8_t*>(&touched) + first / 8, Touched::kBytes);
    for (uint32_t left = alive; left; left &= left - 1) {
      const int block = __builtin_ctz(left);
      uint8_t list[kBatch + W];
      const int n = touched.list(block, list);
      if (n && !blend(state, batch, list, n, block, f.max_alpha)) alive &= ~(1u << block);
    }
  }
  if (f.training) {
    float* out = f.tile_state + index * 5 * kTilePixels;
    const float* planes[5] = {state.r, state.g, state.b, state.depth, state.through};
    for (int p = 0; p < 5; ++p)
      for (int i = 0; i < kTilePixels; i += W) store(out + p * kTilePixels + i, load(planes[p] + i));
  }
  write_images(f, t, state);
}

}  // namespace RECAST_ISA
}  // namespace recast
