// From visible Gaussians to a list of intersections a tile, nearest first.
#pragma once
#include <vector>

#include "buffer.hpp"
#include "frame.hpp"

namespace recast {

// Rows of tiles that are worked on together, because their lists fit into memory.
struct Band {
  int first, end;          // rows of tiles
  uint64_t intersections;  // of them
};

class Binning {
 public:
  // Compacts the chunks' visible Gaussians; returns the number of intersections.
  uint64_t compact(Frame& f, int64_t chunks);
  // Orders them by depth, those of equal depth by place.
  void sort();
  // Cuts the image into bands of at most `most` intersections, or of one row of tiles.
  std::vector<Band> bands(const Frame& f, int64_t chunks, uint64_t total, uint64_t most);
  // Scatters them to the tiles of a band, keeping their order. Fills f.chunk_slots and the slots of
  // f.placements with the gradient records in the band, f.tile_begin and f.intersections.
  void scatter(Frame& f, int64_t chunks, const Band& band);
  // Adds the band's gradient records of each Gaussian, `sums` floats each, to its place in `out`.
  void fold(const Frame& f, int64_t chunks, const Band& band, const float* records, int sums,
            float* out) const;
  int64_t bytes() const;

 private:
  void number(Frame& f, int64_t chunks, const Band& band);

  int64_t visible_ = 0;
  uint32_t key_min_ = 0, key_max_ = 0;
  uint64_t* sorted_ = nullptr;  // key in the high half, place in the low half
  Buffer<uint64_t> pairs_[2];
  Buffer<uint32_t> counts_;
  struct Placed {
    Footprint print;
    uint32_t place, slot;
  };
  Buffer<Placed> placed_;
  Buffer<int64_t> chunk_offsets_;
  Buffer<uint32_t> chunk_slots_;
};

}  // namespace recast
