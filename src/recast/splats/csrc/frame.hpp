// Plain data shared by all stages of one rasterization. No inline code: see simd.hpp.
#pragma once
#include <cstdint>

namespace recast {

constexpr int kTile = 16;          // tile edge, pixels
constexpr int kTilePixels = kTile * kTile;
constexpr int kChunk = 1024;       // Gaussians a work item
constexpr int kFrozenBlock = 128;  // Gaussians that a frozen set culls together
constexpr int kFrozenLanes = 16;   // and that lie together, by column: enough for any vector width
constexpr int kFrozenColumns = 13; // of their geometry: centre, rotation times scale, log2 opacity
constexpr int kFrozenBounds = 5;   // of a block: centre and radius of its centres, largest scale
constexpr int kSums = 10;          // floats a gradient record
constexpr int kAbsoluteSums = 2;   // of those more that absolute gradients need
constexpr int kPastRecord = 16;    // floats behind the last record that may be read
constexpr float kAlphaThreshold = 1.0f / 255.0f;
constexpr float kLog2AlphaThreshold = -7.9943534369f;
constexpr float kTransmittanceThreshold = 1e-4f;
constexpr float kTangentMargin = 0.3f;
constexpr float kSplatUnit = 0.849321800288019f;  // sqrt(log2(e) / 2): Gaussians as powers of two
constexpr float kMinCompensation = 1e-12f;  // floor of det(exact) / det(blurred)
// Determinant of a covariance in the image, px^4, from which on a Gaussian is not drawn: products of
// a few of its entries would leave the range of float32.
constexpr float kLargestDeterminant = 1e30f;
constexpr float kLargestInput = 1e15f;  // of centres and logits

// A projected Gaussian: one cache line.
// log2 alpha at offset d from the centre is log2_opacity - (l1 dx + l2 dy)^2 - (l3 dy)^2: the
// Cholesky factor of the conic, scaled so that exp2 serves; it does not cancel on needles.
struct alignas(64) Splat {
  float x, y;
  float l1, l2, l3;
  float log2_opacity;
  float r, g, b, depth;
  float slope_x;  // dx of the middle of the ellipse at given dy: cov_xy / cov_yy
  float spare[5];
};

// Tiles a Gaussian may touch: x0 (12 bits), y0 (12), width - 1 (12), height - 1 (12), mask (16).
// With width and height of at most 4 the mask says which tiles (bit 4 row + column); larger
// rectangles count whole.
typedef uint64_t Footprint;

// Where a visible Gaussian goes.
struct Placement {
  Footprint print;
  uint32_t slot;  // first gradient record, counted from the first one of its chunk
  uint32_t key;   // depth as a sortable integer
};

struct Intersection {
  uint32_t place;  // of the Gaussian
  uint32_t slot;   // its gradient record
};

// What is wrong with a Gaussian; order known to Python.
enum Fault : uint32_t {
  kFaultNone = 0,
  kFaultMeans = 1,
  kFaultQuats = 2,
  kFaultScales = 3,
  kFaultOpacity = 4,
  kFaultSh = 5,
  kFaultQuatNorm = 6,
};

struct ChunkResult {
  uint32_t visible;
  uint32_t fault;
  uint32_t fault_row;
  uint32_t key_min, key_max;
  uint32_t spare;
  uint64_t intersections;
};

// A frozen set of Gaussians by column, kFrozenLanes at a time; its last block is filled up with
// Gaussians of no opacity. Laid out like the ctypes structure in kernel.py.
struct Part {
  int64_t blocks, first_chunk;
  int64_t sh_bases;          // 1, 4, 9 or 16
  int64_t antialiased;       // of the filter that it was made for
  const float* geometry;     // kFrozenColumns columns
  const uint16_t* colours;   // 3 sh_bases columns, half precision
  const float* bounds;       // kFrozenBounds a block
  float rotation[9], translation[3];  // camera_from_part
  float eps2d;               // of the filter that it was made for
};

struct Frame {
  // Inputs.
  int64_t count;
  int32_t sh_bases;  // 1, 4, 9 or 16
  int32_t width, height;    // of the images: the window of the whole image that is drawn
  int32_t left, top;        // corner of the window
  int32_t whole_width, whole_height;
  // Tiles that the window touches. They are tiles of the whole image, so that a pixel is the same sum
  // in every window.
  int32_t tiles_x, tiles_y;
  int32_t first_tile_x, first_tile_y;
  int32_t antialiased;
  int32_t training;
  int32_t folded;           // records are sums of all tiles, one a place
  float near_plane, far_plane, eps2d, max_alpha;
  float fx, fy, cx, cy;
  float rotation[9], translation[3];
  float background[3];
  const float *means, *quats, *log_scales, *logits, *sh;
  const Part* parts;         // instead of these, one more behind the last; null where there are none

