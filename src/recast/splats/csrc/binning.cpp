#include "binning.hpp"

#include <cstring>

#include "pool.hpp"

namespace recast {
namespace {

// The part of a footprint in the rows of tiles [first, end); an empty mask where there is none.
inline Footprint clipped(Footprint print, int first, int end) {
  const int w = int(print >> 28 & 0xFFF) + 1, h = int(print >> 16 & 0xFFF) + 1;
  const int y = int(print >> 40 & 0xFFF);
  const int low = y > first ? y : first, high = y + h < end ? y + h : end;
  if (low == y && high == y + h) return print;
  if (low >= high) return 0;
  const bool large = w > 4 || h > 4;
  const uint32_t rows = uint32_t(high - low);
  // A rectangle of more than 4x4 tiles has no mask: where it becomes small, it gets a full one.
  const uint32_t full = ((2u << (w - 1)) - 1u) * 0x1111u;
  uint32_t mask = large ? (w > 4 ? 0u : full) : uint32_t(print & 0xFFFF) >> (4 * (low - y));
  if (rows < 4) mask &= (1u << (4 * rows)) - 1u;
  const Footprint kept = print >> 52 << 52 | (print >> 28 & 0xFFF) << 28;
  return kept | Footprint(low) << 40 | Footprint(rows - 1) << 16 | (mask & 0xFFFF);
}

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
  int64_t* offsets = chunk_offsets_.reserve(chunks + 1);
  int64_t visible = 0;
  uint64_t total = 0;
  key_min_ = ~0u;
  key_max_ = 0;
  for (int64_t c = 0; c < chunks; ++c) {
    offsets[c] = visible;
    visible += f.chunks[c].visible;
    total += f.chunks[c].intersections;
    if (f.chunks[c].key_min < key_min_) key_min_ = f.chunks[c].key_min;
    if (f.chunks[c].key_max > key_max_) key_max_ = f.chunks[c].key_max;
  }
  visible_ = visible;
  uint64_t* pairs = pairs_[0].reserve(visible + 1);
  pairs_[1].reserve(visible + 1);
  const uint32_t low = key_min_;
  parallel_for(chunks, [&f, offsets, pairs, low](int64_t c) {
    const uint32_t first = uint32_t(c * kChunk);
    uint64_t* out = pairs + offsets[c];
    for (uint32_t i = 0; i < f.chunks[c].visible; ++i)
      out[i] = uint64_t(f.placements[first + i].key - low) << 32 | (first + i);
  });
  return total;
}

std::vector<Band> Binning::bands(const Frame& f, int64_t chunks, uint64_t total, uint64_t most) {
  if (total <= most) return {{0, f.tiles_y, total}};
  std::vector<uint64_t> rows(size_t(f.tiles_y), 0);
  for (int64_t c = 0; c < chunks; ++c)
    for (uint32_t i = 0; i < f.chunks[c].visible; ++i) {
      const Footprint print = f.placements[c * kChunk + i].print;
      const int y = int(print >> 40 & 0xFFF), h = int(print >> 16 & 0xFFF) + 1;
      for (int j = y; j < y + h; ++j) rows[size_t(j)] += tiles_of(clipped(print, j, j + 1));
    }
  std::vector<Band> found;
  for (int y = 0; y < f.tiles_y; ++y) {
    const uint64_t here = rows[size_t(y)];
    if (found.empty() || found.back().intersections + here > most)
      found.push_back({y, y + 1, here});
    else
      found.back() = {found.back().first, y + 1, found.back().intersections + here};
  }
  return found;
}

void Binning::number(Frame& f, int64_t chunks, const Band& band) {
  uint32_t* firsts = chunk_slots_.reserve(chunks + 1);
  const bool whole = band.first == 0 && band.end == f.tiles_y;
  parallel_for(chunks, [=, &f](int64_t c) {
    uint32_t count = uint32_t(f.chunks[c].intersections);
    if (!whole) {
      count = 0;
      for (uint32_t i = 0; i < f.chunks[c].visible; ++i) {
        Placement& place = f.placements[c * kChunk + i];
        place.slot = count;
        count += tiles_of(clipped(place.print, band.first, band.end));
      }
    }
    firsts[c] = count;
  });
  uint32_t total = 0;
  for (int64_t c = 0; c < chunks; ++c) {
    const uint32_t count = firsts[c];
    firsts[c] = total;
    total += count;
  }
  f.chunk_slots = firsts;
}

void Binning::fold(const Frame& f, int64_t chunks, const Band& band, const float* records,
                   int sums, float* out) const {
  parallel_for(chunks, [=, &f](int64_t c) {
    for (uint32_t i = 0; i < f.chunks[c].visible; ++i) {
      const int64_t place = c * kChunk + i;
      const uint32_t first = f.chunk_slots[c] + f.placements[place].slot;
      const uint32_t end =
          first + tiles_of(clipped(f.placements[place].print, band.first, band.end));
      float* row = out + place * sums;
      for (uint32_t k = first; k < end; ++k)
        if (f.record_used[k])
          for (int j = 0; j < sums; ++j) row[j] += records[int64_t(k) * sums + j];
    }
  });
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

void Binning::scatter(Frame& f, int64_t chunks, const Band& band) {
  number(f, chunks, band);
  const int64_t n = visible_;
  const int64_t first = int64_t(f.tiles_x) * band.first, tiles = int64_t(f.tiles_x) * band.end - first;
  const int64_t parts = n < 16384 ? 1 : thread_count();
  const int tiles_x = f.tiles_x;
  const bool whole = band.first == 0 && band.end == f.tiles_y;
  Placed* placed = placed_.reserve(n + 1);
  uint32_t* counts = counts_.reserve(parts * tiles);
  const uint64_t* sorted = sorted_;
  parallel_for(parts, [=, &f](int64_t p) {
    std::memset(counts + p * tiles, 0, size_t(tiles) * sizeof(uint32_t));
    uint32_t* count = counts + p * tiles - first;  // by tile of the image
    const int64_t begin = n * p / parts, end = n * (p + 1) / parts;
    for (int64_t i = begin; i < end; ++i) {
      // Depth order jumps all over the memory.
      if (i + kAhead < n) __builtin_prefetch(f.placements + uint32_t(sorted[i + kAhead]));
      const uint32_t place = uint32_t(sorted[i]);
      const Placement& g = f.placements[place];
      placed[i] = {g.print, place, f.chunk_slots[place / kChunk] + g.slot};
      if (whole) for_each_tile(g.print, tiles_x, [count](int tile) { ++count[tile]; });
    }
    if (whole) return;
    for (int64_t i = begin; i < end; ++i) {
      placed[i].print = clipped(placed[i].print, band.first, band.end);
      for_each_tile(placed[i].print, tiles_x, [count](int tile) { ++count[tile]; });
    }
  });
  uint32_t total = 0;
  for (int64_t t = 0; t < tiles; ++t) {
    f.tile_begin[first + t] = total;
    for (int64_t p = 0; p < parts; ++p) {
      const uint32_t c = counts[p * tiles + t];
      counts[p * tiles + t] = total;
      total += c;
    }
  }
  f.tile_begin[first + tiles] = f.listed = total;
  parallel_for(parts, [=, &f](int64_t p) {
    uint32_t* next = counts + p * tiles - first;
    Intersection* out = f.intersections;
    for (int64_t i = n * p / parts; i < n * (p + 1) / parts; ++i) {
      const Placed g = placed[i];
      uint32_t slot = g.slot;
      for_each_tile(g.print, tiles_x, [&](int tile) { out[next[tile]++] = {g.place, slot++}; });
    }
  });
}

int64_t Binning::bytes() const {
  return pairs_[0].bytes() + pairs_[1].bytes() + counts_.bytes() + placed_.bytes() +
         chunk_offsets_.bytes() + chunk_slots_.bytes();
}

}  // namespace recast
