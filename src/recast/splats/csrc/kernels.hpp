// The entry points of one instruction-set build.
#pragma once
#include "frame.hpp"

namespace recast {
namespace RECAST_ISA {

void project_chunk(const Frame& f, int64_t chunk);
void project_frozen_chunk(const Frame& f, int64_t chunk);
void raster_tile(const Frame& f, int64_t tile);
void raster_tile_backward(const Frame& f, int64_t tile);
void project_chunk_backward(const Frame& f, int64_t chunk);
void adam_rows(const AdamRows& a, const AdamSettings& settings, const uint8_t* visible,
               int64_t begin, int64_t end);
void photometric_rows(const Photometric& p, int64_t begin, int64_t end);
void photometric_rows_backward(const Photometric& p, int64_t begin, int64_t end);

}  // namespace RECAST_ISA
}  // namespace recast