  // Per place: the visible Gaussians of a chunk in the order of their rows, chunks kChunk apart.
  uint32_t* rows;
  Splat* splats;
  Placement* placements;
  uint8_t* lit;             // bit i: colour channel i is above zero

  // Per chunk.
  ChunkResult* chunks;
  const uint32_t* chunk_slots;  // first gradient record

  // Per Gaussian.
  uint8_t* visible;
  float* radii;
  float* means2d;

  // Per tile.
  uint32_t* tile_begin;     // tiles + 1
  Intersection* intersections;
  uint32_t listed;          // intersections there are
  int32_t* blocks;          // of a tile that an intersection reaches; null where they are not kept
  float* tile_state;        // rgb, depth, transmittance: 5 x kTilePixels floats, in block order

  // Images.
  float *rgb, *depth, *alpha;

  // Backward.
  const float *rgb_grad, *depth_grad, *alpha_grad;  // may be null
  float* records;           // kSums floats an intersection; where folded, a place
  float* absolute_records;  // kAbsoluteSums floats an intersection; null where not asked for
  uint8_t* record_used;
  float *means_grad, *quats_grad, *log_scales_grad, *logits_grad, *sh_grad, *means2d_grad;
  float* means2d_absgrad;    // null where not asked for
  double* pose_grad_chunks;  // 12 a chunk: rotation, translation
};

constexpr int kAdamLanes = 16;  // rows that a column pattern covers: enough for any vector width

struct AdamRows {
  float* value;
  const float* gradient;
  float *first, *second;
  // kAdamLanes rows each: learning rate over 1 - beta1^t, and the bounds of the value.
  const float *steps, *low, *high;
  int64_t width;  // floats a row
};

struct AdamSettings {
  float beta1, beta2;
  float rest1, rest2;  // 1 - beta, not rounded twice
  float epsilon;
  float correction;    // 1 / sqrt(1 - beta2^t)
};

constexpr int kWindowHalf = 5;  // taps of SSIM's window to either side of its centre

struct Photometric {
  const float *image, *target;  // height rows of `row` floats, three a pixel
  // Of the same shape: d SSIM by the blurred image, its square, and its product with the target.
  float *by_mean, *by_square, *by_product;
  double* sums;     // two a row: |image - target|, SSIM
  float* gradient;  // backward
  int64_t height, row;
  float window[kWindowHalf + 1];  // from the outermost tap to the centre
  float c1, c2;
  float l1, ssim;  // backward: factors of the two gradients
};

struct Kernels {
  const char* name;
  void (*project)(const Frame&, int64_t chunk);
  void (*project_frozen)(const Frame&, int64_t chunk);
  void (*raster)(const Frame&, int64_t tile);
  void (*raster_backward)(const Frame&, int64_t tile);
  void (*project_backward)(const Frame&, int64_t chunk);
  void (*adam)(const AdamRows&, const AdamSettings&, const uint8_t* visible, int64_t begin,
               int64_t end);
  void (*photometric)(const Photometric&, int64_t begin, int64_t end);
  void (*photometric_backward)(const Photometric&, int64_t begin, int64_t end);
};

}  // namespace recast
