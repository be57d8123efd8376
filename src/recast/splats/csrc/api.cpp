// The C interface, and the choice of instruction set at run time.
#include <cstdlib>
#include <cstring>
#include <new>

#include "context.hpp"
#include "pool.hpp"
#include "sky.hpp"

#if defined(_WIN32)
#define RECAST_EXPORT extern "C" __declspec(dllexport)
#else
#define RECAST_EXPORT extern "C" __attribute__((visibility("default")))
#endif

namespace recast {

extern const Kernels kernels_portable;
#if defined(RECAST_X86)
extern const Kernels kernels_avx2;
extern const Kernels kernels_avx512;
#endif

namespace {

constexpr int kAbi = 6;

// Best first.
int available(const Kernels** out) {
  int n = 0;
#if defined(RECAST_X86)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
    out[n++] = &kernels_avx512;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
      __builtin_cpu_supports("f16c")) out[n++] = &kernels_avx2;
#endif
  out[n++] = &kernels_portable;
  return n;
}

const Kernels* chosen = nullptr;

const Kernels& kernels() {
  if (!chosen) {
    const Kernels* all[3];
    available(all);
    chosen = all[0];
  }
  return *chosen;
}

}  // namespace
}  // namespace recast

using recast::Context;
using recast::Frame;
using recast::Kernels;

RECAST_EXPORT int recast_abi() { return recast::kAbi; }

// Name of the i-th instruction set this machine runs, best first; null past the end.
RECAST_EXPORT const char* recast_isa_available(int i) {
  const Kernels* all[3];
  const int n = recast::available(all);
  return i >= 0 && i < n ? all[i]->name : nullptr;
}

RECAST_EXPORT const char* recast_isa() { return recast::kernels().name; }

// 0 on success, 1 if this machine or this build does not have it.
RECAST_EXPORT int recast_set_isa(const char* name) {
  const Kernels* all[3];
  const int n = recast::available(all);
  for (int i = 0; i < n; ++i)
    if (std::strcmp(all[i]->name, name) == 0) {
      recast::chosen = all[i];
      return 0;
    }
  return 1;
}

RECAST_EXPORT int recast_threads() { return recast::thread_count(); }
RECAST_EXPORT void recast_set_threads(int n) { recast::set_thread_count(n); }

RECAST_EXPORT Context* recast_create() { return new (std::nothrow) Context(); }
RECAST_EXPORT void recast_destroy(Context* c) { delete c; }

// What crosses the border: laid out like the ctypes structures in kernel.py.
struct RecastView {
  int64_t count;
  int32_t sh_bases, width, height, left, top, whole_width, whole_height;
  int32_t antialiased, training, most_at_once;
  float near_plane, far_plane, eps2d, max_alpha;
  float fx, fy, cx, cy;
  float rotation[9], translation[3], background[3], pad;
  const float *means, *quats, *log_scales, *logits, *sh;
  float *rgb, *depth, *alpha;
  uint8_t* visible;
  float *radii, *means2d;
};

struct RecastGradients {
  const float *means, *quats, *log_scales, *logits, *sh;
  const float *rgb, *depth, *alpha;
  float *means_grad, *quats_grad, *log_scales_grad, *logits_grad, *sh_grad, *means2d_grad;
  float* pose_grad;  // 3x4
  float* means2d_absgrad;  // null: not asked for
};

static Frame frame_of(const RecastView* v) {
  Frame f = {};
  f.count = v->count;
  f.sh_bases = v->sh_bases;
  f.width = v->width;
  f.height = v->height;
  f.left = v->left;
  f.top = v->top;
  f.whole_width = v->whole_width;
  f.whole_height = v->whole_height;
  f.antialiased = v->antialiased;
  f.training = v->training;
  f.near_plane = v->near_plane;
  f.far_plane = v->far_plane;
  f.eps2d = v->eps2d;
  f.max_alpha = v->max_alpha;
  f.fx = v->fx;
  f.fy = v->fy;
  f.cx = v->cx;
  f.cy = v->cy;
  std::memcpy(f.rotation, v->rotation, sizeof f.rotation);
  std::memcpy(f.translation, v->translation, sizeof f.translation);
  std::memcpy(f.background, v->background, sizeof f.background);
  f.means = v->means;
  f.quats = v->quats;
  f.log_scales = v->log_scales;
  f.logits = v->logits;
  f.sh = v->sh;
  f.rgb = v->rgb;
  f.depth = v->depth;
  f.alpha = v->alpha;
  f.visible = v->visible;
  f.radii = v->radii;
  f.means2d = v->means2d;
  return f;
}

