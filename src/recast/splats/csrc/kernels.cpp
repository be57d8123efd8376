// The table of this build, for run-time dispatch.
#include "kernels.hpp"

#define RECAST_TEXT2(x) #x
#define RECAST_TEXT(x) RECAST_TEXT2(x)
#define RECAST_JOIN2(a, b) a##b
#define RECAST_JOIN(a, b) RECAST_JOIN2(a, b)

namespace recast {

extern const Kernels RECAST_JOIN(kernels_, RECAST_ISA);
const Kernels RECAST_JOIN(kernels_, RECAST_ISA) = {
    RECAST_TEXT(RECAST_ISA),
    RECAST_ISA::project_chunk,
    RECAST_ISA::project_frozen_chunk,
    RECAST_ISA::raster_tile,
    RECAST_ISA::raster_tile_backward,
    RECAST_ISA::project_chunk_backward,
    RECAST_ISA::adam_rows,
    RECAST_ISA::photometric_rows,
    RECAST_ISA::photometric_rows_backward,
};

}  // namespace recast
