// From visible Gaussians to a list of intersections a tile, nearest first.
#pragma once
#include "buffer.hpp"
#include "frame.hpp"

namespace recast {

class Binning {
 public:
  // Compacts the chunks' visible Gaussians and assigns gradient records; returns the number of
  // intersections.
  uint64_t compact(Frame& f, int64_t chunks);
  // Orders them by depth, those of equal depth by row.
  void sort();
  // Scatters them to their tiles, keeping that order. Fills f.tile_begin and f.intersections.
  void scatter(Frame& f);
  int64_t bytes() const;

 private:
  int64_t visible_ = 0;
  uint32_t key_min_ = 0, key_max_ = 0;
  uint64_t* sorted_ = nullptr;  // key in the high half, row in the low half
  Buffer<uint64_t> pairs_[2];
  Buffer<uint32_t> counts_;
  struct Placed {
    Footprint print;
    uint32_t id, slot;
  };
  Buffer<Placed> placed_;
  Buffer<int64_t> chunk_offsets_;
};

}  // namespace recast