// 0; a Fault (> 0) with its row; -1 too many intersections; -2 out of memory.
RECAST_EXPORT int recast_forward(Context* c, const RecastView* v, int64_t* fault_row) {
  if (v->most_at_once > 0) c->most_at_once = uint64_t(v->most_at_once);
  try {
    return c->forward(recast::kernels(), frame_of(v), fault_row);
  } catch (const std::bad_alloc&) {
    return -2;
  }
}

// The same of `count` frozen parts instead of the Gaussians of the view.
RECAST_EXPORT int recast_forward_frozen(Context* c, const RecastView* v, const recast::Part* parts,
                                        int count) {
  if (v->most_at_once > 0) c->most_at_once = uint64_t(v->most_at_once);
  try {
    return c->forward_frozen(recast::kernels(), frame_of(v), parts, count);
  } catch (const std::bad_alloc&) {
    return -2;
  }
}

RECAST_EXPORT int recast_backward(Context* c, const RecastGradients* g) {
  Frame f = {};
  f.means = g->means;
  f.quats = g->quats;
  f.log_scales = g->log_scales;
  f.logits = g->logits;
  f.sh = g->sh;
  f.rgb_grad = g->rgb;
  f.depth_grad = g->depth;
  f.alpha_grad = g->alpha;
  f.means_grad = g->means_grad;
  f.quats_grad = g->quats_grad;
  f.log_scales_grad = g->log_scales_grad;
  f.logits_grad = g->logits_grad;
  f.sh_grad = g->sh_grad;
  f.means2d_grad = g->means2d_grad;
  f.means2d_absgrad = g->means2d_absgrad;
  try {
    c->backward(recast::kernels(), f, g->pose_grad);
    return 0;
  } catch (const std::bad_alloc&) {
    return -2;
  }
}

// CPU ms of the last passes: project and colour, sort, bin, raster, raster back, project back.
RECAST_EXPORT void recast_timings(const Context* c, double* out) {
  std::memcpy(out, c->milliseconds, sizeof c->milliseconds);
}
RECAST_EXPORT int64_t recast_bytes(const Context* c) { return c->bytes(); }
RECAST_EXPORT uint64_t recast_intersections(const Context* c) { return c->intersections; }

RECAST_EXPORT void recast_adam(const recast::AdamRows* tensors, int count,
                               const recast::AdamSettings* settings, const uint8_t* visible,
                               int64_t rows) {
  const int64_t part = 4096, parts = (rows + part - 1) / part;
  const Kernels& kernels = recast::kernels();
  recast::parallel_for(parts, [&](int64_t p) {
    const int64_t end = (p + 1) * part < rows ? (p + 1) * part : rows;
    for (int i = 0; i < count; ++i) kernels.adam(tensors[i], *settings, visible, p * part, end);
  });
}

// `rows` runs on all rows of an image, a few at a time.
static void for_rows(const recast::Photometric& p,
                     void (*rows)(const recast::Photometric&, int64_t, int64_t)) {
  const int64_t part = 8;
  recast::parallel_for((p.height + part - 1) / part, [&](int64_t i) {
    rows(p, i * part, (i + 1) * part < p.height ? (i + 1) * part : p.height);
  });
}

RECAST_EXPORT void recast_photometric(const recast::Photometric* p) {
  for_rows(*p, recast::kernels().photometric);
}
RECAST_EXPORT void recast_photometric_backward(const recast::Photometric* p) {
  for_rows(*p, recast::kernels().photometric_backward);
}

RECAST_EXPORT void recast_sky(const recast::Sky* s) { recast::sky_forward(*s); }
RECAST_EXPORT void recast_sky_backward(const recast::Sky* s) { recast::sky_backward(*s); }
