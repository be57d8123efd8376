// The working memory of one view, kept between its forward and its backward pass and from frame to
// frame, and the order of the stages.
#pragma once
#include "binning.hpp"
#include "buffer.hpp"
#include "frame.hpp"

namespace recast {

enum Stage { kProject, kSort, kBin, kRaster, kRasterBackward, kProjectBackward, kStages };

class Context {
 public:
  // Inputs and images of `f` are filled in; returns 0, or a fault with its row, or -1 when there are
  // too many intersections.
  int forward(const Kernels& kernels, Frame f, int64_t* fault_row);
  // The same of frozen sets of Gaussians.
  int forward_frozen(const Kernels& kernels, Frame f, const Part* parts, int count);
  // Gradients of `g` are filled in; the rest comes from the last forward pass.
  void backward(const Kernels& kernels, const Frame& g, float* pose_grad);
  int64_t bytes() const;
  double milliseconds[kStages] = {};
  uint64_t intersections = 0;
  // Intersections that are listed together: what bounds the memory. An image with more is worked on
  // in bands of tiles, each with lists and gradient records of its own.
  uint64_t most_at_once = 1 << 24;

 private:
  Frame frame_ = {};
  Binning binning_;
  std::vector<Band> bands_;
  std::vector<Part> parts_;
  Buffer<Splat> splats_;
  Buffer<Placement> placements_;
  Buffer<uint32_t> rows_, tile_begin_;
  Buffer<ChunkResult> chunks_;
  Buffer<Intersection> intersections_;
  Buffer<int32_t> blocks_;
  Buffer<uint8_t> lit_, visible_, used_;
  Buffer<float> state_, records_, absolute_records_, sums_, absolute_sums_;
  Buffer<double> pose_;
};

}  // namespace recast
