// Arithmetic of ray-traced frames: what `recast.synthetic.rendering` does with numpy, to the bit.
//
// The order of all float operations is that of the numpy code, and no product and sum are fused,
// so that images do not depend on whether this file was compiled. Tests compare the two.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#if defined(_WIN32)
#define RECAST_EXPORT extern "C" __declspec(dllexport)
#else
#define RECAST_EXPORT extern "C" __attribute__((visibility("default")))
#endif
// Wider vectors of the same operations where the machine has them.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__linux__)
#define RECAST_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define RECAST_WIDE
#endif

namespace {

struct Vector {
  float x, y, z;
};

inline Vector load(const float* rows, int64_t row) {
  return {rows[3 * row], rows[3 * row + 1], rows[3 * row + 2]};
}
inline void save(float* rows, int64_t row, Vector v) {
  rows[3 * row] = v.x, rows[3 * row + 1] = v.y, rows[3 * row + 2] = v.z;
}
inline float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector operator*(Vector a, float s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector turn(const float* rotation, Vector v) {
  return {dot(load(rotation, 0), v), dot(load(rotation, 1), v), dot(load(rotation, 2), v)};
}

// Half the likeness of `count` pairs of pixels; `plane` floats between the guide's channels.
RECAST_WIDE void pair_weights(const float* first, const float* second, int64_t plane,
                              int64_t count, float* weight) {
  const float *f0 = first, *f1 = f0 + plane, *f2 = f1 + plane, *f3 = f2 + plane;
  const float *f4 = f3 + plane, *f5 = f4 + plane, *f6 = f5 + plane;
  const float *s0 = second, *s1 = s0 + plane, *s2 = s1 + plane, *s3 = s2 + plane;
  const float *s4 = s3 + plane, *s5 = s4 + plane, *s6 = s5 + plane;
  for (int64_t i = 0; i < count; ++i) {
    float parallel = f3[i] * s3[i] + f4[i] * s4[i] + f5[i] * s5[i];
    float off = (s0[i] - f0[i]) * (f3[i] + s3[i]) + (s1[i] - f1[i]) * (f4[i] + s4[i]) +
                (s2[i] - f2[i]) * (f5[i] + s5[i]);
    off *= s6[i] < f6[i] ? s6[i] : f6[i];
    off *= off;
    parallel = parallel > 0 ? parallel : 0;
    parallel *= parallel, parallel *= parallel, parallel *= parallel, parallel *= parallel;
    off += 1;
    off *= off;
    weight[i] = parallel / off * 0.5f;
  }
}

// out[i] = (in[i] + before[i] in[i - step] + after[i] in[i + step]) / (1 + before[i] + after[i])
RECAST_WIDE void three_taps(const float* in, const float* before, const float* after,
                            int64_t step, int64_t count, float* out) {
  for (int64_t i = 0; i < count; ++i)
    out[i] = (in[i] + before[i] * in[i - step] + after[i] * in[i + step]) /
             (1.0f + before[i] + after[i]);
}

// `Light` of a point, borrowed from one of a frame's centre rays.
struct Borrowed {
  float total, light[4];
};

}  // namespace

// `LightFilter.smooth`: value (4, H, W) in place; guide (7, H, W). Channels before `channels[k]`
// are left out of the passes of `steps[k]`.
RECAST_EXPORT void recast_smooth(float* value, const float* guide, int64_t height, int64_t width,
                                 const int64_t* steps, const int64_t* channels, int64_t passes) {
  const int64_t plane = height * width;
  int64_t most = 0;
  for (int64_t k = 0; k < passes; ++k) most = std::max(most, steps[k]);
  const int64_t margin = most * std::max<int64_t>(width, 1);
  // Zeros on both sides: weights and values where there is no neighbour.
  std::vector<float> weight(plane + 2 * margin), padded(plane + 2 * margin);
  float *w = weight.data() + margin, *in = padded.data() + margin;
  for (int64_t k = 0; k < passes; ++k) {
    for (const bool down : {true, false}) {
      const int64_t step = steps[k];
      if ((down ? height : width) <= step) continue;
      const int64_t stride = down ? step * width : step;
      // w[i]: between i and i + stride.
      std::fill(weight.begin(), weight.end(), 0.0f);
      if (down) {
        pair_weights(guide, guide + stride, plane, plane - stride, w);
      } else {
        for (int64_t y = 0; y < height; ++y) {
          const float* row = guide + y * width;
          pair_weights(row, row + step, plane, width - step, w + y * width);
        }
      }
      for (int64_t c = channels[k]; c < 4; ++c) {
        std::copy_n(value + c * plane, plane, in);
        three_taps(in, w - stride, w, stride, plane, value + c * plane);
      }
    }
  }
}

// `borrow_light`: light (M, 4) of further points, sun first, and whether each found any.
//
// index (H, W): row of a pixel's own point, -1 for sky. `right`, `down`: towards the next pixels.
RECAST_EXPORT void recast_borrow(const float* position, const float* normal, const float* sun,
                                 const float* sky, const int32_t* index, int64_t height,
                                 int64_t width, const float* other_position,
                                 const float* other_normal, const float* other_distance,
                                 const int64_t* other_pixels, int64_t count, int64_t right,
                                 int64_t down, float tolerance, float least, float* light,
                                 uint8_t* found) {
  for (int64_t i = 0; i < count; ++i) {
    const Vector n = load(other_normal, i);
    const float sharp = 1 / (tolerance * (1 + 0.1f * other_distance[i]));
    const float foot = dot(load(other_position, i), n);
    const int64_t row = other_pixels[i] / width, column = other_pixels[i] % width;
    Borrowed sum = {};
    const auto add = [&](int64_t x, int64_t y) {
      x += column, y += row;
      if (x < 0 || y < 0 || x >= width || y >= height) return;
      const int64_t at = index[y * width + x];
      if (at < 0) return;
      const Vector near = load(normal, at);
      float weight = dot(near, n);
      weight = weight > 0 ? weight : 0;
      weight *= weight, weight *= weight, weight *= weight;
      const float off = (dot(load(position, at), n) - foot) * sharp;
      weight /= 1 + off * off;
      sum.total += weight;
      sum.light[0] += sun[at] * weight;
      for (int c = 0; c < 3; ++c) sum.light[1 + c] += sky[3 * at + c] * weight;
    };
    add(0, 0), add(right, 0), add(0, down), add(right, down);
    if (!(sum.total >= least)) {
      sum = {};
      for (int64_t y = -1; y <= 1; ++y)
        for (int64_t x = -1; x <= 1; ++x)
          if (!((x == 0 || x == right) && (y == 0 || y == down))) add(x, y);
    }
    found[i] = sum.total >= least;
    for (int c = 0; c < 4; ++c) light[4 * i + c] = found[i] ? sum.light[c] / sum.total : 0;
  }
}

// `surface_points` of `count` rays: positions, views, faces' and shading normals of what they met.
//
// face: rows of the attributes, of all instances. corners null: shading normals are the faces'.
RECAST_EXPORT void recast_surface(const int64_t* rays, int64_t count, const float* origins,
                                  const float* directions, const float* distances, const float* us,
                                  const float* vs, const uint16_t* instance, const int64_t* face,
                                  const float* flats, const float* corners, const float* rotations,
                                  float* position, float* view, float* flat, float* normal) {
  for (int64_t i = 0; i < count; ++i) {
    const int64_t ray = rays[i];
    const float* rotation = instance[i] ? rotations + 9 * instance[i] : nullptr;
    const Vector d = load(directions, ray);
    Vector f = load(flats, face[i]);
    if (rotation) f = turn(rotation, f);
    const float side = dot(d, f) > 0 ? -1.0f : 1.0f;
    f = f * side;
    save(view, i, d);
    save(flat, i, f);
    save(position, i, d * distances[ray] + load(origins, ray));
    if (!corners) continue;
    const float u = us[ray], v = vs[ray];
    const float* corner = corners + 9 * face[i];
    Vector n = load(corner, 0) * (1 - u - v) + load(corner, 1) * u + load(corner, 2) * v;
    if (rotation) n = turn(rotation, n);
    n = n * side;
    const float away = dot(d, n);
    n = n - d * (away > 0 ? away : 0);
    n = n + f * 1e-4f;
    save(normal, i, n * (1 / std::sqrt(dot(n, n))));
  }
}

// `edge_pixels`: marks in edge (H, W), zero before, the pixels that differ from a neighbour.
RECAST_EXPORT void recast_edges(const float* flat, const float* inverse, const float* grey,
                                const float* shown, const uint8_t* material,
                                const uint16_t* instance, const int32_t* index, int64_t height,
                                int64_t width, float colour_step, uint8_t* edge) {
  struct Look {
    Vector flat;
    float inverse, grey, shown;
    int material, instance;
  };
  const auto look = [&](int64_t pixel) {
    const int64_t at = index[pixel];
    if (at < 0) return Look{};
    return Look{load(flat, at), inverse[at], grey[at], shown[at], material[at], instance[at]};
  };
  const auto differ = [&](const Look& a, const Look& b) {
    const float low = std::min(a.inverse, b.inverse), high = std::max(a.inverse, b.inverse);
    return (dot(a.flat, b.flat) < 0.9f && high > 0) || (low < 0.8f * high && low > 0) ||
           std::abs(a.grey - b.grey) > colour_step || a.material != b.material ||
           std::abs(a.shown - b.shown) > 1 || a.instance != b.instance;
  };
  std::vector<Look> above(width), here(width);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const int64_t pixel = y * width + x;
      here[x] = look(pixel);
      if (x && differ(here[x - 1], here[x])) edge[pixel - 1] = edge[pixel] = 1;
      if (y && differ(above[x], here[x])) edge[pixel - width] = edge[pixel] = 1;
    }
    above.swap(here);
  }
}

// `_Spheres.entered`: distance (spheres, N) at which rays enter, at most; infinite where they miss.
RECAST_EXPORT void recast_entered(const float* centres, const float* radii, int64_t spheres,
                                  const float* origins, const float* directions, int64_t count,
                                  float* entry) {
  for (int64_t k = 0; k < spheres; ++k) {
    const Vector centre = load(centres, k);
    const float radius = radii[k], reach = radius * radius;
    for (int64_t i = 0; i < count; ++i) {
      const Vector to = centre - load(origins, i);
      const float along = dot(to, load(directions, i)), squared = dot(to, to);
      const bool missed = squared - along * along > reach || (squared > reach && along < 0);
      entry[k * count + i] = missed ? INFINITY : along - radius;
    }
  }
}

// Adds light (N, 3), no more than `clip`, to the sums of `pixels`.
RECAST_EXPORT void recast_expose(float* sums, const int64_t* pixels, const float* light,
                                 int64_t count, float clip) {
  for (int64_t i = 0; i < count; ++i)
    for (int k = 0; k < 3; ++k)
      sums[3 * pixels[i] + k] += light[3 * i + k] < clip ? light[3 * i + k] : clip;
}
