// One 16x16 tile: pixels in blocks of W lanes (4 wide), and which Gaussians may touch which block.
#pragma once
#include "frame.hpp"
#include "simd.hpp"

namespace recast {
namespace RECAST_ISA {

constexpr int kBlockWidth = 4;
constexpr int kBlockHeight = W / kBlockWidth;
constexpr int kBlockColumns = kTile / kBlockWidth;
constexpr int kBlockRows = kTile / kBlockHeight;
constexpr int kBlocks = kBlockColumns * kBlockRows;
constexpr int kBatch = 128;  // Gaussians handled at a time: they stay in the first-level cache

// Where pixel row y of block column i lies in block order; four pixels are contiguous.
static inline int block_offset(int y, int column) {
  return (y / kBlockHeight * kBlockColumns + column) * W + y % kBlockHeight * kBlockWidth;
}

struct Tile {
  int x, y;            // corner, pixels
  int width, height;   // inside the image
  uint32_t begin, end; // intersections
};

static inline Tile tile_at(const Frame& f, int64_t index) {
  Tile t;
  t.x = int(index % f.tiles_x) * kTile;
  t.y = int(index / f.tiles_x) * kTile;
  t.width = f.width - t.x < kTile ? f.width - t.x : kTile;
  t.height = f.height - t.y < kTile ? f.height - t.y : kTile;
  t.begin = f.tile_begin[index];
  t.end = f.tile_begin[index + 1];
  return t;
}

// One bit a block that has a pixel inside the image.
static inline uint32_t blocks_inside(const Tile& t) {
  uint32_t mask = 0;
  for (int j = 0; j < kBlockRows; ++j)
    for (int i = 0; i < kBlockColumns; ++i)
      if (i * kBlockWidth < t.width && j * kBlockHeight < t.height)
        mask |= 1u << (j * kBlockColumns + i);
  return mask;
}

// Gaussians of a tile, positions relative to its corner; once by row, once by column.
struct Batch {
  alignas(64) Splat splats[kBatch];
  alignas(64) float columns[10][kBatch];
  int count;
};
// U0 and V0 are u and v at the corner of the tile, see `power_at`.
enum Column { kX, kY, kL1, kL2, kL3, kReach, kSlopeY, kSlopeX, kU0, kV0 };

// log2 alpha of Gaussian i at pixels relative to the corner of the tile, with u = l1 dx + l2 dy and
// v = l3 dy; both passes use it, so that they agree bit by bit.
static inline vf power_at(const Batch& batch, int i, vf px, vf py, vf& u, vf& v) {
  const Splat& s = batch.splats[i];
  u = fma(vf(s.l1), px, fma(vf(s.l2), py, vf(batch.columns[kU0][i])));
  v = fma(vf(s.l3), py, vf(batch.columns[kV0][i]));
  return fnma(v, v, fnma(u, u, vf(s.log2_opacity)));
}

static inline void load_batch(const Frame& f, const Tile& tile, uint32_t begin, int count,
                              Batch& batch) {
  batch.count = count;
  alignas(64) float corner[16] = {float(tile.x), float(tile.y)};
  // The slack keeps the test conservative under rounding.
  const vf slack = kLog2AlphaThreshold - 0.01f;
  for (int first = 0; first < count; first += W) {
    vf part[16 / W][W];
    for (uint32_t i = begin + uint32_t(first) + 2 * W; i < begin + uint32_t(first) + 3 * W; ++i)
      if (i < tile.end) __builtin_prefetch(f.splats + f.intersections[i].id);
    for (int lane = 0; lane < W; ++lane) {
      const int i = first + lane < count ? first + lane : count - 1;
      const float* row = &f.splats[f.intersections[begin + uint32_t(i)].id].x;
      float* out = &batch.splats[first + lane].x;
      for (int c = 0; c < 16 / W; ++c) {
        part[c][lane] = load(row + c * W) - load(corner + c * W);
        store(out + c * W, part[c][lane]);
      }
    }
    for (int c = 0; c < 16 / W; ++c) transpose(part[c]);
    const vf* column = part[0];
    for (int c = 0; c < 5; ++c) store(batch.columns[c] + first, column[c]);
    store(batch.columns[kReach] + first, column[5] - slack);
    store(batch.columns[kSlopeY] + first, column[10]);
    store(batch.columns[kSlopeX] + first, column[11]);
    store(batch.columns[kU0] + first, -fma(column[2], column[0], column[3] * column[1]));
    store(batch.columns[kV0] + first, -(column[4] * column[1]));
  }
}

// Calls visit(block, mask) with the lanes of Gaussians first .. first + W - 1 whose ellipse
// alpha = 1/255 reaches a pixel of the block, for every block in `alive`.
template <typename Visit>
static inline void test_blocks(const Batch& batch, int first, uint32_t alive, Visit visit) {
  const vf x = load(batch.columns[kX] + first), y = load(batch.columns[kY] + first);
  const vf l1 = load(batch.columns[kL1] + first), l2 = load(batch.columns[kL2] + first);
  const vf l3 = load(batch.columns[kL3] + first), reach = load(batch.columns[kReach] + first);
  const vf slope_y = load(batch.columns[kSlopeY] + first);
  const vf slope_x = load(batch.columns[kSlopeX] + first);
  const vf zero = 0.0f;
  vf x0[kBlockColumns], x1[kBlockColumns], best_y[kBlockColumns], l1_dx[kBlockColumns];
  for (int i = 0; i < kBlockColumns; ++i) {
    x0[i] = vf(float(i * kBlockWidth) + 0.5f) - x;
    x1[i] = x0[i] + vf(float(kBlockWidth - 1));
    const vf dx = vmax(vmin(zero, x1[i]), x0[i]);
    best_y[i] = slope_y * dx;
    l1_dx[i] = l1 * dx;
  }
  for (int j = 0; j < kBlockRows; ++j) {
    if (!(alive >> (j * kBlockColumns) & ((1u << kBlockColumns) - 1u))) continue;
    const vf y0 = vf(float(j * kBlockHeight) + 0.5f) - y;
    const vf y1 = y0 + vf(float(kBlockHeight - 1));
    const vf dy = vmax(vmin(zero, y1), y0);
    const vf best_x = slope_x * dy, l2_dy = l2 * dy, l3_dy = l3 * dy;
    for (int i = 0; i < kBlockColumns; ++i) {
      // The least value over a box lies at its point nearest in x or nearest in y.
      const vf ey = vmin(vmax(best_y[i], y0), y1), ex = vmin(vmax(best_x, x0[i]), x1[i]);
      const vf u = fma(l2, ey, l1_dx[i]), v = l3 * ey, p = fma(l1, ex, l2_dy);
      const vf least = vmin(fma(u, u, v * v), fma(p, p, l3_dy * l3_dy));
      visit(j * kBlockColumns + i, least <= reach);
    }
  }
}

}  // namespace RECAST_ISA
}  // namespace recast
