#include "binning.hpp"

#include <cstring>

#include "pool.hpp"

namespace recast {
namespace {

template <typename Visit>
inline void for_each_tile(Footprint print, int tiles_x, Visit visit) {
  const int w = int(print >> 28 & 0xFFF) + 1, h = int(print >> 16 & 0xFFF) + 1;
  const int base = int(print >> 40 & 0xFFF) * tiles_x + int(print >> 52);
  if (w > 4 || h > 4) {
    for (int j = 0; j < h; ++j)
      for (int i = 0; i < w; ++i) visit(base + j * tiles_x + i);
  } else {
    for (uint32_t mask = uint32_t(print & 0xFFFF); mask; mask &= mask - 1) {
      const int bit = __builtin_ctz(mask);
      visit(base + (bit >> 2) * tiles_x + (bit & 3));
    }
  }
}

inline uint32_t tiles_of(Footprint print) {
  const uint32_t w = uint32_t(print >> 28 & 0xFFF) + 1, h = uint32_t(print >> 16 & 0xFFF) + 1;
  return w > 4 || h > 4 ? w * h : uint32_t(__builtin_popcount(uint32_t(print & 0xFFFF)));
}

constexpr int kLeadBits = 8;
constexpr int kAhead = 24;  // Gaussians fetched in advance

// Sorts n pairs by bits 32 .. 32 + bits - 1, ties by the low half, which ascends already.
void sort_bucket(uint64_t* pairs, uint64_t* spare, uint32_t n, int bits) {
  if (n < 2 || bits == 0) return;
  if (n < 48) {
    for (uint32_t i = 1; i < n; ++i) {
      const uint64_t pair = pairs[i];
      uint32_t j = i;
      for (; j && pairs[j - 1] > pair; --j) pairs[j] = pairs[j - 1];
      pairs[j] = pair;
    }
    return;
  }
  // An even number of passes ends where it began.
  const int passes = bits <= 22 ? 2 : 4, width = (bits + passes - 1) / passes;
  uint32_t count[1 << 11];
  const uint32_t mask = (1u << width) - 1u;
  for (int pass = 0; pass < passes; ++pass) {
    const int shift = 32 + pass * width;
    std::memset(count, 0, (size_t(mask) + 1) * sizeof(uint32_t));
    for (uint32_t i = 0; i < n; ++i) ++count[pairs[i] >> shift & mask];
    uint32_t total = 0;
    for (uint32_t k = 0; k <= mask; ++k) {
      const uint32_t c = count[k];
      count[k] = total;
      total += c;
    }
    for (uint32_t i = 0; i < n; ++i) {
      const uint64_t pair = pairs[i];
      spare[count[pair >> shift & mask]++] = pair;
    }
    uint64_t* swap = pairs;
    pairs = spare;
    spare = swap;
  }
}

}  // namespace

uint64_t Binning::compact(Frame& f, int64_t chunks) {
  int64_t* offsets = chunk_offsets_.reserve(2 * (chunks + 1));
  int64_t visible = 0;
  uint64_t total = 0;
  key_min_ = ~0u;
  key_max_ = 0;
  for (int64_t c = 0; c < chunks; ++c) {
    offsets[2 * c] = visible;
    offsets[2 * c + 1] = int64_t(total);
    visible += f.chunks[c].visible;
    total += f.chunks[c].intersections;
    if (f.chunks[c].key_min < key_min_) key_min_ = f.chunks[c].key_min;
    if (f.chunks[c].key_max > key_max_) key_max_ = f.chunks[c].key_max;
  }
  visible_ = visible;
  if (total >= 0xFFFFFFFFull) return total;
  uint64_t* pairs = pairs_[0].reserve(visible + 1);
  pairs_[1].reserve(visible + 1);
  const uint32_t low = key_min_;
  parallel_for(chunks, [&f, offsets, pairs, low](int64_t c) {
    const uint32_t* ids = f.chunk_ids + c * kChunk;
    const uint32_t* keys = f.chunk_keys + c * kChunk;
    uint64_t* out = pairs + offsets[2 * c];
    uint32_t slot = uint32_t(offsets[2 * c + 1]);
    for (uint32_t i = 0; i < f.chunks[c].visible; ++i) {
      out[i] = uint64_t(keys[i] - low) << 32 | ids[i];
      f.slots[ids[i]] = slot;
      slot += tiles_of(f.footprints[ids[i]]);
    }
  });
  return total;
}

void Binning::sort() {
  uint64_t* pairs = pairs_[0].reserve(visible_ + 1);
  uint64_t* spare = pairs_[1].reserve(visible_ + 1);
  sorted_ = pairs;
  const uint32_t range = visible_ ? key_max_ - key_min_ : 0;
  if (range == 0) return;
  // First the leading bits, over all: few enough buckets for the first-level cache. Then the rest,
  // bucket by bucket, each in the cache and on a thread of its own.
  const int key_bits = 32 - __builtin_clz(range);
  const int lead = key_bits < kLeadBits ? key_bits : kLeadBits, left = key_bits - lead;
  const int64_t n = visible_, buckets = int64_t(1) << lead;
  const int64_t parts = n < 16384 ? 1 : thread_count();
  const int shift = 32 + left;
  uint32_t* counts = counts_.reserve((parts + 1) * buckets + 1);
  uint32_t* begins = counts + parts * buckets;
  parallel_for(parts, [=](int64_t p) {
    uint32_t* count = counts + p * buckets;
    std::memset(count, 0, size_t(buckets) * sizeof(uint32_t));
    for (int64_t i = n * p / parts; i < n * (p + 1) / parts; ++i) ++count[pairs[i] >> shift];
  });
  uint32_t total = 0;
  for (int64_t b = 0; b < buckets; ++b) {
    begins[b] = total;
    for (int64_t p = 0; p < parts; ++p) {
      const uint32_t c = counts[p * buckets + b];
      counts[p * buckets + b] = total;
      total += c;
    }
  }
  begins[buckets] = total;
  parallel_for(parts, [=](int64_t p) {
    uint32_t* next = counts + p * buckets;
    for (int64_t i = n * p / parts; i < n * (p + 1) / parts; ++i) {
      const uint64_t pair = pairs[i];
      spare[next[pair >> shift]++] = pair;
    }
  });
  parallel_for(buckets, [=](int64_t b) {
    sort_bucket(spare + begins[b], pairs + begins[b], begins[b + 1] - begins[b], left);
  });
  sorted_ = spare;
}

void Binning::scatter(Frame& f) {
  const int64_t n = visible_, tiles = int64_t(f.tiles_x) * f.tiles_y;
  const int64_t parts = n < 16384 ? 1 : thread_count();
  const int tiles_x = f.tiles_x;
  Placed* placed = placed_.reserve(n + 1);
  uint32_t* counts = counts_.reserve(parts * tiles);
  const uint64_t* sorted = sorted_;
  parallel_for(parts, [=, &f](int64_t p) {
    uint32_t* count = counts + p * tiles;
    std::memset(count, 0, size_t(tiles) * sizeof(uint32_t));
    for (int64_t i = n * p / parts; i < n * (p + 1) / parts; ++i) {
      // Depth order jumps all over the memory.
      if (i + kAhead < n) {
        __builtin_prefetch(f.footprints + uint32_t(sorted[i + kAhead]));
        __builtin_prefetch(f.slots + uint32_t(sorted[i + kAhead]));
      }
      const uint32_t id = uint32_t(sorted[i]);
      const Footprint print = f.footprints[id];
      placed[i] = {print, id, f.slots[id]};
      for_each_tile(print, tiles_x, [count](int tile) { ++count[tile]; });
    }
  });
  uint32_t total = 0;
  for (int64_t t = 0; t < tiles; ++t) {
    f.tile_begin[t] = total;
    for (int64_t p = 0; p < parts; ++p) {
      const uint32_t c = counts[p * tiles + t];
      counts[p * tiles + t] = total;
      total += c;
    }
  }
  f.tile_begin[tiles] = total;
  parallel_for(parts, [=, &f](int64_t p) {
    uint32_t* next = counts + p * tiles;
    Intersection* out = f.intersections;
    for (int64_t i = n * p / parts; i < n * (p + 1) / parts; ++i) {
      const Placed g = placed[i];
      uint32_t slot = g.slot;
      for_each_tile(g.print, tiles_x, [&](int tile) { out[next[tile]++] = {g.id, slot++}; });
    }
  });
}

int64_t Binning::bytes() const {
  return pairs_[0].bytes() + pairs_[1].bytes() + counts_.bytes() + placed_.bytes() +
         chunk_offsets_.bytes();
}

}  // namespace recast
