// Forward, per Gaussian: project, find the tiles, colour.
#define RECAST_EIGHT_LANES  // rows lie scattered: wider vectors gain nothing and spill
#include "geometry.hpp"
#include "harmonics.hpp"
#include "kernels.hpp"
#include "visible.hpp"

namespace recast {
namespace RECAST_ISA {
namespace {

inline vm all_below(const vf* x, int n, float limit) {
  vm m = vabs(x[0]) < vf(limit);
  for (int i = 1; i < n; ++i) m = m & (vabs(x[i]) < vf(limit));
  return m;
}

inline vm all_finite(const vf* x, int n) { return all_below(x, n, 3e38f); }

void note_fault(ChunkResult& result, vm good, uint32_t lanes, uint32_t row, uint32_t fault) {
  const uint32_t bad = ~bits(good) & lanes;
  if (bad && !result.fault) {
    result.fault = fault;
    result.fault_row = row + uint32_t(__builtin_ctz(bad));
  }
}

// The eight low bits as eight bytes.
inline uint64_t spread_bits(uint64_t b) {
  b = (b | b << 28) & 0x0000000F0000000Full;
  b = (b | b << 14) & 0x0003000300030003ull;
  return (b | b << 7) & 0x0101010101010101ull;
}

inline void store_upto(float* p, vf a, int lanes) {
  if (lanes == W)
    store(p, a);
  else
    store_first(p, a, lanes);
}

inline void store_pairs(float* p, const vf (&a)[2], int lanes) {
  alignas(64) float stage[2][W], both[2 * W];
  store(stage[0], a[0]);
  store(stage[1], a[1]);
  for (int i = 0; i < W; ++i) {
    both[2 * i] = stage[0][i];
    both[2 * i + 1] = stage[1][i];
  }
  if (lanes == W)
    __builtin_memcpy(p, both, sizeof both);
  else
    for (int i = 0; i < 2 * lanes; ++i) p[i] = both[i];
}

// Projects rows first .. first + lanes - 1 and appends the visible ones to the places from `base` on.
void project_group(const Frame& f, uint32_t first, int lanes, int64_t base, ChunkResult& result) {
  uint32_t rows[W];
  for (int i = 0; i < W; ++i) rows[i] = first + uint32_t(i < lanes ? i : lanes - 1);
  const uint32_t valid = (1u << lanes) - 1u;
  Parameters p;
  Projection o;
  load_parameters(f, rows, p);
  project(f, p, o);

  // In turn: no NaN passes a comparison, and a norm in range has finite parts.
  vm ok_scale = p.log_scale[0] < vf(14.0f);  // larger ones would overflow the determinant
  for (int i = 0; i < 3; ++i)
    ok_scale = ok_scale & (p.log_scale[i] < vf(14.0f)) & (p.log_scale[i] > vf(-60.0f));
  const vm ok_mean = all_below(p.mean, 3, kLargestInput);
  const vm ok_logit = all_below(&p.logit, 1, kLargestInput);
  const vm ok_norm = (o.norm2 > vf(1e-30f)) & (o.norm2 < vf(1e30f));
  if (__builtin_expect((bits(ok_mean & ok_scale & ok_logit & ok_norm) & valid) != valid, 0)) {
    note_fault(result, ok_mean, valid, first, kFaultMeans);
    note_fault(result, all_finite(p.quat, 4), valid, first, kFaultQuats);
    note_fault(result, ok_scale, valid, first, kFaultScales);
    note_fault(result, ok_logit, valid, first, kFaultOpacity);
    note_fault(result, ok_norm, valid, first, kFaultQuatNorm);
    return;
  }

  Seen seen;
  find_visible(f, o, o.opacity >= vf(kAlphaThreshold), vlog2(vmax(o.opacity, vf(1e-30f))), valid,
               seen);

  store_upto(f.radii + first, keep(seen.mask, vceil(vmax(seen.extent_x, seen.extent_y))), lanes);
  vf pixel[2] = {keep(seen.mask, o.x), keep(seen.mask, o.y)};
  store_pairs(f.means2d + 2 * int64_t(first), pixel, lanes);
  for (int i = 0; i < W; i += 8) {
    const uint64_t bytes = spread_bits(seen.lanes >> i & 0xFF);
    const int n = lanes - i < 8 ? lanes - i : 8;
    if (n > 0) __builtin_memcpy(f.visible + first + i, &bytes, size_t(n));
  }
  const vf rgb[3] = {vf(0.0f), vf(0.0f), vf(0.0f)};  // see `colour`
  if (seen.lanes) list_visible(f, o, seen, rgb, first, base, result);
}

template <int K>
void colour(const Frame& f, int64_t base, ChunkResult& result) {
  float offset[3];
  camera_offset(f, offset);
  const int n = int(result.visible);
  const uint32_t* ids = f.rows + base;
  for (int begin = 0; begin < n; begin += W) {
    uint32_t rows[W];
    for (int i = 0; i < W; ++i) rows[i] = ids[begin + i < n ? begin + i : n - 1];
    const int lanes = n - begin < W ? n - begin : W;
    const int ahead = begin + 2 * W, more = n - ahead < W ? n - ahead : W;
    prefetch_rows<3 * K>(f.sh, ids + ahead, more);
    vf mean[3], d[3], b[16], sh[kPadded<3 * K>];
    gather_columns(f.means, rows, mean);
    view_direction(mean, offset, d);
    harmonics<K>(d, b);
    load_rows<3 * K>(f.sh, rows, sh);
    vf c[3] = {vf(0.5f), vf(0.5f), vf(0.5f)};
    for (int k = 0; k < K; ++k)
      for (int j = 0; j < 3; ++j) c[j] = fma(b[k], sh[3 * k + j], c[j]);
    const vm good = all_finite(c, 3);
    if (bits(~good) && !result.fault) {
      const int lane = __builtin_ctz(bits(~good));
      result.fault = kFaultSh;
      result.fault_row = rows[lane];
    }
    alignas(64) float rgb[3][W];
    uint32_t lit[3];
    for (int j = 0; j < 3; ++j) {
      lit[j] = bits(c[j] > vf(0.0f));
      store(rgb[j], vmax(c[j], vf(0.0f)));
    }
    for (int i = 0; i < lanes; ++i) {
      f.lit[base + begin + i] = uint8_t((lit[0] >> i & 1) | (lit[1] >> i & 1) << 1 | (lit[2] >> i & 1) << 2);
      Splat& s = f.splats[base + begin + i];
      s.r = rgb[0][i];
      s.g = rgb[1][i];
      s.b = rgb[2][i];
    }
  }
}

}  // namespace

void project_chunk(const Frame& f, int64_t chunk) {
  ChunkResult result = {};
  result.key_min = ~0u;
  const int64_t begin = chunk * kChunk;
  const int64_t end = begin + kChunk < f.count ? begin + kChunk : f.count;
  for (int64_t first = begin; first < end && !result.fault; first += W)
    project_group(f, uint32_t(first), int(end - first < W ? end - first : W), begin, result);
  if (!result.fault) {
    if (f.sh_bases == 1) colour<1>(f, begin, result);
    if (f.sh_bases == 4) colour<4>(f, begin, result);
    if (f.sh_bases == 9) colour<9>(f, begin, result);
    if (f.sh_bases == 16) colour<16>(f, begin, result);
  }
  f.chunks[chunk] = result;
}

}  // namespace RECAST_ISA
}  // namespace recast
