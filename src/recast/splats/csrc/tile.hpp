// One 16x16 tile: pixels in blocks of W lanes (4 wide), and which Gaussians may touch which block.
#pragma once
#include "frame.hpp"
#include "simd.hpp"

namespace recast {
namespace RECAST_ISA {
inline namespace RECAST_LANES {

constexpr int kBlockWidth = 4;
constexpr int kBlockHeight = W / kBlockWidth;
constexpr int kBlockColumns = kTile / kBlockWidth;
constexpr int kBlockRows = kTile / kBlockHeight;
constexpr int kBlocks = kBlockColumns * kBlockRows;
constexpr int kAhead = 64;  // Gaussians fetched in advance: nearest first they lie all over the memory
constexpr int kBatch = 256;  // Gaussians handled at a time: they stay in the first-level cache

// Where pixel row y of block column i lies in block order; four pixels are contiguous.
static inline int block_offset(int y, int column) {
  return (y / kBlockHeight * kBlockColumns + column) * W + y % kBlockHeight * kBlockWidth;
}

struct Tile {
  int x, y;            // corner, pixels of the whole image
  int x0, y0, x1, y1;  // pixels of the tile inside of the window, from its corner; ends excluded
  uint32_t begin, end; // intersections
};

static inline Tile tile_at(const Frame& f, int64_t index) {
  Tile t;
  t.x = (int(index % f.tiles_x) + f.first_tile_x) * kTile;
  t.y = (int(index / f.tiles_x) + f.first_tile_y) * kTile;
  const int right = f.left + f.width - t.x, below = f.top + f.height - t.y;
  t.x0 = f.left > t.x ? f.left - t.x : 0;
  t.y0 = f.top > t.y ? f.top - t.y : 0;
  t.x1 = right < kTile ? right : kTile;
  t.y1 = below < kTile ? below : kTile;
  t.begin = f.tile_begin[index];
  t.end = f.tile_begin[index + 1];
  return t;
}

// Where pixel (0, y) of a tile lies in the images, which hold the window alone.
static inline int64_t image_row(const Frame& f, const Tile& t, int y) {
  return int64_t(t.y + y - f.top) * f.width + t.x - f.left;
}

// Calls `visit(y, x, first, end)` for each block's row of pixels x .. x + kBlockWidth - 1 that meets
// the window, which holds pixels first .. end - 1 of it.
template <typename Visit>
static inline void for_each_run(const Tile& t, Visit visit) {
  for (int y = t.y0; y < t.y1; ++y)
    for (int x = t.x0 / kBlockWidth * kBlockWidth; x < t.x1; x += kBlockWidth)
      visit(y, x, x < t.x0 ? t.x0 : x, x + kBlockWidth < t.x1 ? x + kBlockWidth : t.x1);
}

// One bit a block that has a pixel inside the window.
static inline uint32_t blocks_inside(const Tile& t) {
  uint32_t mask = 0;
  for (int j = 0; j < kBlockRows; ++j)
    for (int i = 0; i < kBlockColumns; ++i)
      if (i * kBlockWidth < t.x1 && (i + 1) * kBlockWidth > t.x0 && j * kBlockHeight < t.y1 &&
          (j + 1) * kBlockHeight > t.y0)
        mask |= 1u << (j * kBlockColumns + i);
  return mask;
}

// Columns of a batch: of the splat, and u and v at the corner of the tile, see `power_at`.
enum Column { kX, kY, kL1, kL2, kL3, kLog2Opacity, kR, kG, kB, kDepth, kSlopeX, kU0, kV0, kColumns };

// Gaussians of a tile, positions relative to its corner, by column.
struct Batch {
  alignas(64) float columns[kColumns][kBatch];
  int count;

  vf of(Column c, int i) const { return vf(columns[c][i]); }
};

// log2 alpha of Gaussian i at pixels relative to the corner of the tile, with u = l1 dx + l2 dy and
// v = l3 dy; both passes use it, so that they agree bit by bit.
static inline vf power_at(const Batch& batch, int i, vf px, vf py, vf& u, vf& v) {
  u = fma(batch.of(kL1, i), px, fma(batch.of(kL2, i), py, batch.of(kU0, i)));
  v = fma(batch.of(kL3, i), py, batch.of(kV0, i));
  return fnma(v, v, fnma(u, u, batch.of(kLog2Opacity, i)));
}

static inline void load_batch(const Frame& f, const Tile& tile, uint32_t begin, int count,
                              Batch& batch) {
  batch.count = count;
  const vf corner_x = float(tile.x), corner_y = float(tile.y);
  for (int first = 0; first < count; first += W) {
    vf part[16 / W][W];
    // Past the end they are those of the next tile.
    const uint32_t ahead = begin + uint32_t(first) + kAhead;
    for (uint32_t i = ahead; i < ahead + W && i < f.listed; ++i)
      __builtin_prefetch(f.splats + f.intersections[i].place);
    for (int lane = 0; lane < W; ++lane) {
      const int i = first + lane < count ? first + lane : count - 1;
      const float* row = &f.splats[f.intersections[begin + uint32_t(i)].place].x;
      for (int c = 0; c < 16 / W; ++c) part[c][lane] = load(row + c * W);
    }
    for (int c = 0; c < 16 / W; ++c) transpose(part[c]);
    vf* column = part[0];
    column[kX] = column[kX] - corner_x;
    column[kY] = column[kY] - corner_y;
    for (int c = 0; c <= kSlopeX; ++c) store(batch.columns[c] + first, column[c]);
    store(batch.columns[kU0] + first,
          -fma(column[kL1], column[kX], column[kL2] * column[kY]));
    store(batch.columns[kV0] + first, -(column[kL3] * column[kY]));
  }
}

// The blocks that the ellipses alpha = 1/255 of Gaussians first .. first + W - 1 reach, one bit a
// block: along each row of pixels an ellipse holds the centres of one interval. A few blocks too many
// near its border, none too few.
static inline vi blocks_reached(const Batch& batch, int first) {
  const vf x = load(batch.columns[kX] + first), y = load(batch.columns[kY] + first);
  const vf inverse = vf(1.0f) / load(batch.columns[kL1] + first);
  const vf slope = load(batch.columns[kSlopeX] + first);
  // Half the interval, squared, is wide - (steep dy)^2; the factor covers the error of its root.
  const vf steep = load(batch.columns[kL3] + first) * inverse;
  const vf reach = load(batch.columns[kLog2Opacity] + first) - vf(kLog2AlphaThreshold - 0.01f);
  const vf wide = reach * inverse * inverse * vf(1.004f);
  const vf tiny = 1e-12f, zero = 0.0f, all = float(kBlockColumns), per_block = 1.0f / kBlockWidth;
  // Blocks with a centre right of the left end and one left of the right end, with a slack of a
  // hundredth of a block: rounded to the nearest integer.
  const vf from = 0.49f - (kBlockWidth - 0.5f) / kBlockWidth;
  const vf after = kBlockColumns - 1 + 0.49f + 0.5f / kBlockWidth;
  vi masks = vi(0);
  for (int j = 0; j < kBlockRows; ++j) {
    vf left, right;
    for (int k = 0; k < kBlockHeight; ++k) {
      const vf dy = vf(float(j * kBlockHeight + k) + 0.5f) - y;
      const vf v = steep * dy;
      const vf square = fnma(v, v, wide);
      // Far below zero where the row misses the ellipse: then the interval is empty.
      const vf half = square * fast_rsqrt(vmax(square, tiny)), middle = fma(slope, dy, x);
      left = k ? vmin(left, middle - half) : middle - half;
      right = k ? vmax(right, middle + half) : middle + half;
    }
    const vf skip = vmin(vmax(fma(left, per_block, from), zero), all);
    const vf miss = vmin(vmax(fnma(right, per_block, after), zero), all);
    masks = masks | run_of_four(skip, miss, j * kBlockColumns);
  }
  return masks;
}

// The blocks that each Gaussian of the batch reaches; none past its end.
static inline void find_blocks(const Batch& batch, int32_t (&masks)[kBatch]) {
  for (int first = 0; first < batch.count; first += W)
    store(masks + first, blocks_reached(batch, first));
  __builtin_memset(masks + batch.count, 0, size_t(kBatch - batch.count) * sizeof(int32_t));
}

}  // namespace RECAST_LANES
}  // namespace RECAST_ISA
}  // namespace recast
