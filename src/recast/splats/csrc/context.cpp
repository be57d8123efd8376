#include "context.hpp"

#include <cstring>
#include <ctime>

#include "pool.hpp"

namespace recast {
namespace {

// Processor time of the whole process: what a stage costs, whoever else uses the machine.
double cpu_milliseconds() {
#if defined(CLOCK_PROCESS_CPUTIME_ID)
  timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return double(t.tv_sec) * 1e3 + double(t.tv_nsec) * 1e-6;
#else
  return double(std::clock()) * 1e3 / CLOCKS_PER_SEC;
#endif
}

int64_t chunk_count(const Frame& f) { return (f.count + kChunk - 1) / kChunk; }
int64_t part_chunks(const Part& p) {
  return (p.blocks * kFrozenBlock + kChunk - 1) / kChunk;
}
int64_t tile_count(const Frame& f) { return int64_t(f.tiles_x) * f.tiles_y; }

template <typename Visit>
void for_tiles(const Frame& f, const Band& band, Visit visit) {
  const int64_t first = int64_t(band.first) * f.tiles_x;
  parallel_for(int64_t(band.end) * f.tiles_x - first, [&](int64_t t) { visit(first + t); });
}

float* zeros(Buffer<float>& buffer, int64_t count) {
  float* out = buffer.reserve(count + kPastRecord);
  std::memset(out, 0, size_t(count) * sizeof(float));
  return out;
}

}  // namespace

int Context::forward(const Kernels& kernels, Frame f, int64_t* fault_row) {
  const int64_t chunks = chunk_count(f);
  f.first_tile_x = f.left / kTile;
  f.first_tile_y = f.top / kTile;
  f.tiles_x = (f.left + f.width + kTile - 1) / kTile - f.first_tile_x;
  f.tiles_y = (f.top + f.height + kTile - 1) / kTile - f.first_tile_y;
  const int64_t tiles = tile_count(f);
  double start = cpu_milliseconds();
  const auto add = [&](Stage stage) {
    const double now = cpu_milliseconds();
    milliseconds[stage] += now - start;
    start = now;
  };
  const auto lap = [&](Stage stage) {
    milliseconds[stage] = 0;
    add(stage);
  };

  const int64_t places = chunks * kChunk;
  f.rows = rows_.reserve(places);
  f.splats = splats_.reserve(places);
  f.placements = placements_.reserve(places);
  f.lit = lit_.reserve(places);
  f.chunks = chunks_.reserve(chunks);
  if (f.parts) {
    parallel_for(chunks, [&](int64_t c) { kernels.project_frozen(f, c); });
  } else {
    uint8_t* given = f.visible;
    f.visible = visible_.reserve(f.count);
    parallel_for(chunks, [&](int64_t c) { kernels.project(f, c); });
    if (f.count) std::memcpy(given, f.visible, size_t(f.count));
  }
  for (int64_t c = 0; c < chunks; ++c)
    if (f.chunks[c].fault) {
      *fault_row = f.chunks[c].fault_row;
      return int(f.chunks[c].fault);
    }
  intersections = binning_.compact(f, chunks);
  lap(kProject);
  binning_.sort();
  lap(kSort);
  bands_ = binning_.bands(f, chunks, intersections, most_at_once);
  uint64_t most = 0;
  for (const Band& band : bands_) most = band.intersections > most ? band.intersections : most;
  if (most >= 0xFFFFFFFFull) return -1;
  f.tile_begin = tile_begin_.reserve(tiles + 1);
  f.intersections = intersections_.reserve(int64_t(most) + 1);
  // In bands the intersections of one take the place of those of another.
  f.blocks = f.training && bands_.size() == 1 ? blocks_.reserve(int64_t(most) + 1) : nullptr;
  if (f.training) f.tile_state = state_.reserve(tiles * 5 * kTilePixels);
  milliseconds[kBin] = milliseconds[kRaster] = 0;
  for (const Band& band : bands_) {
    binning_.scatter(f, chunks, band);
    add(kBin);
    for_tiles(f, band, [&](int64_t t) { kernels.raster(f, t); });
    add(kRaster);
  }
  frame_ = f;
  return 0;
}

int Context::forward_frozen(const Kernels& kernels, Frame f, const Part* parts, int count) {
  parts_.assign(parts, parts + count);
  parts_.push_back({});
  int64_t chunks = 0;
  for (Part& part : parts_) {
    part.first_chunk = chunks;
    chunks += part_chunks(part);
  }
  f.parts = parts_.data();
  f.count = chunks * kChunk;
  int64_t row;
  return forward(kernels, f, &row);
}

void Context::backward(const Kernels& kernels, const Frame& g, float* pose_grad) {
  Frame f = frame_;
  f.means = g.means;
  f.quats = g.quats;
  f.log_scales = g.log_scales;
  f.logits = g.logits;
  f.sh = g.sh;
  f.rgb_grad = g.rgb_grad;
  f.depth_grad = g.depth_grad;
  f.alpha_grad = g.alpha_grad;
  f.means_grad = g.means_grad;
  f.quats_grad = g.quats_grad;
  f.log_scales_grad = g.log_scales_grad;
  f.logits_grad = g.logits_grad;
  f.sh_grad = g.sh_grad;
  f.means2d_grad = g.means2d_grad;
  f.means2d_absgrad = g.means2d_absgrad;
  const int64_t chunks = chunk_count(f), places = chunks * kChunk;
  double start = cpu_milliseconds();
  const bool several = bands_.size() > 1;
  float *sums = nullptr, *absolute_sums = nullptr;
  if (several) {
    sums = zeros(sums_, places * kSums);
    if (f.means2d_absgrad) absolute_sums = zeros(absolute_sums_, places * kAbsoluteSums);
  }
  f.folded = 0;
  f.absolute_records = nullptr;
  for (const Band& band : bands_) {
    if (several) binning_.scatter(f, chunks, band);
    const int64_t count = int64_t(band.intersections);
    f.records = records_.reserve(count * kSums + kPastRecord);
    if (f.means2d_absgrad)
      f.absolute_records = absolute_records_.reserve(count * kAbsoluteSums + kPastRecord);
    f.record_used = used_.reserve(count + 1);
    std::memset(f.record_used, 0, size_t(count));
    for_tiles(f, band, [&](int64_t t) { kernels.raster_backward(f, t); });
    if (!several) continue;
    binning_.fold(f, chunks, band, f.records, kSums, sums);
    if (absolute_sums)
      binning_.fold(f, chunks, band, f.absolute_records, kAbsoluteSums, absolute_sums);
  }
  if (several) {
    f.folded = 1;
    f.records = sums;
    f.absolute_records = absolute_sums;
  }
  double now = cpu_milliseconds();
  milliseconds[kRasterBackward] = now - start;
  start = now;
  f.pose_grad_chunks = pose_.reserve(12 * chunks + 1);
  parallel_for(chunks, [&](int64_t c) { kernels.project_backward(f, c); });
  double pose[12] = {};
  for (int64_t c = 0; c < chunks; ++c)
    for (int i = 0; i < 12; ++i) pose[i] += f.pose_grad_chunks[12 * c + i];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) pose_grad[4 * i + j] = float(pose[3 * i + j]);
    pose_grad[4 * i + 3] = float(pose[9 + i]);
  }
  milliseconds[kProjectBackward] = cpu_milliseconds() - start;
}

int64_t Context::bytes() const {
  return binning_.bytes() + rows_.bytes() + splats_.bytes() + placements_.bytes() +
         tile_begin_.bytes() + chunks_.bytes() + intersections_.bytes() +
         visible_.bytes() + lit_.bytes() + blocks_.bytes() + used_.bytes() + state_.bytes() +
         records_.bytes() +
         absolute_records_.bytes() + sums_.bytes() + absolute_sums_.bytes() + pose_.bytes();
}

}  // namespace recast
